//! Launch files of ROS 2: what becomes of their actions, and files that are wrong or made to do harm.

use crate::hostile::opening;
use crate::random::Random;
use import::{Files, ImportError, Imported, LaunchSettings, RemarkKind, import_with};
use language::{Options, Source, compile};
use std::collections::BTreeMap;

/// Imports the first of some files; the package `here` is installed.
fn imported(files: &[(&str, &str)], arguments: &[(&str, &str)]) -> Result<Imported, ImportError> {
    let texts: BTreeMap<&str, &str> = files.iter().copied().collect();
    let read = |path: &str| {
        let text = texts.get(path).ok_or_else(|| format!("`{path}` cannot be read: there is none"))?;
        Ok(Source::new(path, *text))
    };
    let share = |package: &str| (package == "here").then(|| "/opt/share/here".to_owned());
    let arguments = arguments.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
    let settings = LaunchSettings { arguments, setup: Some("/opt/setup.bash".into()) };
    import_with(&Source::new(files[0].0, files[0].1), &[], &settings, &Files { read: &read, share: &share })
}

fn xml(inside: &str) -> String {
    format!("<launch>{inside}</launch>")
}

/// Checks that the spec of some actions has these texts, in any order.
#[track_caller]
fn check(inside: &str, expected: &[&str]) {
    let text = imported(&[("a.launch.xml", &xml(inside))], &[]).expect("it has a counterpart").text;
    for part in expected {
        assert!(text.contains(part), "no {part:?} in\n{text}");
    }
}

/// The texts of the remarks of a kind.
fn remarks(inside: &str, kind: RemarkKind) -> Vec<String> {
    let imported = imported(&[("a.launch.xml", &xml(inside))], &[]).expect("it has a counterpart");
    imported.remarks.into_iter().filter(|remark| remark.kind == kind).map(|remark| remark.text).collect()
}

#[test]
fn a_variable_holds_in_its_group() {
    let node = |name: &str| format!("<node pkg=\"p\" exec=\"e\" name=\"{name}\" namespace=\"$(var v)\"/>");
    let group = format!("<group><let name=\"v\" value=\"in\"/>{}</group>", node("a"));
    check(&format!("<let name=\"v\" value=\"out\"/>{group}{}", node("b")), &["node \"/in/a\"", "node \"/out/b\""]);
    let leaking = group.replace("<group>", "<group scoped=\"false\">");
    check(&format!("<let name=\"v\" value=\"out\"/>{leaking}{}", node("b")), &["node \"/in/a\"", "node \"/in/b\""]);
    let closed = "<group forwarding=\"false\"><node pkg=\"p\" exec=\"e\" name=\"$(var v gone)\"/></group>";
    check(&format!("<let name=\"v\" value=\"out\"/>{closed}"), &["node \"/gone\""]);
}

#[test]
fn conditions_decide_what_is_started() {
    let when = |condition: &str| {
        format!("<node pkg=\"p\" exec=\"e\" name=\"n\" {condition}/><node pkg=\"p\" exec=\"other\"/>")
    };
    for on in [
        "if=\"true\"",
        "if=\"1\"",
        "unless=\"False\"",
        "if=\"$(not false)\"",
        "if=\"$(equals a a)\"",
        "unless=\"$(and 1 0)\"",
    ] {
        check(&when(on), &["node \"/n\""]);
    }
    for off in ["if=\"0\"", "unless=\"true\"", "if=\"$(eval &quot;'a' == 'b'&quot;)\"", "if=\"$(or 0 false)\""] {
        let text = imported(&[("a.launch.xml", &xml(&when(off)))], &[]).expect("it has a counterpart").text;
        assert!(!text.contains("/n\""), "{off}: {text}");
    }
    let missing = remarks(&when("if=\"$(command 'date')\""), RemarkKind::Missing);
    assert!(missing.iter().any(|text| text.contains("`$(command …)` has no counterpart")), "{missing:?}");
}

#[test]
fn settings_of_all_nodes_reach_each_node_of_the_group() {
    let group = "<group><set_parameter name=\"use_sim_time\" value=\"true\"/><set_remap from=\"/tf\" to=\"tf\"/>
        <set_env name=\"A\" value=\"1\"/><node pkg=\"p\" exec=\"e\"><param name=\"use_sim_time\" value=\"false\"/><env name=\"B\" value=\"2\"/></node></group>";
    let text = imported(&[("a.launch.xml", &xml(&format!("{group}<node pkg=\"p\" exec=\"later\"/>")))], &[])
        .expect("good")
        .text;
    let (first, later) = text.split_once("`later`").expect("there are two");
    assert!(first.contains("use_sim_time: Truth = false") && first.contains("remap \"/tf\" -> \"tf\""), "{first}");
    assert!(first.contains("A = \"1\"") && first.contains("B = \"2\""), "{first}");
    assert!(!later.contains("use_sim_time") && !later.contains("env{"), "{later}");
}

/// A file that is included sees the variables around it, and its own ones stay, as in ROS 2.
#[test]
fn included_files_are_read_from_their_folder() {
    let files = [
        (
            "x/a.launch.xml",
            "<launch><include file=\"$(dirname)/more/b.launch.yaml\"><arg name=\"ns\" value=\"one\"/></include>\
            <include file=\"$(find-pkg-share here)/launch/c.launch.xml\"/><node pkg=\"p\" exec=\"e\" name=\"$(var left)\"/></launch>",
        ),
        (
            "x/more/b.launch.yaml",
            "launch:\n- arg: {name: ns, default: two}\n- node: {pkg: p, exec: e, name: b, namespace: $(var ns)}\n\
            - let: {name: left, value: behind}\n",
        ),
        (
            "/opt/share/here/launch/c.launch.xml",
            "<launch><arg name=\"size\" default=\"7\"/><node pkg=\"p\" exec=\"c\"><param name=\"size\" value=\"$(var size)\"/></node></launch>",
        ),
    ];
    let text = imported(&files, &[]).expect("good").text;
    for part in [
        "node \"/one/b\"",
        "node \"/behind\"",
        "main(robot: Host = c1, size = 7)",
        "instof C(robot, size = size)",
        "setup \"/opt/setup.bash\"",
    ] {
        assert!(text.contains(part), "no {part:?} in\n{text}");
    }
    let gone = remarks("<include file=\"gone.launch.xml\"/>", RemarkKind::Missing);
    assert!(gone.iter().any(|text| text.contains("`gone.launch.xml` cannot be read")), "{gone:?}");
}

#[test]
fn a_value_of_the_user_replaces_a_default() {
    let text = xml(
        "<arg name=\"n\"/><node pkg=\"p\" exec=\"e\" name=\"$(var n)\"><param name=\"v\" value=\"$(var n)\"/></node>",
    );
    let given = imported(&[("a.launch.xml", &text)], &[("n", "r7")]).expect("good").text;
    assert!(given.contains("node \"/r7\"") && given.contains("n: Text = \"r7\""), "{given}");
    let refused = imported(&[("a.launch.xml", &text)], &[("m", "r7")]).expect_err("there is no `m`");
    assert!(refused.why.contains("has no argument `m`; its arguments are: `n`"), "{refused}");
    let without = imported(&[("a.launch.xml", &text)], &[]).expect("the rest has a counterpart");
    assert!(without.remarks.iter().any(|remark| remark.text.contains("`--set n=VALUE`")), "{:?}", without.remarks);
}

#[test]
fn files_that_include_each_other_are_refused() {
    let one = ("a.launch.xml", "<launch><include file=\"b.launch.xml\"/></launch>");
    let two = ("b.launch.xml", "<launch><include file=\"./x/../a.launch.xml\"/></launch>");
    let refused = imported(&[one, two], &[]).expect_err("it is a circle");
    assert_eq!((refused.file.as_str(), refused.line), ("b.launch.xml", 1));
    assert!(refused.why.contains("`a.launch.xml` includes `b.launch.xml` includes `a.launch.xml`"), "{refused}");
    // Each of 17 files includes the next one twice.
    let names: Vec<String> = (0..18).map(|number| format!("{number}.launch.xml")).collect();
    let texts: Vec<String> =
        (1..19).map(|next| xml(&format!("<include file=\"{next}.launch.xml\"/>").repeat(2))).collect();
    let files: Vec<(&str, &str)> =
        names.iter().zip(&texts).map(|(name, text)| (name.as_str(), text.as_str())).collect();
    assert!(imported(&files, &[]).expect_err("too deep").why.contains("included"));
    assert!(imported(&files[4..], &[]).expect_err("too many").why.contains("included"));
}

#[test]
fn files_that_would_become_huge_are_refused() {
    let doubled = "<let name=\"v\" value=\"$(var v)$(var v)\"/>".repeat(5_000);
    let long = imported(&[("a.launch.xml", &xml(&format!("<let name=\"v\" value=\"xx\"/>{doubled}")))], &[]);
    assert!(long.expect_err("it is long").why.contains("bytes of text"));
    let many = "<node pkg=\"p\" exec=\"e\"/>".repeat(600);
    assert!(imported(&[("a.launch.xml", &xml(&many))], &[]).expect_err("too many").why.contains("500 programs"));
    let many = "<log message=\"x\"/>".repeat(20_001);
    assert!(imported(&[("a.launch.xml", &xml(&many))], &[]).expect_err("too many").why.contains("20000 actions"));
    let deep = format!("launch: {}", "[".repeat(100_000));
    let refused = imported(&[("a.launch.yaml", &deep)], &[]).expect_err("it is deep");
    assert!(refused.why.contains("recursion limit"), "{refused}");
    let deep = format!("launch: {}", (0..60).map(|depth| format!("\n{}- a:", "  ".repeat(depth))).collect::<String>());
    let refused = imported(&[("a.launch.yaml", &deep)], &[]).expect_err("it is deep");
    assert!(refused.why.contains("more than 48 deep"), "{refused}");
    let nested = "$(not ".repeat(10_000);
    assert!(imported(&[("a.launch.xml", &xml(&format!("<let name=\"v\" value=\"{nested}\"/>")))], &[]).is_ok());
}

#[test]
fn files_that_are_no_launch_files_are_refused() {
    for (name, text, why) in [
        ("a.launch.py", "def generate_launch_description(): pass", "`ros \"package file.launch.py\";`"),
        ("a.yaml", "", "the file is empty"),
        ("a.yaml", "launch: 5", "a list of actions"),
        ("a.yaml", "nodes:\n- node: {}", "behind the key `launch`"),
        ("a.yaml", "launch:\n- node: {pkg: a, pkg: b}", "the key `pkg` occurs twice"),
        ("a.yaml", "launch:\n- node: &x {pkg: a}\n- node: *x", "aliases"),
        ("a.yaml", "launch:\n- node: talker", "`node` needs keys"),
        ("a.yaml", "launch: []\n---\nlaunch: []", "second document"),
        ("a.yaml", "launch: [}", ""),
        ("a.launch.xml", "<launch><include file=\"a.xml\"></launch>", "expected 'include' tag"),
    ] {
        let refused = imported(&[(name, text)], &[]).expect_err(text);
        assert!(refused.why.contains(why) && refused.line > 0, "{text}: {refused}");
    }
    let tree = "<root BTCPP_format=\"4\"><BehaviorTree ID=\"T\"><A/></BehaviorTree></root>";
    assert!(
        imported(&[("a.xml", tree)], &[]).expect_err("a tree has no arguments").why.contains("are for launch files")
    );
}

const KINDS: &str = "node lifecycle_node node_container executable group include arg let param remap env set_env unset_env \
                     push_ros_namespace set_parameter set_remap set_parameters_from_file set_use_sim_time timer log \
                     composable_node load_composable_node extra_arg shutdown choice";
const ATTRIBUTES: &str = "pkg exec name namespace args ros_args respawn respawn_delay sigterm_timeout cwd cmd shell from to \
                          value type default description if unless file filename period scoped forwarding target plugin \
                          autostart output allow_substs";
/// With `|` between them.
const VALUES: &str = "a|b|talker|/a/b|//|~/x|true|false|1|-1|0.5|1e400|.inf|[1, 2]|[a|$(var a)|$(var b)/x|$(var a $(var b))|$(env H /h)|$(env H)|\
                      $(find-pkg-share here)/a.xml|$(find-pkg-share p)/x.launch.py|$(dirname)/a|$(eval 1 == 1)|$(eval '|$(|$()|$(not $(var a))|\
                      self.launch.xml|--ros-args -r a:=b|it's|&quot;|'a b' c|a&#10;b|\u{202e}x|日本|host|main|robot|within|rosout:=x|node:a|\\|\\$(x)|\
                      DCA_X|PATH|str|int|float|bool|double[]||9007199254740993|00|1:2|*|a=b|{|}|{a: b}|#|-|a//b|9a|__ns|x.y.z|x y";

/// Actions and parts of them, put together without a plan.
fn nonsense(random: &mut Random, depth: usize) -> String {
    let words = |text: &'static str| text.split_whitespace().collect::<Vec<_>>();
    let values: Vec<&str> = VALUES.split('|').collect();
    let kind = random.pick(&words(KINDS));
    let likely: &[&str] = match kind {
        "node" | "lifecycle_node" | "node_container" => &["pkg", "exec", "name", "namespace", "args"],
        "executable" => &["cmd", "name", "shell"],
        "composable_node" => &["pkg", "plugin", "name"],
        "include" => &["file"],
        "arg" => &["name", "default"],
        "remap" | "set_remap" => &["from", "to"],
        "timer" => &["period"],
        _ => &["name", "value", "type", "namespace", "from"],
    };
    let all = words(ATTRIBUTES);
    let mut text =
        opening(
            random,
            kind,
            6,
            &values,
            |random| {
                if random.one_in(4) { random.pick(&all) } else { random.pick(likely) }
            },
        );
    if depth > 0 {
        for _ in 0..random.below(4) {
            text += &nonsense(random, depth - 1);
        }
    }
    format!("{text}</{kind}>")
}

/// Returns whether a file became a spec, which then has to be a good one.
#[track_caller]
fn becomes_a_spec(name: &str, text: &str, told: &str) -> bool {
    let imported = match imported(&[(name, text)], &[]) {
        Ok(imported) => imported,
        Err(error) => {
            assert!(!error.why.contains("the resulting spec is refused"), "{told}: {error}\n{text}");
            return false;
        }
    };
    let compiled = compile(&Source::new("nonsense.dca", imported.text.as_str()), &[], &Options::named("nonsense"));
    assert!(compiled.plan.is_some(), "{told}: {text}\n{}", imported.text);
    for remark in imported.remarks {
        assert!(imported.text.contains(&remark.text), "{told}: `{}` is in the text", remark.text);
    }
    true
}

#[test]
fn nonsense_is_refused_or_becomes_a_spec() {
    let good = |seed| {
        let mut random = Random(seed);
        let inside: String = (0..1 + random.below(6)).map(|_| nonsense(&mut random, 3)).collect();
        becomes_a_spec("self.launch.xml", &xml(&inside), &format!("seed {seed}"))
    };
    let good = (0..200).filter(|seed| good(*seed)).count();
    assert!(good > 100, "{good} of 200 were imported");
}

const SIGNS: [char; 15] = ['"', '<', '$', '(', ')', '\'', ':', '-', ' ', '\n', '0', '/', '\u{0}', '\u{202e}', 'é'];

/// The cases with some bytes changed, left out or doubled.
fn changed_cases_are_refused_or_become_specs(seeds: std::ops::Range<u64>) {
    let cases = [
        ("case.launch.xml", include_str!("../cases/turtles.launch.xml")),
        ("case.launch.yaml", include_str!("../cases/robot.launch.yaml")),
    ];
    let mut good = 0;
    for seed in seeds.clone() {
        let mut random = Random(seed);
        let (name, text) = cases[random.below(2)];
        let mut characters: Vec<char> = text.chars().collect();
        for _ in 0..1 + random.below(4) {
            let at = random.below(characters.len());
            match random.below(4) {
                0 => drop(characters.remove(at)),
                1 => characters[at] = SIGNS[random.below(SIGNS.len())],
                2 => {
                    let end = (at + random.below(40)).min(characters.len());
                    let part = characters[at..end].to_vec();
                    let to = random.below(characters.len());
                    characters.splice(to..to, part);
                }
                _ => characters.truncate(at.max(20)),
            }
        }
        let text: String = characters.into_iter().collect();
        good += usize::from(becomes_a_spec(name, &text, &format!("seed {seed}")));
    }
    assert!(good * 10 > usize::try_from(seeds.end - seeds.start).expect("a small number"), "{good} were imported");
}

#[test]
fn changed_files_are_refused_or_become_specs() {
    changed_cases_are_refused_or_become_specs(0..150);
}

#[test]
#[ignore = "long: 20,000 files, and 20,000 of nonsense"]
fn many_changed_files_are_refused_or_become_specs() {
    changed_cases_are_refused_or_become_specs(150..20_150);
    for seed in 200..20_200 {
        let mut random = Random(seed);
        let inside: String = (0..1 + random.below(6)).map(|_| nonsense(&mut random, 3)).collect();
        becomes_a_spec("self.launch.xml", &xml(&inside), &format!("seed {seed}"));
    }
}

/// The type of a value is that of `yaml.safe_load`, as `ros2 launch` reads it.
#[test]
fn values_of_parameters_have_the_type_of_yaml_1_1() {
    let node = |value: &str| format!("<node pkg=\"p\" exec=\"e\"><param name=\"v\" value=\"{value}\"/></node>");
    for (value, expected) in [
        ("0x46d", "v = 1133"),
        ("1_000", "v = 1000"),
        ("012", "v = 10"),
        ("0b11", "v = 3"),
        ("+5", "v = 5"),
        ("1:30", "v = 90"),
        ("1e5", "v: Text = \"1e5\""),
        ("yes", "v: Truth = true"),
        ("off", "v: Truth = false"),
        ("'5'", "v: Text = \"5\""),
        ("[0x10, 2]", "v = [16, 2]"),
        ("[1.0, 2.5]", "v: Number[] = [1, 2.5]"),
        ("[a, '1']", "v: Text[] = [\"a\", \"1\"]"),
        ("[true, no]", "v: Truth[] = [true, false]"),
        (".inf", "-p v:=.inf"),
        ("-.Inf", "-p v:=-.inf"),
        (".nan", "-p v:=.nan"),
        ("12345678901234567", "-p v:=12345678901234567"),
    ] {
        check(&node(value), &[expected]);
        let argument = format!("<arg name=\"a\" default=\"{value}\"/>{}", node("$(var a)"));
        check(&argument, &[&expected.replacen("v", if expected.starts_with("-p") { "v" } else { "a" }, 1)]);
    }
    // In a list of a file in YAML, a text in quotes stays a text.
    let yaml =
        "launch:\n- node: {pkg: p, exec: e, param: [{name: v, value: [\"2\", '5']}, {name: w, value: [0x2, 5]}]}\n";
    let text = imported(&[("a.launch.yaml", yaml)], &[]).expect("good").text;
    assert!(text.contains("v: Text[] = [\"2\", \"5\"], w = [2, 5]"), "{text}");
    // The node gets a value of the same type.
    for (value, expected) in
        [("0x46d", "1133"), ("5.0", "5.0"), ("[1.0, 2.0]", "[1.0, 2.0]"), ("[a, '1']", r#"["a", "1"]"#)]
    {
        for text in [node(value), format!("<arg name=\"a\" default=\"{value}\"/>{}", node("$(var a)"))] {
            let text = imported(&[("a.launch.xml", &xml(&text))], &[]).expect("good").text;
            let plan =
                compile(&Source::new("a.dca", text.as_str()), &[], &Options::named("a")).plan.expect("a good spec");
            let given: Vec<String> = plan.leaves[0].arguments.iter().map(|one| one.value.bare()).collect();
            assert_eq!(given, [expected], "{text}");
        }
    }
    for value in ["~", "null", "2026-01-02", "[]", "{a: 1}", "[1, 2.0]"] {
        let missing = remarks(&node(value), RemarkKind::Missing);
        assert!(missing.iter().any(|text| text.contains("parameter `v` is left out")), "{value}: {missing:?}");
    }
}

#[test]
fn the_environment_is_that_of_the_place_in_the_file() {
    let node = |name: &str| format!("<node pkg=\"p\" exec=\"{name}\"/>");
    let set = "<set_env name=\"A\" value=\"1\"/>";
    let text = format!(
        "{}{set}<group>{}<unset_env name=\"A\"/><set_env name=\"B\" value=\"2\"/>{}</group>{}",
        node("first"),
        node("second"),
        node("third"),
        node("fourth")
    );
    let text = imported(&[("a.launch.xml", &xml(&text))], &[]).expect("good").text;
    let of = |name: &str| {
        let (_, module) = text.split_once(&format!("/// `{name}`")).expect("it has a module");
        module.split("\n}").next().unwrap_or_default().to_owned()
    };
    assert!(!of("first").contains("env{"), "{text}");
    assert!(of("second").contains("A = \"1\"") && !of("second").contains("B = "), "{text}");
    assert!(!of("third").contains("A = ") && of("third").contains("B = \"2\""), "{text}");
    assert!(of("fourth").contains("A = \"1\"") && !of("fourth").contains("B = "), "{text}");
    // A variable from outside stays, and a remark says so.
    let missing = remarks(&format!("<unset_env name=\"X\"/>{}", node("e")), RemarkKind::Missing);
    assert!(missing.iter().any(|text| text.contains("`X` is not set here")), "{missing:?}");
    let missing = remarks(&format!("{set}{}", node("e")), RemarkKind::Missing);
    assert!(missing.is_empty(), "{missing:?}");
}
