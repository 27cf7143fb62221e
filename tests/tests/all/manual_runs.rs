//! A page of the manual for newcomers: each of its commands runs, and prints exactly the text of the page.

use dca_tests::cluster::Cluster;
use std::path::Path;

/// The pages. The text of a block `dca,FILE` is written to FILE, and the text after `$ dca …` in a block `console` is
/// printed.
const PAGES: [&str; 1] = ["first_proof.md"];

#[test]
fn each_command_prints_what_the_page_says() {
    for page in PAGES {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/src").join(page);
        let text = std::fs::read_to_string(&path).expect("the page is there");
        let made = made(&text);
        expect_test::expect_file![path].assert_eq(&made);
    }
}

/// Returns the page with the present output of its commands.
fn made(page: &str) -> String {
    let cluster = Cluster::new();
    let (mut made, mut commands) = (String::new(), 0);
    let mut lines = page.lines();
    while let Some(line) = lines.next() {
        made += &format!("{line}\n");
        let Some(mark) = line.strip_prefix("```").filter(|mark| !mark.is_empty()) else { continue };
        let block: Vec<&str> = lines.by_ref().take_while(|line| *line != "```").collect();
        if let Some((_, file)) = mark.split_once(',') {
            cluster.file(file.trim(), &block.iter().map(|line| format!("{line}\n")).collect::<String>());
        }
        if mark != "console" {
            block.iter().for_each(|line| made += &format!("{line}\n"));
            made += "```\n";
            continue;
        }
        for command in block.iter().filter_map(|line| line.strip_prefix("$ ")) {
            made += &format!("$ {command}\n{}", run(&cluster, command));
            commands += 1;
        }
        made += "```\n";
    }
    assert!(commands > 3, "only {commands} commands");
    made
}

/// Returns the output of a command: `dca …`, or `cat FILE`.
fn run(cluster: &Cluster, command: &str) -> String {
    let words: Vec<&str> = command.split(' ').collect();
    let printed = match words.as_slice() {
        ["dca", arguments @ ..] => {
            let ended = cluster.here().ask(arguments);
            assert!(ended.code == Some(0) || ended.code == Some(1), "{command}: {ended}");
            // The time of a proof differs between runs, and the page says so.
            let said = ended.err.lines().filter(|line| !line.starts_with("it took "));
            ended.out + &said.map(|line| format!("{line}\n")).collect::<String>()
        }
        ["cat", file] => std::fs::read_to_string(cluster.folder().join(file)).expect("the file is there"),
        _ => panic!("the page runs `{command}`, and a test cannot"),
    };
    format!("{}\n", printed.trim_matches('\n'))
}
