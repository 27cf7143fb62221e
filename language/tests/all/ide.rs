//! The answers to an editor: each case is a text with `$0` at the cursor.

mod corpus;
use crate::disk;

use crate::shown::shown;
use language::ide::{Analysis, CompletionKind, Declaration, rename};
use language::plan::Plan;
use language::{Content, Options, Role, Source, Span, gather};
use std::path::{Path, PathBuf};

/// The interfaces of the programs of the cases.
const INTERFACES: &str = "/// Looks for the door.
module Camera(host, speed: Speed = 0.1 m/s, zoom) { out Out: Twist; out Seen: Truth; service; }
module Arm(host) { in In: Twist; in Stop: Truth optional; out Force: Force; done; claims arm, grip(read); }";

/// A group to ask about; the cases differ in one line each.
fn door(instances: &str, sections: &str, actions: &str) -> String {
    format!(
        "// Größe: 𝄞\nconst slow = 0.2 m/s;\n/// Opens the door.\nprocess Door(host1, limit: Time) {{\n    host{{host1}}\n    \
         instantiated_processes {{\n        eye instof Camera(host1, zoom = 2);\n        arm instof Arm(host1);\n{instances}    }}\n    \
         internal_connections(eye, see) {{ eye, Out -> arm, In; }}\n{sections}    \
         internal_event_actions {{ {actions} }}\n}}\nprocess main() {{\n    instantiated_processes {{ door instof Door(c1, 5 s); }}\n    \
         internal_event_actions {{ door }}\n}}\n"
    )
}

/// The analysis of a text, and where its `$0` was.
fn analysis(text: &str) -> (Analysis, usize) {
    let offset = text.find("$0").expect("the case has a cursor");
    let spec = Source::new("door.dca", text.replacen("$0", "", 1));
    let interfaces = vec![Source::new("programs", INTERFACES)];
    (Analysis::new(spec, interfaces, &Options::named("door")), offset)
}

#[track_caller]
fn completes(text: &str, expect: &str) {
    let (analysis, offset) = analysis(text);
    let (_, offers) = analysis.complete(offset);
    let labels: Vec<&str> = offers.iter().map(|offer| offer.label.trim()).collect();
    assert_eq!(labels.join(" "), expect, "{text}");
}

#[test]
fn completion_knows_what_can_stand_here() {
    let instances = |line: &str| door(&format!("        {line}\n"), "", "eye[see] , arm");
    completes(&instances("x instof $0"), "Camera Arm");
    completes(&instances("x instof Ca$0;"), "Camera Arm");
    completes(&instances("x $0"), "instof");
    completes(&instances("x instof Camera($0);"), "speed = zoom = host1 limit c1 slow");
    completes(&instances("x instof Camera(host1, $0);"), "speed = zoom = host1 limit slow");
    completes(&instances("x instof Camera(host1, zoom = $0);"), "host1 limit slow");
    completes(&instances("x instof Camera(host1) { $0 }"), POLICIES);
    completes(&instances("x instof Camera(host1) { restart $0; }"), "temporary transient permanent");
    completes(&instances("x instof Camera(host1, 5 $0);"), "");
    completes(&instances("x instof Camera(host1, zoom = 5 $0);"), ALL_UNITS);
    let sections = |line: &str| door("", &format!("    {line}\n"), "eye[see] , arm");
    completes(&sections("$0"), "external_io internal_connections resource supervision on_boot verify");
    completes(&sections("ext$0"), "external_io internal_connections resource supervision on_boot verify");
    completes(&sections("external_io { Out = $0; }"), "eye arm");
    completes(&sections("external_io { Out = eye, $0; }"), "Out Seen");
    completes(&sections("internal_connections($0) {}"), "eye arm");
    completes(&sections("internal_connections(eye, on) { $0 }"), "eye arm");
    completes(&sections("internal_connections(eye, on) { eye, $0 }"), "Out Seen");
    completes(&sections("internal_connections(eye, on) { eye.$0 }"), "Out Seen");
    completes(&sections("internal_connections(eye, on) { eye, Seen -> arm, $0; }"), "In Stop");
    completes(&sections("internal_connections(eye, on) { arm, $0 <- eye, Seen; }"), "In Stop");
    completes(&sections("internal_connections(eye, on) { eye, Seen -> $0 }"), "eye arm");
    completes(
        &sections("internal_connections(eye, on) { eye, Seen -> arm, Stop $0; }"),
        "push pull latch drop queue rate",
    );
    completes("process main() { host{$0} }", "");
    completes("$0", "process module const type use verify");
    completes(
        "module M(host) { $0 }",
        "in out proc state calls init service done plain remembers exec python venv action ros setup node remap params components lifecycle env inherit directory stop claims",
    );
    completes("module M(host) { in In: $0 }", "Force Truth Twist");
    completes("module M(host) { claims $0 }", "arm grip");
    completes("module M(host) { claims arm($0) }", "read write");
    completes("process P(a: $0) {}", VALUE_TYPES);
    completes("// $0", "");
    completes("use \"$0\";", "");
}

#[test]
fn completion_knows_supervision() {
    completes("process P() { supervision { $0 } }", "strategy restarts backoff");
    completes("process P() { on_boot { $0 } }", "none resume");
    completes("process P() { supervision { strategy $0 } }", "one_for_one one_for_all rest_for_one");
}

const POLICIES: &str = "runs_in restart backoff replace watchdog ready on_agent_loss on_link_loss memory cpu cores pids files file_size nice realtime";
const ALL_UNITS: &str = "s ms us ns min h s2 m cm mm um km rad deg Hz kHz N kN Nm kg g A mA V mV W B kB MB";
const VALUE_TYPES: &str = "Host Text Number Truth Secret Time Length Angle Speed AngularSpeed Acceleration Frequency Mass Force Torque Stiffness Power Current Voltage Size";

#[test]
fn completion_knows_event_actions() {
    let actions = |text: &str| door("", "", text);
    let (analysis, offset) = analysis(&actions("eye[see] , $0"));
    let (_, offers) = analysis.complete(offset);
    let instances = offers.iter().filter(|offer| offer.kind == CompletionKind::Instance);
    assert_eq!(instances.map(|offer| offer.label.as_str()).collect::<Vec<_>>(), ["eye", "arm"]);
    assert!(
        ["skip", "never", "wait", "any", "all", "each", "race", "retry"]
            .iter()
            .all(|word| offers.iter().any(|offer| offer.label == *word))
    );
    completes(&actions("eye[$0] , arm"), "see");
    completes(&actions("eye[see] $0"), "else finally as with within");
    completes(&actions("(eye , arm) $0"), "else finally as with within");
    completes(&actions("wait(5 $0)"), "s ms us ns min h else finally as with within");
    completes(&actions("eye within 5 $0"), "s ms us ns min h else finally as with within");
    completes(&actions("eye within $0"), "host1 limit slow");
    completes(&actions("retry(3, $0) eye"), "pause");
    completes(&actions("retry($0, pause 1 s) eye"), "host1 limit slow");
    completes(&actions("any $0 of (eye, arm)"), "host1 limit slow");
    let (shielded, offset) = self::analysis(&actions("shield $0"));
    assert!(shielded.complete(offset).1.iter().any(|offer| offer.label == "arm"));
}

/// A group with a process that ends in two ways, and something to take.
const OUTCOMES: &str = "module Find(host) { done(found: Pose | missing); }
process main() {
    instantiated_processes { find instof Find(c1); }
    resource table;
    internal_event_actions { using(table) (find : match { $1 }) }
}";

#[test]
fn outcomes_and_resources_are_names() {
    let with = |arms: &str| OUTCOMES.replace("$1", arms);
    completes(&with("$0"), "found missing");
    completes(&with("found => skip, $0"), "missing");
    completes(&OUTCOMES.replace("using(table)", "using($0)"), "table");
    is_defined(&with("fou$0nd => skip, missing => skip"), "door.dca:1 found");
    is_defined(&with("found => skip").replace("using(table)", "using(ta$0ble)"), "door.dca:4 table");
    is_told(&with("fou$0nd => skip, missing => skip"), &["found: Pose", "outcome of `Find`"]);
    is_told(&with("found => skip").replace("using(table)", "using(ta$0ble)"), &["resource table;"]);
    renames(&with("fou$0nd => skip, missing => skip"), "seen", "found -> seen, found -> seen");
    renames(&with("fou$0nd => skip, missing => skip"), "missing", "`missing` is taken: an outcome has this name");
    renames(&with("found => skip").replace("using(table)", "using(ta$0ble)"), "desk", "table -> desk, table -> desk");
}

#[test]
fn a_repeat_ends_with_outcomes() {
    let with = |actions: &str| OUTCOMES.replace("using(table) (find : match { $1 })", actions);
    completes(&with("repeat find $0"), "until else finally as with within");
    completes(&with("repeat find until $0"), "found missing");
    completes(&with("repeat find until found | $0"), "missing");
    is_defined(&with("repeat find until fou$0nd"), "door.dca:1 found");
    renames(&with("repeat find until fou$0nd"), "seen", "found -> seen, found -> seen");
}

#[test]
fn a_result_has_a_name_in_one_operand() {
    let with = |actions: &str| OUTCOMES.replace("using(table) (find : match { $1 })", actions);
    completes(&with("find : p => find with $0"), "p");
    completes(&with("find : p => (find : match { found q => find with $0 })"), "q p");
    completes(&with("find : (p => find) ; find with $0"), "");
    is_defined(&with("find : p => (find ; find with p$0)"), "door.dca:5 p");
    is_told(&with("find : p => find with p$0"), &["name of a result"]);
    renames(&with("find : p => (find with p$0 ; find with p)"), "to", "p -> to, p -> to, p -> to");
    renames(&with("find : match { found p$0 => find with p }"), "q", "p -> q, p -> q");
    renames(
        &with("find : p$0 => (find : q => find with p)"),
        "q",
        "with `q` some name in door.dca would mean something else",
    );
}

#[test]
fn an_arm_behind_else_names_a_cause() {
    let with = |actions: &str| OUTCOMES.replace("using(table) (find : match { $1 })", actions);
    completes(
        &with("find else match { $0 }"),
        "timeout reported crash host_lost busy stop_unconfirmed service_ended no_match script_budget script_failed",
    );
    completes(
        &with("find else match { timeout => skip, $0 }"),
        "reported crash host_lost busy stop_unconfirmed service_ended no_match script_budget script_failed",
    );
    completes(&with("find : match { found => skip } else match { busy => find : match { $0 } }"), "found missing");
}

/// A group in a group with a sentence to write.
const PROVED: &str = "module Find(host) { done(found | missing); }
process Hit() {
    instantiated_processes { force instof Find(c2); }
    internal_event_actions { force }
}
process main() {
    instantiated_processes { find instof Find(c1); hit instof Hit(); }
    internal_event_actions { find ; hit }
    verify { $1; can finish; }
}";

#[test]
fn sentences_are_completed_word_by_word() {
    let with = |sentence: &str| PROVED.replace("$1", sentence);
    let begins = "never exclusive always after once eventually can finish finishes within stops within on crash of on hang of \
        on loss of host assume holds ltl find hit";
    completes(&with("$0"), begins);
    completes(&with("never $0"), "find hit");
    completes(&with("never find $0"), "with");
    completes(&with("always find $0"), "implies");
    completes(&with("find $0"), "only after at most");
    completes(&with("find only $0"), "after");
    completes(&with("find only after hit.$0"), "force done aborted started ended");
    completes(&with("find only after hit.force.do$0"), "done aborted started ended");
    completes(&with("hit only after find.done.$0"), "found missing");
    completes(&with("after find.done: $0"), "find hit never not eventually");
    completes(&with("after find.done: hit $0"), "stopped");
    completes(&with("after find.done: hit stopped $0"), "within");
    completes(&with("after $0"), "find hit the");
    completes(&with("after the 2nd $0"), "find hit start of end of abort of");
    completes(&with("after the 2nd start $0"), "of");
    completes(&with("after the 2nd start of $0"), "find hit");
    completes(&with("after the 2nd start of find: $0"), "find hit never not eventually");
    completes(&with("once $0"), "find hit");
    completes(&with("once find $0"), "runs");
    completes(&with("once find runs: $0"), "find hit never always exclusive not eventually");
    completes(&with("once find runs: never find $0"), "with");
    completes(&with("once find runs: always find $0"), "implies");
    completes(&with("once find runs: hit $0"), "stopped");
    completes(&with("on $0"), "crash of hang of loss of host");
    completes(&with("on crash of $0"), "any find hit");
    completes(&with("on loss of host($0"), "c1 c2");
    completes(&with("assume find $0"), "takes");
    completes(&with("holds $0"), "ltl");
    completes(&with("holds ltl \"G (find -> $0)\""), "find hit G F");
    completes(&with("holds ltl \"find.$0\""), "done aborted started ended running stopping");
    completes(&with("holds ltl \"find $0\""), "U W R");
    let block = |sentence: &str| format!("{}\nverify Hit {{ {sentence}; }}", PROVED.replace("$1", "can finish"));
    completes(&block("eventually $0"), "force");
}

#[test]
fn sentences_know_their_names_and_words() {
    let with = |sentence: &str| PROVED.replace("$1", sentence);
    is_defined(&with("hi$0t only after find.done"), "door.dca:7 hit");
    is_defined(&with("find only after hit.fo$0rce.done"), "door.dca:3 force");
    is_defined(&with("holds ltl \"G (find -> F hit.for$0ce)\""), "door.dca:3 force");
    is_defined(&format!("{}\nverify H$0it {{ can finish; }}", PROVED.replace("$1", "can finish")), "door.dca:2 Hit");
    is_told(&with("never find wi$0th hit"), &["never active at the same time"]);
    is_told(&with("find on$0ly after hit.done"), &["b never starts before"]);
    is_told(&with("find only after hit.do$0ne"), &["`a.done.found` asks for the outcome"]);
    is_told(&with("holds ltl \"find $0W hit.done\""), &["or for ever"]);
    is_told(&with("hi$0t only after find.done"), &["hit instof Hit"]);
    is_told(&with("after the 2nd sta$0rt of hit: never find"), &["is activated"]);
    is_told(&with("once find ru$0ns: never find with hit"), &["from the first start of a on"]);
    renames(&with("after the 2nd start of hi$0t: never find"), "touch", "hit -> touch, hit -> touch, hit -> touch");
    renames(&with("never find with hi$0t"), "touch", "hit -> touch, hit -> touch, hit -> touch");
    renames(
        &with("holds ltl \"G (find -> F hit.fo$0rce)\""),
        "press",
        "force -> press, force -> press, force -> press",
    );
}

/// A record that contains another one.
const RECORDS: &str = "/// How to hold.
type Grasp = { force: Force = 20 N, place: Place };
type Place = { x: Length, yaw: Angle };
module Grip(host, grasp: Grasp) { out At: Place; done; }
process main(grasp: Grasp = { place = { x = 1 m, yaw = 2 rad } }) {
    instantiated_processes { grip instof Grip(c1, $1); }
    internal_event_actions { grip }
}";

#[test]
fn records_are_known_field_by_field() {
    let with = |value: &str| RECORDS.replace("$1", value);
    completes(&with("{ $0 }"), "force = place =");
    completes(&with("{ force = 1 N, $0 }"), "place =");
    completes(&with("{ place = { yaw = 1 rad, $0 } }"), "x =");
    completes(&with("grasp = { place = { yaw = 1 $0 } }"), "rad deg");
    completes(&with("{ place = $0 }"), "grasp");
    let way = |value: &str| with(value).replace("grasp: Grasp) {", "grasp: Grasp, way: Place[]) {");
    completes(&way("grasp, [{ x = 1 m }, { x = 2 m, $0 }]"), "yaw =");
    completes(&way("grasp, [{ yaw = 1 $0 }]"), "rad deg");
    is_defined(&way("grasp, [{ ya$0w = 1 rad, x = 1 m }]"), "door.dca:3 yaw");
    completes(
        &with("grasp").replace("force: Force =", "force: Force, other: $0 ="),
        &format!("{VALUE_TYPES} Grasp Place"),
    );
    completes(&with("grasp").replace("yaw = 2 rad }", "yaw = 2 $0 }"), "rad deg");
    completes(&with("grasp").replace("out At: Place", "out At: Place; out To: $0"), "Grasp Place Force Truth Twist");
    is_defined(&with("{ pl$0ace = { x = 1 m, yaw = 1 rad } }"), "door.dca:2 place");
    is_defined(&with("{ place = { x = 1 m, ya$0w = 1 rad } }"), "door.dca:3 yaw");
    is_defined(&with("grasp").replace("out At: Place", "out At: Pla$0ce"), "door.dca:3 Place");
    is_told(
        &with("grasp").replace("grasp: Grasp)", "grasp: Gra$0sp)"),
        &["type Grasp = { force: Force = 20, place: Place };", "How to hold."],
    );
    is_told(&with("{ place = { x$0 = 1 m, yaw = 1 rad } }"), &["x: Length", "A field.", "`0.2 m`"]);
    is_told(&with("grasp").replace("out At", "out A$0t"), &["out At: Place\ntype Place = { x: Length, yaw: Angle };"]);
    renames(&with("{ place = { x$0 = 1 m, yaw = 1 rad } }"), "left", "x -> left, x -> left, x -> left");
    renames(
        &with("grasp").replace("type Place", "type Pla$0ce"),
        "Spot",
        "Place -> Spot, Place -> Spot, Place -> Spot",
    );
    renames(
        &with("grasp").replace("type Place", "type Pla$0ce"),
        "Grasp",
        "`Grasp` is taken: another type has this name",
    );
}

#[test]
fn what_is_typed_is_replaced() {
    let (analysis, offset) = analysis(&door("", "", "ar$0m"));
    let (range, _) = analysis.complete(offset);
    assert_eq!(&analysis.spec().text[range], "arm");
    let (analysis, offset) = self::analysis(&door("", "", "wait(5m$0)"));
    let (range, _) = analysis.complete(offset);
    assert_eq!(&analysis.spec().text[range], "m");
}

/// The texts of spans, each with its line.
fn lines(analysis: &Analysis, spans: &[Span]) -> Vec<String> {
    let place = |span: &Span| {
        let source = analysis.source(*span);
        let name = &source.text[span.start as usize..span.end as usize];
        format!("{}:{} {name}", source.name, language::Lines::new(source).position(span.start).line)
    };
    spans.iter().map(place).collect()
}

#[track_caller]
fn is_defined(text: &str, expect: &str) {
    let (analysis, offset) = analysis(text);
    let found = analysis.definition(offset).map(|span| lines(&analysis, &[span]).join(""));
    assert_eq!(found.unwrap_or_default(), expect, "{text}");
}

#[test]
fn every_name_leads_to_its_declaration() {
    is_defined(&door("", "", "e$0ye[see] , arm"), "door.dca:7 eye");
    is_defined(&door("", "", "eye$0[see] , arm"), "door.dca:7 eye");
    is_defined(&door("", "", "Camera$0[see] , arm"), "door.dca:7 eye");
    is_defined(&door("", "", "eye[s$0ee] , arm"), "door.dca:10 see");
    is_defined(&door("x instof C$0amera(c1);", "", "eye , x"), "programs:2 Camera");
    is_defined(&door("x instof Camera(c1, sp$0eed = 1 m/s);", "", "eye , x"), "programs:2 speed");
    is_defined(&door("x instof Camera(c1, speed = sl$0ow);", "", "eye , x"), "door.dca:2 slow");
    is_defined(&door("x instof Camera(hos$0t1);", "", "eye , x"), "door.dca:4 host1");
    is_defined(&door("", "external_io { Out = eye, S$0een; }", "eye"), "programs:2 Seen");
    is_defined(&door("", "external_io { Out = a$0rm, Force; }", "eye"), "door.dca:8 arm");
    is_defined(&door("", "", "wait(5$0 s)"), "");
    is_defined(&door("r[4] instof Arm(c1);", "", "all i in 0..4 (r$0[i])"), "door.dca:9 r");
    is_defined(&door("r[4] instof Arm(c1);", "", "all i in 0..4 (r[$0i])"), "door.dca:11 i");
}

#[track_caller]
fn is_told(text: &str, parts: &[&str]) {
    let (analysis, offset) = analysis(text);
    let hover = analysis.hover(offset).map(|hover| hover.text).unwrap_or_default();
    for part in parts {
        assert!(hover.contains(part), "{part} is not in\n{hover}\nof\n{text}");
    }
    assert!(!parts.is_empty() || hover.is_empty(), "{hover}");
}

#[test]
fn a_hand_that_rests_is_told() {
    let arm = &["arm instof Arm", "in In: Twist", "claims grip(read)", "*task*", "Runs on `c1`", "together with `eye`"];
    is_told(&door("", "", "eye[see] , a$0rm"), arm);
    is_told(&door("", "", "eye[see] # a$0rm"), &["together with `eye`"]);
    is_told(&door("", "", "arm ; ey$0e"), &["nothing runs together with it", "Looks for the door.", "*service*"]);
    is_told(
        &door("x instof Came$0ra(c1, zoom = 1);", "", "eye , x"),
        &["module Camera(host, speed: Speed = 0.1, zoom)"],
    );
    is_told(&door("", "", "eye[se$0e]"), &["eye, Out -> arm, In;", "Open while `eye`"]);
    is_told(&door("", "external_io { Out = eye, Se$0en; }", "eye"), &["out Seen: Truth", "A port of `Camera`"]);
    is_told(&door("", "", "eye $0# arm"), &["the first to end stops the other"]);
    is_told(&door("", "", "wait(5 m$0s)"), &["`1 ms` is `0.001` in SI units", "`Time`"]);
    is_told("const a$0 = 5 ms;", &["const a = 0.005;", "SI"]);
    is_told("process main(limit$0: Time) {}", &["limit: Time", "parameter of `main`", "`5 s`"]);
    is_told("proc$0ess main() {}", &["process group"]);
    is_told("// not$0hing\nprocess main() {}", &[]);
}

#[track_caller]
fn renames(text: &str, to: &str, expect: &str) {
    let (analysis, offset) = analysis(text);
    let declared = analysis.prepare_rename(offset).map(|_| analysis.declaration(offset).expect("it has a name"));
    let edits = declared.and_then(|declared| rename(&[&analysis], &declared, to));
    let told = match edits {
        Ok(edits) => {
            let name = |start: u32, end: u32| analysis.spec().text[start as usize..end as usize].to_owned();
            let places = edits.iter().map(|edit| format!("{} -> {}", name(edit.start, edit.end), edit.text));
            places.collect::<Vec<_>>().join(", ")
        }
        Err(error) => error.to_string(),
    };
    assert_eq!(told, expect, "{text}");
}

#[test]
fn names_change_everywhere_or_nowhere() {
    renames(&door("", "", "ey$0e[see] , arm"), "cam", "eye -> cam, eye -> cam, eye -> cam, eye -> cam");
    renames(&door("", "", "Came$0ra[see] , arm"), "cam", "eye -> cam, eye -> cam, eye -> cam, Camera -> cam");
    renames(&door("", "", "eye[se$0e] , arm"), "on", "see -> on, see -> on");
    renames(&door("r[2] instof Arm(c1);", "", "r[0] ; r$0_1"), "q", "r -> q, r -> q, r_1 -> q_1");
    renames(&door("r[2] instof Arm(c1);", "", "all i$0 in 0..2 (r[i])"), "j", "i -> j, i -> j");
    renames(&door("x instof Camera(c1, speed = slo$0w, zoom = 1);", "", "eye , x"), "v", "slow -> v, slow -> v");
    renames(&door("x instof Camera(lim$0it);", "", "eye"), "most", "limit -> most, limit -> most");
    renames(&door("", "", "ey$0e , arm"), "arm", "`arm` is taken: an instance of `Door` has this name");
    renames(&door("", "", "ey$0e , arm"), "a b", "`a b` is not a name: letters, digits and `_`, and no digit first");
    renames(&door("", "", "ey$0e , skip"), "skip", "with `skip` some name in door.dca would mean something else");
    renames(&door("", "", "eye , Ar$0m"), "Camera", "arm -> Camera, arm -> Camera, Arm -> Camera");
    renames(&door("", "", "Camera , ar$0m"), "Camera", "with `Camera` some name in door.dca would mean something else");
    renames(
        &door("x instof Cam$0era(c1);", "", "eye"),
        "Eye",
        "`Camera` is declared by the program programs: rename it there",
    );
    renames("process ma$0in() {}", "other", "`main` is where a deployment starts, so its name stays");
    renames("process main() { host{c$01} }", "c2", "this place has no name that can be changed");
}

/// A parameter that decides the shape of its group, in every place where it can.
const SHAPED: &str = "process Team(h: Host, n$0: Number, t: Time) {
    instantiated_processes { a[n] instof Arm(h); b instof Arm(h); }
    internal_event_actions { retry(n, pause t) any n of (all i in 0..n (a[i])) ; b ::[n] a ; wait(t) ; b within t }
}
process Teams(size: Number) {
    instantiated_processes { one instof Team(c1, n = size, t = 1 s); other instof Team(c2, 2, 2 s); }
    internal_event_actions { one ; other }
}
process main() { instantiated_processes { teams instof Teams(3); } internal_event_actions { teams } }";

#[test]
fn parameters_that_decide_a_shape_have_other_names() {
    let all = |from: &str, to: &str, count: usize| vec![format!("{from} -> {to}"); count].join(", ");
    renames(SHAPED, "count", &all("n", "count", 7));
    let at = |mark: &str| SHAPED.replacen("n$0:", "n:", 1).replacen(mark, &format!("{mark}$0"), 1);
    renames(&at("wait(t"), "limit", &all("t", "limit", 5));
    renames(&at("size"), "count", &all("size", "count", 2));
    renames(&at("retry(n"), "h", "`h` is taken: a parameter has this name");
    renames(&at("retry(n"), "pause", &all("n", "pause", 7));
    is_defined(&at("any n"), "door.dca:1 n");
    is_told(&at("::[n"), &["n: Number", "A parameter of `Team`."]);
}

#[test]
fn names_are_found_in_other_files() {
    let arm = "module Arm(host, speed) { done; }\nprocess Two() { instantiated_processes { a instof Arm(c1, 1); } internal_event_actions { a } }";
    let read = |path: &str| match path {
        "arm.dca" | "arms/arm.dca" => Ok(Content::File(arm.to_owned())),
        "arms" => Ok(Content::Folder(vec!["arm.dca".to_owned()])),
        _ => Err("no such file".to_owned()),
    };
    let spec = Source::new(
        "door.dca",
        "use \"arm.dca\";\nprocess main() { instantiated_processes { b instof Arm(c1, speed = 2); two instof Two(); } internal_event_actions { b ; two } }",
    );
    let parts = gather(&spec, &read);
    let analysis = Analysis::new(spec.clone(), parts.clone(), &Options::named("door"));
    let used = spec.text.find("speed").unwrap();
    assert_eq!(lines(&analysis, &[analysis.definition(used).unwrap()]), ["arm.dca:1 speed"]);
    let file = analysis.definition(spec.text.find("arm.dca").unwrap()).unwrap();
    assert_eq!((analysis.source(file).name.as_str(), file.start), ("arm.dca", 0));
    assert_eq!(analysis.others()[0].role, Role::Part);
    // A folder leads to its first file.
    let spec = Source::new("door.dca", "use \"arms\";");
    let folder = Analysis::new(spec.clone(), gather(&spec, &read), &Options::named("door"));
    let file = folder.definition(6).unwrap();
    assert_eq!((folder.source(file).name.as_str(), file.start), ("arms/arm.dca", 0));
    // The file that is used alone knows the same declaration.
    let own = Analysis::new(Source::new("arm.dca", arm), Vec::new(), &Options::named("arm"));
    let declaration = own.declaration(arm.find("Arm").unwrap()).unwrap();
    assert_eq!(
        lines(&analysis, &analysis.references(&declaration)),
        ["arm.dca:1 Arm", "door.dca:2 Arm", "arm.dca:2 Arm"]
    );
    let edits = rename(&[&own, &analysis], &declaration, "Hand").unwrap();
    assert_eq!(edits.len(), 3);
}
