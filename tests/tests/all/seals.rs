//! The seals of wires against an ordinary zenoh session with links to both ends of a wire. It tries to forge, repeat,
//! read and answer, without success. [`team_wires`](../team_wires.rs) does the same with programs on hosts of a team.

use comms::io::clock::now;
use comms::io::data::{Cover, DataSession, DeviceGate, Opener, Priority, SealCounter, SealKey, Sealer, Voucher};
use comms::io::session::Reach;
use comms::logic::codec;
use comms::logic::control::Dial;
use comms::logic::seal::Refusal;
use comms::logic::switch::{Arrival, Boundary};
use dca_tests::cluster::{Cluster, SOON, wait_until};
use std::borrow::Cow;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};
use zenoh::Wait as _;
use zenoh::bytes::ZBytes;
use zenoh::query::Query;
use zenoh::sample::{Locality, Sample as Heard, SourceInfo};
use zeroize::Zeroizing;

fn seal_key(secret: u8) -> SealKey {
    SealKey::new(&Zeroizing::new([secret; 32]), Cover::Bytes)
}

/// Both ends of a wire, and both ends of a fetched wire, in one process.
struct Ends {
    producer: DataSession,
    consumer: DataSession,
    sealer: Arc<Sealer>,
    opener: Arc<Opener>,
    refused: Receiver<Refusal>,
    cluster: Cluster,
}

const PUSHED: &str = "dca/d/t/1/w/0";
const FETCHED: &str = "dca/d/t/1/w/1";

impl Ends {
    fn new() -> Self {
        let cluster = Cluster::new();
        let open = |name: &str| DataSession::open(&cluster.folder().join(name), Reach::Host).expect("it opens");
        let (producer, consumer) = (open("p"), open("c"));
        let location = producer.location();
        let dial = Dial { session: location.session, locators: location.local };
        consumer.dial(&dial, SOON).expect("it is there");
        let (refused_tx, refused) = sync_channel(1000);
        let sealer = Arc::new(Sealer::new(&SealCounter::default()));
        let opener = Arc::new(Opener::new(move |why, _| refused_tx.try_send(why).unwrap_or_default()));
        sealer.set(Some(seal_key(1)));
        opener.set(Some(seal_key(1)));
        Self { producer, consumer, sealer, opener, refused, cluster }
    }

    /// Returns an ordinary zenoh session with links to both ends.
    fn intruder(&self) -> zenoh::Session {
        let mut config = zenoh::Config::default();
        let places =
            ["p", "c"].map(|name| format!("\"unixsock-stream/{}\"", self.cluster.folder().join(name).display()));
        for (key, value) in [
            ("mode", "\"peer\"".to_owned()),
            ("scouting/multicast/enabled", "false".to_owned()),
            ("listen/endpoints", "[]".to_owned()),
            ("connect/endpoints", format!("[{}]", places.join(","))),
        ] {
            config.insert_json5(key, &value).expect("zenoh knows it");
        }
        #[expect(clippy::disallowed_methods, reason = "an intruder's session is none of ours")]
        let session = zenoh::open(config).wait().expect("a session opens");
        let linked = wait_until(SOON, || session.info().peers_zid().wait().count() == 2);
        assert!(linked.is_some(), "it is linked to both");
        session
    }
}

#[test]
fn an_intruder_forges_repeats_and_reads_nothing() {
    let ends = Ends::new();
    let (tx, heard) = sync_channel(1000);
    let hears = move |arrival: Arrival<Cow<'_, [u8]>>, _| {
        let arrival = match arrival {
            Arrival::Value(bytes) => Arrival::Value(bytes.into_owned()),
            Arrival::Boundary(boundary) => Arrival::Boundary(boundary),
        };
        tx.try_send(arrival).unwrap_or_default();
    };
    let _hearing = ends.consumer.on_sealed_wire(PUSHED, Arc::clone(&ends.opener), hears).expect("it is open");
    let wire = ends.producer.publisher(PUSHED, Priority::Wire).expect("it is open").sealed(Arc::clone(&ends.sealer));
    assert!(wire.wait_heard(SOON));
    let intruder = ends.intruder();
    let (overheard_tx, overheard) = sync_channel::<Heard>(1000);
    let overhears = move |sample: Heard| overheard_tx.try_send(sample).unwrap_or_default();
    let _all = intruder.declare_subscriber("**").callback(overhears).wait().expect("it is open");
    let only_it = ends.producer.publisher("nobody/else", Priority::Wire).expect("it is open");
    assert!(only_it.wait_heard(SOON), "the producer knows that somebody else listens");
    let opened = Boundary::Opened { generation: 0, after: vec![] };
    wire.mark(&opened, 0).expect("it is open");
    for number in 1..=3_u8 {
        wire.put_numbered(vec![number; 40], number.into()).expect("it is open");
    }
    let next = || heard.recv_timeout(SOON).expect("it comes");
    assert_eq!(next(), Arrival::Boundary(opened));
    assert_eq!([1, 2, 3].map(|_| next()), [1, 2, 3].map(|number| Arrival::Value(vec![number; 40])));
    // The intruder also receives the values, but can read none of them.
    let caught: Vec<Heard> = (0..4).map(|_| overheard.recv_timeout(SOON).expect("it hears the wire")).collect();
    for sample in &caught {
        let bytes = sample.payload().to_bytes();
        assert!(!bytes.windows(8).any(|part| part.iter().all(|byte| (1..=3).contains(byte) && *byte == part[0])));
    }
    let reaches = |session: &zenoh::Session| {
        let matching = session.declare_publisher(PUSHED).allowed_destination(Locality::Remote).wait();
        let matching = matching.expect("it is open");
        wait_until(SOON, || matching.matching_status().wait().is_ok_and(|status| status.matching()))
    };
    assert!(reaches(&intruder).is_some());
    let is_refused_as = |why| assert_eq!(ends.refused.recv_timeout(SOON), Ok(why));
    let put = |bytes: ZBytes, seal: Option<ZBytes>, source: Option<SourceInfo>| {
        intruder.put(PUSHED, bytes).attachment(seal).source_info(source).wait().expect("it is open");
    };
    for sample in &caught {
        put(sample.payload().clone(), sample.attachment().cloned(), sample.source_info().cloned());
    }
    (0..4).for_each(|_| is_refused_as(Refusal::Repeated));
    // Forged values: one without a seal, one with a malformed seal, one with the seal of another value, and one with a
    // key of the intruder.
    put(vec![9; 40].into(), None, None);
    assert_eq!(ends.refused.recv_timeout(SOON), Ok(Refusal::Unsealed));
    let closed = Boundary::Closed { generation: 0, sent: 0 };
    put(ZBytes::new(), Some(codec::encode(&closed).expect("it is short").into()), None);
    assert_eq!(ends.refused.recv_timeout(SOON), Ok(Refusal::Unsealed));
    let own = Arc::new(Sealer::new(&SealCounter::default()));
    own.set(Some(seal_key(2)));
    let thief = DataSession::open(&ends.cluster.folder().join("t"), Reach::Host).expect("it opens");
    let location = ends.consumer.location();
    thief.dial(&Dial { session: location.session, locators: location.local }, SOON).expect("it is there");
    let stolen = thief.publisher(PUSHED, Priority::Wire).expect("it is open").sealed(own);
    assert!(stolen.wait_heard(SOON));
    stolen.put_numbered(vec![9; 40], 4).expect("it is open");
    assert_eq!(ends.refused.recv_timeout(SOON), Ok(Refusal::OtherKey));
    // The wire continues.
    wire.put_numbered(vec![4; 40], 4).expect("it is open");
    assert_eq!(next(), Arrival::Value(vec![4; 40]));
    // A value was caught and held back, and now has the number of the next value. It is not accepted.
    let is_last = |sample: &Heard| sample.source_info().is_some_and(|source| source.source_sn() == 4);
    let hears = || overheard.recv_timeout(SOON).expect("it hears the wire");
    let last = std::iter::repeat_with(hears).find(is_last).expect("it hears the wire");
    let later = last.source_info().map(|source| SourceInfo::new(*source.source_id(), 5));
    put(last.payload().clone(), last.attachment().cloned(), later);
    assert_eq!(ends.refused.recv_timeout(SOON), Ok(Refusal::Repeated));
    wire.put_numbered(vec![5; 40], 5).expect("it is open");
    assert_eq!(next(), Arrival::Value(vec![5; 40]));
    assert!(heard.try_recv().is_err() && ends.refused.try_recv().is_err());
}

#[test]
fn nobody_answers_for_another_and_answers_are_for_one_question() {
    let ends = Ends::new();
    let answering =
        ends.producer.answer_sealed(FETCHED, Arc::clone(&ends.sealer), || Some(b"the latest value".to_vec()));
    let _answering = answering.expect("it is open");
    let intruder = ends.intruder();
    let ask = || ends.consumer.ask_sealed(FETCHED, Arc::clone(&ends.opener), SOON).expect("it is open");
    assert_eq!(ask().answer(now() + SOON), Ok(Some(b"the latest value".to_vec())));
    // If an intruder itself asks, it cannot read the answer, and it cannot pass the answer to another end.
    let replies = intruder.get(FETCHED).payload(7_u64.to_le_bytes().to_vec()).wait().expect("it is open");
    let reply = replies.recv_timeout(SOON).expect("it is open").expect("it is answered");
    let caught = reply.result().expect("it is an answer").clone();
    assert!(!caught.payload().to_bytes().windows(6).any(|part| part == b"latest"));
    let lies = move |query: Query| {
        let key = query.key_expr().clone();
        query.reply_err("nothing").wait().unwrap_or_default();
        query.reply(key.clone(), "a lie").wait().unwrap_or_default();
        query.reply(key, caught.payload().clone()).attachment(caught.attachment().cloned()).wait().unwrap_or_default();
    };
    let _lying = intruder.declare_queryable(FETCHED).complete(true).callback(lies).wait().expect("it is open");
    let lied = wait_until(SOON, || {
        assert_eq!(ask().answer(now() + SOON), Ok(Some(b"the latest value".to_vec())));
        ends.refused.try_iter().any(|why| why == Refusal::Broken)
    });
    assert!(lied.is_some(), "the answer to another question is refused");
}

/// A device belongs to one program, and two programs use it. Its values go to both at once, and both believe only its
/// owner. Values of each user count as values of that user only. A program with links to all of them may look.
#[test]
fn a_device_hears_and_says_nothing_of_an_intruder() {
    let ends = Ends::new();
    let intruder = ends.intruder();
    let (owner, user) = (&ends.producer, &ends.consumer);
    let counter = SealCounter::default();
    let sealer = |secret| {
        let sealer = Sealer::new(&counter);
        sealer.set(Some(seal_key(secret)));
        Arc::new(sealer)
    };
    let opener = |secret| {
        let opener = Opener::new(|_, _| ());
        opener.set(Some(seal_key(secret)));
        Arc::new(opener)
    };
    let hear = |session: &DataSession, key: &str, senders: Vec<Arc<Opener>>| {
        let ((tx, heard), (refused_tx, refused)) = (sync_channel(1000), sync_channel(1000));
        let gate = DeviceGate::new(move |why, _| refused_tx.try_send(why).unwrap_or_default());
        gate.set(senders);
        let hears = move |bytes: Cow<'_, [u8]>| tx.try_send(bytes.into_owned()).unwrap_or_default();
        (session.on_vouched(key, Arc::new(gate), hears).expect("it is open"), heard, refused)
    };
    let (state, command) = ("dca/d/hw/arm/state", "dca/d/hw/arm/cmd");
    // There are two keys for the two users. One user is here, and one key is for this user's values.
    let (_state, states, lies) = hear(user, state, vec![opener(2)]);
    let (_command, commands, orders) = hear(owner, command, vec![opener(4), opener(3)]);
    let (says, to_users) = (owner.publisher(state, Priority::Device).expect("it is open"), Voucher::default());
    to_users.set(vec![sealer(1), sealer(2)]);
    let (asks, to_owner) = (user.publisher(command, Priority::Device).expect("it is open"), Voucher::default());
    to_owner.set(vec![sealer(3)]);
    assert!(says.wait_heard(SOON) && asks.wait_heard(SOON));
    let (overheard_tx, overheard) = sync_channel::<Heard>(1000);
    let overhears = move |sample: Heard| overheard_tx.try_send(sample).unwrap_or_default();
    let _all = intruder.declare_subscriber("**").callback(overhears).wait().expect("it is open");
    let only_it = owner.publisher("nobody/else", Priority::Wire).expect("it is open");
    assert!(only_it.wait_heard(SOON), "the owner knows that somebody else listens");
    for value in [1, 2] {
        says.put_vouched(vec![value; 8], &to_users).expect("it is open");
        asks.put_vouched(vec![value; 4], &to_owner).expect("it is open");
        assert_eq!(states.recv_timeout(SOON), Ok(vec![value; 8]));
        assert_eq!(commands.recv_timeout(SOON), Ok(vec![value; 4]));
    }
    let hears = || overheard.recv_timeout(SOON).expect("it hears the device");
    let caught = std::iter::repeat_with(hears).find(|sample| sample.key_expr().as_str() == state).expect("it is told");
    let put = |key: &str, bytes: Vec<u8>, seals: Option<ZBytes>| {
        intruder.put(key.to_owned(), bytes).attachment(seals).wait().expect("it is open");
    };
    let reaches = |key: &str| {
        let publisher = intruder.declare_publisher(key.to_owned()).allowed_destination(Locality::Remote);
        let publisher = publisher.wait().expect("it is open");
        wait_until(SOON, || publisher.matching_status().wait().is_ok_and(|status| status.matching()))
    };
    assert!(reaches(state).is_some() && reaches(command).is_some());
    put(state, caught.payload().to_bytes().into_owned(), caught.attachment().cloned());
    assert_eq!(lies.recv_timeout(SOON), Ok(Refusal::Repeated));
    put(state, vec![9; 8], None);
    assert_eq!(lies.recv_timeout(SOON), Ok(Refusal::Unsealed));
    put(command, vec![9; 4], None);
    assert_eq!(orders.recv_timeout(SOON), Ok(Refusal::Unsealed));
    // The seal of a state is not valid for a command.
    put(command, caught.payload().to_bytes().into_owned(), caught.attachment().cloned());
    assert_eq!(orders.recv_timeout(SOON), Ok(Refusal::OtherKey));
    says.put_vouched(vec![3; 8], &to_users).expect("it is open");
    assert_eq!(states.recv_timeout(SOON), Ok(vec![3; 8]));
    assert!(states.try_recv().is_err() && commands.try_recv().is_err());
}
