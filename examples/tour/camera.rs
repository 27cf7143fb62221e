//! Vision, off board: one camera that turns to an exhibit and takes a picture. One robot at a time has its lock.
//!
//! The engine is a stand-in: it takes the time of a turn and of a picture, and its picture is one number.

use super::ear::{NAME, robot_name};
use super::{ANSWER_WITHIN, PERIOD, TourLeg, start};
use crate::headline;
use controllers::sdk::messaging::{Lock, LockAnswer, LockRequest, LockSettings, LockUser};
use controllers::sdk::serde::{Deserialize, Serialize};
use controllers::sdk::{
    About, Arguments, Calls, Controller, Exports, Message, Outcome, Outputs, Progress, Reply, Signal, Stopping, Tick,
    Time,
};
use std::time::Duration;

/// How long the camera turns and takes a picture.
const PICTURE: Duration = Duration::from_millis(1500);
/// How long a robot waits for its picture, with the time until it has the camera.
const PATIENCE: Duration = Duration::from_secs(6);
const SETTINGS: LockSettings = LockSettings { lease: Duration::from_secs(1), preempt_after: None, waiting_max: 8 };

/// An order to take a picture.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
pub(super) struct Shot {
    /// The number of the grant of the lock.
    fence: u64,
    /// The exhibit.
    stop: f64,
}

impl Message for Shot {
    const TYPE: &'static str = "Shot";
}

/// A picture.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
pub(super) struct Picture {
    /// How bright it is, from 0 to 1.
    brightness: f64,
}

impl Message for Picture {
    const TYPE: &'static str = "Picture";
    const FIELDS: &'static str = "brightness: Number";
}

/// A picture that is being taken.
struct Exposure {
    shot: Shot,
    reply: Reply<Picture>,
    /// When it is ready. None if the camera has not begun to turn.
    ready: Option<Time>,
}

/// The camera of the museum.
pub(super) struct CameraService {
    lock: Lock,
    present: Option<Exposure>,
    taken: f64,
    refused: f64,
}

impl CameraService {
    fn photograph(&mut self, shot: Shot, reply: Reply<Picture>) {
        let is_busy = self.present.as_ref().is_some_and(|present| present.reply.is_wanted());
        if let Err(why) = self.lock.admit(Some(shot.fence)) {
            self.refused += 1.0;
            reply.refuse(format!("this robot does not have the camera: {why}"));
        } else if is_busy {
            reply.refuse("the camera is taking a picture");
        } else {
            self.present = Some(Exposure { shot, reply, ready: None });
        }
    }
}

impl Controller for CameraService {
    type Inputs = ();
    type Outputs = ();
    const TYPE: &'static str = "CameraService";

    fn about() -> About {
        About::service("Takes pictures of exhibits for the robot that has its lock.")
            .every(PERIOD)
            .signals_every(Duration::from_secs(1))
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self { lock: Lock::new(SETTINGS), present: None, taken: 0.0, refused: 0.0 })
    }

    fn exports(exports: &mut Exports<Self>) {
        exports
            .procedure_later("camera", "The lock of the camera.", |service: &mut Self, request, reply| {
                service.lock.ask(request, reply);
            })
            .procedure_later("Photograph", "Turns to an exhibit and takes a picture of it.", Self::photograph)
            .state("lock", "The robot that has the camera, and the robots that wait for it.", |service| {
                service.lock.status()
            });
    }

    fn main_calc(&mut self, tick: Tick, (): &(), (): &mut ()) -> Progress {
        self.lock.work(tick.now);
        let Some(mut exposure) = self.present.take() else { return Progress::Continue };
        if self.lock.admit(Some(exposure.shot.fence)).is_err() {
            // The lease has run out in the middle: the next robot may already turn the camera.
            self.refused += 1.0;
            exposure.reply.refuse("the lease of the camera is over");
        } else if *exposure.ready.get_or_insert(tick.now + PICTURE) <= tick.now {
            self.taken += 1.0;
            exposure.reply.send(Picture { brightness: 0.5 + exposure.shot.stop / 100.0 });
        } else {
            self.present = Some(exposure);
        }
        Progress::Continue
    }

    fn signals(&self) -> Vec<Signal> {
        vec![headline("pictures", "", self.taken), headline("refused pictures", "", self.refused)]
    }
}

#[derive(Outputs)]
pub(super) struct LookOutputs {
    /// The lock of the camera.
    #[calls("Camera")]
    camera: Calls<LockRequest, LockAnswer>,
    /// The camera.
    #[calls("Photograph")]
    photograph: Calls<Shot, Picture>,
}

/// Takes a picture of the next exhibit of a tour.
pub(super) struct Look {
    user: LockUser,
    leg: TourLeg,
    began: Option<Time>,
    /// The open order, or the outcome.
    result: Option<&'static str>,
    is_ordered: bool,
    is_holding: bool,
}

impl Controller for Look {
    type Inputs = ();
    type Outputs = LookOutputs;
    const TYPE: &'static str = "Look";

    fn about() -> About {
        const OUTCOMES: &[Outcome] =
            &[Outcome { tag: "seen", type_name: None }, Outcome { tag: "unseen", type_name: None }];
        About::task("Takes the camera, has a picture taken, and gives the camera back.")
            .every(PERIOD)
            .with(NAME)
            .starts_with::<TourLeg>()
            .ends_with(OUTCOMES)
            .signals_every(PERIOD)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let user = LockUser::new(&robot_name(arguments)?).map_err(|cause| cause.to_string())?;
        let leg = TourLeg::default();
        Ok(Self { user, leg, began: None, result: None, is_ordered: false, is_holding: false })
    }

    fn init(&mut self, value: &[u8]) -> Result<(), String> {
        (self.leg, self.began, self.result) = (start(value)?, None, None);
        (self.is_ordered, self.is_holding) = (false, false);
        self.user.want(0);
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, (): &(), outputs: &mut LookOutputs) -> Progress {
        let LookOutputs { camera, photograph } = outputs;
        self.user.work(tick.now, camera);
        let held = self.user.held(tick.now);
        self.is_holding = held.is_some();
        if let Some(result) = self.result {
            // Without the link, the camera is free after its lease.
            let is_late = tick.now.since(*self.began.get_or_insert(tick.now)) > PATIENCE + ANSWER_WITHIN;
            let is_over = self.user.is_idle() || is_late;
            return if is_over { Progress::outcome(result, &()) } else { Progress::Continue };
        }
        while let Some((_, picture)) = photograph.answer() {
            self.result = Some(if picture.is_ok() { "seen" } else { "unseen" });
        }
        if let (Some(fence), false) = (held, self.is_ordered) {
            let stop = self.leg.stops.first().copied().unwrap_or_default();
            photograph.call(Shot { fence, stop }, PICTURE + ANSWER_WITHIN);
            self.is_ordered = true;
        }
        if tick.now.since(*self.began.get_or_insert(tick.now)) > PATIENCE {
            self.result = Some("unseen");
        }
        if self.result.is_some() {
            self.user.let_go();
        }
        Progress::Continue
    }

    fn stop(&mut self, tick: Tick, (): &(), outputs: &mut LookOutputs) -> Stopping {
        if self.is_holding {
            self.user.let_go();
            self.user.work(tick.now, &mut outputs.camera);
        }
        self.is_holding = false;
        Stopping::Finished
    }

    fn signals(&self) -> Vec<Signal> {
        let value = f64::from(u8::from(self.is_holding));
        vec![Signal { name: "has the camera".into(), unit: "".into(), value, headline: false }]
    }
}
