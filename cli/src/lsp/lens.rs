//! The results of `dca verify` for the sentences of a `verify` block. The editor shows them above the block.
//!
//! A separate thread computes the results within limits, at most once for each text. The next version of the text
//! cancels the thread. So a person who types never waits for a proof.

use super::inbox::Event;
use comms::io::clock;
use comms::logic::time::Time;
use language::ide::Analysis;
use language::{Options, Source, Span, compile_with_sites};
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::SyncSender;
use std::time::Duration;
use verify::{Alone, Finding, GoesOn, Limits, Repair, Verdict};

/// The most states and bytes of one exploration, and the longest time for everything. These limits are lower than the
/// limits of `dca verify`.
const STATES: u32 = 200_000;
const MEMORY: usize = 256 << 20;
const TIME: Duration = Duration::from_secs(5);
/// The most failing sentences that are named.
const NAMED_MAX: usize = 3;

/// The line above each block.
pub(super) type Titles = Vec<(Span, String)>;

/// Results of a thread about a text.
#[derive(Debug)]
pub(super) struct ProofReply {
    uri: String,
    number: u64,
    found: Found,
}

#[derive(Debug)]
enum Found {
    /// The titles of the results.
    Titles(Titles),
    /// Verified edits that repair the failing sentences. To find them takes longer, so they arrive later.
    Repairs(Vec<Repair>),
}

/// The known results for the blocks of one document.
struct Proof {
    /// The version of the text that the results are about.
    of: Rc<Analysis>,
    number: u64,
    is_called_off: Arc<AtomicBool>,
    /// Nothing until they are known.
    titles: Option<Titles>,
    repairs: Vec<Repair>,
}

/// The proofs of all documents that an editor has asked for.
pub(super) struct Proofs {
    events: SyncSender<Event>,
    documents: BTreeMap<String, Proof>,
    /// The number of the next proof.
    next: u64,
}

impl Proofs {
    pub(super) fn new(events: SyncSender<Event>) -> Self {
        Self { events, documents: BTreeMap::new(), next: 0 }
    }

    /// Returns the line above each block of a text. If it has no block that can be proved, cancels the computation for it.
    pub(super) fn titles(&mut self, uri: &str, analysis: &Rc<Analysis>) -> Option<Titles> {
        let blocks = analysis.blocks_to_prove();
        if blocks.is_empty() || analysis.plan().is_none() {
            self.forget(uri);
            return None;
        }
        let under_way = || blocks.iter().map(|block| (*block, "being proved …".to_owned())).collect();
        Some(self.of(uri, analysis).and_then(|known| known.titles.clone()).unwrap_or_else(under_way))
    }

    /// Returns the results that are known now. If the text is new, begins to compute them.
    fn of(&mut self, uri: &str, analysis: &Rc<Analysis>) -> Option<&Proof> {
        if !self.documents.get(uri).is_some_and(|known| Rc::ptr_eq(&known.of, analysis)) {
            self.begin(uri, analysis);
        }
        self.documents.get(uri)
    }

    /// Returns the repairs of a text that are known now.
    pub(super) fn repairs(&mut self, uri: &str, analysis: &Rc<Analysis>) -> &[Repair] {
        self.of(uri, analysis).map_or(&[], |known| &known.repairs)
    }

    fn begin(&mut self, uri: &str, analysis: &Rc<Analysis>) {
        self.forget(uri);
        let is_called_off = Arc::new(AtomicBool::new(false));
        let number = self.next;
        self.next += 1;
        let (events, reply_to, off) = (self.events.clone(), uri.to_owned(), Arc::clone(&is_called_off));
        let (spec, others, blocks) = (analysis.spec().clone(), analysis.others().to_vec(), analysis.blocks_to_prove());
        let prove = move || {
            find_out(&spec, &others, &blocks, off, |found| {
                let reply = ProofReply { uri: reply_to.clone(), number, found };
                // If the editor is gone, the result has no receiver.
                events.send(Event::Proof(reply)).unwrap_or_default();
            });
        };
        // The thread is not joined: it ends within its limits.
        let is_begun = std::thread::Builder::new().name("prove".to_owned()).spawn(prove).is_ok();
        let titles = (!is_begun).then(Titles::new);
        let proof = Proof { of: Rc::clone(analysis), number, is_called_off, titles, repairs: Vec::new() };
        self.documents.insert(uri.to_owned(), proof);
    }

    /// Takes the results of a thread. Returns whether they are still about the present text.
    pub(super) fn take(&mut self, arrived: ProofReply) -> bool {
        let known = self.documents.get_mut(&arrived.uri).filter(|known| known.number == arrived.number);
        let Some(known) = known else { return false };
        match arrived.found {
            Found::Titles(titles) => known.titles = Some(titles),
            Found::Repairs(repairs) => known.repairs = repairs,
        }
        true
    }

    /// Cancels the computation for a document.
    pub(super) fn forget(&mut self, uri: &str) {
        if let Some(known) = self.documents.remove(uri) {
            known.is_called_off.store(true, Ordering::Relaxed);
        }
    }
}

impl Drop for Proofs {
    fn drop(&mut self) {
        self.documents.values().for_each(|known| known.is_called_off.store(true, Ordering::Relaxed));
    }
}

/// The time when a computation has to end. It ends earlier if it is cancelled.
#[derive(Debug)]
struct Until {
    end: Time,
    is_called_off: Arc<AtomicBool>,
}

impl GoesOn for Until {
    fn goes_on(&self) -> bool {
        !self.is_called_off.load(Ordering::Relaxed) && clock::now() < self.end
    }
}

/// Verifies a text, and then searches for repairs.
fn find_out(
    spec: &Source,
    others: &[Source],
    blocks: &[Span],
    is_called_off: Arc<AtomicBool>,
    mut tell: impl FnMut(Found),
) {
    let options = Options::named("spec");
    let (compiled, sites) = compile_with_sites(spec, others, &options);
    let Some((plan, sites)) = compiled.plan.zip(sites) else { return tell(Found::Titles(Titles::new())) };
    let until = Until { end: clock::now() + TIME, is_called_off };
    let limits = Limits { states: STATES, memory: MEMORY, threads: &Alone, goes_on: &until };
    let report = verify::verify(&plan, &sites, &limits);
    let title = |block: &Span| {
        let is_of_block = |finding: &&Finding| finding.place.is_some_and(|place| block.contains(place));
        (*block, title(spec, &report.findings.iter().filter(is_of_block).collect::<Vec<_>>()))
    };
    tell(Found::Titles(blocks.iter().map(title).collect()));
    let before = verify::Verified { spec, plan: &plan, sites: &sites, report: &report };
    let repairs = verify::repairs(&before, others, &options, &limits);
    if !repairs.is_empty() {
        tell(Found::Repairs(repairs));
    }
}

/// Returns the line for a block: `12 sentences hold`, `2 of 12 do not hold: never a with b; can finish`. A sentence
/// about several groups holds only if it holds for each of them.
fn title(spec: &Source, found: &[&Finding]) -> String {
    let of = |verdict: Verdict| -> BTreeSet<Span> {
        found.iter().filter(|finding| finding.verdict == verdict).filter_map(|finding| finding.place).collect()
    };
    let (proved, fails, open) = (of(Verdict::Proved), of(Verdict::Fails), of(Verdict::Open));
    let all = proved.union(&fails).chain(&open).collect::<BTreeSet<_>>().len();
    let text = |span: &Span| spec.text.get(span.start as usize..span.end as usize).unwrap_or_default();
    let mut parts = Vec::new();
    if !fails.is_empty() {
        let named: Vec<&str> = fails.iter().take(NAMED_MAX).map(text).collect();
        let more = if fails.len() > NAMED_MAX { "; …" } else { "" };
        let verb = if fails.len() == 1 { "does" } else { "do" };
        parts.push(format!("{} of {all} {verb} not hold: {}{more}", fails.len(), named.join("; ")));
    }
    if !open.is_empty() {
        parts.push(format!("{} of {all} not decided here: `dca verify` takes its time", open.len()));
    }
    match (parts.is_empty(), all) {
        (true, 0) => "nothing to prove".to_owned(),
        (true, 1) => "1 sentence holds".to_owned(),
        (true, all) => format!("{all} sentences hold"),
        (false, _) => parts.join(" · "),
    }
}
