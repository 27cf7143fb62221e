//! Requests that are refused, each for its reason, and accepted ones.

use crate::world::{NOW, World, keys};
use trust::identity::{KeyId, SecretKeys};
use trust::name::Name;
use trust::request::{AHEAD_MAX, Accepted, Audience, Context, Refusal, ReplayError, Replays, Request, check};
use trust::role::Action;
use trust::team::{Credential, SKEW, TrustError};

const BODY: &[u8] = b"the plan";

fn request(world: &World) -> Request {
    Request {
        team: world.team.id(),
        audience: Audience::Node(node(world)),
        action: Action::Deploy,
        id: [1; 16],
        sequence: 7,
        epoch: 3,
        not_before: NOW,
        not_after: NOW.plus(60),
    }
}

fn node(world: &World) -> KeyId {
    world.r1.1.certificate().subject()
}

fn context<'a>(world: &'a World, deployment: Option<&'a Name>) -> Context<'a> {
    let name = &world.r1.1.certificate().claims().name;
    Context { judge: world.judge(NOW), node: node(world), name, deployment, epoch_min: 3 }
}

fn ask(world: &World, request: &Request, by: &(SecretKeys, Credential)) -> Result<Accepted, Refusal> {
    let bytes = request.sign(BODY, &by.0, &by.1);
    check(&bytes, BODY, &context(world, None), &mut Replays::default())
}

/// Case 37 of the study: unsigned, wrong audience, expired, lower epoch, insufficient role, another body, another
/// team.
#[test]
fn each_wrong_request_has_its_refusal() {
    let world = World::new();
    let good = request(&world);
    assert_eq!(ask(&world, &good, &world.deployer).unwrap().request, good);
    let refused = |change: &dyn Fn(&mut Request)| {
        let mut request = good.clone();
        change(&mut request);
        ask(&world, &request, &world.deployer).unwrap_err()
    };
    let other = world.r2.1.certificate().subject();
    assert_eq!(refused(&|it| it.team = other), Refusal::OtherTeam);
    assert_eq!(refused(&|it| it.audience = Audience::Node(other)), Refusal::Audience);
    assert_eq!(refused(&|it| it.audience = Audience::Deployment("door".parse().unwrap())), Refusal::Audience);
    assert_eq!(refused(&|it| it.audience = Audience::Host("r2".parse().unwrap())), Refusal::Audience);
    assert_eq!(refused(&|it| it.epoch = 2), Refusal::Epoch { found: 2, known: 3 });
    assert_eq!(refused(&|it| it.not_after = NOW.plus(8 * 24 * 3600)), Refusal::Window(7 * 24 * 3600));
    let stop_later = |it: &mut Request| (it.action, it.not_after) = (Action::Stop, NOW.plus(61));
    assert_eq!(refused(&stop_later), Refusal::Window(60));
    let early = |it: &mut Request| (it.not_before, it.not_after) = (NOW.plus(SKEW + 1), NOW.plus(SKEW + 9));
    assert_eq!(refused(&early), Refusal::NotYet);
    let late = |it: &mut Request| {
        (it.not_before.0, it.not_after.0) = (NOW.0 - SKEW - 60, NOW.0 - SKEW - 1);
    };
    assert_eq!(refused(&late), Refusal::Late(SKEW + 1));
    assert!(matches!(ask(&world, &good, &world.viewer), Err(Refusal::Trust(TrustError::Role { .. }))));
    let bytes = good.sign(BODY, &world.deployer.0, &world.deployer.1);
    let other_body = check(&bytes, b"the pLan", &context(&world, None), &mut Replays::default());
    assert_eq!(other_body, Err(Refusal::Body));
}

#[test]
fn a_number_far_ahead_of_the_time_is_refused_and_spends_nothing() {
    let world = World::new();
    let mut replays = Replays::default();
    let mut ask = |sequence| {
        let bytes = Request { sequence, ..request(&world) }.sign(BODY, &world.deployer.0, &world.deployer.1);
        check(&bytes, BODY, &context(&world, None), &mut replays).map(|accepted| accepted.request.sequence)
    };
    let ahead = NOW.0 + AHEAD_MAX + 1;
    assert_eq!(ask(u64::MAX), Err(Refusal::Ahead(u64::MAX)));
    assert_eq!(ask(ahead), Err(Refusal::Ahead(ahead)));
    assert_eq!(ask(NOW.0), Ok(NOW.0), "the signer is not locked out");
    assert_eq!(ask(ahead - 1), Ok(ahead - 1));
}

#[test]
fn a_signature_belongs_to_one_signer() {
    let world = World::new();
    let good = request(&world);
    // A stranger with a stolen credential, and a member that uses another member's credential.
    for signer in [&keys(99), &world.viewer.0, &world.admin.0] {
        let bytes = good.sign(BODY, signer, &world.deployer.1);
        let found = check(&bytes, BODY, &context(&world, None), &mut Replays::default());
        assert_eq!(found, Err(Refusal::Signature));
    }
    let bytes = good.sign(BODY, &world.deployer.0, &world.deployer.1);
    for at in 0..bytes.len() {
        let mut changed = bytes.clone();
        changed[at] ^= 0x10;
        let mut replays = Replays::default();
        assert!(check(&changed, BODY, &context(&world, None), &mut replays).is_err(), "byte {at}");
        assert_eq!(replays, Replays::default(), "a refusal spends nothing");
    }
}

#[test]
fn a_request_has_an_effect_once_also_over_a_restart() {
    let world = World::new();
    let bytes = request(&world).sign(BODY, &world.deployer.0, &world.deployer.1);
    let mut replays = Replays::default();
    let accepted = check(&bytes, BODY, &context(&world, None), &mut replays).unwrap();
    let used = Err(Refusal::Replay(ReplayError::Used(7)));
    assert_eq!(check(&bytes, BODY, &context(&world, None), &mut replays), used);
    let mut after_restart = Replays::default();
    after_restart.restore(&accepted.write).unwrap();
    assert_eq!(check(&bytes, BODY, &context(&world, None), &mut after_restart), used);
}

#[test]
fn a_request_for_a_deployment_or_the_team_is_for_its_nodes() {
    let world = World::new();
    let door: Name = "door".parse().unwrap();
    let mut request = request(&world);
    request.audience = Audience::Deployment(door.clone());
    let bytes = request.sign(BODY, &world.deployer.0, &world.deployer.1);
    assert!(check(&bytes, BODY, &context(&world, Some(&door)), &mut Replays::default()).is_ok());
    request.audience = Audience::Host("r1".parse().unwrap());
    let bytes = request.sign(BODY, &world.deployer.0, &world.deployer.1);
    assert!(check(&bytes, BODY, &context(&world, None), &mut Replays::default()).is_ok());
    assert_eq!(Request::peek(&bytes).unwrap(), (request.clone(), "dan".parse().unwrap()));
    (request.audience, request.action) = (Audience::Team, Action::Estop);
    let bytes = request.sign(b"", &world.viewer.0, &world.viewer.1);
    assert!(check(&bytes, b"", &context(&world, None), &mut Replays::default()).is_ok());
}
