//! Many callers commit at the same time: how many commits share a sync, compared with the number of callers. The same
//! on sled.

use crate::Failure;
use crate::robot::{Robot, request};
use crate::table::{Reach, Table};
use comms::io::clock;
use dbmanager::io::group::Groups;
use dbmanager::io::store::{Engine, Store};
use dbmanager::logic::clock::Wall;
use dbmanager::logic::replica::{CommitRequest, Effect, Input};
use std::path::Path;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::Duration;

/// How many callers there are.
const CALLERS: u64 = 64;
/// How many commits each caller makes, one after another.
const COMMITS: u64 = 50;

/// The result of a run.
struct Run {
    /// Groups, hence syncs.
    groups: u64,
    took: Duration,
}

/// A wish, and where the answer goes.
type Call = (CommitRequest, SyncSender<()>);

pub(crate) fn measure(folder: &Path, table: &mut Table) -> Result<(), Failure> {
    let ours = run(Robot::on(Engine::Redb, folder)?)?;
    let sled = run(Robot::on(Engine::Sled, folder)?)?;
    let count = (CALLERS * COMMITS) as f64;
    let per_second = |run: &Run| format!("{:.0} commits/s", count / run.took.as_secs_f64());
    let per_group = |run: &Run| count / run.groups as f64;
    let of = "commits a sync";
    table.line("64 callers at the same time", &per_second(&ours), (per_group(&ours), of), Reach::AtLeast(32.0));
    table.line("the same on sled", &per_second(&sled), (per_group(&sled), of), Reach::None);
    Ok(())
}

/// Lets callers commit until all are done.
fn run(mut robot: Robot<impl Store>) -> Result<Run, Failure> {
    let (sender, queue) = sync_channel::<Call>(1024);
    let began = clock::now();
    let groups = std::thread::scope(|scope| {
        for caller in 0..CALLERS {
            let calls = sender.clone();
            scope.spawn(move || call(caller, &calls));
        }
        drop(sender);
        serve(&mut robot, &mut Groups::new(queue, 256))
    })?;
    Ok(Run { groups, took: clock::now().since(began) })
}

/// Makes commits one after another, until the receiver is dropped.
fn call(caller: u64, calls: &SyncSender<Call>) {
    let (done, answers) = sync_channel(1);
    for number in (0..COMMITS).map(|number| caller * COMMITS + number) {
        let Ok(request) = request(number) else { return };
        if calls.send((request, done.clone())).is_err() || answers.recv().is_err() {
            return;
        }
    }
}

/// Commits for all callers, group by group; returns the number of groups.
fn serve(robot: &mut Robot<impl Store>, groups: &mut Groups<Call>) -> Result<u64, Failure> {
    let mut count = 0;
    while let Some(group) = groups.next(None) {
        count += 1;
        let (requests, callers): (Vec<CommitRequest>, Vec<SyncSender<()>>) = group.into_iter().unzip();
        let began = clock::now();
        let effects = robot.tell(Input::Commit(requests, Wall::default()))?;
        groups.synced(clock::now().since(began));
        let answered = effects.iter().filter(|effect| matches!(effect, Effect::Answer(..))).count();
        if answered != callers.len() {
            return Err("somebody was not answered".into());
        }
        for caller in callers {
            caller.send(())?;
        }
    }
    Ok(count)
}
