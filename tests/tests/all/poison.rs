//! Numbers that are not finite, at every input of every law, in every phase of the mission, on virtual time. Nothing
//! panics and nothing hangs. No command with such a number reaches a device, and the reported end of the mission is
//! true.

use comms::logic::time::Time;
use controllers::message::{
    ArmCommand, ArmState, BaseCommand, BasePose, BaseState, BaseVelocity, CameraState, Constraint, FtCommand, FtState,
    GripperCommand, GripperState, JointState, JointVelocity, LaserScan, LaserState, Velocity, Wrench,
};
use controllers::sdk::Message;
use controllers::sdk::harness::Disturbance;
use dca_tests::simulation::{Finish, Sample, Simulation, plan};
use dca_tests::survey::PHASES;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;
use std::time::Duration;

const DOOR: &str = include_str!("../../../specs/door_opening.dca");
const THROUGH: &str = include_str!("../../../specs/door_through.dca");
const WORLD: &str = "main/world";
const NOT_FINITE: [f64; 3] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
/// The greatest force in any run, whatever the poison (N).
const FORCE_MAX: f64 = 100.0;
/// The time between two poisoned samples. Each counts as one missing sample.
const APART: Duration = Duration::from_millis(24);
/// If an input has at least this many samples in a phase, it was poisoned in this phase.
const SAMPLES: u64 = 12;

/// Returns `bytes` with `number` in one place of the message. A message without a number is unchanged.
fn poisoned(type_name: &str, bytes: &[u8], number: f64) -> Vec<u8> {
    macro_rules! with {
        ($($message:ident: $($place:ident)+ $([$index:literal])?,)+) => {
            match type_name {
                $(<$message as Message>::TYPE => {
                    let mut message: $message = postcard::from_bytes(bytes).expect("it was encoded");
                    with!(@put message $($place)+ $([$index])?, number);
                    postcard::to_stdvec(&message).expect("it is encoded again")
                })+
                FtCommand::TYPE => bytes.to_vec(),
                other => panic!("no number of a `{other}` can be poisoned: add it here"),
            }
        };
        (@put $message:ident $place:ident [$index:literal], $number:ident) => {
            $message.$place[$index] = $number
        };
        (@put $message:ident $place:ident, $number:ident) => {
            $message.$place = $number
        };
        (@put $message:ident some $place:ident, $number:ident) => {
            if let Some(place) = &mut $message.$place {
                with!(@any place, $number);
            }
        };
        (@put $message:ident marks $place:ident [$index:literal], $number:ident) => {
            if let Some(mark) = &mut $message.$place[$index] {
                mark[2] = $number;
            }
        };
        (@any $place:ident, $number:ident) => {
            $place.put($number)
        };
    }
    with! {
        Velocity: twist[2],
        Wrench: force[1],
        Constraint: tangent[0],
        JointState: angles[1],
        JointVelocity: rates[3],
        BaseVelocity: rates[0],
        BasePose: pose[2],
        LaserScan: ranges[180],
        ArmState: angles[2],
        ArmCommand: some rates,
        BaseState: rolling[1],
        BaseCommand: some velocity,
        FtState: force[2],
        GripperState: width,
        GripperCommand: some width,
        LaserState: ranges[100],
        CameraState: marks marks[0],
    }
}

/// A place for a number.
trait Put {
    fn put(&mut self, number: f64);
}

impl Put for f64 {
    fn put(&mut self, number: f64) {
        *self = number;
    }
}

impl<const N: usize> Put for [f64; N] {
    fn put(&mut self, number: f64) {
        self[0] = number;
    }
}

/// Returns whether a command to a device has only finite numbers. Anything else counts as finite.
fn is_finite(type_name: &str, bytes: &[u8]) -> bool {
    let all = |numbers: &[f64]| numbers.iter().all(|number| number.is_finite());
    match type_name {
        ArmCommand::TYPE => {
            postcard::from_bytes::<ArmCommand>(bytes).is_ok_and(|command| all(&command.rates.unwrap_or_default()))
        }
        BaseCommand::TYPE => {
            postcard::from_bytes::<BaseCommand>(bytes).is_ok_and(|command| all(&command.velocity.unwrap_or_default()))
        }
        GripperCommand::TYPE => postcard::from_bytes::<GripperCommand>(bytes)
            .is_ok_and(|command| all(&[command.width.unwrap_or_default(), command.force])),
        _ => true,
    }
}

/// The result of a mission.
#[derive(Debug)]
struct Flight {
    finish: Finish,
    angle: f64,
    worst: f64,
    /// For each input and phase, the number of samples and the number of poisoned ones.
    samples: BTreeMap<(String, &'static str), (u64, u64)>,
}

/// The samples that are poisoned.
enum Which<'a> {
    /// One sample of each input in each phase, with `number`.
    OneOfEach,
    /// All samples of the input `path port`, from this phase on.
    All(&'a str, &'a str),
}

fn fly((spec, phases): (&str, &[&'static str]), which: &Which<'_>, number: f64) -> Flight {
    let plan = plan("poison.dca", spec).unwrap_or_else(|why| panic!("{why}"));
    let mut simulation = Simulation::new(plan, Disturbance::NONE).unwrap_or_else(|why| panic!("{why}"));
    let samples = Rc::new(RefCell::new(BTreeMap::<(String, &'static str), (u64, u64)>::new()));
    let phase = Rc::new(RefCell::new(None::<&'static str>));
    let (counted, current) = (Rc::clone(&samples), Rc::clone(&phase));
    let stays = match which {
        Which::OneOfEach => None,
        Which::All(input, from) => Some(((*input).to_owned(), (*from).to_owned())),
    };
    let (mut last, mut began) = (Time::ZERO, false);
    simulation.meddle(move |path: &str, sample: &Sample, bytes: &mut Vec<u8>| {
        assert!(is_finite(sample.type_name, bytes), "{path} has got {} at {:?}", sample.type_name, sample.at);
        let Some(phase) = *current.borrow() else { return };
        let input = format!("{path} {}", sample.port);
        let mut counted = counted.borrow_mut();
        let (seen, hit) = counted.entry((input.clone(), phase)).or_default();
        *seen += 1;
        let is_meant = match &stays {
            None => *hit == 0 && sample.at.since(last) >= APART,
            Some((of, from)) => {
                began |= phase == from;
                began && input.ends_with(of.as_str())
            }
        };
        if is_meant {
            (*hit, last) = (*hit + 1, if sample.type_name == FtCommand::TYPE { last } else { sample.at });
            *bytes = poisoned(sample.type_name, bytes, number);
        }
    });
    let limit = Time::ZERO + Duration::from_secs(220);
    let finish = simulation.run(limit, &mut |simulation| {
        *phase.borrow_mut() = phases.iter().copied().find(|part| simulation.is_any_active(part));
    });
    let (angle, worst) = (simulation.signal(WORLD, "door angle"), simulation.signal(WORLD, "peak force"));
    drop(simulation);
    Flight { finish, angle, worst, samples: Rc::into_inner(samples).expect("the mission is over").into_inner() }
}

fn phases() -> Vec<&'static str> {
    PHASES.iter().map(|(part, _)| *part).collect()
}

/// One refused sample counts as one missing sample, so the door opens as usual.
fn expect_one_of_each_does_no_harm(spec: &str, phases: &[&'static str], angle_min: f64) {
    for number in NOT_FINITE {
        let flight = fly((spec, phases), &Which::OneOfEach, number);
        assert_eq!(flight.finish, Finish::Done, "{number}");
        assert!(flight.angle >= angle_min && flight.worst <= FORCE_MAX, "{number}: {flight:?}");
        // The sample that zeroes the force sensor contains no number.
        let missed = flight
            .samples
            .iter()
            .filter(|((input, _), (seen, hit))| *seen >= SAMPLES && *hit == 0 && !input.ends_with(" ft/cmd"));
        assert_eq!(missed.collect::<Vec<_>>(), [], "{number}");
    }
}

#[test]
fn one_number_that_is_not_finite_at_each_input_in_each_phase_does_no_harm() {
    expect_one_of_each_does_no_harm(DOOR, &phases(), 60.0);
}

#[test]
#[ignore = "long: three missions with the drive through the door"]
fn nor_does_it_on_the_way_through_the_door() {
    expect_one_of_each_does_no_harm(THROUGH, &[phases(), vec!["/letgo", "/passage"]].concat(), 60.0);
}

/// Flies a mission in which one input has only poisoned samples from one phase on. It may end well if another sensor
/// is sufficient.
fn expect_true_end(input: &str, phase: &str, number: f64) -> String {
    let flight = fly((DOOR, &phases()), &Which::All(input, phase), number);
    let what = format!("{number} at `{input}` from {phase} on");
    assert!(flight.worst <= FORCE_MAX, "{what}: {flight:?}");
    match flight.finish {
        Finish::Done => {
            assert!(flight.angle >= 60.0, "{what}: done at {:.1} deg", flight.angle);
            "done".to_owned()
        }
        Finish::Aborted(why) => why,
        Finish::Unfinished => panic!("{what}: it never ends"),
    }
}

/// Sensors with only such values. The reason names the device.
#[test]
fn a_sensor_that_says_nothing_finite_is_named() {
    for (input, phase, number) in [
        ("visualserv camera/state", "/visualserv", f64::NAN),
        ("hit/force ft/state", "/approach", f64::INFINITY),
        ("presshandle ft/state", "/presshandle", f64::NAN),
        ("model gripper/state", "/dooropen/", f64::NEG_INFINITY),
    ] {
        let device = input.rsplit_once(' ').expect("it has a port").1;
        let why = expect_true_end(input, phase, number);
        println!("{input} from {phase} on: {why}");
        assert!(why.contains(&format!("`{device}` has refused its last")), "{input}: {why}");
    }
}

#[test]
#[ignore = "long: a mission for each input and phase"]
fn whatever_says_nothing_finite_the_end_is_true() {
    let flight = fly((DOOR, &phases()), &Which::OneOfEach, f64::NAN);
    let mut ends = BTreeMap::<String, Vec<String>>::new();
    for (input, phase) in flight.samples.keys() {
        let why = expect_true_end(input, phase, f64::NAN);
        ends.entry(why).or_default().push(format!("{input} from {phase} on"));
    }
    for (why, inputs) in ends {
        println!("{why}\n    {}", inputs.join("\n    "));
    }
}
