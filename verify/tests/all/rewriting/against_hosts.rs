//! Compares brute force with `verify`: both give the same verdicts on random small specs of groups on two hosts.

use super::against_loss::{loss_difference, never_after_loss};
use super::explore::{Trouble, explore as explore_group};
use super::graph::{Graph, Kind, Seat, Seen};
use super::hosts::{Links, Tags, explore, explore_frail};
use super::random::{Dice, TAGS, Taste, of_size};
use super::rules::Reference;
use super::term::{Conf, Outcome, expression};
use super::text::written;
use language::algebra::Value;
use language::plan::{Group, MemberKind, Plan};
use language::sites::Sites;
use language::{Code, Options, Source, compile_with_sites};
use std::cell::OnceCell;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::rc::Rc;
use verify::{Alone, Always, Finding, Limits, Story, Verdict};

/// The result for a seed.
#[derive(Debug)]
pub(crate) enum Compared {
    /// The number of sentences that hold, and of those that do not. Both agree about them.
    Same(usize, usize),
    /// The check refused the spec, or the spec has too many states for brute force, or it has only one group.
    LeftOut,
    Differs(String),
}

/// A sentence about two members.
#[derive(Clone, Copy, Debug)]
enum Form {
    NeverWith,
    Implies,
    OnlyAfterDone,
    OnlyAfterStart,
    AfterDoneNever,
    AfterStartNever,
    AfterEndNever,
    AtMostOnce,
    AfterDoneStopped,
    AfterStartStopped,
    AfterDoneEventually,
    AfterEndEventually,
    Eventually,
    EventuallyDone,
    /// Formulas with the same meaning as `never a with b`, `a only after b.started` and `after a.done: never b`.
    NeverAsFormula,
    OnlyAfterAsFormula,
    AfterAsFormula,
    Counted(Counted),
    /// About the second member, once `c2` is lost.
    LossNever,
}

/// A sentence that counts only one occurrence of an event.
#[derive(Clone, Copy, Debug)]
enum Counted {
    SecondStartNever,
    SecondEndNever,
    SecondDoneStopped,
    SecondEndEventually,
    FirstAbortNever,
    OnceNeverWith,
    OnceImplies,
    OnceStopped,
}

const FORMS: [Form; 26] = [
    Form::NeverWith,
    Form::Implies,
    Form::OnlyAfterDone,
    Form::OnlyAfterStart,
    Form::AfterDoneNever,
    Form::AfterStartNever,
    Form::AfterEndNever,
    Form::AtMostOnce,
    Form::AfterDoneStopped,
    Form::AfterStartStopped,
    Form::AfterDoneEventually,
    Form::AfterEndEventually,
    Form::Eventually,
    Form::EventuallyDone,
    Form::NeverAsFormula,
    Form::OnlyAfterAsFormula,
    Form::AfterAsFormula,
    Form::Counted(Counted::SecondStartNever),
    Form::Counted(Counted::SecondEndNever),
    Form::Counted(Counted::SecondDoneStopped),
    Form::Counted(Counted::SecondEndEventually),
    Form::Counted(Counted::FirstAbortNever),
    Form::Counted(Counted::OnceNeverWith),
    Form::Counted(Counted::OnceImplies),
    Form::Counted(Counted::OnceStopped),
    Form::LossNever,
];
/// The number of pairs of members with a question.
const PAIRS: usize = 3;

pub(crate) fn compare(seed: u64) -> Compared {
    let mut dice = Dice::new(seed ^ 0x0D15_7A17);
    let made = Made::new(&mut dice);
    if made.groups.len() < 2 {
        return Compared::LeftOut;
    }
    let all = made.members();
    let mut pairs = Vec::new();
    for _ in 0..PAIRS {
        let (a, b) = (*dice.pick(&all), *dice.pick(&all));
        let is_inside = |inner: Seat, outer: Seat| inner.0 != 0 && outer == made.around[inner.0 as usize];
        if a != b && !is_inside(a, b) && !is_inside(b, a) {
            pairs.push((a, b));
        }
    }
    let is_asked = |form: &Form| made.is_on_two_hosts() || !matches!(form, Form::LossNever);
    let forms = |(a, b)| FORMS.into_iter().filter(is_asked).map(move |form| (form, a, b));
    let asked: Vec<(Form, Seat, Seat)> = pairs.into_iter().flat_map(forms).collect();
    let words: Vec<String> = asked.iter().map(|asked| made.words(*asked)).collect();
    let (text, tags) = made.text(&words);
    let source = Source::new("random.dca", text.clone());
    let (compiled, sites) = compile_with_sites(&source, &[], &Options::named("random"));
    let Some((plan, sites)) = compiled.plan.zip(sites) else { return Compared::LeftOut };
    if !plan.groups[1..].iter().all(is_box) {
        return Compared::LeftOut;
    }
    let tags = made.tags_in(&plan, &tags);
    let Some((graph, seats)) = explore(&plan, &tags, Links::InOrder).zip(made.seats_in(&plan)) else {
        return Compared::LeftOut;
    };
    // The verifier does not follow every message. So for the verifier, some messages that it follows may overtake each
    // other.
    let loose = OnceCell::new();
    let loose = || loose.get_or_init(|| explore(&plan, &tags, Links::EachMember)).as_ref();
    let limits = Limits { states: 200_000, memory: 64 << 20, threads: &Alone, goes_on: &Always };
    let found = verify::sentences(&plan, &sites, &limits);
    let (mut hold, mut fail, mut differences) = (0, 0, Vec::new());
    for (((form, a, b), words), finding) in asked.iter().zip(&words).zip(&found) {
        let asked = Asked { form: *form, a: seats(*a), b: seats(*b) };
        let scope = |groups| Scope { plan: &plan, groups };
        if matches!(form, Form::LossNever) {
            differences.extend(never_after_loss((&plan, &tags), asked.b, finding));
            continue;
        }
        let holds = holds(scope(Around::Them), asked, &graph);
        if matches!(form, Form::NeverWith) && finding.verdict == Verdict::Proved {
            differences.extend(loss_difference((&plan, &tags), (asked.a, asked.b), finding));
        }
        match (holds, finding.verdict) {
            (true, Verdict::Proved) => hold += 1,
            (false, Verdict::Fails) => fail += 1,
            // The verifier also opens a group that may hang, and counts the messages in transit to the group and from
            // it.
            (true, Verdict::Fails) if !self::holds(scope(Around::All), asked, &graph) => fail += 1,
            (true, Verdict::Fails) if loose().is_none_or(|graph| !self::holds(scope(Around::Them), asked, graph)) => {
                fail += 1;
            }
            (true, Verdict::Fails) if !survives_losses(asked, &plan, &tags) => fail += 1,
            (_, verdict) => {
                let story = finding.story.iter().flat_map(Story::lines).collect::<Vec<_>>().join("\n");
                differences.push(format!("`{words}`: {holds} by brute force, {verdict:?}\n{story}"));
            }
        }
    }
    differences.extend(hang_difference((&plan, &sites), &graph, &limits));
    match differences.is_empty() {
        true => Compared::Same(hold, fail),
        false => Compared::Differs(format!("seed {seed}: {}\n{text}", differences.join("\n"))),
    }
}

/// Returns whether a sentence also holds if the groups that it does not name may be lost with their hosts.
fn survives_losses(asked: Asked, plan: &Plan, tags: &Tags) -> bool {
    let groups = 1..u32::try_from(plan.groups.len()).expect("few groups");
    let frail = groups.filter(|group| ![asked.a.0, asked.b.0].contains(group)).collect();
    let graph = explore_frail(plan, tags, frail);
    graph.is_some_and(|graph| holds(Scope { plan, groups: Around::Them }, asked, &graph))
}

/// Returns the difference in a finding that belongs to no sentence: whether a group may reach a state where it never
/// ends, in any surroundings.
fn hang_difference((plan, sites): (&Plan, &Sites), graph: &Graph, limits: &Limits<'_>) -> Option<String> {
    // In this case, the node that promises to end is a whole group.
    if plan.groups.iter().any(|group| expression(group).is_service) {
        return None;
    }
    let report = verify::verify(plan, sites, limits);
    let is_hang =
        |found: &Finding| found.diagnostic.as_ref().is_some_and(|it| [Code::E0811, Code::E0813].contains(&it.code));
    let found = report.findings.iter().find(|found| is_hang(found));
    let ends = |happened: &[(Seat, Kind)], seat: Seat| {
        happened.iter().any(|(other, kind)| *other == seat && ENDS.contains(kind))
    };
    let may_hang = |seat: Seat| {
        !graph.pays(false, false, |_, happened, seen| seen.active.contains(&seat) && !ends(happened, seat))
    };
    let inner = (0_u32..).zip(&plan.groups).flat_map(|(group, source)| {
        let groups = (0_u32..).zip(&source.members).filter(|(_, member)| matches!(member.kind, MemberKind::Group(_)));
        groups.map(move |(slot, _)| (group, slot))
    });
    let hangs = inner.into_iter().find(|seat| may_hang(*seat)).map_or(!graph.always_ends(), |_| true);
    let story = found.and_then(|found| found.story.as_ref()).map(|story| story.lines().join("\n"));
    (hangs != found.is_some()).then(|| {
        format!("hangs: {hangs} by brute force, {:?}\n{}", found.map(|it| &it.sentence), story.unwrap_or_default())
    })
}

/// Returns whether a group behaves as the verifier assumes of a closed group: it takes some time, stops nothing at
/// once, and may fail.
fn is_box(group: &Group) -> bool {
    let group = Rc::new(group.clone());
    let mut first = Reference::new(&group);
    let ends = first.begin(Value::EMPTY);
    let is_stopping = |conf: &Conf| conf.any(&|part| matches!(part, Conf::Stopping(..)));
    let takes_time = ends.is_none() && !first.conf.as_ref().is_some_and(is_stopping);
    let alone = explore_group(&group, &BTreeMap::new(), Trouble::Any);
    takes_time
        && alone.is_some_and(|graph| graph.seen.iter().any(|seen| matches!(seen.ended, Some(Outcome::Aborted(_)))))
}

/// Random groups: `main`, and the groups that are members of it.
struct Made {
    groups: Vec<Group>,
    /// For each group, its own seat as a member of `main`.
    around: Vec<Seat>,
    /// For each group, its host and the hosts of its members.
    hosts: Vec<(u32, Vec<u32>)>,
    matched: Vec<Vec<u32>>,
}

impl Made {
    fn new(dice: &mut Dice) -> Self {
        let size = 2 + dice.below(2);
        let main = of_size(dice, Taste::Text, size);
        let mut made = Self { groups: vec![main], around: vec![(0, 0)], hosts: Vec::new(), matched: Vec::new() };
        let mut matched = Vec::new();
        written(&made.groups[0].expression, &mut matched);
        for slot in 0..made.groups[0].members.len() {
            let number = u32::try_from(slot).expect("few members");
            if made.groups.len() < 3 && !matched.contains(&number) && !dice.one_in(3) {
                let size = 1 + dice.below(2);
                made.groups.push(of_size(dice, Taste::Text, size));
                made.around.push((0, number));
                let inner = u32::try_from(made.groups.len() - 1).expect("few groups");
                made.groups[0].members[slot].kind = MemberKind::Group(inner);
            }
        }
        for (index, group) in made.groups.iter().enumerate() {
            let own = if index == 0 { 0 } else { dice.below(2) };
            let others = group.members.iter().map(|_| if dice.one_in(4) { 1 - own } else { own }).collect();
            made.hosts.push((own, others));
            let mut matched = Vec::new();
            written(&group.expression, &mut matched);
            made.matched.push(matched);
        }
        made
    }

    fn members(&self) -> Vec<Seat> {
        let groups = (0_u32..).zip(&self.groups);
        groups.flat_map(|(group, source)| (0_u32..).zip(&source.members).map(move |(slot, _)| (group, slot))).collect()
    }

    /// Returns whether a group or a member is on `c2`.
    fn is_on_two_hosts(&self) -> bool {
        self.hosts.iter().any(|(own, others)| *own == 1 || others.contains(&1))
    }

    /// Returns the name of a member in a sentence about `main`.
    fn name(&self, (group, slot): Seat) -> String {
        match group {
            0 => format!("m{slot}"),
            _ => format!("m{}.m{slot}", self.around[group as usize].1),
        }
    }

    fn words(&self, (form, a, b): (Form, Seat, Seat)) -> String {
        let (a, b) = (self.name(a), self.name(b));
        match form {
            Form::NeverWith => format!("never {a} with {b}"),
            Form::Implies => format!("always {a} implies {b}"),
            Form::OnlyAfterDone => format!("{a} only after {b}.done"),
            Form::OnlyAfterStart => format!("{a} only after {b}.started"),
            Form::AfterDoneNever => format!("after {a}.done: never {b}"),
            Form::AfterStartNever => format!("after {a}.started: never {b}"),
            Form::AfterEndNever => format!("after {a}.ended: never {b}"),
            Form::AtMostOnce => format!("{a} at most once"),
            Form::AfterDoneStopped => format!("after {a}.done: {b} stopped"),
            Form::AfterStartStopped => format!("after {a}.started: {b} stopped"),
            Form::AfterDoneEventually => format!("after {a}.done: eventually {b}"),
            Form::AfterEndEventually => format!("after {a}.ended: eventually {b}.done"),
            Form::Eventually => format!("eventually {a}"),
            Form::EventuallyDone => format!("eventually {a}.done"),
            Form::NeverAsFormula => format!("holds ltl \"G !({a} & {b})\""),
            Form::OnlyAfterAsFormula => format!("holds ltl \"!{a}.started W {b}.started\""),
            Form::AfterAsFormula => format!("holds ltl \"G ({a}.done -> G !{b}.started)\""),
            Form::Counted(Counted::SecondStartNever) => format!("after the 2nd start of {a}: never {b}"),
            Form::Counted(Counted::SecondEndNever) => format!("after the 2nd end of {a}: never {b}"),
            Form::Counted(Counted::SecondDoneStopped) => format!("after the 2nd {a}.done: {b} stopped"),
            Form::Counted(Counted::SecondEndEventually) => format!("after the 2nd end of {a}: eventually {b}.done"),
            Form::Counted(Counted::FirstAbortNever) => format!("after the 1st abort of {a}: never {b}"),
            Form::Counted(Counted::OnceNeverWith) => format!("once {a} runs: never {a} with {b}"),
            Form::Counted(Counted::OnceImplies) => format!("once {b} runs: always {a} implies {b}"),
            Form::Counted(Counted::OnceStopped) => format!("once {a} runs: {b} stopped"),
            Form::LossNever => format!("on loss of host(c2): never {b}"),
        }
    }

    fn text(&self, sentences: &[String]) -> (String, BTreeSet<Seat>) {
        let (mut text, mut tags) = (String::new(), BTreeSet::new());
        for (index, group) in self.groups.iter().enumerate() {
            for (slot, member) in (0..).zip(&group.members) {
                let seat = (u32::try_from(index).expect("few groups"), slot);
                let ends = match (self.matched[index].contains(&slot), member.service) {
                    (true, _) => {
                        tags.insert(seat);
                        format!("done({} | {})", TAGS[0], TAGS[1])
                    }
                    (false, true) => "service".to_owned(),
                    (false, false) => "done".to_owned(),
                };
                writeln!(text, "module M{index}_{slot}(host: Host) {{ init start; {ends}; }}").expect("a text");
            }
        }
        for index in (0..self.groups.len()).rev() {
            let group = &self.groups[index];
            let (own, others) = &self.hosts[index];
            let (name, mut instances) =
                (if index == 0 { "main".to_owned() } else { format!("P{index}") }, String::new());
            for (slot, (member, host)) in group.members.iter().zip(others).enumerate() {
                let module = match member.kind {
                    MemberKind::Group(inner) => format!("P{inner}()"),
                    MemberKind::Leaf(_) => format!("M{index}_{slot}(c{})", host + 1),
                };
                writeln!(instances, "        m{slot} instof {module};").expect("a text");
            }
            let expression = written(&group.expression, &mut Vec::new());
            let stated: String = sentences.iter().map(|words| format!("        {words};\n")).collect();
            let verify = if index == 0 { format!("    verify{{\n{stated}    }}\n") } else { String::new() };
            writeln!(
                text,
                "process {name}(){{\n    host{{c{}}}\n    resource arm, gripper;\n    instantiated_processes{{\n\
                 {instances}    }}\n    internal_event_actions{{\n        {expression}\n    }}\n{verify}}}",
                own + 1
            )
            .expect("a text");
        }
        (text, tags)
    }

    /// Returns a function that finds the seats of these members in a plan.
    fn seats_in<'m>(&'m self, plan: &'m Plan) -> Option<impl Fn(Seat) -> Seat + 'm> {
        let number = |group: u32| {
            let path = if group == 0 { "main".to_owned() } else { format!("main/m{}", self.around[group as usize].1) };
            plan.groups.iter().position(|source| source.path == path)
        };
        let numbers: Option<Vec<usize>> = (0_u32..).zip(&self.groups).map(|(group, _)| number(group)).collect();
        let numbers = numbers?;
        Some(move |(group, slot): Seat| {
            let group = numbers[group as usize];
            let name = format!("m{slot}");
            let slot = plan.groups[group].members.iter().position(|member| member.name == name).expect("it is there");
            (u32::try_from(group).expect("few groups"), u32::try_from(slot).expect("few members"))
        })
    }

    fn tags_in(&self, plan: &Plan, tags: &BTreeSet<Seat>) -> Tags {
        let Some(seats) = self.seats_in(plan) else { return Tags::new() };
        tags.iter().map(|seat| (seats(*seat), TAGS.map(str::to_owned).to_vec())).collect()
    }
}

/// The groups in which orders under way and stops count: those around the two members of a sentence, or all.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Around {
    Them,
    All,
}

/// The part of a plan that a sentence is about.
#[derive(Clone, Copy)]
struct Scope<'a> {
    plan: &'a Plan,
    groups: Around,
}

/// A form of a sentence, with the two members.
#[derive(Clone, Copy)]
struct Asked {
    form: Form,
    a: Seat,
    b: Seat,
}

fn holds(scope: Scope<'_>, asked: Asked, graph: &Graph) -> bool {
    let Asked { form, a, b } = asked;
    let state =
        |breaks: &dyn Fn(&Seen) -> bool| !graph.objects(|_, _, seen| if breaks(seen) { Err(()) } else { Ok(false) });
    // Returns whether no forbidden event happens before the first occurrence of another event, or none from it on.
    let order = |first: (Seat, &[Kind]), forbidden: Seat, is_before: bool| {
        !graph.objects(|mut was: bool, happened, _| {
            for (seat, kind) in happened {
                let is_first = *seat == first.0 && first.1.contains(kind);
                was |= is_first && is_before;
                if *seat == forbidden && *kind == Kind::Started && was != is_before {
                    return Err(());
                }
                was |= is_first;
            }
            Ok(was)
        })
    };
    // Each occurrence of the event counts.
    let stopped = |seat, kinds| stopped(scope, Nth { seat, kinds, nth: 0 }, b, graph);
    let follows = |event: (Seat, &[Kind]), other: (Seat, &[Kind])| {
        graph.pays(false, false, |mut was, happened, _| {
            for happened in happened {
                was |= happens(&[*happened], event);
                was &= !happens(&[*happened], other);
            }
            was
        })
    };
    let comes = |event: (Seat, &[Kind])| graph.pays(true, true, |was, happened, _| was && !happens(happened, event));
    match form {
        Form::AfterDoneStopped => stopped(a, &[Kind::Done]),
        Form::AfterStartStopped => stopped(a, &[Kind::Started]),
        Form::AfterDoneEventually => follows((a, &[Kind::Done]), (b, &[Kind::Started])),
        Form::AfterEndEventually => follows((a, ENDS), (b, &[Kind::Done])),
        Form::Eventually => comes((a, &[Kind::Started])),
        Form::EventuallyDone => comes((a, &[Kind::Done])),
        Form::NeverWith | Form::NeverAsFormula => state(&|seen| seen.active.contains(&a) && seen.active.contains(&b)),
        Form::Implies => {
            let has = |seen: &Seen, of: &BTreeSet<Seat>, seat| of.contains(&seat) && !seen.starting.contains(&seat);
            state(&|seen| has(seen, &seen.running, a) && !has(seen, &seen.active, b))
        }
        Form::OnlyAfterDone => order((b, &[Kind::Done]), a, true),
        Form::OnlyAfterStart => order((b, &[Kind::Started]), a, true),
        Form::AfterDoneNever => order((a, &[Kind::Done]), b, false),
        Form::AfterStartNever => order((a, &[Kind::Started]), b, false),
        Form::AfterEndNever => order((a, ENDS), b, false),
        Form::AtMostOnce => order((a, &[Kind::Started]), a, false),
        Form::Counted(form) => counted(scope, form, [a, b], graph),
        Form::LossNever => unreachable!("it is asked of another graph"),
        // Simultaneous events have no order in a formula.
        Form::OnlyAfterAsFormula => !graph.objects(|was: bool, happened, _| {
            let has = |seat: Seat| happened.contains(&(seat, Kind::Started));
            if !was && has(a) && !has(b) { Err(()) } else { Ok(was || has(b)) }
        }),
        Form::AfterAsFormula => !graph.objects(|was: bool, happened, _| {
            let was = was || happened.contains(&(a, Kind::Done));
            if was && happened.contains(&(b, Kind::Started)) { Err(()) } else { Ok(was) }
        }),
    }
}

/// The ways in which a member may end.
const ENDS: &[Kind] = &[Kind::Done, Kind::Failed, Kind::Stopped];

fn happens(happened: &[(Seat, Kind)], (seat, kinds): (Seat, &[Kind])) -> bool {
    happened.iter().any(|(other, kind)| *other == seat && kinds.contains(kind))
}

fn counted(scope: Scope<'_>, form: Counted, [a, b]: [Seat; 2], graph: &Graph) -> bool {
    match form {
        Counted::SecondStartNever => never_since_nth(graph, Nth { seat: a, kinds: &[Kind::Started], nth: 2 }, b),
        Counted::SecondEndNever => never_since_nth(graph, Nth { seat: a, kinds: ENDS, nth: 2 }, b),
        Counted::FirstAbortNever => never_since_nth(graph, Nth { seat: a, kinds: &[Kind::Failed], nth: 1 }, b),
        Counted::SecondEndEventually => {
            let event = Nth { seat: a, kinds: ENDS, nth: 2 };
            graph.pays_noted(
                false,
                (0, false),
                |(_, is_owed)| is_owed,
                |(mut count, mut is_owed), happened, _| {
                    for happened in happened {
                        is_owed |= event.comes(&mut count, *happened);
                        is_owed &= *happened != (b, Kind::Done);
                    }
                    (count, is_owed)
                },
            )
        }
        Counted::SecondDoneStopped => stopped(scope, Nth { seat: a, kinds: &[Kind::Done], nth: 2 }, b, graph),
        Counted::OnceStopped => stopped(scope, Nth { seat: a, kinds: &[Kind::Started], nth: 1 }, b, graph),
        Counted::OnceNeverWith => once(graph, a, &|seen| seen.active.contains(&a) && seen.active.contains(&b)),
        Counted::OnceImplies => {
            let has = |seen: &Seen, of: &BTreeSet<Seat>, seat| of.contains(&seat) && !seen.starting.contains(&seat);
            once(graph, b, &|seen| has(seen, &seen.running, a) && !has(seen, &seen.active, b))
        }
    }
}

/// One occurrence of an event of a member. If its number is 0, each occurrence counts.
#[derive(Clone, Copy)]
struct Nth {
    seat: Seat,
    kinds: &'static [Kind],
    nth: u8,
}

impl Nth {
    /// Counts an event. Returns whether this is the occurrence.
    fn comes(self, count: &mut u8, happened: (Seat, Kind)) -> bool {
        let is_one = happens(&[happened], (self.seat, self.kinds)) && *count < self.nth;
        *count += u8::from(is_one);
        is_one && *count == self.nth
    }
}

/// Returns whether a member never starts after this occurrence of an event.
fn never_since_nth(graph: &Graph, event: Nth, forbidden: Seat) -> bool {
    !graph.objects(|mut count: u8, happened, _| {
        for happened in happened {
            if count == event.nth && *happened == (forbidden, Kind::Started) {
                return Err(());
            }
            event.comes(&mut count, *happened);
        }
        Ok(count)
    })
}

/// Returns whether no state from the first start of a member on is broken.
fn once(graph: &Graph, first: Seat, breaks: &dyn Fn(&Seen) -> bool) -> bool {
    !graph.objects(|was: bool, happened, seen| {
        let was = was || happened.contains(&(first, Kind::Started));
        if was && breaks(seen) { Err(()) } else { Ok(was) }
    })
}

/// Returns whether a member does not run after an event, once all stops in the groups are answered, and whether they
/// are answered at some time. An order to start the member was given before. The supervisors know of the end of each
/// group that contains one of the two.
fn stopped(scope: Scope<'_>, event: Nth, who: Seat, graph: &Graph) -> bool {
    let Scope { plan, groups } = scope;
    let is_quiet = |seen: &Seen| {
        let holds = |seat: &Seat, other: Seat| {
            *seat == other || plan.groups[seat.0 as usize].members[seat.1 as usize].kind == MemberKind::Group(other.0)
        };
        let is_known = |seat: &Seat| !holds(seat, who) && !holds(seat, event.seat);
        if groups == Around::All {
            return seen.stopping.is_empty() && seen.starting.is_empty() && seen.unheard.is_empty();
        }
        ![0, who.0, event.seat.0].iter().any(|group| seen.stopping.contains(group))
            && !seen.starting.iter().any(|seat| holds(seat, who))
            && seen.unheard.iter().all(is_known)
    };
    let due = |(mut count, mut was): (u8, bool), happened: &[(Seat, Kind)]| {
        for happened in happened {
            was |= match event.nth {
                0 => happens(&[*happened], (event.seat, event.kinds)),
                _ => event.comes(&mut count, *happened),
            };
        }
        (count, was)
    };
    let owes = |note: (u8, bool), happened: &[(Seat, Kind)], seen: &Seen| {
        let (count, was) = due(note, happened);
        (count, was && !is_quiet(seen))
    };
    let breaks = graph.objects(|note, happened, seen| {
        let is_due = due(note, happened).1 && is_quiet(seen);
        if is_due && seen.running.contains(&who) { Err(()) } else { Ok(owes(note, happened, seen)) }
    });
    !breaks && graph.pays_noted(false, (0, false), |(_, is_owed)| is_owed, owes)
}
