//! Scripts against each limit, against errors, and against hostile texts.

use super::*;
use crate::algebra::Value;
use proptest::prelude::*;
use std::time::Duration;

fn number() -> Layout {
    Layout::Number { of: "Number".to_owned() }
}

fn list(of: Layout) -> Layout {
    Layout::List { of: Box::new(of), count: None }
}

fn result(layout: Layout) -> ScriptResult {
    ScriptResult { variable: "goal".to_owned(), of: "Place".to_owned(), layout }
}

fn script(text: &str, layout: Layout) -> Script {
    Script { text: text.to_owned(), inputs: Vec::new(), result: result(layout) }
}

/// Runs a script without inputs, with a number as its result.
fn run(text: &str) -> Result<f64, ScriptError> {
    let value = script(text, number()).run(&|_| Given::Number(0))?;
    Ok(f64::from_le_bytes(value.bytes().try_into().unwrap()))
}

#[track_caller]
fn check(text: &str, kind: ScriptErrorKind, why: &str) {
    let error = run(text).unwrap_err();
    assert!(error.kind == kind && error.why.contains(why), "{text}: {error:?}");
}

#[test]
fn a_script_computes() {
    assert_eq!(run("1 + 1"), Ok(2.0));
    assert_eq!(run("let sum = 0.0; for x in [1.0, 2.5] { sum += x; } sum"), Ok(3.5));
    assert_eq!(run("fn twice(x) { x * 2 } twice(21)"), Ok(42.0));
    assert_eq!(run("let near = [3.0, 1.0, 2.0]; near.sort(|a, b| if a < b { -1 } else { 1 }); near[0]"), Ok(1.0));
    assert_eq!(run("atan(0.0, 1.0) + sqrt(4.0) + max(1, 2)"), Ok(4.0));
    assert_eq!(run("let a = [1, \"x\", true]; a.index_of(1.0) + if \"x\" in a && !(2 in a) { 1 } else { 5 }"), Ok(1.0));
    for (one, other, are_equal) in [
        ("[1, 2.0, \"x\", 'y', ()]", "[1.0, 2, \"x\", 'y', ()]", true),
        ("[1]", "[1, 1]", false),
        ("[[1], #{ a: true }]", "[[1], #{ a: true }]", true),
        ("[[1], #{ a: true }]", "[[1], #{ a: false }]", false),
        ("#{ a: 1 }", "#{ b: 1 }", false),
        ("[\"x\"]", "[1]", false),
    ] {
        let text = format!(
            "let a = {one}; let b = {other}; (if a == b {{ 1 }} else {{ 0 }}) + if a != b {{ 10 }} else {{ 0 }}"
        );
        assert_eq!(run(&text), Ok(if are_equal { 1.0 } else { 10.0 }), "{text}");
    }
    assert_eq!(run("let a = [[1], [1], 2]; a.dedup(); a.len"), Ok(2.0));
}

#[test]
fn each_limit_ends_a_script() {
    let budget = |text: &str, why: &str| check(text, ScriptErrorKind::Budget, why);
    budget("loop {}", "line 1 of the script: more than 2000 operations");
    budget("let n = 0;\nwhile true { n += 1; }", "line 2 of the script: more than 2000 operations");
    budget("for i in 0..1000000000 {}", "operations");
    budget(
        "let a = []; a.pad(30, 0); a.map(|x| { let a = []; a.pad(30, 0); a.map(|x| { let a = []; a.pad(30, 0); a.map(|x| 1) }) })",
        "operations",
    );
    budget("let a = []; a.pad(100, 0); loop { a.sort(|x, y| 1); }", "operations");
    budget("fn f(n) { f(n + 1) } f(0)", "more than 8 calls");
    budget("let s = \"x\"; loop { s += s; }", "text of more than 1024 bytes");
    budget("let s = \"\"; s.pad(1000000000, \"x\"); s", "text of more than 1024 bytes");
    budget("let a = [0]; loop { a += a; }", "list or record of more than 128 values");
    budget("let a = []; a.pad(1000000000, 0); a", "list or record of more than 128 values");
    budget("let a = [0]; loop { a = [a, a]; }", "list or record");
    budget("let m = #{}; loop { m = #{ a: m }; }", "list or record");
    let variables: String = (0..80).map(|number| format!("let x{number} = 1; ")).collect();
    budget(&variables, "more than 64 variables");
    let functions: String = (0..20).map(|number| format!("fn f{number}() {{}} ")).collect();
    check(&functions, ScriptErrorKind::Failed, "function");
    check(&format!("{}1{}", "(".repeat(100), ")".repeat(100)), ScriptErrorKind::Failed, "maximum complexity");
    check(&format!("1{}", " ".repeat(SCRIPT_TEXT_MAX)), ScriptErrorKind::Budget, "8192 bytes");
}

#[test]
fn an_error_names_its_line() {
    let failed = |text: &str, why: &str| check(text, ScriptErrorKind::Failed, why);
    failed("let a = 1;\n\na / 0", "line 3 of the script: ");
    failed("9223372036854775807 + 1", "overflow");
    failed("fn f() {\n throw \"no way\" } f()", "line 2 of the script: runtime error: no way");
    failed("[1][7]", "index");
    failed("#{ x: 1 }.y", "property");
    failed("let a = 1; a.fly()", "function not found");
    failed("1 / 0.0", "so it needs a finite number, not inf");
    failed("sqrt(-1.0)", "so it needs a finite number, not NaN");
    for text in ["[1].to_string()", "#{ a: 1 }.to_json()"] {
        failed(text, "a script cannot print whole lists and records");
    }
    for word in [
        "eval(\"1\")",
        "import \"a\" as b; 1",
        "print(1)",
        "debug(1)",
        "sleep(1)",
        "timestamp()",
        "Fn(\"f\")",
        "|x| x.curry(1)",
        "exit(1)",
    ] {
        check(word, ScriptErrorKind::Failed, "");
    }
}

/// Returns a layout with a number and a truth value.
fn pose() -> Layout {
    Layout::Record(vec![("x".to_owned(), number()), ("ok".to_owned(), Layout::Truth)])
}

/// A script with a result of another type fails in a run, and before the run as far as its result is known.
#[test]
fn a_result_has_the_declared_type() {
    let two = || Layout::List { of: Box::new(number()), count: Some(2) };
    let reader = ScriptReader::new();
    for (text, layout, needs) in [
        ("\"1\"", number(), "it needs a number, not a text"),
        ("'1'", Layout::Text, "it needs a text, not a letter"),
        ("[1]", number(), "it needs a number, not a list"),
        ("|x| x", number(), "it needs a number, not a function"),
        ("#{ x: 2 }", pose(), "it needs a field `ok`, not a record without it"),
        ("#{ x: 2, ok: true, z: 1 }", pose(), "it needs a record of this type, not one with a field `z`"),
        ("[#{ x: 2, ok: 3 }]", list(pose()), "`goal[0].ok` needs `true` or `false`, not a number"),
        ("let a = 1; return [#{ x: a + 1, ok: () }];", list(pose()), "`goal[0].ok` needs `true` or `false`, not `()`"),
        ("[1]", two(), "it needs 2 values, not 1"),
        ("()", pose(), "it needs a record, not `()`"),
        ("let a = 1; if a > 1 { [1, 2] } else { { `${a}` } }", two(), "it needs a list, not a text"),
    ] {
        let why = format!("`goal` is of type `Place`, so {needs}");
        let failed = script(text, layout.clone()).run(&|_| Given::Number(0)).unwrap_err();
        assert_eq!((failed.kind, &*failed.why), (ScriptErrorKind::Failed, why.as_str()), "{text}");
        let found = reader.mistake(text, std::iter::empty(), Some(&result(layout))).unwrap();
        assert_eq!(found.mistake, Mistake::Result(why), "{text}");
    }
    for (text, layout) in [
        ("#{ ok: true, x: 2 }", pose()),
        ("let n = 1; #{ ok: n == 1, x: n + 1 }", pose()),
        ("[[1].len(), 2.5]", two()),
        ("let n = 1; if n > 2 { throw \"no\" } else { [1, 2] }", two()),
        ("let n = 1; if n > 2 { \"\" } else { `n ${n}` }", Layout::Text),
    ] {
        script(text, layout.clone()).run(&|_| Given::Number(0)).unwrap();
        assert_eq!(reader.mistake(text, std::iter::empty(), Some(&result(layout))), None, "{text}");
    }
}

#[test]
fn a_function_that_does_not_exist_is_a_mistake() {
    let reader = ScriptReader::new();
    let mistake = |text: &str| reader.mistake(text, std::iter::empty(), None);
    for (name, text) in [
        ("parse_json", "parse_json(\"{}\")"),
        ("blob", "let b = blob(10, 1); 1"),
        ("sleep", "sleep(1)"),
        ("timestamp", "if true { let t = timestamp(); }"),
        ("fly", "let a = 1; a.fly()"),
        ("fly", "let a = 1; a.len().fly(2)"),
        ("fly", "let f = |x| x.fly(); f.call(1)"),
        ("fly", "fn f(x) { fly(x) } f(1)"),
        ("fly", "let a = [1]; a[fly(0)]"),
        ("fly", "`${fly(1)}`"),
        ("fly", "[1].map(|x| { switch x { 1 => fly(x), _ => 2 } })"),
    ] {
        let found = mistake(text).unwrap();
        assert_eq!(found.mistake, Mistake::Function(name.to_owned()), "{text}");
        assert!(text[found.offset..].starts_with(name), "{text}: {}", found.offset);
    }
    for (name, text) in
        [("sqrt", "sqrt()"), ("sqrt", "2.0.sqrt(1)"), ("f", "fn f(x) { x } f(1, 2)"), ("f", "fn f(x) { x } 1.f(1, 2)")]
    {
        assert_eq!(mistake(text).unwrap().mistake, Mistake::Arguments(name.to_owned()), "{text}");
    }
    for text in [
        "sqrt(2.0) + 2.0.sqrt() + max(1, 2) + atan(0.0, 1.0)",
        "fn f(x) { if x < 1 { 0 } else { f(x - 1) } } f(3)",
        "fn f(x) { this + x } 1.f(2)",
        "let f = |x| x + 1; f.call(1)",
        "type_of(1); [1, 2].map(|x| x * 2).filter(|x| x > 2).len()",
        "let a = [3, 1]; a.sort(); a.push(4); a[0] + a.len + -1",
        "for (x, i) in range(0, 10, 2) { let y = `${x}`.to_upper(); }",
    ] {
        assert_eq!(mistake(text), None, "{text}");
    }
}

#[test]
fn a_script_reads_its_inputs_and_cannot_change_them() {
    let source = ScriptSource::Slot { slot: 0, layout: list(Layout::Text) };
    let input = |name: &str, source: ScriptSource| ScriptInput { name: name.to_owned(), source };
    let read = |text: &str, bytes: &[u8]| {
        let inputs = vec![input("seen", source.clone()), input("tries", ScriptSource::Variable(0))];
        let script = Script { inputs, ..script(text, number()) };
        script.run(&|source| match source {
            ScriptSource::Variable(_) => Given::Number(3),
            ScriptSource::Slot { .. } | ScriptSource::Event(_) => Given::Bytes(Value::new(bytes)),
        })
    };
    let seven = Value::new(&7.0_f64.to_le_bytes());
    assert_eq!(read("seen.len() + seen[1].len() + tries", &[2, 0, 2, b'a', b'b']), Ok(seven.clone()));
    assert_eq!(read("if seen == () { 7 } else { 0 }", &[]), Ok(seven));
    for text in ["tries = 4; 1", "seen.push(\"a\"); 1", "seen[0] = \"b\"; 1"] {
        assert_eq!(read(text, &[1, 0]).unwrap_err().kind, ScriptErrorKind::Failed, "{text}");
    }
    let why = |bytes: &[u8]| read("1", bytes).unwrap_err();
    assert_eq!(*why(&[1, 2, 0xff, 0xff]).why, *"the bytes of `seen` are not a value of its type");
    assert_eq!(why(&[1, 5, 0]).kind, ScriptErrorKind::Failed);
    let texts = |count: u8| [&[count | 0x80, 1][..], &vec![0; usize::from(count)]].concat();
    assert_eq!(why(&texts(129)).kind, ScriptErrorKind::Budget);
    assert_eq!(read("seen.len()", &texts(128)), Ok(Value::new(&128.0_f64.to_le_bytes())), "as many as a list may have");
    // An `if` without `else` may give nothing.
    let error = run("let n = 1; if n > 2 { 3 }").unwrap_err();
    assert_eq!(*error.why, *"`goal` is of type `Place`, so it needs a number, not `()`");
}

/// Runs a text on a stack as small as that of a thread of a node, or smaller.
fn on_a_small_stack(texts: Vec<String>) {
    let run = move || {
        let reader = ScriptReader::new();
        for text in texts {
            // If the stack is too small, the last line of the output is the text.
            eprintln!("{}", &text[..text.floor_char_boundary(60)]);
            drop(run(&text));
            drop(reader.mistake(&text, std::iter::empty(), Some(&result(number()))));
        }
    };
    std::thread::Builder::new().stack_size(1 << 20).spawn(run).unwrap().join().unwrap();
}

#[test]
fn hostile_scripts_end() {
    let deep = |open: &str, close: &str| format!("{}1{}", open.repeat(2_000), close.repeat(2_000));
    let texts = [
        "loop { try { loop {} } catch { loop {} } }",
        "fn f(n) { try { f(n) } catch { f(n) } } f(1)",
        "let f = |n, f| f.call(n, f); f.call(1, f)",
        "let a = []; loop { a = [a]; }",
        "let a = []; for i in 0..60 { a = [a]; } `${a}`.len()",
        "let a = []; for i in 0..60 { a = [a]; } a == a",
        "let m = #{}; loop { m = #{ a: m }; }",
        "let m = #{}; for i in 0..60 { m = #{ a: m }; } m.to_json().len()",
        "let a = [1, 2, 3]; loop { a.sort(); a += a.map(|x| x + 1); }",
        "let s = \"ab\"; loop { s = s.replace(\"a\", \"aa\"); }",
        "9223372036854775807 * 9223372036854775807",
        "-9223372036854775807 - 2",
        "1 << 64",
        "2 ** 4096",
        "(0 - 9223372036854775807 - 1) / -1",
        "(0 - 9223372036854775807 - 1) % -1",
        "[].reduce(|a, b| a + b)[-1]",
        "\"\"[0]",
        "let x = 1; x.y.z = 2",
        "switch 1 { 1 => throw #{ a: [1] }, _ => 2 }",
        "this",
        "\u{0}",
        "`${`${`${1}`}`}`",
        "let a = [0]; a.splice(0, 9223372036854775807, [1]); a.extract(-9, 99)",
        "for x in 0..=9223372036854775807 { for y in range(0, 9223372036854775807, 1) { } }",
    ];
    let nested = [
        deep("(", ")"),
        deep("[", "]"),
        deep("#{a:", "}"),
        deep("-", ""),
        deep("{", "}"),
        deep("|x|", ""),
        deep("!", ""),
        deep("1+", ""),
        deep("1.max(", ")"),
        deep("a.b.", ""),
    ];
    on_a_small_stack(texts.iter().map(|text| (*text).to_owned()).chain(nested).collect());
}

/// A value, its layout, and its bytes, made without the code under test.
#[derive(Clone, Debug)]
struct Sample {
    layout: Layout,
    bytes: Vec<u8>,
}

fn samples() -> impl Strategy<Value = Sample> {
    let leaf = prop_oneof![
        (-1e9..1e9_f64).prop_map(|number| Sample { layout: self::number(), bytes: number.to_le_bytes().to_vec() }),
        any::<bool>().prop_map(|truth| Sample { layout: Layout::Truth, bytes: vec![u8::from(truth)] }),
        ".{0,40}"
            .prop_map(|text: String| Sample { layout: Layout::Text, bytes: postcard::to_allocvec(&text).unwrap() }),
    ];
    leaf.prop_recursive(3, 24, 4, |inner| {
        let record = proptest::collection::vec(inner.clone(), 1..4).prop_map(|parts| {
            let bytes = parts.iter().flat_map(|part| part.bytes.clone()).collect();
            let fields = parts.into_iter().enumerate().map(|(index, part)| (format!("f{index}"), part.layout));
            Sample { layout: Layout::Record(fields.collect()), bytes }
        });
        let list = (inner, 0..5_usize, any::<bool>()).prop_map(|(part, count, is_fixed)| {
            let length = if is_fixed { Vec::new() } else { postcard::to_allocvec(&count).unwrap() };
            let layout = Layout::List { of: Box::new(part.layout), count: is_fixed.then_some(count) };
            Sample { layout, bytes: [length, part.bytes.repeat(count)].concat() }
        });
        prop_oneof![record, list]
    })
}

/// Words of the language of scripts, for texts at random.
const WORDS: [&str; 48] = [
    "let",
    "a",
    "b",
    "x",
    "=",
    "+=",
    "+",
    "-",
    "*",
    "/",
    "%",
    "**",
    "<",
    "==",
    "!",
    "(",
    ")",
    "[",
    "]",
    "{",
    "}",
    "#{",
    ":",
    ",",
    ";",
    ".",
    "..",
    "|a|",
    "if",
    "else",
    "while",
    "for",
    "in",
    "loop",
    "fn",
    "return",
    "throw",
    "try",
    "catch",
    "switch",
    "=>",
    "1",
    "0.5",
    "\"s\"",
    "'c'",
    "`${",
    "break",
    "a.push(1);",
];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn values_come_back_as_they_were(sample in samples()) {
        let inputs = vec![ScriptInput { name: "x".to_owned(), source: ScriptSource::Event(sample.layout.clone()) }];
        let script = Script { inputs, ..script("x", sample.layout) };
        let value = Value::new(&sample.bytes);
        prop_assert_eq!(script.run(&|_| Given::Bytes(value.clone())), Ok(value.clone()));
    }

    #[test]
    fn bytes_that_are_no_value_are_refused(sample in samples(), bytes in proptest::collection::vec(any::<u8>(), 0..64)) {
        let inputs = vec![ScriptInput { name: "x".to_owned(), source: ScriptSource::Event(sample.layout.clone()) }];
        let script = Script { inputs, ..script("x", sample.layout) };
        let value = Value::new(&bytes);
        if let Ok(read) = script.run(&|_| Given::Bytes(value.clone())) {
            prop_assert_eq!(read.bytes().len(), bytes.len());
        }
    }

    #[test]
    fn random_scripts_end_and_repeat(words in proptest::collection::vec(0..WORDS.len(), 0..40)) {
        let text = words.iter().map(|&word| WORDS[word]).collect::<Vec<_>>().join(" ");
        let first = format!("{:?}", run(&text));
        prop_assert_eq!(first, format!("{:?}", run(&text)));
        if let Some(mistake) = ScriptReader::new().mistake(&text, std::iter::empty(), Some(&result(number()))) {
            prop_assert!(mistake.offset <= text.len() && text.is_char_boundary(mistake.offset));
        }
    }

    #[test]
    fn random_texts_are_refused(text in ".{0,80}") {
        on_a_small_stack(vec![text]);
    }
}

/// Returns the processor time of this thread so far.
fn spent() -> Duration {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    Duration::from_nanos(text.split(' ').next().unwrap().parse().unwrap())
}

/// Scripts whose single operations take as long as possible, and texts that are slow to read.
fn slow_scripts() -> Vec<String> {
    let records = "let a = []; for i in 0..120 { a.push(#{ x: i }); }";
    let nested = "let a = []; for i in 0..120 { a = [a]; }";
    let text = "let s = \"\"; s.pad(1024, \"a\");";
    let loops = [
        ("", "n += 1;"),
        (records, "let b = a;"),
        (records, "let b = [a];"),
        (records, "a == a;"),
        (records, "switch a { 1 => 2, [1] => 3 }"),
        (records, "try { a.fly(a, a, a, a) } catch {}"),
        (records, "a.sort(|x, y| 1);"),
        (records, "a.map(|x| x);"),
        (records, "a.reduce(|sum, x| x);"),
        (nested, "let b = a;"),
        (nested, "a.zip(a, |x, y| x);"),
        (nested, "a.order().order().order().order().order();"),
        (nested, "for x in a { let y = x; }"),
        ("let m = #{}; for i in 0..120 { m[`k${i}`] = i; }", "let b = m + m;"),
        ("let m = #{}; for i in 0..120 { m[`k${i}`] = i; }", "m.filter(|k, v| true);"),
        (text, "s[1] = 'b';"),
        (text, "s.crop(0);"),
        (text, "s.replace(\"a\", \"b\");"),
        (text, "s.split(\"b\");"),
    ];
    let loops = loops.map(|(before, inside)| format!("let n = 0; {before} loop {{ {inside} }}"));
    let long = |text: &str| text.repeat(SCRIPT_TEXT_MAX / text.len());
    let texts =
        ["let a = 1;", "`${1}`;", "|x|x;", "1*2+", "/*", "{", "!", "if 1 {} else ", "1;", "[0]", "1=>1,"].map(long);
    loops.into_iter().chain(texts).collect()
}

/// A script runs inside the step of a supervisor, so its operations bound the time of other work. The limit has a reserve
/// for slower machines: `--nocapture` prints the times.
#[test]
fn no_script_takes_long() {
    for text in slow_scripts() {
        // Other work of the machine may make some runs slower, and none faster. The kernel counts in steps of some milliseconds.
        let mean = || {
            let began = spent();
            (0..8).for_each(|_| drop(run(&text)));
            (spent() - began) / 8
        };
        let took = (0..3).map(|_| mean()).min().unwrap();
        let why = run(&text).err().map_or_else(String::new, |error| error.to_string());
        println!("{:>6.2} ms  {:.90}  {why}", took.as_secs_f64() * 1e3, text);
        assert!(took < Duration::from_millis(25), "{text} took {took:?}");
    }
}
