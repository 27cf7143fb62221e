//! Compares random runs with a clock with `finishes within` and `stops within`: no run takes longer than the proved
//! time.

use super::random::{Dice, Taste, group};
use super::rules::{Event, Order, Reference};
use super::text::text;
use language::algebra::Value;
use language::plan::Group;
use language::{Options, Source, compile_with_sites};
use std::collections::BTreeMap;
use std::rc::Rc;
use verify::{Alone, Always, Limits, Verdict};

/// The number of runs of each group.
const RUNS: u32 = 60;
/// The test leaves out a run with more events, since nothing seems to bound it.
const EVENTS_MAX: u32 = 60;

/// The longest times of programs and of their stops, in milliseconds, by their slots.
struct Takes(Vec<(u64, u64)>);

/// One run: the next events, and when each of them happens.
struct Run<'r> {
    dice: &'r mut Dice,
    takes: &'r Takes,
    tags: &'r BTreeMap<u32, Vec<String>>,
    group: Rc<Group>,
    reference: Reference,
    now: u64,
    programs: BTreeMap<u32, (u64, Event)>,
    timers: BTreeMap<u32, u64>,
}

impl Run<'_> {
    /// Returns the time of the run from its start, or from the stop that is requested after `stop_after` events.
    fn takes(&mut self, stop_after: Option<u32>) -> Option<u64> {
        let mut ended = self.reference.begin(Value::EMPTY).is_some();
        let mut since = 0;
        for count in 0..EVENTS_MAX {
            self.carry_out();
            if ended {
                return (stop_after.is_none_or(|after| after < count)).then(|| self.now - since);
            }
            if stop_after == Some(count) {
                since = self.now;
                ended = self.reference.halt().is_some();
                continue;
            }
            ended = self.next()?;
        }
        None
    }

    /// Lets the earliest due event happen. Returns whether everything has ended, or none if nothing is due.
    fn next(&mut self) -> Option<bool> {
        let program = self.programs.iter().map(|(slot, (at, _))| (*at, true, *slot));
        let timers = self.timers.iter().map(|(timer, at)| (*at, false, *timer));
        let due: Vec<(u64, bool, u32)> = program.chain(timers).collect();
        let first = due.iter().map(|(at, ..)| *at).min()?;
        let due: Vec<_> = due.into_iter().filter(|(at, ..)| *at == first).collect();
        let (at, is_program, which) = *self.dice.pick(&due);
        self.now = at;
        let event = match is_program {
            true => self.programs.remove(&which)?.1,
            false => {
                self.timers.remove(&which);
                Event::Elapsed(which)
            }
        };
        Some(self.reference.happen(&event).is_some())
    }

    fn carry_out(&mut self) {
        for order in std::mem::take(&mut self.reference.orders) {
            match order {
                Order::Activate(slot, _) => self.begins(slot),
                Order::Stop(slot) => {
                    let time = self.sometime(self.takes.0[slot as usize].1);
                    self.programs.insert(slot, (self.now + time, Event::Stopped(slot)));
                }
                Order::Arm(timer, after) => {
                    let after = u64::try_from(after.as_millis()).expect("a short time");
                    self.timers.insert(timer, self.now + after);
                }
                Order::Cancel(timer) => drop(self.timers.remove(&timer).is_some()),
                Order::Connect(_) | Order::Disconnect(_) => {}
            }
        }
    }

    fn begins(&mut self, slot: u32) {
        let most = self.takes.0[slot as usize].0;
        let is_service = self.group.members[slot as usize].service;
        let fails = self.dice.one_in(if is_service { 2 } else { 4 });
        let event = match self.tags.get(&slot) {
            _ if fails => Event::Aborted(slot),
            // A service runs until it is stopped.
            _ if is_service => return,
            None => Event::Done(slot, Vec::new()),
            Some(tags) => {
                let value = Value::tagged(self.dice.pick::<String>(tags), &[]).expect("a short tag");
                Event::Done(slot, value.bytes().to_vec())
            }
        };
        let time = if fails { self.sometime(most) } else { self.sometime(most - 1000) + 1000 };
        self.programs.insert(slot, (self.now + time, event));
    }

    /// Returns a time up to `most`, and often `most` itself.
    fn sometime(&mut self, most: u64) -> u64 {
        match self.dice.below(3) {
            0 => u64::from(self.dice.below(u32::try_from(most / 500).expect("a short time") + 1)) * 500,
            1 => 0,
            _ => most,
        }
    }
}

/// Returns a proved sentence that does not hold. Otherwise, returns the number of sentences that hold.
pub(crate) fn compare(seed: u64) -> Result<u32, String> {
    let mut dice = Dice::new(seed ^ 0x71E5);
    let made = group(&mut dice, Taste::Text);
    let takes: Vec<(u64, u64)> =
        made.members.iter().map(|_| (1000 * u64::from(1 + dice.below(9)), 1000 * u64::from(dice.below(5)))).collect();
    let (written, tags) = text(&made, "");
    let mut spec = written;
    for (slot, (takes, stop)) in takes.iter().enumerate() {
        let duration = if made.members[slot].service { String::new() } else { format!("duration 1 s .. {takes} ms; ") };
        let (from, of) = (format!("module M{slot}(host: Host) {{ "), "module");
        spec = spec.replace(&from, &format!("{of} M{slot}(host: Host) {{ stop within {stop} ms; {duration}"));
    }
    let (takes, group) = (Takes(takes), Rc::new(made));
    let Some(plan) = compile_with_sites(&Source::new("r.dca", spec.clone()), &[], &Options::named("r")).0.plan else {
        return Ok(0);
    };
    let lowered = Rc::new(plan.groups[0].clone());
    let (mut longest, mut longest_stop) = (0, 0);
    for run in 0..RUNS {
        for stop_after in [None, Some(run % 12)] {
            let mut run = Run {
                dice: &mut dice,
                takes: &takes,
                tags: &tags,
                group: Rc::clone(&group),
                reference: Reference::new(&lowered),
                now: 0,
                programs: BTreeMap::new(),
                timers: BTreeMap::new(),
            };
            let most = if stop_after.is_none() { &mut longest } else { &mut longest_stop };
            *most = run.takes(stop_after).unwrap_or(0).max(*most);
        }
    }
    let mut count = 0;
    for (sentence, longest) in
        [("finishes", longest), ("stops", longest_stop)].into_iter().filter(|(_, most)| *most > 0)
    {
        for (limit, may_hold) in [(longest - 1, false), (1_000_000, true)] {
            let sentence = format!("{sentence} within {limit} ms");
            let text = spec.replace("    verify{\n", &format!("    verify{{\n        {sentence};\n"));
            let (compiled, sites) = compile_with_sites(&Source::new("r.dca", text), &[], &Options::named("r"));
            let Some((plan, sites)) = compiled.plan.zip(sites) else { return Ok(0) };
            let limits = Limits { states: 100_000, memory: 64 << 20, threads: &Alone, goes_on: &Always };
            let is_proved = verify::sentences(&plan, &sites, &limits)[0].verdict == Verdict::Proved;
            if is_proved && !may_hold {
                return Err(format!("seed {seed}: `{sentence}` is proved, and a run takes {longest} ms\n{spec}"));
            }
            count += u32::from(is_proved);
        }
    }
    Ok(count)
}
