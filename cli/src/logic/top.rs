//! The state of `dca top`: the page, the cursor, and the effect of each key. It is pure: the same model, state and time
//! give the same picture.

pub(crate) mod draw;
mod rows;
mod table;

use crate::logic::keys::Key;
use comms::logic::time::Time;
use rows::Row;
use view::{MissionId, Model, Robot};

/// The longest filter, in bytes.
const FILTER_MAX: usize = 60;

/// A page of the view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Tab {
    Robots,
    Processes,
    Wires,
    Events,
    Output,
    Questions,
}

impl Tab {
    /// All pages, in the order of their numbers.
    pub(crate) const ALL: [Self; 6] =
        [Self::Robots, Self::Processes, Self::Wires, Self::Events, Self::Output, Self::Questions];

    fn title(self) -> &'static str {
        match self {
            Self::Robots => "Robots",
            Self::Processes => "Processes",
            Self::Wires => "Wires",
            Self::Events => "Events",
            Self::Output => "Output",
            Self::Questions => "Questions",
        }
    }

    /// Returns whether the newest row is at the end, where the cursor stays unless it is moved.
    fn has_tail(self) -> bool {
        matches!(self, Self::Events | Self::Output)
    }

    fn place(self) -> usize {
        Self::ALL.iter().position(|tab| *tab == self).unwrap_or_default()
    }

    fn next(self, step: usize) -> Self {
        Self::ALL[(self.place() + step) % Self::ALL.len()]
    }
}

/// How the picture is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Look {
    /// Only characters of ASCII.
    pub(crate) is_ascii: bool,
    pub(crate) is_coloured: bool,
}

/// A process, and where it runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Program {
    pub(crate) mission: MissionId,
    pub(crate) host: String,
    pub(crate) path: String,
}

/// An output of a process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ProgramOutput {
    pub(crate) program: Program,
    pub(crate) port: String,
}

/// An answer to a question of an activity.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct GivenAnswer {
    pub(crate) mission: MissionId,
    pub(crate) path: String,
    pub(crate) question: u64,
    pub(crate) option: String,
}

/// An order of a person to the command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Action {
    Leave,
    /// Draw everything again, over texts of other programs.
    Redraw,
    /// Stop everything on all robots.
    Estop,
    /// Let programs begin again.
    Release,
    Answer(GivenAnswer),
}

/// The use of the next key.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Mode {
    Look,
    /// The text of a filter.
    Filter,
    Help,
    ConfirmEstop,
    ConfirmRelease,
    /// The number of an answer, to the question with this id.
    Answer(String),
}

/// The cursor and the filter of a page.
#[derive(Clone, Debug, Default)]
struct Pane {
    /// The id of the row under the cursor; none for the first row, or the newest.
    selected: Option<String>,
    filter: String,
}

/// The state of the view.
#[derive(Clone, Debug)]
pub(crate) struct Top {
    look: Look,
    tab: Tab,
    panes: [Pane; Tab::ALL.len()],
    mode: Mode,
    /// The process whose output is shown.
    program: Option<Program>,
    /// A word about the last action, until the next key.
    message: String,
    /// How many rows are visible.
    height: usize,
    /// The moment of the picture.
    now: Time,
}

impl Top {
    pub(crate) fn new(look: Look) -> Self {
        Self {
            look,
            tab: Tab::Processes,
            panes: std::array::from_fn(|_| Pane::default()),
            mode: Mode::Look,
            program: None,
            message: String::new(),
            height: 1,
            now: Time::ZERO,
        }
    }

    /// Takes note of the size of the terminal.
    pub(crate) fn resize(&mut self, rows: u16) {
        self.height = usize::from(rows.saturating_sub(draw::AROUND)).max(1);
    }

    /// Takes note of the time.
    pub(crate) fn tick(&mut self, now: Time) {
        self.now = now;
    }

    /// Shows a word about an action.
    pub(crate) fn say(&mut self, message: &str) {
        self.message = node::logic::printable::one_line(message);
    }

    /// Returns the process whose output is watched: none while another page is shown.
    pub(crate) fn heard(&self) -> Option<&Program> {
        self.program.as_ref().filter(|_| self.tab == Tab::Output)
    }

    /// Returns the output whose rate is watched: the output of the wire under the cursor.
    pub(crate) fn measured(&self, model: &Model) -> Option<ProgramOutput> {
        let (id, _) = (self.tab == Tab::Wires).then(|| self.selected(model))??;
        rows::output_of(model, &id)
    }

    /// Handles a key. Returns the requested action.
    pub(crate) fn key(&mut self, model: &Model, key: Key) -> Option<Action> {
        self.message.clear();
        if key == Key::Control('c') {
            return Some(Action::Leave);
        }
        match std::mem::replace(&mut self.mode, Mode::Look) {
            Mode::Look => self.look_key(model, key),
            Mode::Help => None,
            Mode::Filter => {
                self.filter_key(key);
                None
            }
            Mode::ConfirmEstop => self.confirmed(key, Action::Estop),
            Mode::ConfirmRelease => self.confirmed(key, Action::Release),
            Mode::Answer(id) => self.answer_key(model, &id, key),
        }
    }

    fn look_key(&mut self, model: &Model, key: Key) -> Option<Action> {
        match key {
            Key::Char('q') | Key::Function(10) => return Some(Action::Leave),
            Key::Control('l') => return Some(Action::Redraw),
            Key::Char('?' | 'h') | Key::Function(1) => self.mode = Mode::Help,
            Key::Char(digit @ '1'..='6') => {
                self.tab = Tab::ALL[usize::from(u8::try_from(digit).unwrap_or(b'1') - b'1')];
            }
            Key::Tab | Key::Right => self.tab = self.tab.next(1),
            Key::BackTab | Key::Left => self.tab = self.tab.next(Tab::ALL.len() - 1),
            Key::Up | Key::Char('k') => self.step(model, |at, _| at.saturating_sub(1)),
            Key::Down | Key::Char('j') => self.step(model, |at, _| at + 1),
            Key::PageUp | Key::Control('b') => self.step(model, usize::saturating_sub),
            Key::PageDown | Key::Control('f') => self.step(model, |at, page| at + page),
            Key::Home | Key::Char('g') => self.step(model, |_, _| 0),
            Key::End | Key::Char('G') => self.step(model, |_, _| usize::MAX),
            Key::Char('/') | Key::Function(4) => self.mode = Mode::Filter,
            Key::Escape => self.pane_mut().filter.clear(),
            Key::Char('l' | 'a') | Key::Enter => self.open(model),
            Key::Char('E') => self.mode = Mode::ConfirmEstop,
            Key::Char('R') if stopped(model).next().is_some() => self.mode = Mode::ConfirmRelease,
            Key::Char('R') => self.say("nothing to release: no emergency stop is active"),
            Key::Char(_) | Key::Control(_) | Key::Function(_) | Key::Backspace => {}
        }
        None
    }

    fn filter_key(&mut self, key: Key) {
        let filter = &mut self.pane_mut().filter;
        if key == Key::Enter {
            return;
        }
        if key == Key::Escape {
            filter.clear();
            return;
        }
        if key == Key::Backspace {
            filter.pop();
        }
        if let Key::Char(character) = key
            && filter.len() < FILTER_MAX
        {
            filter.push(character);
        }
        self.mode = Mode::Filter;
    }

    fn confirmed(&mut self, key: Key, action: Action) -> Option<Action> {
        if key == Key::Char('y') {
            return Some(action);
        }
        self.say("nothing was done");
        None
    }

    fn answer_key(&mut self, model: &Model, id: &str, key: Key) -> Option<Action> {
        let Key::Char(digit @ '1'..='9') = key else {
            self.say("no answer was given");
            return None;
        };
        let Some(question) = rows::question_of(model, id) else {
            self.say("the question is no longer open");
            return None;
        };
        let place = usize::from(u8::try_from(digit).unwrap_or(b'1') - b'1');
        let Some(option) = question.question.options.get(place).cloned() else {
            self.say(&format!("the question has no answer {digit}"));
            return None;
        };
        let (mission, path) = (question.mission.clone(), question.path.to_owned());
        Some(Action::Answer(GivenAnswer { mission, path, question: question.question.number, option }))
    }

    /// Opens the row under the cursor: the output of a process, or the answers to a question.
    fn open(&mut self, model: &Model) {
        let Some((id, _)) = self.selected(model) else { return };
        match self.tab {
            Tab::Questions => self.mode = Mode::Answer(id),
            Tab::Processes => match rows::program_of(model, &id) {
                Some(program) => (self.program, self.tab) = (Some(program), Tab::Output),
                None => self.say("choose a process: a deployment has no output of its own"),
            },
            Tab::Robots | Tab::Wires | Tab::Events | Tab::Output => {}
        }
    }

    fn pane(&self) -> &Pane {
        &self.panes[self.tab.place()]
    }

    fn pane_mut(&mut self) -> &mut Pane {
        &mut self.panes[self.tab.place()]
    }

    fn rows(&self, model: &Model) -> Vec<Row> {
        let mut rows = rows::rows(model, self.now, self.tab, self.heard());
        let filter = self.pane().filter.to_lowercase();
        rows.retain(|row| filter.is_empty() || row.text().to_lowercase().contains(&filter));
        rows
    }

    /// Returns the id and the place of the row under the cursor.
    fn selected(&self, model: &Model) -> Option<(String, usize)> {
        let rows = self.rows(model);
        let place = self.place(&rows)?;
        Some((rows.get(place)?.id.clone(), place))
    }

    fn place(&self, rows: &[Row]) -> Option<usize> {
        let last = rows.len().checked_sub(1)?;
        let found = self.pane().selected.as_ref().and_then(|id| rows.iter().position(|row| row.id == *id));
        Some(found.unwrap_or(if self.tab.has_tail() && self.pane().selected.is_none() { last } else { 0 }))
    }

    /// Moves the cursor to a place that is computed from the present one and the height of the page.
    fn step(&mut self, model: &Model, step: impl FnOnce(usize, usize) -> usize) {
        let rows = self.rows(model);
        let (Some(place), Some(last)) = (self.place(&rows), rows.len().checked_sub(1)) else { return };
        let to = step(place, self.height).min(last);
        let follows = self.tab.has_tail() && to == last;
        self.pane_mut().selected = rows.get(to).filter(|_| !follows).map(|row| row.id.clone());
    }
}

/// Returns the robots on which everything is stopped, according to the last report of each robot. This includes robots
/// that do not answer now.
fn stopped(model: &Model) -> impl Iterator<Item = (&Robot, &str)> {
    model.robots().filter_map(|robot| Some((robot, robot.estop.as_deref()?)))
}

#[cfg(test)]
mod tests;
