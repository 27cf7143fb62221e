//! Pictures of `dca top`, and the effects of its keys.

use super::*;
use comms::logic::time::Time;
use expect_test::{Expect, expect};
use node::logic::protocol::{
    ActivityStatus, Change, Containment, Deployment, DeploymentStatus, Estop, Event, FailureCause, LostValues, Network,
    NodeStatus, OpenQuestion, ProcessStatus, Report,
};
use ratatui_core::buffer::Buffer;
use ratatui_core::layout::Rect;
use ratatui_core::style::{Color, Modifier};
use std::time::Duration;
use view::{Fleet, Input, MissionId, RobotId};

const PLAIN: Look = Look { is_ascii: false, is_coloured: true };

fn at(seconds: u64) -> Time {
    Time::ZERO + Duration::from_secs(10_000 + seconds)
}

fn door() -> Deployment {
    Deployment { name: "door".into(), epoch: 3 }
}

fn robot(host: &str) -> RobotId {
    RobotId { host: host.into(), fleet: Fleet::Standing }
}

/// The deployment [`door`] with its home on `r1`.
fn mission() -> MissionId {
    MissionId { deployment: door(), home: "r1".into(), fleet: Fleet::Standing }
}

fn told(status: NodeStatus) -> Input {
    Input::Status { fleet: Fleet::Standing, status: Box::new(status) }
}

fn happened(event: Event) -> Input {
    Input::Event { home: robot("r1"), event: Box::new(event) }
}

fn process(path: &str, kind: &str, state: &str) -> ProcessStatus {
    let pid = path.contains('/').then_some(4711);
    ProcessStatus { path: path.into(), kind: kind.into(), state: state.into(), pid, activity: None }
}

fn node(host: &str, processes: Vec<ProcessStatus>) -> NodeStatus {
    let lost = vec![LostValues { wire: "main/hit/force, Out -> main/hit/arm, In".into(), count: 12 }];
    let (home, phase) = ("r1".into(), "running".into());
    let part = DeploymentStatus {
        deployment: door(),
        home,
        phase,
        processes,
        lost,
        refused: Vec::new(),
        undelivered: Vec::new(),
    };
    NodeStatus {
        host: host.into(),
        pid: 1,
        version: "0.1.0".into(),
        up: Duration::from_secs(4000),
        peers: Vec::new(),
        deployments: vec![part],
        containment: Containment::default(),
        network: Network::Insecure,
        estop: None,
        policy: None,
        missing: Vec::new(),
        waiting: Vec::new(),
    }
}

fn with_question() -> ProcessStatus {
    let question =
        OpenQuestion { number: 2, text: "Is the door free?".into(), options: vec!["yes".into(), "no".into()] };
    let activity = ActivityStatus { states: vec!["Asking".into()], questions: vec![question], orders: Vec::new() };
    ProcessStatus { activity: Some(activity), ..process("main/ask", "Ask", "running; in Asking") }
}

fn event(number: u64, path: &str, change: Change) -> Input {
    let report = Report::Process { path: path.into(), change, at: Duration::from_secs(4) };
    let time = Duration::from_secs(1_795_392_000 + number);
    let ago = Duration::from_secs(40);
    happened(Event { deployment: door(), number, host: "r2".into(), ago, report, time })
}

/// Two robots with a door, a crash and a question.
fn model() -> Model {
    let mut model = Model::new(1);
    let first = vec![process("main", "Main", "running"), with_question(), process("main/hit", "Hit", "running")];
    let second = vec![process("main/hit/arm", "Arm", "running"), process("main/hit/force", "Force", "dead: SIGSEGV")];
    model.apply(at(0), event(0, "main/hit/arm", Change::Started { pid: 4711 }));
    model.apply(at(0), event(1, "main/hit/force", Change::Died(FailureCause::Signal(11))));
    model.apply(at(0), told(node("r1", first)));
    model.apply(at(1), told(node("r2", second)));
    model
}

fn picture(top: &Top, model: &Model, width: u16) -> Buffer {
    let mut buffer = Buffer::empty(Rect::new(0, 0, width, 14));
    draw::draw(top, model, Duration::from_secs(1_795_392_123), &mut buffer);
    buffer
}

fn lines(buffer: &Buffer) -> Vec<String> {
    let width = usize::from(buffer.area().width);
    let line = |cells: &[ratatui_core::buffer::Cell]| cells.iter().map(|cell| cell.symbol()).collect::<String>();
    buffer.content().chunks(width).map(|cells| line(cells).trim_end().to_owned()).collect()
}

#[track_caller]
fn check(keys: &[Key], model: &Model, expected: &Expect) {
    let mut top = Top::new(PLAIN);
    top.resize(14);
    top.tick(at(2));
    for key in keys {
        assert_eq!(top.key(model, *key), None);
    }
    // The first column is blank. An expectation cannot have a column of blanks.
    let shown = lines(&picture(&top, model, 80));
    let shown = shown.iter().map(|line| line.strip_prefix(' ').unwrap_or(line).to_owned() + "\n");
    expected.assert_eq(&shown.collect::<String>());
}

#[test]
fn processes_are_a_tree() {
    check(
        &[],
        &model(),
        &expect![[r#"
         2 robots  1 deployment  5 processes  1 failed                        00:02:03Z
         1 Robots  2 Processes  3 Wires  4 Events  5 Output  6 Questions (1)
         PROCESS             STATE            SINCE  HOST   PID  RESTARTS
         door@3              running                 r1
           main: Main        running            >2s  r1
             ask: Ask        asks a question    >2s  r1    4711
             hit: Hit        running            >2s  r1    4711
               arm: Arm      running            42s  r2    4711
               force: Force  dead: SIGSEGV      42s  r2    4711




         ? help  / filter  Enter output  E stop everything  q leave
    "#]],
    );
}

#[test]
fn robots_have_an_age() {
    check(
        &[Key::Char('1')],
        &model(),
        &expect![[r#"
            2 robots  1 deployment  5 processes  1 failed                        00:02:03Z
            1 Robots  2 Processes  3 Wires  4 Events  5 Output  6 Questions (1)
            ROBOT  STATE  DATA   UP  PROCESSES  DATABASE  NOTE
            r1     here     2s  66m          3            open to everybody on the network:
            r2     here     1s  66m          2            open to everybody on the network:







            NOTE: open to everybody on the network: --insecure-lan
            ? help  / filter  E stop everything  q leave
        "#]],
    );
}

#[test]
fn wires_have_losses() {
    check(
        &[Key::Char('3')],
        &model(),
        &expect![[r#"
         2 robots  1 deployment  5 processes  1 failed                        00:02:03Z
         1 Robots  2 Processes  3 Wires  4 Events  5 Output  6 Questions (1)
         WIRE                                         RATE  LOST  LOST/S  REFUSED
         door: main/hit/force.Out -> main/hit/arm.In          12       -        -









         ? help  / filter  E stop everything  q leave
    "#]],
    );
}

#[test]
fn events_are_in_order() {
    check(
        &[Key::Char('4')],
        &model(),
        &expect![[r#"
         2 robots  1 deployment  5 processes  1 failed                        00:02:03Z
         1 Robots  2 Processes  3 Wires  4 Events  5 Output  6 Questions (1)
         TIME      HOST  DEPLOYMENT  EVENT
         00:00:00  r2    door@3      main/hit/arm  started as process 4711
         00:00:01  r2    door@3      main/hit/force  died: SIGSEGV








         ? help  / filter  E stop everything  q leave
    "#]],
    );
}

#[test]
fn the_output_of_the_process_under_the_cursor_is_shown() {
    let mut model = model();
    let bytes = b"\x1b[2Jhello\nworld\n".to_vec();
    model.apply(at(1), Input::Output { mission: mission(), path: "main/ask".into(), bytes });
    check(
        &[Key::Down, Key::Down, Key::Enter],
        &model,
        &expect![[r#"
            2 robots  1 deployment  5 processes  1 failed                        00:02:03Z
            1 Robots  2 Processes  3 Wires  4 Events  5 Output  6 Questions (1)
            door@3:main/ask
            \x1b[2Jhello
            world








            ? help  / filter  E stop everything  q leave
        "#]],
    );
}

#[test]
fn a_question_is_answered_by_a_number() {
    let model = model();
    check(
        &[Key::Char('6'), Key::Enter],
        &model,
        &expect![[r#"
         2 robots  1 deployment  5 processes  1 failed                        00:02:03Z
         1 Robots  2 Processes  3 Wires  4 Events  5 Output  6 Questions (1)
         ACTIVITY       NUMBER  QUESTION           ANSWERS
         door:main/ask       2  Is the door free?  yes, no









         Answer: 1: yes  2: no  other keys: cancel
    "#]],
    );
    let mut top = Top::new(PLAIN);
    let press = |top: &mut Top, keys: &[Key]| keys.iter().find_map(|key| top.key(&model, *key));
    assert_eq!(press(&mut top, &[Key::Char('6'), Key::Char('a'), Key::Char('3')]), None, "there are two answers");
    assert_eq!(press(&mut top, &[Key::Char('a'), Key::Escape, Key::Char('1')]), None);
    let answer = press(&mut top, &[Key::Char('6'), Key::Char('a'), Key::Char('2')]);
    let (path, option) = ("main/ask".into(), "no".into());
    assert_eq!(answer, Some(Action::Answer(GivenAnswer { mission: mission(), path, question: 2, option })));
}

#[test]
fn help_fits_into_80_columns() {
    let help = lines(&picture_of(&[Key::Char('?')], 80));
    let wide = lines(&picture_of(&[Key::Char('?')], 200));
    assert!(help[2].contains("1 to 6") && help == wide, "{help:#?}\n{wide:#?}");
}

#[test]
fn a_narrow_terminal_shows_every_page_by_its_number() {
    let shown = |width| lines(&picture_of(&[Key::Char('2')], width))[1].clone();
    assert_eq!(shown(40), " 1 2 Processes 3 4 5 6 Questions (1)");
    assert_eq!(shown(80), " 1 Robots  2 Processes  3 Wires  4 Events  5 Output  6 Questions (1)");
}

fn picture_of(keys: &[Key], width: u16) -> Buffer {
    let (mut top, model) = (Top::new(PLAIN), model());
    top.tick(at(2));
    keys.iter().for_each(|key| assert_eq!(top.key(&model, *key), None));
    let mut buffer = Buffer::empty(Rect::new(0, 0, width, 24));
    draw::draw(&top, &model, Duration::ZERO, &mut buffer);
    // The clock of the summary is at the right edge.
    for x in 0..width {
        buffer[(x, 0)].set_char(' ');
    }
    buffer
}

#[test]
fn an_estop_is_given_only_after_a_yes() {
    let model = model();
    let mut top = Top::new(PLAIN);
    let press = |top: &mut Top, keys: &[Key]| keys.iter().find_map(|key| top.key(&model, *key));
    let asked = picture_of(&[Key::Char('E')], 80);
    assert!(
        lines(&asked)[23].contains("Stop everything on 2 robots at once? y: stop everything"),
        "{:?}",
        lines(&asked)
    );
    assert_eq!(press(&mut top, &[Key::Char('E'), Key::Enter]), None);
    assert_eq!(press(&mut top, &[Key::Char('y')]), None, "the question is over");
    assert_eq!(press(&mut top, &[Key::Char('E'), Key::Char('y')]), Some(Action::Estop));
    assert_eq!(press(&mut top, &[Key::Char('R'), Key::Char('y')]), None, "nothing is stopped");
}

/// The end of a question may decide the answer, so a person has to see all of it.
#[test]
fn a_long_question_is_shown_whole_where_it_is_answered() {
    let text = "Is the door free, is nobody behind it, and is the floor dry? If you are not sure, look again, since a no costs \
                nothing, and a yes moves an arm of 60 kg: DANGER";
    let mut ask = with_question();
    let activity = ask.activity.as_mut().expect("it asks");
    activity.questions[0].text = text.into();
    let mut model = Model::new(1);
    model.apply(at(0), told(node("r1", vec![ask])));
    let mut top = Top::new(PLAIN);
    top.tick(at(1));
    for key in [Key::Char('6'), Key::Enter] {
        top.key(&model, key);
    }
    let shown = lines(&picture(&top, &model, 80));
    let words = |text: &str| text.split_whitespace().map(str::to_owned).collect::<Vec<_>>();
    let below: Vec<String> = words(&shown[4..shown.len() - 1].join(" "));
    assert!(below.join(" ").contains(&words(text).join(" ")), "{shown:#?}");
    assert_eq!(shown.last().map(String::as_str), Some(" Answer: 1: yes  2: no  other keys: cancel"));
}

#[test]
fn an_estop_is_on_every_page() {
    let mut model = model();
    let estop = Some(Estop { by: "ann@c1".into(), reason: "a person".into() });
    model.apply(at(1), told(NodeStatus { estop, ..node("r1", Vec::new()) }));
    for page in ['1', '2', '3', '4', '5', '6', '?'] {
        let mut top = Top::new(PLAIN);
        top.tick(at(2));
        top.key(&model, Key::Char(page));
        let shown = picture(&top, &model, 80);
        let expected = " EVERYTHING IS STOPPED (R releases) on r1: everything was stopped by ann@c1: a p";
        assert_eq!(lines(&shown)[0], expected);
        assert!(shown[(1, 0)].fg == Color::Red && shown[(79, 0)].modifier.contains(Modifier::REVERSED));
    }
    // A robot that does not answer now stays stopped, and can be released.
    model.apply(at(2), Input::Silent { robot: robot("r1"), why: "it sleeps".into() });
    let mut top = Top::new(PLAIN);
    let released = [Key::Char('R'), Key::Char('y')].iter().find_map(|key| top.key(&model, *key));
    assert_eq!(released, Some(Action::Release));
}

#[test]
fn data_that_is_not_live_is_said_to_be_so() {
    let (mut top, model) = (Top::new(PLAIN), model());
    top.tick(at(3));
    assert!(!lines(&picture(&top, &model, 80))[0].contains("NOT LIVE"));
    top.tick(at(5));
    let shown = picture(&top, &model, 80);
    assert_eq!(lines(&shown)[0], " NOT LIVE SINCE 4 S: no robot answers");
    assert!(shown[(1, 0)].fg == Color::Red);
}

#[test]
fn without_colours_there_are_none_and_ascii_is_ascii() {
    let mut model = model();
    let bytes = "é√\n".as_bytes().to_vec();
    model.apply(at(1), Input::Output { mission: mission(), path: "main".into(), bytes });
    let mut top = Top::new(Look { is_ascii: true, is_coloured: false });
    top.tick(at(9));
    for keys in ["1", "2", "3", "4", "6", "2j\r"] {
        for key in keys.chars() {
            top.key(&model, if key == '\r' { Key::Enter } else { Key::Char(key) });
        }
        let shown = picture(&top, &model, 80);
        assert!(shown.content().iter().all(|cell| (cell.fg, cell.bg) == (Color::Reset, Color::Reset)));
        assert!(lines(&shown).iter().all(|line| line.is_ascii()), "{:#?}", lines(&shown));
    }
    assert!(lines(&picture(&top, &model, 80)).iter().any(|line| line.contains("??")));
}

#[test]
fn the_cursor_stays_on_its_row_and_a_filter_hides_rows() {
    let mut model = model();
    let mut top = Top::new(PLAIN);
    top.resize(14);
    let selected = |top: &Top, model: &Model| top.selected(model).map(|(id, _)| id);
    top.key(&model, Key::End);
    assert_eq!(selected(&top, &model).as_deref(), Some("door@3 r1:main/hit/force"));
    // A row that comes before it does not move it.
    let more = vec![process("main", "Main", "running"), with_question(), process("main/a", "A", "idle")];
    model.apply(at(2), told(node("r1", more)));
    assert_eq!(selected(&top, &model).as_deref(), Some("door@3 r1:main/hit/force"));
    for key in
        [Key::Char('/'), Key::Char('A'), Key::Char('r'), Key::Char('x'), Key::Backspace, Key::Char('m'), Key::Enter]
    {
        top.key(&model, key);
    }
    assert_eq!(top.rows(&model).len(), 1);
    assert_eq!(selected(&top, &model).as_deref(), Some("door@3 r1:main/hit/arm"));
    top.key(&model, Key::Escape);
    assert!(top.rows(&model).len() > 3);
}

#[test]
fn the_last_event_is_followed_until_the_cursor_is_moved() {
    let (mut model, mut top) = (model(), Top::new(PLAIN));
    top.key(&model, Key::Char('4'));
    let selected = |top: &Top, model: &Model| top.selected(model).map(|(id, _)| id).unwrap();
    assert_eq!(selected(&top, &model), "1");
    model.apply(at(2), event(2, "main", Change::Activated));
    assert_eq!(selected(&top, &model), "2");
    top.key(&model, Key::Up);
    model.apply(at(2), event(3, "main", Change::Stopping));
    assert_eq!(selected(&top, &model), "1");
    top.key(&model, Key::End);
    model.apply(at(2), event(4, "main", Change::Stopping));
    assert_eq!(selected(&top, &model), "4");
}

#[test]
fn output_and_rates_are_heard_only_while_they_are_looked_at() {
    let (model, mut top) = (model(), Top::new(PLAIN));
    [Key::End, Key::Enter].iter().for_each(|key| assert_eq!(top.key(&model, *key), None));
    assert_eq!(top.heard().map(|program| program.path.as_str()), Some("main/hit/force"));
    assert_eq!(top.measured(&model), None);
    top.key(&model, Key::Char('3'));
    assert_eq!(top.heard(), None);
    let measured = top.measured(&model).map(|output| (output.program.host, output.program.path, output.port));
    assert_eq!(measured, Some(("r2".into(), "main/hit/force".into(), "Out".into())));
    top.key(&model, Key::Char('2'));
    assert_eq!(top.measured(&model), None);
}

#[test]
fn a_small_terminal_is_no_reason_to_fail() {
    let model = model();
    for (width, height) in [(0, 0), (1, 1), (5, 2), (20, 3), (200, 60)] {
        for page in ['1', '2', '3', '4', '5', '6', '?', 'E'] {
            let mut top = Top::new(PLAIN);
            top.resize(height);
            top.tick(at(2));
            top.key(&model, Key::Char(page));
            let mut buffer = Buffer::empty(Rect::new(0, 0, width, height));
            draw::draw(&top, &model, Duration::ZERO, &mut buffer);
        }
    }
}

/// 1,000 processes on 20 robots: the time to draw is printed.
#[test]
fn a_thousand_processes_are_drawn_quickly() {
    let mut model = Model::new(1);
    for robot in 0..20 {
        let path = |number: usize| format!("main/r{robot}/p{number}");
        let processes = (0..50).map(|number| process(&path(number), "Any", "running")).collect();
        model.apply(at(0), told(node(&format!("r{robot}"), processes)));
    }
    let (mut top, begun) = (Top::new(PLAIN), comms::io::clock::now());
    top.resize(50);
    top.tick(at(1));
    for _ in 0..20 {
        top.key(&model, Key::PageDown);
        draw::draw(&top, &model, Duration::ZERO, &mut Buffer::empty(Rect::new(0, 0, 120, 50)));
    }
    let took = comms::io::clock::now().since(begun) / 20;
    println!("a key and a picture of 1,000 processes: {} us", took.as_micros());
    // The limit is far above the usual time: a machine may be very busy.
    assert!(took < Duration::from_millis(500), "{took:?}");
}

/// The picture of the manual is drawn by this code.
#[test]
fn the_manual_shows_this_picture() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/src/looking.md");
    let manual = std::fs::read_to_string(file).unwrap();
    let (mut top, model) = (Top::new(PLAIN), model());
    top.tick(at(2));
    let shown = lines(&picture(&top, &model, 80));
    let shown: Vec<&str> = shown.iter().map(String::as_str).collect();
    assert!(
        manual.contains(&format!("```text\n{}\n```", shown.join("\n"))),
        "put this into {file}:\n{}",
        shown.join("\n")
    );
}
