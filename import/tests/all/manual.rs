//! The pages of the manual show what the import makes: a block `dca,imported` is the spec of the XML before it.
//!
//! `UPDATE_EXPECT=1` writes these blocks into the pages.

use expect_test::expect_file;
use import::import;
use language::Source;
use std::path::Path;

/// The pages with such blocks.
const PAGES: [&str; 2] = ["behaviortree.md", "nav2.md"];

#[test]
fn imported_blocks_are_what_the_import_makes() {
    for name in PAGES {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/src/from").join(name);
        let page = std::fs::read_to_string(&path).expect("the page is there");
        let (mut written, mut xml, mut block) = (String::new(), None, None::<(&str, String)>);
        for line in page.lines() {
            match (line.strip_prefix("```"), block.take()) {
                (Some(kind), None) => {
                    written += &format!("{line}\n");
                    block = Some((kind, String::new()));
                }
                (Some(_), Some((kind, body))) => {
                    let body = match (kind, &xml) {
                        ("dca,imported", Some(tree)) => import(tree, &[]).expect("a good tree").text,
                        _ => body,
                    };
                    if kind == "xml" {
                        xml = Some(Source::new("tree.xml", body.as_str()));
                    }
                    written += &format!("{body}```\n");
                }
                (None, Some((kind, body))) => block = Some((kind, format!("{body}{line}\n"))),
                (None, None) => written += &format!("{line}\n"),
            }
        }
        assert!(written.contains("```dca,imported"), "{name}");
        expect_file![path].assert_eq(&written);
    }
}
