//! TLS 1.3 with raw Ed25519 keys (RFC 7250) at both ends. The handshake proves that the other end has a key. Its credential
//! shows afterwards whether that key is trusted. No certificate is parsed, and no certificate authority is trusted.

use rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use rustls::client::{AlwaysResolvesClientRawPublicKeys, Resumption};
use rustls::crypto::ring::{default_provider, sign::any_eddsa_type};
use rustls::crypto::{CryptoProvider, verify_tls13_signature_with_raw_key};
use rustls::pki_types::{CertificateDer, PrivatePkcs8KeyDer, ServerName, SubjectPublicKeyInfoDer, UnixTime};
use rustls::server::danger::{ClientCertVerified, ClientCertVerifier};
use rustls::server::{AlwaysResolvesServerRawPublicKeys, NoServerSessionStorage};
use rustls::sign::CertifiedKey;
use rustls::version::TLS13;
use rustls::{
    CertificateError, ClientConfig, CommonState, DigitallySignedStruct, DistinguishedName, Error, ServerConfig,
    SignatureScheme,
};
use std::sync::Arc;
use tokio_rustls::{TlsAcceptor, TlsConnector};
use zeroize::Zeroizing;

/// The name of the protocol inside, so that no other use of the same keys fits.
const PROTOCOL: &[u8] = b"dca-tunnel-1";
/// The bytes before a public key in its `SubjectPublicKeyInfo`. Source: RFC 8410, section 10.1.
const PUBLIC_PREFIX: [u8; 12] = [0x30, 0x2a, 0x30, 0x05, 0x06, 0x03, 0x2b, 0x65, 0x70, 0x03, 0x21, 0x00];
/// The bytes before a secret key in its PKCS #8 form. Source: RFC 8410, section 7.
const SECRET_PREFIX: [u8; 16] =
    [0x30, 0x2e, 0x02, 0x01, 0x00, 0x30, 0x05, 0x06, 0x03, 0x2b, 0x65, 0x70, 0x04, 0x22, 0x04, 0x20];

/// A public Ed25519 key. Source: RFC 8032, section 5.1.5.
pub type PublicKey = [u8; 32];

/// Both roles of TLS with one key.
#[derive(Clone)]
pub(super) struct Tls {
    pub(super) connector: TlsConnector,
    pub(super) acceptor: TlsAcceptor,
}

impl Tls {
    /// Takes the secret key and its public one.
    pub(super) fn new(secret: &Zeroizing<[u8; 32]>, public: &PublicKey) -> Result<Self, Error> {
        let provider = Arc::new(default_provider());
        let pkcs8 = Zeroizing::new([&SECRET_PREFIX[..], &secret[..]].concat());
        let signing = any_eddsa_type(&PrivatePkcs8KeyDer::from(&pkcs8[..]))?;
        let info = CertificateDer::from([&PUBLIC_PREFIX[..], public].concat());
        let own = Arc::new(CertifiedKey::new(vec![info], signing));
        let any_key = Arc::new(AnyKey(Arc::clone(&provider)));
        let client = ClientConfig::builder_with_provider(Arc::clone(&provider)).with_protocol_versions(&[&TLS13])?;
        let client = client.dangerous().with_custom_certificate_verifier(Arc::clone(&any_key) as _);
        let mut client =
            client.with_client_cert_resolver(Arc::new(AlwaysResolvesClientRawPublicKeys::new(Arc::clone(&own))));
        client.resumption = Resumption::disabled();
        client.enable_sni = false;
        client.alpn_protocols = vec![PROTOCOL.to_vec()];
        let server = ServerConfig::builder_with_provider(provider).with_protocol_versions(&[&TLS13])?;
        let server = server.with_client_cert_verifier(any_key);
        let mut server = server.with_cert_resolver(Arc::new(AlwaysResolvesServerRawPublicKeys::new(own)));
        server.session_storage = Arc::new(NoServerSessionStorage {});
        server.send_tls13_tickets = 0;
        server.alpn_protocols = vec![PROTOCOL.to_vec()];
        Ok(Self { connector: Arc::new(client).into(), acceptor: Arc::new(server).into() })
    }
}

/// Returns the server name that TLS requires from a client; the server ignores it.
pub(super) fn server_name() -> ServerName<'static> {
    ServerName::try_from("dca.invalid").expect("it is a name")
}

/// Returns the key that the other end has proved to have.
pub(super) fn peer_key(connection: &CommonState) -> Result<PublicKey, String> {
    let info = connection.peer_certificates().and_then(<[_]>::first).ok_or("it has shown no key")?;
    if connection.alpn_protocol() != Some(PROTOCOL) {
        return Err("it speaks another protocol".to_owned());
    }
    key(info).ok_or_else(|| "it has shown another kind of key".to_owned())
}

fn key(info: &CertificateDer<'_>) -> Option<PublicKey> {
    info.as_ref().strip_prefix(&PUBLIC_PREFIX)?.try_into().ok()
}

/// Accepts any Ed25519 key, and checks that the other end has its secret key.
#[derive(Debug)]
struct AnyKey(Arc<CryptoProvider>);

impl AnyKey {
    fn check_form(info: &CertificateDer<'_>) -> Result<(), Error> {
        key(info).map(drop).ok_or(Error::InvalidCertificate(CertificateError::BadEncoding))
    }

    fn check_signature(
        &self,
        message: &[u8],
        info: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        let info = SubjectPublicKeyInfoDer::from(info.as_ref());
        verify_tls13_signature_with_raw_key(message, &info, signed, &self.0.signature_verification_algorithms)
    }
}

const NO_TLS_12: Error = Error::General(String::new());

/// The common requirements of a client and a server.
macro_rules! both_roles {
    () => {
        fn verify_tls12_signature(
            &self,
            _: &[u8],
            _: &CertificateDer<'_>,
            _: &DigitallySignedStruct,
        ) -> Result<HandshakeSignatureValid, Error> {
            Err(NO_TLS_12)
        }

        fn verify_tls13_signature(
            &self,
            message: &[u8],
            info: &CertificateDer<'_>,
            signed: &DigitallySignedStruct,
        ) -> Result<HandshakeSignatureValid, Error> {
            self.check_signature(message, info, signed)
        }

        fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
            vec![SignatureScheme::ED25519]
        }

        fn requires_raw_public_keys(&self) -> bool {
            true
        }
    };
}

impl ServerCertVerifier for AnyKey {
    fn verify_server_cert(
        &self,
        info: &CertificateDer<'_>,
        _: &[CertificateDer<'_>],
        _: &ServerName<'_>,
        _: &[u8],
        _: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        Self::check_form(info).map(|()| ServerCertVerified::assertion())
    }

    both_roles!();
}

impl ClientCertVerifier for AnyKey {
    fn root_hint_subjects(&self) -> &[DistinguishedName] {
        &[]
    }

    fn verify_client_cert(
        &self,
        info: &CertificateDer<'_>,
        _: &[CertificateDer<'_>],
        _: UnixTime,
    ) -> Result<ClientCertVerified, Error> {
        Self::check_form(info).map(|()| ClientCertVerified::assertion())
    }

    both_roles!();
}
