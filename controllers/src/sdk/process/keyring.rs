//! The keys of a program in a team, and the messages it seals with them: values of wires, boundaries between them,
//! answers to fetches, and calls.
//!
//! The keys are made at the start of the process and never leave it. They also identify the data session, which accepts
//! links from the programs at the other ends of wires. The node sends the public keys of these programs, and sends them
//! again after one of them was restarted. Existing seals then use the new key.

use super::inbox::Inbox;
use super::warrants::Warrants;
use comms::io::data::{CallGate, CallWay, Caller, Cover, DeviceGate, Opener, SealCounter, SealKey, Sealer, Voucher};
use comms::io::direct::{Guard, WireSecrets};
use comms::io::session::Digest;
use comms::logic::control::Partner;
use comms::logic::key::{self, ObjectKeys};
use comms::logic::proof::Proof;
use comms::logic::seal::{DEVICE, LINK, NO_WIRE, Refusal};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use team::program::{ProgramIdentity, Sealing};

/// The use of a sealing key: for the values of a wire's producer, or for the messages of its consumer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Use {
    /// For messages that the producer sends or answers.
    Values,
    /// For answers of the consumer.
    Type,
    /// For messages of the caller.
    Call,
    /// For messages of a caller that cancels.
    Cancel,
    /// For answers of the server.
    Result,
}

impl Use {
    fn word(self) -> &'static str {
        match self {
            Self::Values => "values",
            Self::Type => "type",
            Self::Call => "call",
            Self::Cancel => "cancel",
            Self::Result => "result",
        }
    }
}

/// The keys, and the objects that seal with them.
#[derive(Debug)]
pub(super) struct Keyring {
    /// The identity, which has the keys. It also checks the calls of visitors.
    identity: Arc<ProgramIdentity>,
    counter: SealCounter,
    inbox: Arc<Inbox>,
    warrants: Arc<Warrants>,
    state: Mutex<State>,
}

/// The programs that may call this one, and the keys of their calls.
#[derive(Debug)]
struct Serving {
    keys: ObjectKeys,
    gate: Arc<CallGate>,
}

/// The state by the number of the wire. It is kept for the life of the program, so that a wire that was made again
/// cannot accept a message twice.
#[derive(Debug, Default)]
struct State {
    partners: BTreeMap<u32, Arc<Partner>>,
    sealers: BTreeMap<(u32, Use), (String, Arc<Sealer>)>,
    openers: BTreeMap<(u32, Use), (String, Arc<Opener>)>,
    serving: Option<Serving>,
    /// The programs that share a device, by its name.
    sharing: BTreeMap<String, Vec<Arc<Partner>>>,
    /// By device and key, the vouchers.
    vouchers: BTreeMap<(String, String), Arc<Voucher>>,
    gates: BTreeMap<(String, String), Arc<DeviceGate>>,
    /// The openers of samples from the programs that share a device, by the keys of both programs. No sample is
    /// accepted twice.
    senders: BTreeMap<(String, Vec<u8>), Arc<Opener>>,
}

impl Keyring {
    /// Returns a keyring that seals with the keys of a program.
    pub(super) fn new(identity: &Arc<ProgramIdentity>, inbox: &Arc<Inbox>) -> Self {
        let (identity, inbox) = (Arc::clone(identity), Arc::clone(inbox));
        let warrants = Arc::new(Warrants::new(&inbox));
        Self { identity, counter: SealCounter::default(), inbox, warrants, state: Mutex::default() }
    }

    /// Returns the calls of users that the node checks.
    pub(super) const fn warrants(&self) -> &Arc<Warrants> {
        &self.warrants
    }

    /// Takes the node's signature on the keys.
    pub(super) fn take_delegation(&self, delegation: &[u8]) {
        self.identity.take_delegation(delegation);
    }

    /// Returns the public keys.
    pub(super) fn public(&self) -> Vec<u8> {
        self.identity.keys().public().to_vec()
    }

    /// Takes the programs at the other ends of wires; they replace the previous programs.
    pub(super) fn take(&self, partners: Vec<Partner>) {
        self.identity.let_in(partners.iter().map(|partner| &*partner.keys));
        let mut state = self.state();
        state.partners.clear();
        state.sharing.clear();
        for partner in partners.into_iter().map(Arc::new) {
            state.partners.extend(partner.wires.iter().map(|wire| (*wire, Arc::clone(&partner))));
            for device in &partner.devices {
                state.sharing.entry(device.clone()).or_default().push(Arc::clone(&partner));
            }
        }
        for (&(wire, used), (key, sealer)) in &state.sealers {
            sealer.set(self.key(&state, wire, used, key, Sealing::Here));
        }
        for (&(wire, used), (key, opener)) in &state.openers {
            if opener.set(self.key(&state, wire, used, key, Sealing::There)) {
                self.inbox.partner_changed(wire);
            }
        }
        self.admit(&mut state);
        self.inbox.partner_changed(NO_WIRE);
        self.inbox.partner_changed(DEVICE);
        for ((device, key), voucher) in state.vouchers.clone() {
            voucher.set(self.vouched(&state, &device, &key));
        }
        for ((device, key), gate) in state.gates.clone() {
            gate.set(self.senders(&mut state, &device, &key));
        }
        let partners: Vec<Vec<u8>> = state.sharing.values().flatten().map(|partner| partner.keys.clone()).collect();
        state.senders.retain(|(_, keys), _| partners.contains(keys));
    }

    /// Returns the guard of direct paths, which lets in the other ends of wires on this host.
    pub(super) fn guard(self: &Arc<Self>) -> Guard {
        let (keyring, inbox) = (Arc::clone(self), Arc::clone(&self.inbox));
        let refused = move |who| inbox.refuse(LINK, Refusal::NoWire, Some(who));
        Guard::new(move |key| keyring.wire_secrets(key), refused)
    }

    fn wire_secrets(&self, key: &str) -> Option<WireSecrets> {
        let wire = key::parse_wire(key)?;
        let partner = self.state().partners.get(&wire).filter(|partner| partner.is_near).cloned()?;
        let about = format!("{key} {wire} direct");
        let secret = |sealing| self.identity.keys().wire(&partner.keys, sealing, &about).ok();
        Some(WireSecrets { shown: secret(Sealing::Here)?, expected: secret(Sealing::There)? })
    }

    /// Returns the voucher for samples of a device to the programs that share it. `key` is the key of the samples.
    pub(super) fn voucher(&self, device: &str, key: &str) -> Arc<Voucher> {
        let mut state = self.state();
        let voucher = Arc::new(Voucher::default());
        voucher.set(self.vouched(&state, device, key));
        state.vouchers.insert((device.to_owned(), key.to_owned()), Arc::clone(&voucher));
        voucher
    }

    /// Returns the gate that lets in the samples of a device from the programs that share it.
    pub(super) fn device_gate(&self, device: &str, key: &str) -> Arc<DeviceGate> {
        let mut state = self.state();
        let inbox = Arc::clone(&self.inbox);
        let gate = Arc::new(DeviceGate::new(move |why, from| inbox.refuse(DEVICE, why, from)));
        gate.set(self.senders(&mut state, device, key));
        state.gates.insert((device.to_owned(), key.to_owned()), Arc::clone(&gate));
        gate
    }

    fn vouched(&self, state: &State, device: &str, key: &str) -> Vec<Arc<Sealer>> {
        let sealer = |partner: &Arc<Partner>| {
            let sealer = Sealer::new(&self.counter);
            sealer.set(Some(self.shared(partner, Sealing::Here, &format!("{key} device"))?));
            Some(Arc::new(sealer))
        };
        state.sharing.get(device).into_iter().flatten().filter_map(sealer).collect()
    }

    fn senders(&self, state: &mut State, device: &str, key: &str) -> Vec<Arc<Opener>> {
        let partners = state.sharing.get(device).cloned().unwrap_or_default();
        let sender = |partner: Arc<Partner>| {
            let shared = self.shared(&partner, Sealing::There, &format!("{key} device"))?;
            let new = || Arc::new(Opener::new(|_, _| ()));
            let opener = state.senders.entry((key.to_owned(), partner.keys.clone())).or_insert_with(new);
            opener.set(Some(shared));
            Some(Arc::clone(opener))
        };
        partners.into_iter().filter_map(sender).collect()
    }

    /// Returns the sealer for one use of a wire. `key` is the key of the wire, or of the calls.
    pub(super) fn sealer(&self, wire: u32, used: Use, key: &str) -> Arc<Sealer> {
        self.sealer_in(&mut self.state(), wire, used, key)
    }

    /// Returns the opener for one use of a wire, which the other end has sealed.
    pub(super) fn opener(&self, wire: u32, used: Use, key: &str) -> Arc<Opener> {
        self.opener_in(&mut self.state(), wire, used, key)
    }

    /// Returns the path of calls over a wire to the server with these keys.
    pub(super) fn way(&self, wire: u32, keys: &ObjectKeys) -> CallWay {
        let mut state = self.state();
        CallWay::Sealed {
            call: self.sealer_in(&mut state, wire, Use::Call, &keys.call),
            cancel: self.sealer_in(&mut state, wire, Use::Cancel, &keys.cancel),
            answer: self.opener_in(&mut state, wire, Use::Result, &keys.call),
        }
    }

    /// Returns the gate for calls with these keys. It lets in the programs at the other ends of wires, and visitors.
    pub(super) fn gate(&self, keys: &ObjectKeys) -> Arc<CallGate> {
        let (identity, inbox) = (Arc::clone(&self.identity), Arc::clone(&self.inbox));
        let visits = move |proof: &Proof, digest: &Digest| identity.visit_problem(proof, digest);
        let gate = Arc::new(CallGate::new(visits, move |why, from| inbox.refuse(NO_WIRE, why, from)));
        let mut state = self.state();
        state.serving = Some(Serving { keys: keys.clone(), gate: Arc::clone(&gate) });
        self.admit(&mut state);
        gate
    }

    /// Allows calls from the programs at the other ends of wires.
    fn admit(&self, state: &mut State) {
        let Some(Serving { keys, gate }) = state.serving.take() else { return };
        let mut callers = Vec::new();
        for (wire, partner) in state.partners.clone() {
            let sealer = self.sealer_in(state, wire, Use::Result, &keys.call);
            for (used, key) in [(Use::Call, &keys.call), (Use::Cancel, &keys.cancel)] {
                let (opener, sealer) = (self.opener_in(state, wire, used, key), Arc::clone(&sealer));
                let caller = Caller { session: partner.session.clone(), opener, sealer };
                callers.extend(caller.opener.key_id().map(|id| (id, caller)));
            }
        }
        gate.set(callers);
        state.serving = Some(Serving { keys, gate });
    }

    fn sealer_in(&self, state: &mut State, wire: u32, used: Use, key: &str) -> Arc<Sealer> {
        let sealing = self.key(state, wire, used, key, Sealing::Here);
        let new = || (key.to_owned(), Arc::new(Sealer::new(&self.counter)));
        let (about, sealer) = state.sealers.entry((wire, used)).or_insert_with(new);
        key.clone_into(about);
        sealer.set(sealing);
        Arc::clone(sealer)
    }

    fn opener_in(&self, state: &mut State, wire: u32, used: Use, key: &str) -> Arc<Opener> {
        let sealing = self.key(state, wire, used, key, Sealing::There);
        let inbox = Arc::clone(&self.inbox);
        let new = || {
            let refused = move |why, from| inbox.refuse(wire, why, from);
            (key.to_owned(), Arc::new(Opener::new(refused)))
        };
        let (about, opener) = state.openers.entry((wire, used)).or_insert_with(new);
        key.clone_into(about);
        opener.set(sealing);
        Arc::clone(opener)
    }

    fn key(&self, state: &State, wire: u32, used: Use, key: &str, sealing: Sealing) -> Option<SealKey> {
        self.shared(state.partners.get(&wire)?, sealing, &format!("{key} {wire} {}", used.word()))
    }

    fn shared(&self, partner: &Partner, sealing: Sealing, about: &str) -> Option<SealKey> {
        let secret = self.identity.keys().wire(&partner.keys, sealing, about);
        let secret = secret.inspect_err(|error| tracing::warn!(about, %error, "there is no key")).ok()?;
        // No third program can read messages between programs of one machine. So there it is enough to prove the
        // sender.
        Some(SealKey::new(&secret, if partner.is_near { Cover::Sender } else { Cover::Bytes }))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
