//! Draws `dca top` into a buffer of cells.

use super::rows::{self, Row, Tone};
use super::table::{self, Column, Placed};
use super::{Mode, Tab, Top, stopped};
use node::logic::table::counted;
use ratatui_core::buffer::Buffer;
use ratatui_core::layout::Rect;
use ratatui_core::style::{Color, Modifier, Style};
use std::time::Duration;
use unicode_width::UnicodeWidthStr as _;
use view::sentence::time_of_day;
use view::{Health, Model, Presence};

/// The lines around the rows: the summary, the pages, the titles, and the keys.
pub(crate) const AROUND: u16 = 4;

/// The help, a line for each key.
const HELP: [(&str, &str); 16] = [
    ("1 to 6, Tab", "go to another page"),
    ("Up, Down, k, j", "move the cursor by a row"),
    ("PageUp, PageDown", "move the cursor by a page"),
    ("Home, End, g, G", "go to the first or last row; the last one follows events"),
    ("/", "filter the rows; Enter keeps the filter, Escape ends it"),
    ("Enter, l", "page Processes: show the output of this process"),
    ("Enter, a", "page Questions: answer this question"),
    ("E", "stop everything on all robots at once, after a question"),
    ("R", "let programs begin again, after a question"),
    ("?, Ctrl-L", "this help; draw everything again"),
    ("q, Ctrl-C", "leave; all missions continue"),
    ("", ""),
    ("", "Page Wires measures the rate of the wire under the cursor. Other rates are not"),
    ("", "measured, since a measured output sends its values to this terminal."),
    ("", ""),
    ("", "SINCE with `>`: the exact time is not known; it is this time or earlier."),
];

/// Draws everything. `time` is the time of day, since 1970.
pub(crate) fn draw(top: &Top, model: &Model, time: Duration, buffer: &mut Buffer) {
    let area = *buffer.area();
    let mut canvas = Canvas { top, buffer, area };
    canvas.summary(model, time);
    canvas.pages(model);
    match &top.mode {
        Mode::Help => canvas.help(),
        Mode::Look | Mode::Filter | Mode::ConfirmEstop | Mode::ConfirmRelease | Mode::Answer(_) => canvas.table(model),
    }
    canvas.keys(model);
}

struct Canvas<'a> {
    top: &'a Top,
    buffer: &'a mut Buffer,
    area: Rect,
}

impl Canvas<'_> {
    /// Writes a text into a line; returns the column behind it.
    fn put(&mut self, column: u16, line: u16, text: &str, style: Style) -> u16 {
        if line >= self.area.height || column >= self.area.width {
            return column;
        }
        let ascii = |character: char| if character.is_ascii() { character } else { '?' };
        let shown: String = if self.top.look.is_ascii { text.chars().map(ascii).collect() } else { text.to_owned() };
        self.buffer.set_stringn(column, line, shown, usize::from(self.area.width - column), style).0
    }

    fn style(&self, tone: Tone) -> Style {
        let colour = match tone {
            Tone::Plain | Tone::Title => None,
            Tone::Good => Some(Color::Green),
            Tone::Quiet => None,
            Tone::Changing => Some(Color::Yellow),
            Tone::Bad => Some(Color::Red),
        };
        let style = colour.filter(|_| self.top.look.is_coloured).map_or(Style::new(), |colour| Style::new().fg(colour));
        match tone {
            Tone::Title | Tone::Bad => style.add_modifier(Modifier::BOLD),
            Tone::Quiet => style.add_modifier(Modifier::DIM),
            Tone::Plain | Tone::Good | Tone::Changing => style,
        }
    }

    /// An alarm, over the whole line.
    fn alarm(&mut self, line: u16, text: &str) {
        let style = self.style(Tone::Bad).add_modifier(Modifier::REVERSED);
        let text = table::cell(text, usize::from(self.area.width), false);
        self.put(0, line, &text, style);
    }

    fn summary(&mut self, model: &Model, time: Duration) {
        let freshness = model.freshness(self.top.now);
        if !freshness.is_live() {
            return self.alarm(0, &format!(" {}: no robot answers", freshness.to_string().to_uppercase()));
        }
        if let Some((_, by)) = stopped(model).next() {
            let hosts: Vec<String> = stopped(model).map(|(robot, _)| robot.id.to_string()).collect();
            return self.alarm(0, &format!(" EVERYTHING IS STOPPED (R releases) on {}: {by}", hosts.join(", ")));
        }
        let (robots, running) = (model.robots().count(), model.deployments().filter(|live| live.end.is_none()).count());
        let processes = || model.deployments().flat_map(|live| live.processes.values().map(move |one| (&live.id, one)));
        let failed = processes().filter(|(id, process)| model.health(id, process) == Health::Failed).count();
        let away = model.robots().filter(|robot| robot.presence != Presence::Here).count();
        let text = format!(
            " {}  {}  {}",
            counted(robots, "robot"),
            counted(running, "deployment"),
            processes_in_words(processes().count()),
        );
        let mut column = self.put(0, 0, &text, self.style(Tone::Title));
        for (count, words) in [(failed, "failed"), (away, "not answering")] {
            if count > 0 {
                column = self.put(column, 0, &format!("  {count} {words}"), self.style(Tone::Bad));
            }
        }
        let clock = time_of_day(time) + "Z";
        let width = u16::try_from(clock.len()).unwrap_or_default();
        if column + 1 + width < self.area.width {
            self.put(self.area.width - width - 1, 0, &clock, Style::new());
        }
    }

    /// Draws the titles of the pages. On a narrow terminal, only the page that is shown and open questions have a title.
    fn pages(&mut self, model: &Model) {
        let questions = model.questions().count();
        let title = |(place, tab): (usize, Tab), is_short: bool| {
            let count = if tab == Tab::Questions && questions > 0 { format!(" ({questions})") } else { String::new() };
            let has_title = !is_short || tab == self.top.tab || !count.is_empty();
            let text =
                if has_title { format!("{} {}{count}", place + 1, tab.title()) } else { (place + 1).to_string() };
            let style = match (tab == self.top.tab, count.is_empty()) {
                (true, _) => Style::new().add_modifier(Modifier::REVERSED),
                (false, true) => Style::new(),
                (false, false) => self.style(Tone::Changing).add_modifier(Modifier::BOLD),
            };
            (text, style)
        };
        let titles = |is_short: bool| -> Vec<(String, Style)> {
            Tab::ALL.into_iter().enumerate().map(|numbered| title(numbered, is_short)).collect()
        };
        let (mut shown, mut gap) = (titles(false), 2);
        if shown.iter().map(|(text, _)| text.len() + 2).sum::<usize>() > usize::from(self.area.width) {
            (shown, gap) = (titles(true), 1);
        }
        let mut column = 1;
        for (text, style) in shown {
            column = self.put(column, 1, &text, style) + gap;
        }
    }

    fn table(&mut self, model: &Model) {
        let rows = self.top.rows(model);
        let columns = rows::columns(self.top.tab);
        let widest = widest(columns, &rows);
        let placed = table::fit(columns, &widest, usize::from(self.area.width.saturating_sub(1)));
        let titles: Vec<String> = columns.iter().map(|column| column.title.to_owned()).collect();
        let title = match (self.top.tab, &self.top.program) {
            (Tab::Output, Some(program)) => format!("{}:{}", program.mission, program.path),
            (_, _) => line(columns, &placed, &titles),
        };
        self.put(1, 2, &title, Style::new().add_modifier(Modifier::UNDERLINED));
        if rows.is_empty() {
            self.put(1, 3, self.nothing(), self.style(Tone::Quiet));
            return;
        }
        let selected = self.top.place(&rows).unwrap_or_default();
        let detail = self.detail(columns, &placed, &rows[selected]);
        let below = u16::try_from(detail.len()).unwrap_or_default();
        for (at, text) in (self.area.height.saturating_sub(1 + below)..).zip(&detail) {
            self.put(1, at, text, self.style(Tone::Title));
        }
        let height = usize::from(self.area.height.saturating_sub(AROUND + below)).max(1);
        let first = first_visible(selected, height, rows.len());
        for (at, row) in rows.iter().enumerate().skip(first).take(height) {
            let mut style = self.style(row.tone);
            let text = line(columns, &placed, &row.cells);
            let width = usize::from(self.area.width.saturating_sub(1));
            let text = if at == selected { table::cell(&text, width, false) } else { text };
            if at == selected {
                style = style.add_modifier(Modifier::REVERSED);
            }
            let y = u16::try_from(at - first + 3).unwrap_or(u16::MAX);
            self.put(1, y, &text, style);
        }
    }

    /// Returns the whole texts of the row under the cursor that its columns have cut, in lines for below the table. They take a third
    /// of the terminal at most, and a question that is being answered two thirds.
    fn detail(&self, columns: &[Column], placed: &[Placed], row: &Row) -> Vec<String> {
        let is_cut = |one: &&Placed| row.cells.get(one.place).is_some_and(|cell| cell.width() > one.width);
        let text = |one: &Placed| format!("{}: {}", columns[one.place].title, row.cells[one.place].trim());
        let texts: Vec<String> = placed.iter().filter(is_cut).map(text).collect();
        let part = if matches!(self.top.mode, Mode::Answer(_)) { 2 } else { 1 };
        let limit = usize::from(self.area.height.saturating_sub(AROUND)) * part / 3;
        table::wrap(&texts.join("  "), usize::from(self.area.width.saturating_sub(1)), limit)
    }

    /// Returns the sentence for a page without rows.
    fn nothing(&self) -> &'static str {
        if !self.top.pane().filter.is_empty() {
            return "no row has this text; Escape shows all rows";
        }
        match self.top.tab {
            Tab::Robots => "no robot is known",
            Tab::Processes => "nothing is deployed",
            Tab::Wires => "no deployment has wires",
            Tab::Events => "nothing has happened yet",
            Tab::Output if self.top.program.is_some() => "it has written nothing yet",
            Tab::Output => "choose a process on page 2, and press Enter",
            Tab::Questions => "no question is open",
        }
    }

    fn help(&mut self) {
        for (at, (keys, text)) in (2_u16..).zip(HELP) {
            let column = if keys.is_empty() { 1 } else { 20 };
            self.put(1, at, keys, self.style(Tone::Title));
            self.put(column, at, text, Style::new());
        }
    }

    /// The last line: a question, a word about the last action, or the keys.
    fn keys(&mut self, model: &Model) {
        let line = self.area.height.saturating_sub(1);
        let robots = counted(model.robots().count(), "robot");
        let pane = self.top.pane();
        match &self.top.mode {
            Mode::ConfirmEstop => {
                return self
                    .alarm(line, &format!(" Stop everything on {robots} at once? y: stop everything  other keys: no"));
            }
            Mode::ConfirmRelease => {
                return self.alarm(line, " Let programs begin again on all robots? y: release  other keys: no");
            }
            Mode::Answer(id) => {
                let options = rows::question_of(model, id).map(|question| question.question.options.clone());
                let options = options.unwrap_or_default();
                let keys: Vec<String> =
                    options.iter().enumerate().map(|(at, text)| format!("{}: {text}", at + 1)).collect();
                if keys.is_empty() {
                    return self.alarm(line, " This question is no longer open; press any key to continue");
                }
                return self.alarm(line, &format!(" Answer: {}  other keys: cancel", keys.join("  ")));
            }
            Mode::Filter => {
                self.put(0, line, &format!(" filter: {}_", pane.filter), self.style(Tone::Title));
                return;
            }
            Mode::Look | Mode::Help => {}
        }
        if !self.top.message.is_empty() {
            self.put(0, line, &format!(" {}", self.top.message), self.style(Tone::Title));
            return;
        }
        let filter = if pane.filter.is_empty() { String::new() } else { format!("  [{}: Esc]", pane.filter) };
        let open = match self.top.tab {
            Tab::Processes => "  Enter output",
            Tab::Questions => "  Enter answer",
            Tab::Robots | Tab::Wires | Tab::Events | Tab::Output => "",
        };
        let text = format!(" ? help  / filter{open}  E stop everything  q leave{filter}");
        self.put(0, line, &text, Style::new());
    }
}

fn processes_in_words(count: usize) -> String {
    format!("{count} process{}", if count == 1 { "" } else { "es" })
}

/// Returns the first row that is visible, so that the one under the cursor is, and no line is left empty.
fn first_visible(selected: usize, height: usize, count: usize) -> usize {
    let middle = selected.saturating_sub(height / 2);
    middle.min(count.saturating_sub(height))
}

fn widest(columns: &[Column], rows: &[Row]) -> Vec<usize> {
    let widest = |place: usize| rows.iter().filter_map(|row| row.cells.get(place)).map(|cell| cell.width()).max();
    (0..columns.len()).map(|place| widest(place).unwrap_or_default()).collect()
}

fn line(columns: &[Column], placed: &[Placed], cells: &[String]) -> String {
    let cell = |one: &Placed| {
        let text = cells.get(one.place).map_or("", String::as_str);
        table::cell(text, one.width, columns[one.place].is_right)
    };
    placed.iter().map(cell).collect::<Vec<_>>().join("  ").trim_end().to_owned()
}
