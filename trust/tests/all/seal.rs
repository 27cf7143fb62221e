//! The readers of a secret.

use crate::world::keys;
use proptest::prelude::*;
use trust::identity::{Entropy, KeyId, PublicKeys};
use trust::seal::{Place, READERS_MAX, SECRET_MAX, SealError, Sealed, Secret, readable_by};
use zeroize::Zeroizing;

const TEAM: KeyId = KeyId([3; 32]);
const PLACE: Place<'_> = Place { team: TEAM, path: "team/camera/password" };

fn secret(bytes: &[u8]) -> Secret {
    Secret::new(Zeroizing::new(bytes.to_vec())).expect("the input is good")
}

fn sealed(bytes: &[u8], readers: &[u8]) -> Sealed {
    let readers: Vec<PublicKeys> = readers.iter().map(|number| *keys(*number).public()).collect();
    Sealed::seal(&secret(bytes), &PLACE, &readers, &mut Entropy::new(&[1; 32])).expect("the input is good")
}

#[test]
fn its_readers_open_it_and_nobody_else() {
    let sealed = sealed(b"hunter2", &[2, 7]);
    for number in [2, 7] {
        assert_eq!(sealed.open(&PLACE, &keys(number)).unwrap().expose(), b"hunter2");
    }
    assert_eq!(sealed.open(&PLACE, &keys(3)).unwrap_err(), SealError::NotForUs);
    for place in [Place { path: "team/camera/passwore", ..PLACE }, Place { team: KeyId([4; 32]), ..PLACE }] {
        assert_eq!(sealed.open(&place, &keys(2)).unwrap_err(), SealError::Damaged, "it cannot be moved");
    }
    let bytes = sealed.to_bytes();
    let clear = bytes.windows(7).any(|part| part == b"hunter2");
    assert!(!clear && !format!("{sealed:?} {:?}", secret(b"hunter2")).contains("hunter2"));
}

#[test]
fn no_bit_of_it_can_be_changed() {
    let bytes = sealed(b"hunter2", &[2, 7]).to_bytes();
    for at in 0..bytes.len() * 8 {
        let mut changed = bytes.clone();
        changed[at / 8] ^= 1 << (at % 8);
        let opened = Sealed::from_bytes(&changed).ok().and_then(|read| read.open(&PLACE, &keys(2)).ok());
        assert!(opened.is_none(), "bit {at}");
    }
}

#[test]
fn a_rotated_secret_is_a_new_one() {
    let first = sealed(b"old", &[2, 7]);
    let mut entropy = Entropy::new(&[9; 32]);
    let second = first.rotate(&secret(b"new"), &PLACE, &[*keys(7).public()], &mut entropy).unwrap();
    assert_eq!((first.number(), second.number()), (1, 2));
    assert_eq!(second.open(&PLACE, &keys(7)).unwrap().expose(), b"new");
    assert_eq!(second.open(&PLACE, &keys(2)).unwrap_err(), SealError::NotForUs);
    let values = [("team/a", &first), ("team/b", &second)];
    assert_eq!(readable_by(&keys(2).public().id(), values), ["team/a"], "what a stolen robot could read");
}

#[test]
fn everything_has_a_limit() {
    let long = Secret::new(Zeroizing::new(vec![0; SECRET_MAX + 1]));
    assert_eq!(long.unwrap_err(), SealError::TooLong);
    let (own, mut entropy) = (*keys(2).public(), Entropy::new(&[1; 32]));
    let mut seal = |path: &str, readers: &[PublicKeys]| {
        Sealed::seal(&secret(b"x"), &Place { team: TEAM, path }, readers, &mut entropy).map(drop)
    };
    assert_eq!(seal(&"x".repeat(1025), &[own]), Err(SealError::Path));
    assert_eq!(seal("x", &[]), Err(SealError::Readers));
    assert_eq!(seal("x", &[own, own]), Err(SealError::Readers));
    assert_eq!(seal("x", &[own; READERS_MAX + 1]), Err(SealError::Readers));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn what_is_sealed_is_opened(bytes in prop::collection::vec(any::<u8>(), 0..300), readers in prop::collection::btree_set(2u8..40, 1..5)) {
        let readers: Vec<u8> = readers.into_iter().collect();
        let sealed = sealed(&bytes, &readers);
        let read = Sealed::from_bytes(&sealed.to_bytes()).unwrap();
        prop_assert_eq!(&read, &sealed);
        for reader in readers {
            let opened = read.open(&PLACE, &keys(reader)).unwrap();
            prop_assert_eq!(opened.expose(), &bytes[..]);
        }
    }
}
