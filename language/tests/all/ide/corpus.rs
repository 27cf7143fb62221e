//! Every place of every spec of the corpus: names keep their meaning when they are renamed, and every question has an answer.

use super::*;

/// Every file of the corpus that is accepted, with the files it uses and its interfaces.
fn corpus() -> Vec<Analysis> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus");
    let entries = std::fs::read_dir(&folder).expect("the corpus is a folder");
    let mut paths: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "dca"));
    paths.sort();
    let analysis = |path: PathBuf| {
        let text = std::fs::read_to_string(&path).expect("a file of the corpus is text");
        let spec = Source::new(path.file_name().unwrap_or_default().to_string_lossy(), text);
        let mut others = gather(&spec, &|name| disk::content(&folder.join(name)));
        let interface = std::fs::read_to_string(path.with_extension("interface"));
        others.extend(interface.ok().map(|text| Source::new("interface", text)));
        Analysis::new(spec, others, &Options::named("corpus"))
    };
    paths.into_iter().map(analysis).collect()
}

/// The name of everything that can be renamed, once, with its first place.
fn names(analysis: &Analysis) -> Vec<(usize, Declaration)> {
    let mut found: Vec<(usize, Declaration)> = Vec::new();
    for offset in 0..analysis.spec().text.len() {
        let declared = analysis.prepare_rename(offset).ok().and_then(|_| analysis.declaration(offset));
        found.extend(declared.filter(|new| found.iter().all(|(_, known)| known != new)).map(|new| (offset, new)));
    }
    found
}

/// A plan as text with another name for one word, in every place: also in `robot_0`, and in paths.
fn respelled(plan: &Plan, from: &str, to: &str) -> String {
    let is_part = |c: char| c.is_alphanumeric() || c == '_';
    let text = shown(plan);
    let mut out = String::with_capacity(text.len());
    for piece in text.split_inclusive(|c| !is_part(c)) {
        let word = piece.trim_end_matches(|c| !is_part(c));
        let element = word.strip_prefix(from).and_then(|rest| rest.strip_prefix('_'));
        let is_element = element.is_some_and(|number| number.parse::<u32>().is_ok());
        out += if word == from || is_element { to } else { &word[..0] };
        out += if word == from {
            ""
        } else if is_element {
            &word[from.len()..]
        } else {
            word
        };
        out += &piece[word.len()..];
    }
    out
}

/// A rename keeps the plan, up to the name; the number of diagnostics stays the same.
#[test]
fn names_mean_the_same_under_another_name() {
    let (mut renamed, mut refused) = (0, 0);
    for analysis in corpus().iter().filter(|analysis| analysis.plan().is_some()) {
        for (offset, declaration) in names(analysis) {
            let span = analysis.prepare_rename(offset).unwrap();
            let from = &analysis.source(analysis.definition(offset).unwrap()).text;
            let from = &from[declaration.start as usize..declaration.end as usize];
            let to = "renamed9";
            let Ok(edits) = rename(&[analysis], &declaration, to) else {
                refused += 1;
                continue;
            };
            let change = |source: &Source| {
                let mut text = source.text.clone();
                for edit in edits.iter().rev().filter(|edit| edit.file == source.name) {
                    text.replace_range(edit.start as usize..edit.end as usize, &edit.text);
                }
                Source { text, ..source.clone() }
            };
            let others: Vec<Source> = analysis.others().iter().map(change).collect();
            let after = Analysis::new(change(analysis.spec()), others, &Options::named("corpus"));
            let place = format!("{from} at {} in {}", span.start, analysis.spec().name);
            let plan = after.plan().unwrap_or_else(|| panic!("{place}: {:?}", after.diagnostics()));
            // The same word may also be the name of other things: it is respelled in both.
            assert_eq!(respelled(analysis.plan().unwrap(), from, to), respelled(plan, from, to), "{place}");
            renamed += 1;
        }
    }
    println!("{renamed} names renamed, {refused} refused");
    assert!(renamed > 400 && refused * 20 < renamed, "{renamed} renamed, {refused} refused");
}

/// Every place of every text has an answer.
#[test]
fn every_place_of_every_text_can_be_asked_about() {
    for analysis in corpus() {
        let text = &analysis.spec().text;
        analysis.outline();
        analysis.folds();
        let highlights = analysis.highlights();
        assert!(highlights.windows(2).all(|pair| pair[0].span.end <= pair[1].span.start), "{}", analysis.spec().name);
        for token in language::syntax::lex(text) {
            let offset = token.start as usize;
            analysis.hover(offset);
            let (definition, declaration) = (analysis.definition(offset), analysis.declaration(offset));
            if let (Some(place), Some(declaration)) = (definition, declaration) {
                assert_eq!(analysis.references(&declaration).first(), Some(&place));
            }
            // Completion reads the text again each time, so it is asked at every token only.
            let (range, _) = analysis.complete(token.end as usize);
            assert!(text.get(range).is_some());
        }
    }
}
