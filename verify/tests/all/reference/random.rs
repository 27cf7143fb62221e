//! Random expressions from a seed.

use super::term::Expr;

/// Numbers from a seed (Steele, Lea, Flood 2014: SplitMix64).
pub(crate) struct Random {
    state: u64,
    /// How many pauses were written.
    waits: u32,
}

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self { state: seed, waits: 0 }
    }

    fn next(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.state ^ (self.state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    pub(crate) fn below(&mut self, end: u64) -> u64 {
        self.next() % end
    }

    /// An expression of the processes that are left, each used once.
    pub(crate) fn expression(&mut self, left: &mut Vec<usize>, depth: u32) -> Expr {
        if depth == 0 || left.len() < 2 || self.below(8) == 0 {
            return self.leaf(left);
        }
        match self.below(11) {
            0 | 1 => Expr::Seq(self.boxed(left, depth), self.boxed(left, depth)),
            2 => Expr::Else(self.boxed(left, depth), self.boxed(left, depth)),
            3 => Expr::Rec(self.guarded(left, depth), self.boxed(left, depth)),
            4 | 5 => Expr::Par(self.several(left, depth)),
            6 => Expr::FailFast(self.several(left, depth)),
            7 => Expr::Any(1, self.several(left, depth)),
            8 => Expr::Shield(self.boxed(left, depth)),
            9 => Expr::Finally(self.boxed(left, depth), self.boxed(left, depth)),
            _ => Expr::Disable(self.several(left, depth)),
        }
    }

    fn boxed(&mut self, left: &mut Vec<usize>, depth: u32) -> Box<Expr> {
        Box::new(self.expression(left, depth - 1))
    }

    fn several(&mut self, left: &mut Vec<usize>, depth: u32) -> Vec<Expr> {
        (0..2 + self.below(2)).map(|_| self.expression(left, depth - 1)).collect()
    }

    /// A loop has to take time.
    fn guarded(&mut self, left: &mut Vec<usize>, depth: u32) -> Box<Expr> {
        let first = left.pop().map_or_else(|| self.wait(), Expr::Leaf);
        Box::new(Expr::Seq(Box::new(first), self.boxed(left, depth)))
    }

    fn wait(&mut self) -> Expr {
        self.waits += 1;
        Expr::Wait(self.waits)
    }

    fn leaf(&mut self, left: &mut Vec<usize>) -> Expr {
        match (self.below(10), left.pop()) {
            (0, _) => Expr::Skip,
            (1, _) => self.wait(),
            (2, _) => Expr::Fail,
            (3, _) => Expr::Never,
            (_, Some(leaf)) => Expr::Leaf(leaf),
            (_, None) => Expr::Skip,
        }
    }
}
