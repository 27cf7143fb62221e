//! The exports of the plant: the hardware level of the door, as procedures and states.

use super::super::seconds;
use super::{DoorWorld, State};
use crate::message::{ArmStatus, BaseStatus, GripperStatus, Wrench};
use crate::sdk::Exports;
use comms::logic::time::Time;

/// Adds all exports.
pub(super) fn exports(exports: &mut Exports<DoorWorld>) {
    locks(exports);
    commands(exports);
    states(exports);
    exports.procedure(
        "Reset",
        "Moves the simulated robot and its door back to their start. Refused while a client holds a device.",
        |world: &mut DoorWorld, ()| world.reset(),
    );
}

fn locks(exports: &mut Exports<DoorWorld>) {
    exports
        .procedure_later("LockBase", "The lock of the base: lease 500 ms.", |world: &mut DoorWorld, request, reply| {
            world.servers.base.ask(request, reply);
        })
        .procedure_later("LockArm", "The lock of the arm: lease 500 ms.", |world: &mut DoorWorld, request, reply| {
            world.servers.arm.ask(request, reply);
        })
        .procedure_later(
            "LockGripper",
            "The lock of the gripper: lease 500 ms.",
            |world: &mut DoorWorld, request, reply| world.servers.gripper.ask(request, reply),
        );
}

fn commands(exports: &mut Exports<DoorWorld>) {
    exports
        .procedure(
            "BaseCommands",
            "Velocities of the base (m/s, rad/s), each for 100 ms or until the next: a queue of `BaseVelocity` under its lock.",
            |world: &mut DoorWorld, message| Ok(world.servers.base.receive(message)),
        )
        .procedure(
            "ArmCommands",
            "Rates of the joints (rad/s), each for 100 ms or until the next: a queue of `JointVelocity` under its lock.",
            |world: &mut DoorWorld, message| Ok(world.servers.arm.receive(message)),
        )
        .procedure(
            "GripperCommands",
            "Widths of the fingers (m) and their force (N), held until the next: a queue of `Grip` under its lock.",
            |world: &mut DoorWorld, message| Ok(world.servers.gripper.receive(message)),
        );
}

fn states(exports: &mut Exports<DoorWorld>) {
    exports
        .state(
            "base",
            "Where the base is by dead reckoning (m, rad), how fast it moves, who holds it.",
            DoorWorld::base,
        )
        .state("arm", "Where the joints are (rad), how fast they turn (rad/s), who holds the arm.", DoorWorld::arm)
        .state("gripper", "How far the fingers are apart (m), how they press (N), who holds them.", DoorWorld::gripper)
        .state("wrench", "Force (N) and torque (Nm) on the hand, tool axes.", DoorWorld::wrench)
        .state("base_commands", "The commands that wait.", |world| world.servers.base.queue())
        .state("arm_commands", "The commands that wait.", |world| world.servers.arm.queue())
        .state("gripper_commands", "The commands that wait.", |world| world.servers.gripper.queue());
}

impl DoorWorld {
    fn reset(&mut self) -> Result<(), String> {
        if let Some((device, holder)) = self.servers.held() {
            return Err(format!("the {device} is held by `{holder}`"));
        }
        self.state = None;
        Ok(())
    }

    fn base(&self) -> BaseStatus {
        let (commanded, refused, holder) = self.servers.base.status();
        let drive = self.plant(|state| &state.plant.base.drive);
        let (velocity, stopped) = drive.map_or(([0.0; 3], None), |drive| (drive.velocity, drive.stopped));
        let pose = self.plant(|state| state.odometry.pose()).map_or([0.0; 3], |pose| (*pose).into());
        BaseStatus { pose, velocity, commanded, stopped: or_never(stopped), refused, holder }
    }

    fn arm(&self) -> ArmStatus {
        let (commanded, refused, holder) = self.servers.arm.status();
        let angles = self.plant(|state| &state.plant).map_or([0.0; 6], |plant| plant.arm.encoders().into());
        let rates = self.plant(|state| &state.plant).map_or([0.0; 6], |plant| plant.joint_rates());
        let stopped = self.plant(|state| &state.plant).and_then(|plant| plant.arm.drive.stopped);
        ArmStatus { angles, rates, commanded, stopped: or_never(stopped), refused, holder }
    }

    fn gripper(&self) -> GripperStatus {
        let (commanded, refused, holder) = self.servers.gripper.status();
        let (width, force) =
            self.plant(|state| &state.plant).map_or((0.0, 0.0), |plant| (plant.gripper.width(), plant.gripper.force()));
        GripperStatus { width, force, commanded, refused, holder }
    }

    /// Returns the last sample of the wrist sensor.
    fn wrench(&self) -> Wrench {
        let last = self.plant(|state| state).and_then(|state| state.samples.force.last.as_ref());
        let none = Wrench { measured: 0.0, force: [0.0; 3], torque: [0.0; 3] };
        let wrench = |state: &crate::message::FtState| Wrench {
            measured: seconds(state.stamp),
            force: state.force,
            torque: state.torque,
        };
        last.map_or(none, wrench)
    }

    /// Returns what `of` reads from the state of the plant, once the plant has begun.
    fn plant<'a, T>(&'a self, of: impl Fn(&'a State) -> T) -> Option<T> {
        self.state.as_deref().map(of)
    }
}

fn or_never(at: Option<Time>) -> f64 {
    at.map_or(0.0, seconds)
}
