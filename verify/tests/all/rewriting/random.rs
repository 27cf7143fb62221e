//! Random small groups, from a seed.

use language::automaton::Failure;
use language::plan::{Arm, CatchArm, Expression, Given, Group, Member, MemberKind, Supervision, text_value};
use std::time::Duration;

/// The tags at the ends of modules in random groups.
pub(crate) const TAGS: [&str; 2] = ["found", "missing"];
const RESOURCES: [&str; 2] = ["arm", "gripper"];
/// The most members of a group.
pub(crate) const MEMBERS: u32 = 5;

/// A sequence of numbers from a seed (xorshift64*).
#[derive(Clone, Debug)]
pub(crate) struct Dice(u64);

impl Dice {
    pub(crate) fn new(seed: u64) -> Self {
        Self((seed + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    /// A number below `end`.
    pub(crate) fn below(&mut self, end: u32) -> u32 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        let high = self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 33;
        u32::try_from(high % u64::from(end)).expect("it is below a u32")
    }

    pub(crate) fn one_in(&mut self, of: u32) -> bool {
        self.below(of) == 0
    }

    pub(crate) fn pick<'a, T>(&mut self, of: &'a [T]) -> &'a T {
        let length = u32::try_from(of.len()).expect("a short list");
        &of[self.below(length) as usize]
    }
}

/// Which operators a random group may contain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Taste {
    /// Everything that a plan can hold, even if `dca check` refuses it. For example, a member runs twice at once, or
    /// an arm is unreachable.
    Anything,
    /// Mostly expressions that a text can contain and that `dca check` accepts.
    Text,
}

struct Maker<'d> {
    dice: &'d mut Dice,
    taste: Taste,
    used: u32,
    /// The members that may occur again: those outside of loops.
    again: Vec<u32>,
    is_in_loop: bool,
    /// How many values with names are kept around.
    names: u32,
}

/// Makes a group of up to five members. Its expression may contain every operator.
pub(crate) fn group(dice: &mut Dice, taste: Taste) -> Group {
    let size = 2 + dice.below(4);
    of_size(dice, taste, size)
}

/// Makes a group whose expression has about `size` operands.
pub(crate) fn of_size(dice: &mut Dice, taste: Taste, size: u32) -> Group {
    let mut maker = Maker { dice, taste, used: 0, again: Vec::new(), is_in_loop: false, names: 0 };
    let expression = maker.expression(size);
    let used = maker.used;
    let members = (0..used.max(1)).map(|index| {
        let is_group = taste == Taste::Anything && dice.one_in(4);
        let kind = if is_group { MemberKind::Group(index) } else { MemberKind::Leaf(index) };
        Member { name: format!("m{index}"), kind, service: dice.one_in(4) }
    });
    Group {
        path: "main".into(),
        process: "main".into(),
        host: 0,
        members: members.collect(),
        sets: Vec::new(),
        sets_always: if taste == Taste::Anything { vec![90, 91] } else { Vec::new() },
        expression,
        supervision: Supervision::default(),
    }
}

impl Maker<'_> {
    fn expression(&mut self, size: u32) -> Expression {
        if size <= 1 {
            return self.leaf();
        }
        match self.dice.below(34) {
            0..=2 => Expression::Concurrent(self.operands(size)),
            3 => Expression::FailFast(self.operands(size)),
            4 | 5 => {
                let of = self.operands(size);
                let count = 1 + self.dice.below(u32::try_from(of.len()).expect("a short list"));
                Expression::AnyOf { count, of }
            }
            6..=8 => Expression::Disable(self.operands(size)),
            9 | 10 => self.two(size, Expression::Sequence),
            11 => self.two(size, Expression::Conditional),
            12 | 13 => self.recurrent(size),
            14 | 15 => self.two(size, Expression::Otherwise),
            16 | 17 => self.two(size, Expression::Finally),
            18 => self.matching(size),
            25 | 26 => self.repeat(size),
            27 | 28 => self.catch(size),
            29 | 30 => {
                let of = self.operands(size);
                let count = 1 + self.dice.below(u32::try_from(of.len()).expect("a short list"));
                Expression::AtLeast { count, of }
            }
            19 => {
                let bound = self.dice.one_in(2).then(|| self.time());
                Expression::Shield { bound, of: Box::new(self.expression(size - 1)) }
            }
            20 | 21 => self.using(size),
            22 => self.pool(size),
            23 => {
                let given = Given::Known { text: "\"a\"".to_owned(), value: text_value("a") };
                Expression::With { given, of: Box::new(self.expression(size - 1)) }
            }
            31 => {
                let name = format!("p{}", self.names);
                self.names += 1;
                let mut of = Box::new(self.expression(size - 1));
                self.names -= 1;
                if self.dice.one_in(2) {
                    of = Box::new(Expression::With { given: Given::Result(name.clone()), of });
                }
                Expression::Named { name, of }
            }
            32 | 33 if self.names > 0 => {
                let given = Given::Result(format!("p{}", self.dice.below(self.names)));
                Expression::With { given, of: Box::new(self.expression(size - 1)) }
            }
            _ => {
                Expression::Tagged { tag: (*self.dice.pick(&TAGS)).to_owned(), of: Box::new(self.expression(size - 1)) }
            }
        }
    }

    fn leaf(&mut self) -> Expression {
        match self.dice.below(14) {
            0 => Expression::Skip,
            1 => Expression::Never,
            2 => Expression::Fail("broken".into()),
            3 => Expression::Wait(self.time()),
            _ => self.run(),
        }
    }

    fn run(&mut self) -> Expression {
        let may_repeat = self.taste == Taste::Anything && !self.is_in_loop && !self.again.is_empty();
        let member = if self.used == MEMBERS || (may_repeat && self.dice.one_in(6)) {
            if !may_repeat {
                return Expression::Wait(self.time());
            }
            *self.dice.pick(&self.again)
        } else {
            self.used += 1;
            if !self.is_in_loop {
                self.again.push(self.used - 1);
            }
            self.used - 1
        };
        let sets = if self.taste == Taste::Anything { vec![member * 2, member * 2 + 1] } else { Vec::new() };
        Expression::Run { member, sets }
    }

    fn time(&mut self) -> Duration {
        Duration::from_secs(u64::from(1 + self.dice.below(5)))
    }

    fn operands(&mut self, size: u32) -> Vec<Expression> {
        let first = 1 + self.dice.below(size - 1);
        let mut of = vec![self.expression(first), self.expression(size - first)];
        if self.dice.one_in(4) {
            of.push(self.leaf());
        }
        of
    }

    fn two(&mut self, size: u32, kind: fn(Box<Expression>, Box<Expression>) -> Expression) -> Expression {
        let first = 1 + self.dice.below(size - 1);
        let p = self.expression(first);
        let q = self.expression(size - first);
        kind(Box::new(p), Box::new(q))
    }

    fn recurrent(&mut self, size: u32) -> Expression {
        let was = std::mem::replace(&mut self.is_in_loop, true);
        let first = 1 + self.dice.below(size - 1);
        let p = self.expression(first);
        let mut q = self.expression(size - first);
        if may_be_instant(&p) && may_be_instant(&q) {
            q = Expression::Sequence(Box::new(q), Box::new(Expression::Wait(self.time())));
        }
        self.is_in_loop = was;
        Expression::Recurrent(Box::new(p), Box::new(q))
    }

    fn pool(&mut self, size: u32) -> Expression {
        let was = std::mem::replace(&mut self.is_in_loop, true);
        let source = self.expression(size - 1);
        let mut pool = vec![self.expression(1)];
        if self.dice.one_in(2) {
            pool.push(self.expression(1));
        }
        self.is_in_loop = was;
        if may_be_instant(&source) && pool.iter().any(may_be_instant) {
            pool = vec![Expression::Wait(self.time())];
        }
        Expression::Asynchronous { source: Box::new(source), pool }
    }

    fn using(&mut self, size: u32) -> Expression {
        let resources: &[&str] = match self.dice.below(4) {
            0 => &RESOURCES,
            1 => &RESOURCES[1..],
            _ => &RESOURCES[..1],
        };
        let resources = resources.iter().map(|&resource| resource.to_owned()).collect();
        Expression::Using { resources, of: Box::new(self.expression(size - 1)) }
    }

    /// Returns a process, or a race of two processes, followed by a `match`.
    fn matching(&mut self, size: u32) -> Expression {
        let before = if self.dice.one_in(2) { self.run() } else { self.race(1) };
        let arms = vec![
            Arm { tag: Some(TAGS[0].to_owned()), body: self.expression(size - 1) },
            Arm { tag: if self.dice.one_in(3) { None } else { Some(TAGS[1].to_owned()) }, body: self.leaf() },
        ];
        Expression::Conditional(Box::new(before), Box::new(Expression::Match(arms)))
    }

    /// Returns an operand with one to three arms for its failures, and perhaps an `else`.
    fn catch(&mut self, size: u32) -> Expression {
        let of = Box::new(self.expression(size - 1));
        let mut failures = vec![
            Failure::Reported,
            Failure::Busy,
            Failure::StopUnconfirmed,
            Failure::ServiceEnded,
            Failure::NoMatch,
            Failure::Crash,
            Failure::Failed("broken".to_owned()),
        ];
        let mut arms = Vec::new();
        for _ in 0..=self.dice.below(3) {
            let at = self.dice.below(u32::try_from(failures.len()).expect("a short list"));
            arms.push(CatchArm { failure: Some(failures.remove(at as usize)), body: self.leaf() });
        }
        if self.dice.one_in(3) {
            arms.push(CatchArm { failure: None, body: self.leaf() });
        }
        Expression::Catch { of, arms }
    }

    /// Returns a process, or a race, that repeats until it ends with one tag, or with one of two.
    fn repeat(&mut self, size: u32) -> Expression {
        let was = std::mem::replace(&mut self.is_in_loop, true);
        let mut of = if self.dice.one_in(2) { self.run() } else { self.race(size - 1) };
        self.is_in_loop = was;
        if may_be_instant(&of) {
            of = Expression::Sequence(Box::new(Expression::Wait(self.time())), Box::new(of));
        }
        let count = if self.dice.one_in(4) { 2 } else { 1 };
        Expression::Repeat { until: TAGS[..count].iter().map(|&tag| tag.to_owned()).collect(), of: Box::new(of) }
    }

    /// Returns two operands, each with a tag of its own.
    fn race(&mut self, size: u32) -> Expression {
        let tagged = |tag: &str, of| Expression::Tagged { tag: tag.to_owned(), of: Box::new(of) };
        Expression::Disable(vec![tagged(TAGS[0], self.expression(size)), tagged(TAGS[1], self.leaf())])
    }
}

/// Returns whether an expression may be done as soon as it starts. In doubt, it returns yes.
fn may_be_instant(expression: &Expression) -> bool {
    *expression == Expression::Skip || expression.operands().into_iter().any(may_be_instant)
}
