//! The gate of a node in a team: refused requests, each for its reason, and accepted ones. Cases 37 of the study of
//! supervision.

mod ledger;
mod world;

use comms::logic::object::Access;
use dbmanager::logic::key::Key;
use dbmanager::logic::txn::Write;
use language::plan::{Member, MemberKind, OnBoot, Plan};
use node::logic::database::question::{AckLevel, Commit, Question};
use node::logic::gate::{Gate, Ledger, Passed, Refusal};
use node::logic::protocol::{CallRequest, ChangeOrder, ChangeRequest, Deployment, Request, Signed, ToParticipant};
use std::time::Duration;
use trust::request::{Audience, Refusal as Unsound, ReplayError};
use trust::revocation::Revocations;
use trust::role::{Action, Role};
use trust::team::TrustError;
use world::{NOW, User, World, plan};

fn deploy(plan: Plan) -> Request {
    Request::Deploy { request: 7, plan, by: "somebody".into(), start: Default::default() }
}

fn stop() -> Request {
    Request::Stop { name: "test".into() }
}

fn at(epoch: u64) -> Deployment {
    Deployment { name: "test".into(), epoch }
}

fn prepare() -> ToParticipant {
    ToParticipant::Prepare { plan: plan() }
}

fn rejoin(plan: Plan) -> ToParticipant {
    ToParticipant::Rejoin { plan, number: 1, since_go: Duration::ZERO }
}

/// The orders of `c1`, the home, to `c2`.
fn order(gate: &mut Gate, world: &World, epoch: u64, order: &ToParticipant) -> Result<(), Refusal> {
    gate.order(&at(epoch), "c1", order, &world.judge(NOW)).map(drop).map_err(|refused| refused.why)
}

fn call(gate: &mut Gate, world: &World, request: Request) -> Result<Passed, Refusal> {
    gate.call(request, &world.judge(NOW), |_| 3).map_err(|refused| refused.why)
}

#[test]
fn looking_needs_no_signature_and_everything_else_does() {
    let world = World::new();
    let mut gate = world.gate("c2");
    for request in [Request::Status, Request::Names, Request::Database(Question::Status), Request::Clock] {
        assert_eq!(call(&mut gate, &world, request.clone()), Ok(Passed::Open(request)));
    }
    let write = Write { key: Key::new("team/gain").unwrap(), value: None };
    let commit = Commit {
        reason: String::new(),
        requires: vec![],
        writes: vec![write],
        level: AckLevel::Local,
        within: Duration::ZERO,
    };
    let here = Request::Here { proof: "known".into(), question: Question::Commit(commit) };
    for (request, action) in [
        (deploy(plan()), Action::Deploy),
        (stop(), Action::Stop),
        (Request::Forget { deployment: at(1) }, Action::Stop),
        (here, Action::Write),
        (Request::Database(Question::Found), Action::Found),
        (Request::Database(Question::Retire { member: "r1".into() }), Action::Found),
    ] {
        assert_eq!(call(&mut gate, &world, request), Err(Refusal::Unsigned(action)));
    }
    for unsigned in [prepare(), rejoin(plan()), ToParticipant::Change(ChangeOrder::Examine { number: 1, plan: plan() })]
    {
        assert_eq!(order(&mut gate, &world, 1, &unsigned), Err(Refusal::Unsigned(Action::Deploy)));
    }
    assert_eq!(*gate.ledger(), Ledger::default(), "what is refused changes nothing");
}

#[test]
fn a_call_passes_once_and_only_as_it_was_signed() {
    let world = World::new();
    let (dan, mut gate) = (world.user("dan", Role::Deployer), world.gate("c1"));
    let refused = |gate: &mut Gate, signed: Signed| call(gate, &world, Request::Signed(Box::new(signed))).unwrap_err();
    let stop_it = |change: &dyn Fn(&mut trust::request::Request)| dan.sign_with(&stop(), "c1", change);
    assert_eq!(refused(&mut gate, dan.sign(&stop(), "c2")), Unsound::Audience.into());
    assert_eq!(refused(&mut gate, stop_it(&|it| it.team = world.key("c1"))), Unsound::OtherTeam.into());
    assert_eq!(refused(&mut gate, stop_it(&|it| it.epoch = 2)), Refusal::Epoch { found: 2, known: 3 });
    let late = |it: &mut trust::request::Request| {
        (it.not_before, it.not_after) = (trust::name::UnixTime(NOW.0 - 1000), trust::name::UnixTime(NOW.0 - 940));
    };
    assert_eq!(refused(&mut gate, stop_it(&late)), Unsound::Late(940).into());
    assert_eq!(refused(&mut gate, stop_it(&|it| it.not_after = NOW.plus(3600))), Unsound::Window(60).into());
    let other = refused(&mut gate, stop_it(&|it| it.action = Action::Watch));
    assert_eq!(other, Refusal::Action { signed: Action::Watch, asked: Action::Stop });
    let mut altered = dan.sign(&stop(), "c1");
    altered.body = dan.sign(&Request::Stop { name: "tent".into() }, "c1").body;
    assert_eq!(refused(&mut gate, altered), Unsound::Body.into());
    let mut forged = dan.sign(&stop(), "c1");
    forged.head[60] ^= 1;
    assert!(matches!(refused(&mut gate, forged), Refusal::Request(_)));
    let nested = dan.sign(&stop(), "c1");
    assert_eq!(refused(&mut gate, dan.sign_as(&Request::Signed(Box::new(nested)), Action::Stop)), Refusal::Unreadable);
    assert_eq!(refused(&mut gate, Signed { head: vec![1; 50], body: vec![2; 50] }), Refusal::Unreadable);
    assert_eq!(*gate.ledger(), Ledger::default(), "what is refused changes nothing");

    let good = dan.sign(&stop(), "c1");
    let passed = call(&mut gate, &world, Request::Signed(Box::new(good.clone()))).unwrap();
    let Passed::Signed(attempt, _) = passed else { panic!("{passed:?}") };
    assert_eq!((attempt.who.as_str(), attempt.what.as_str()), ("dan", "stop `test`"));
    let is_replay = |why| matches!(why, Refusal::Request(Unsound::Replay(ReplayError::Used(_))));
    assert!(is_replay(refused(&mut gate, good.clone())));
    // The next node of this name only has the ledger on the disk.
    let kept = Ledger::from_bytes(&gate.ledger().to_bytes(), &Revocations::default()).unwrap().ledger;
    let mut restarted = world.gate_with("c1", kept);
    assert!(is_replay(refused(&mut restarted, good)));
    assert!(Ledger::from_bytes(b"something else", &Revocations::default()).is_err());
}

/// A call that has come to a program of `c2`.
fn grip(access: Access) -> CallRequest {
    let (path, procedure) = ("main/hand".to_owned(), "Grip".to_owned());
    CallRequest { deployment: at(3), path, procedure, access, digest: [7; 32] }
}

#[test]
fn a_user_calls_what_the_role_allows_and_each_call_once() {
    let world = World::new();
    let mut gate = world.gate("c2");
    let may = [
        (Role::Viewer, [false, false]),
        (Role::Operator, [true, false]),
        (Role::Ci, [true, true]),
        (Role::Deployer, [true, true]),
        (Role::Admin, [true, true]),
    ];
    for (role, may) in may {
        let user = world.user(&format!("a-{role}"), role);
        for (access, may) in [Access::Operate, Access::Deploy].into_iter().zip(may) {
            let signed = user.sign(&Request::Call(Box::new(grip(access))), "c2");
            let judged = gate.procedure(grip(access), &signed, &world.judge(NOW));
            assert_eq!(judged.is_ok(), may, "{role} {access}: {judged:?}");
            let attempt = judged.unwrap_or_else(|refused| refused.attempt);
            assert_eq!(
                (attempt.who, attempt.what),
                (format!("a-{role}"), "call `Grip` of `main/hand` of `test@3`".into())
            );
            assert!(gate.procedure(grip(access), &signed, &world.judge(NOW)).is_err(), "it was sent again");
        }
    }
}

#[test]
fn a_call_that_is_not_the_one_that_was_signed_is_refused() {
    let world = World::new();
    let (olga, mut gate) = (world.user("olga", Role::Operator), world.gate("c2"));
    let asked = |call| Request::Call(Box::new(call));
    let signed = olga.sign(&asked(grip(Access::Operate)), "c2");
    let refused =
        |gate: &mut Gate, call, signed: &Signed| gate.procedure(call, signed, &world.judge(NOW)).unwrap_err().why;
    let others = [
        CallRequest { procedure: "Open".into(), ..grip(Access::Operate) },
        CallRequest { path: "main/arm".into(), ..grip(Access::Operate) },
        CallRequest { deployment: at(4), ..grip(Access::Operate) },
        CallRequest { digest: [8; 32], ..grip(Access::Operate) },
        grip(Access::Deploy),
    ];
    for other in others {
        assert_eq!(refused(&mut gate, other, &signed), Refusal::OtherCall);
    }
    let elsewhere = olga.sign(&asked(grip(Access::Operate)), "c1");
    assert_eq!(refused(&mut gate, grip(Access::Operate), &elsewhere), Unsound::Audience.into());
    let stopped = olga.sign_with(&asked(grip(Access::Operate)), "c2", &|it| it.action = Action::Stop);
    let other = Refusal::Action { signed: Action::Stop, asked: Action::Operate };
    assert_eq!(refused(&mut gate, grip(Access::Operate), &stopped), other);
    let direct = call(&mut gate, &world, Request::Signed(Box::new(signed.clone())));
    assert_eq!(direct, Err(Refusal::Unreadable), "no node carries out a call by itself");
    assert_eq!(*gate.ledger(), Ledger::default(), "what is refused changes nothing");
    assert!(gate.procedure(grip(Access::Operate), &signed, &world.judge(NOW)).is_ok());
}

/// A relay of a request can change nothing in it: not one byte, and not its length.
#[test]
fn a_request_that_is_changed_anywhere_is_refused() {
    let world = World::new();
    let (dan, mut gate) = (world.user("dan", Role::Deployer), world.gate("c2"));
    let good = dan.sign(&deploy(plan()), "c1");
    let ordered = |gate: &mut Gate, signed: &Signed| order(gate, &world, 5, &prepare().signed(Some(signed)));
    for place in 0..good.head.len() {
        for bit in [1, 0x80] {
            let mut changed = good.clone();
            changed.head[place] ^= bit;
            assert!(ordered(&mut gate, &changed).is_err(), "byte {place} of the head");
        }
    }
    for place in 0..good.body.len() {
        let mut changed = good.clone();
        changed.body[place] ^= 1;
        assert!(ordered(&mut gate, &changed).is_err(), "byte {place} of the body");
    }
    for cut in [0, 1, good.head.len() / 2, good.head.len() - 1] {
        let shorter = Signed { head: good.head[..cut].to_vec(), ..good.clone() };
        assert!(ordered(&mut gate, &shorter).is_err(), "{cut} bytes of the head");
    }
    let longer = Signed { body: [&good.body[..], &[0]].concat(), ..good.clone() };
    assert!(ordered(&mut gate, &longer).is_err());
    assert_eq!(*gate.ledger(), Ledger::default(), "what is refused changes nothing");
    assert_eq!(ordered(&mut gate, &good), Ok(()));
}

#[test]
fn roles_and_revocations_count() {
    let mut world = World::new();
    let mut gate = world.gate("c1");
    let may = |gate: &mut Gate, world: &World, user: &User, request: &Request| {
        call(gate, world, Request::Signed(Box::new(user.sign(request, "c1")))).map(drop)
    };
    let role = |refused: Result<(), Refusal>| {
        let Err(Refusal::Request(Unsound::Trust(TrustError::Role { role, action, .. }))) = refused else {
            panic!("{refused:?}")
        };
        (role, action)
    };
    let retire = Request::Database(Question::Retire { member: "r1".into() });
    let [vic, oli, dan, ann] =
        [("vic", Role::Viewer), ("oli", Role::Operator), ("dan", Role::Deployer), ("ann", Role::Admin)]
            .map(|(name, role)| world.user(name, role));
    assert_eq!(role(may(&mut gate, &world, &vic, &stop())), (Role::Viewer, Action::Stop));
    assert_eq!(may(&mut gate, &world, &oli, &stop()), Ok(()));
    assert_eq!(role(may(&mut gate, &world, &oli, &deploy(plan()))), (Role::Operator, Action::Deploy));
    assert_eq!(may(&mut gate, &world, &dan, &deploy(plan())), Ok(()));
    assert_eq!(role(may(&mut gate, &world, &dan, &retire)), (Role::Deployer, Action::Found));
    assert_eq!(may(&mut gate, &world, &ann, &retire), Ok(()));
    world.revoke(&dan);
    let revoked = TrustError::Revoked("dan".parse().unwrap());
    assert_eq!(may(&mut gate, &world, &dan, &deploy(plan())), Err(Unsound::Trust(revoked).into()));
    let stranger = World::of_team(99).user("dan", Role::Admin);
    assert_eq!(may(&mut gate, &world, &stranger, &stop()), Err(Unsound::OtherTeam.into()));
}

/// The home passes on the plan that the user has signed. A home that lies starts nothing.
#[test]
fn an_order_starts_what_was_signed_and_nothing_else() {
    let world = World::new();
    let (dan, mut gate) = (world.user("dan", Role::Deployer), world.gate("c2"));
    let by = dan.sign(&deploy(plan()), "c1");
    let altered = Refusal::Altered("c1".into());
    let mut other = plan();
    other.leaves[0].exec = Some("/bin/sh".into());
    assert_eq!(order(&mut gate, &world, 5, &rejoin(other.clone()).signed(Some(&by))), Err(altered.clone()));
    // A program behind a path that exists twice: in the place of the signed one, or beside it. A program without a
    // place is not started.
    let mut hidden = plan();
    hidden.leaves.push(other.leaves[0].clone());
    let number = u32::try_from(hidden.leaves.len() - 1).expect("there are a few");
    assert_eq!(order(&mut world.gate("c2"), &world, 5, &rejoin(hidden.clone()).signed(Some(&by))), Ok(()));
    let mut beside = hidden.clone();
    let member = Member { kind: MemberKind::Leaf(number), ..beside.groups[0].members[0].clone() };
    beside.groups[0].members.push(member);
    assert_eq!(order(&mut gate, &world, 5, &rejoin(beside).signed(Some(&by))), Err(altered.clone()));
    hidden.groups[0].members[0].kind = MemberKind::Leaf(number);
    assert_eq!(order(&mut gate, &world, 5, &rejoin(hidden).signed(Some(&by))), Err(altered.clone()));
    let another = Deployment { name: "other".into(), epoch: 5 };
    let refused = gate.order(&another, "c1", &prepare().signed(Some(&by)), &world.judge(NOW)).unwrap_err();
    assert_eq!((refused.why, refused.attempt.who.as_str()), (altered.clone(), "dan"));
    let refused = gate.order(&at(5), "c3", &prepare().signed(Some(&by)), &world.judge(NOW)).unwrap_err();
    assert_eq!(refused.why, Refusal::Altered("c3".into()), "only the home of the plan orders");
    let mut elsewhere = world.gate("c9");
    assert_eq!(order(&mut elsewhere, &world, 5, &prepare().signed(Some(&by))), Err(altered.clone()));
    let stopping = prepare().signed(Some(&dan.sign(&stop(), "c1")));
    assert!(matches!(order(&mut gate, &world, 5, &stopping), Err(Refusal::Action { .. })));
    let low = world.user("oli", Role::Operator).sign(&deploy(plan()), "c1");
    assert!(matches!(order(&mut gate, &world, 5, &prepare().signed(Some(&low))), Err(Refusal::Request(_))));
    assert_eq!(*gate.ledger(), Ledger::default(), "what is refused changes nothing");

    assert_eq!(order(&mut gate, &world, 5, &prepare().signed(Some(&by))), Ok(()));
    let replayed = order(&mut gate, &world, 6, &prepare().signed(Some(&by)));
    assert!(matches!(replayed, Err(Refusal::Request(Unsound::Replay(ReplayError::Used(_))))), "{replayed:?}");
    let fresh = dan.sign(&deploy(plan()), "c1");
    for epoch in [4, 5] {
        let lower = order(&mut gate, &world, epoch, &prepare().signed(Some(&fresh)));
        assert_eq!(lower, Err(Refusal::Epoch { found: epoch, known: 5 }));
    }
    assert_eq!(order(&mut gate, &world, 6, &prepare().signed(Some(&fresh))), Ok(()));
}

/// A host that was away takes part again long after the request has ended, also with a new node; in nothing that is outdated.
#[test]
fn a_deployment_goes_on_by_the_request_that_began_it() {
    let mut world = World::new();
    let (dan, mut gate) = (world.user("dan", Role::Deployer), world.gate("c2"));
    let by = dan.sign(&deploy(plan()), "c1");
    assert_eq!(order(&mut gate, &world, 5, &prepare().signed(Some(&by))), Ok(()));
    let kept = Ledger::from_bytes(&gate.ledger().to_bytes(), &Revocations::default()).unwrap().ledger;
    let mut gate = world.gate_with("c2", kept);
    let back = rejoin(plan()).signed(Some(&by));
    let later = |gate: &mut Gate, world: &World, epoch: u64, order: &ToParticipant| {
        let judge = world.judge(NOW.plus(20 * 24 * 3600));
        gate.order(&at(epoch), "c1", order, &judge).map(drop).map_err(|refused| refused.why)
    };
    assert_eq!(later(&mut gate, &world, 5, &back), Ok(()));
    // As another deployment, it is a request that has ended.
    assert!(matches!(later(&mut gate, &world, 6, &back), Err(Refusal::Request(Unsound::Late(_)))));
    assert_eq!(later(&mut gate, &world, 4, &back), Err(Refusal::Epoch { found: 4, known: 5 }));
    let mut other = plan();
    other.leaves[0].exec = Some("/bin/sh".into());
    let refused = later(&mut gate, &world, 5, &rejoin(other).signed(Some(&by)));
    assert_eq!(refused, Err(Refusal::Altered("c1".into())));
    world.revoke(&dan);
    assert!(matches!(later(&mut gate, &world, 5, &back), Err(Refusal::Request(Unsound::Trust(_)))));
}

/// After a reboot its home resumes a mission under a later epoch, if the signed plan says so and its signer still may.
#[test]
fn a_mission_is_resumed_by_the_request_that_began_it_if_that_says_so() {
    for on_boot in [OnBoot::None, OnBoot::Resume] {
        let mut world = World::new();
        let (dan, mut gate) = (world.user("dan", Role::Deployer), world.gate("c2"));
        let plan = Plan { on_boot, ..plan() };
        let by = dan.sign(&deploy(plan.clone()), "c1");
        let prepare = ToParticipant::Prepare { plan }.signed(Some(&by));
        assert_eq!(order(&mut gate, &world, 5, &prepare), Ok(()));
        let later = |gate: &mut Gate, world: &World, epoch: u64| {
            let judge = world.judge(NOW.plus(20 * 24 * 3600));
            gate.order(&at(epoch), "c1", &prepare, &judge).map(drop).map_err(|refused| refused.why)
        };
        if on_boot == OnBoot::None {
            assert!(matches!(later(&mut gate, &world, 6), Err(Refusal::Request(Unsound::Late(_)))));
            continue;
        }
        assert_eq!(later(&mut gate, &world, 6), Ok(()));
        assert_eq!(later(&mut gate, &world, 6), Err(Refusal::Epoch { found: 6, known: 6 }));
        assert_eq!(later(&mut gate, &world, 9), Ok(()), "once more after the next reboot");
        let other = dan.sign(&deploy(self::plan()), "c1");
        let newer = ToParticipant::Prepare { plan: self::plan() }.signed(Some(&other));
        assert_eq!(order(&mut gate, &world, 10, &newer), Ok(()));
        assert!(matches!(later(&mut gate, &world, 11), Err(Refusal::Request(Unsound::Late(_)))), "it was superseded");
        let mut gate = world.gate("c2");
        assert_eq!(order(&mut gate, &world, 5, &prepare), Ok(()));
        world.revoke(&dan);
        assert!(matches!(later(&mut gate, &world, 6), Err(Refusal::Request(Unsound::Trust(_)))));
    }
}

/// The home itself has no order of another node: it is asked whether the request it had accepted may be resumed.
#[test]
fn a_home_resumes_what_its_signer_may_still_have() {
    let mut world = World::new();
    let (dan, gate) = (world.user("dan", Role::Deployer), world.gate("c1"));
    let plan = Plan { on_boot: OnBoot::Resume, ..plan() };
    let by = dan.sign(&deploy(plan.clone()), "c1");
    let resumed = |gate: &Gate, world: &World, deployment: Deployment, signed: Option<&Signed>| {
        let judge = world.judge(NOW.plus(20 * 24 * 3600));
        gate.resumed(&deployment, signed, &judge).map(drop).map_err(|refused| refused.why)
    };
    assert_eq!(resumed(&gate, &world, at(5), Some(&by)), Ok(()), "its time is over, and it was accepted in its time");
    assert_eq!(resumed(&gate, &world, at(5), None), Err(Refusal::Unsigned(Action::Deploy)));
    let other = Deployment { name: "other".into(), epoch: 5 };
    assert_eq!(resumed(&gate, &world, other, Some(&by)), Err(Refusal::Altered("c1".into())));
    let silent = dan.sign(&deploy(self::plan()), "c1");
    assert_eq!(resumed(&gate, &world, at(5), Some(&silent)), Err(Refusal::Altered("c1".into())));
    assert_eq!(resumed(&world.gate("c2"), &world, at(5), Some(&by)), Err(Refusal::Altered("c2".into())));
    let forged = Signed { body: silent.body, ..by.clone() };
    assert!(resumed(&gate, &world, at(5), Some(&forged)).is_err());
    let viewer = world.user("eve", Role::Viewer).sign(&deploy(plan), "c1");
    assert!(matches!(resumed(&gate, &world, at(5), Some(&viewer)), Err(Refusal::Request(Unsound::Trust(_)))));
    world.revoke(&dan);
    assert!(matches!(resumed(&gate, &world, at(5), Some(&by)), Err(Refusal::Request(Unsound::Trust(_)))));
}

#[test]
fn a_change_is_applied_as_it_was_signed_and_can_be_taken_back() {
    let world = World::new();
    let (dan, mut gate) = (world.user("dan", Role::Deployer), world.gate("c2"));
    let first = dan.sign(&deploy(plan()), "c1");
    assert_eq!(order(&mut gate, &world, 5, &prepare().signed(Some(&first))), Ok(()));
    let mut next = plan();
    next.leaves[0].exec = Some("new".into());
    let again = vec![next.leaves[1].path.clone()];
    let request = |epoch: u64| {
        let (name, plan, again) = ("test".into(), next.clone(), again.clone());
        Request::Change(Box::new(ChangeRequest {
            name,
            epoch,
            revision: 0,
            plan,
            again,
            probation: Duration::ZERO,
            by: "?".into(),
        }))
    };
    let examine = |plan: &Plan| ToParticipant::Change(ChangeOrder::Examine { number: 1, plan: plan.clone() });
    let apply = |plan: &Plan, again: &[u32]| {
        let (plan, again) = (plan.clone(), again.to_vec());
        ToParticipant::Change(ChangeOrder::Apply { number: 1, plan, again, probation: Duration::ZERO })
    };
    let altered = Err(Refusal::Altered("c1".into()));
    let of_other = dan.sign(&request(4), "c1");
    assert_eq!(order(&mut gate, &world, 5, &examine(&next).signed(Some(&of_other))), altered);
    let by = dan.sign(&request(5), "c1");
    assert_eq!(order(&mut gate, &world, 5, &examine(&plan()).signed(Some(&by))), altered);
    assert_eq!(order(&mut gate, &world, 5, &examine(&next).signed(Some(&by))), Ok(()));
    assert_eq!(order(&mut gate, &world, 5, &apply(&next, &[0]).signed(Some(&by))), altered, "leaf 0 is not named");
    assert_eq!(order(&mut gate, &world, 5, &apply(&next, &[1]).signed(Some(&by))), Ok(()));
    // It was not healthy: back to the previous plan, by the previous request.
    assert_eq!(order(&mut gate, &world, 5, &apply(&plan(), &[1]).signed(Some(&first))), altered);
    assert_eq!(order(&mut gate, &world, 5, &apply(&plan(), &[]).signed(Some(&first))), Ok(()));
    // The next program may be a separate leaf, beside the previous one, which is not started any more.
    let mut beside = plan();
    let number = u32::try_from(beside.leaves.len()).expect("there are a few");
    beside.leaves.push(next.leaves[0].clone());
    beside
        .wires
        .iter_mut()
        .flat_map(|wire| [&mut wire.from, &mut wire.to])
        .filter(|end| end.leaf == 0)
        .for_each(|end| end.leaf = number);
    let members = beside.groups.iter_mut().flat_map(|group| &mut group.members);
    members
        .filter(|member| member.kind == MemberKind::Leaf(0))
        .for_each(|member| member.kind = MemberKind::Leaf(number));
    assert_eq!(order(&mut gate, &world, 5, &apply(&beside, &[]).signed(Some(&by))), Ok(()));
    assert_eq!(order(&mut gate, &world, 5, &apply(&beside.back_to(&plan()), &[]).signed(Some(&first))), Ok(()));
    beside.leaves[number as usize].exec = Some("other".into());
    assert_eq!(order(&mut gate, &world, 5, &apply(&beside, &[]).signed(Some(&by))), altered);
}

/// A signed request costs a node less than a millisecond in an optimised build; here the cost is only printed.
#[test]
fn the_cost_of_a_request_is_told() {
    let world = World::new();
    let (dan, mut gate) = (world.user("dan", Role::Deployer), world.gate("c2"));
    let signed: Vec<Signed> = (0..64).map(|_| dan.sign(&deploy(plan()), "c1")).collect();
    let began = comms::io::clock::now();
    for (epoch, by) in (1..).zip(&signed) {
        assert_eq!(order(&mut gate, &world, epoch, &prepare().signed(Some(by))), Ok(()));
    }
    println!("{:?} a request", comms::io::clock::now().since(began) / 64);
}

#[test]
fn a_signature_around_an_audience_of_the_team_is_for_whoever_takes_part() {
    let world = World::new();
    let dan = world.user("dan", Role::Deployer);
    let by = dan.sign(&deploy(plan()), "c1");
    assert_eq!(dan.audience(&by), Audience::Deployment("test".parse().unwrap()));
    assert_eq!(order(&mut world.gate("c2"), &world, 1, &prepare().signed(Some(&by))), Ok(()));
}
