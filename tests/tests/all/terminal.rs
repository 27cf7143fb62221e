//! The output on a terminal: colours if they are wanted, lines that fit, and no characters that it cannot draw.

use dca_tests::cluster::Cluster;

/// An undeclared name. It results in a diagnostic with carets.
const WRONG: &str =
    "process main(){ host{ c1 } instantiated_processes{ a instof A(c1); } internal_event_actions{ bee } }";

/// Three steps with long names. Each lasts long enough for the live line to be drawn.
const LONG: &str = "
module Nap(host) { exec \"sleep 0.3\"; plain; done; }
process main() {
    host { c1 }
    instantiated_processes {
        first_with_a_name_that_nobody_wants_to_type instof Nap(c1);
        second_with_a_name_that_nobody_wants_to_type instof Nap(c1);
        third_with_a_name_that_nobody_wants_to_type instof Nap(c1);
    }
    internal_event_actions {
        (first_with_a_name_that_nobody_wants_to_type , second_with_a_name_that_nobody_wants_to_type) ;
        third_with_a_name_that_nobody_wants_to_type
    }
}
";

#[test]
fn colours_are_for_terminals_that_have_them_and_people_who_want_them() {
    let cluster = Cluster::new();
    let (here, file) = (cluster.here(), cluster.file("wrong.dca", WRONG));
    for (environment, is_coloured) in
        [(&[][..], true), (&[("NO_COLOR", "")], true), (&[("NO_COLOR", "1")], false), (&[("TERM", "dumb")], false)]
    {
        let (code, text) = here.on_terminal(80, environment, &["check", &file]);
        assert_eq!(code, Some(1), "{text}");
        assert!(text.contains("unknown process `bee`"), "{text}");
        assert_eq!(text.contains('\x1b'), is_coloured, "{environment:?}: {text:?}");
    }
    let into_a_file = here.ask(&["check", &file]);
    assert!(!into_a_file.err.contains('\x1b'), "{into_a_file}");
}

#[test]
fn a_mission_fits_into_80_columns_and_a_dumb_terminal_gets_whole_lines() {
    let cluster = Cluster::new();
    let (here, file) = (cluster.here(), cluster.file("a_mission_with_a_long_name.dca", LONG));
    for (terminal, is_redrawn) in [("xterm", true), ("dumb", false)] {
        let (code, text) = here.on_terminal(80, &[("TERM", terminal)], &["run", "--no-record", &file]);
        assert_eq!(code, Some(0), "{text}");
        assert!(text.contains("whole run"), "{text}");
        assert_eq!(text.contains("\x1b[K"), is_redrawn, "{terminal}: {text:?}");
        let width = |text: &str| text.chars().count();
        for line in text.split("\r\n") {
            assert!(is_redrawn || !line.contains('\r'), "{terminal}: {line:?}");
            // A line that is redrawn must fit in one line. Text that stays, such as the reason for a failure, may
            // have several lines.
            for live in line.split('\r').filter_map(|drawn| drawn.strip_suffix("\x1b[K")) {
                assert!(width(live) < 80 && !live.contains('\x1b'), "{} columns: {live:?}", width(live));
            }
        }
        let (_, summary) = text.rsplit_once("\r\n\r\n  phase").expect("the summary has a table");
        assert!(summary.split("\r\n").skip(1).all(|line| width(line) <= 80), "{summary}");
        assert!(summary.contains("whole run") && !summary.contains('\x1b'), "{summary:?}");
    }
}
