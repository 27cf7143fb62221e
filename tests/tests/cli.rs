//! What `dca check` says of specs, and with which exit code.

use dca_tests::cluster::{Cluster, Ended};

fn check(file: &str) -> Ended {
    let path = format!("{}/../language/tests/corpus/{file}.dca", env!("CARGO_MANIFEST_DIR"));
    Cluster::new().here().ask(&["check", &path])
}

/// Acceptance 6: the paper's own listings, as printed, are accepted with warnings and fixes, and no error.
#[test]
fn the_papers_listings_are_accepted() {
    for (file, programs) in [("paper_appendix_a", "19 programs"), ("paper_compliant_motion", "4 programs")] {
        let ended = check(file);
        assert_eq!(ended.code, Some(0), "{ended}");
        assert!(ended.out.contains(programs) && ended.out.contains("no errors"), "{ended}");
        assert!(ended.err.contains("warning[") && !ended.err.contains("error["), "{ended}");
    }
    assert!(check("paper_appendix_a").err.contains("= fix: replace with `motionctrl`"));
}

/// Acceptance 6: the fixes of a listing leave nothing to fix, and `--deny lenient-names` takes the rest as errors.
#[test]
fn fixes_make_the_listing_exact() {
    let cluster = Cluster::new();
    let listing = include_str!("../../language/tests/corpus/paper_appendix_a.dca");
    let file = cluster.file("listing.dca", listing);
    let denied = cluster.here().ask(&["check", "--deny", "lenient-names", &file]);
    assert_eq!(denied.code, Some(1), "{denied}");
    let fixed = cluster.here().ask(&["check", "--fix", &file]);
    assert_eq!(fixed.code, Some(0), "{fixed}");
    let exact = cluster.here().ask(&["check", "--deny", "lenient-names", &file]);
    assert_eq!(exact.code, Some(0), "{exact}");
}

/// Acceptance 6: a misspelt instance, an unknown label and a recursive group are errors, each with a suggestion.
#[test]
fn mistakes_are_errors_with_a_suggestion() {
    let cases = [
        ("E0201_unknown_process", "error[E0201]: unknown process `forcedato`", "did you mean `forcedata`?"),
        ("E0301_unknown_label", "error[E0301]: `forcedata` has no connection set `lbl1`", "replace with `lb11`"),
        ("E0102_recursive_group", "error[E0102]: `Search` contains itself: Search -> Retry -> Search", "run `p ;; p`"),
    ];
    for (file, error, suggestion) in cases {
        let ended = check(file);
        assert_eq!(ended.code, Some(1), "{ended}");
        assert!(ended.err.contains(error) && ended.err.contains(suggestion), "{ended}");
        assert!(ended.out.is_empty(), "{ended}");
    }
}

/// What is no command is answered with how it is used, and exit code 2.
#[test]
fn wrong_usage_has_its_own_code() {
    let cluster = Cluster::new();
    for arguments in [&["open", "door"][..], &["run"], &["check", "a.dca", "--quickly"]] {
        let ended = cluster.here().ask(arguments);
        assert_eq!(ended.code, Some(2), "{ended}");
        assert!(ended.err.contains("Usage: dca"), "{ended}");
    }
}
