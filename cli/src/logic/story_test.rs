//! A test that `dca verify --test` writes and `dca test` runs. It contains a mistake of a spec, and the story that leads to the mistake.

use language::Diagnostic;
use language::plan::Plan;
use language::sites::{Property, Sites};
use verify::{Finding, Script, Verdict};

/// A mistake that was found once, in the form of its file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct StoryTest {
    /// The path of the spec, relative to the folder of the test.
    pub(crate) spec: String,
    /// The code of the mistake: `E0817`.
    pub(crate) code: String,
    /// The message about it.
    pub(crate) message: String,
    /// The sentence of the spec that did not hold, as a block: `verify main { never a with b; }`.
    pub(crate) block: Option<String>,
    /// The events that lead to the mistake; nothing if the mistake has no story.
    pub(crate) script: Option<Script>,
}

impl StoryTest {
    /// Makes a test from a finding that does not hold.
    pub(crate) fn of(spec: &str, finding: &Finding, plan: &Plan, sites: &Sites) -> Option<Self> {
        let diagnostic = finding.diagnostic.as_ref()?;
        let is_it = |property: &&Property| is_about(diagnostic, property, plan);
        let block = sites.properties.iter().find(is_it).map(|property| block(property, plan));
        Some(Self {
            spec: spec.to_owned(),
            code: diagnostic.code.to_string(),
            message: diagnostic.message.clone(),
            block,
            script: finding.story.as_ref().and_then(Script::of),
        })
    }

    /// Returns the content of the file, with the story in words.
    pub(crate) fn text(&self, story: &[String]) -> String {
        let Self { spec, code, message, block, script } = self;
        let mut text = format!(
            "# A mistake that `dca verify` has found. `dca test` fails on this file as long as the spec has it, and passes once it is gone.\n\
             spec: {spec}\nfound: {code} {message}\n"
        );
        if let Some(block) = block {
            text += &format!("{block}\n");
        }
        text += "\n";
        story.iter().for_each(|line| text += &format!("# {line}\n"));
        script.iter().for_each(|script| text += &script.to_string());
        text
    }

    /// Reads the content of a file.
    ///
    /// # Errors
    /// One sentence about the mistake, for a person.
    pub(crate) fn read(text: &str) -> Result<Self, String> {
        let (mut spec, mut found, mut block, mut rest) = (None, None, None, String::new());
        for line in text.lines() {
            if let Some(name) = line.strip_prefix("spec:") {
                spec = Some(name.trim().to_owned());
            } else if let Some(mistake) = line.strip_prefix("found:") {
                found = mistake.trim().split_once(' ').map(|(code, message)| (code.to_owned(), message.to_owned()));
            } else if line.starts_with("verify ") {
                block = Some(line.to_owned());
            } else {
                rest += line;
            }
            // An empty line keeps the numbers of the following lines.
            rest.push('\n');
        }
        let script: Script = rest.parse().map_err(|error: verify::ScriptError| error.to_string())?;
        let (code, message) = found.ok_or("a line `found: CODE MESSAGE` is missing")?;
        let spec = spec.ok_or("a line `spec: FILE` is missing")?;
        let script = Some(script).filter(|script| !script.events.is_empty());
        Ok(Self { spec, code, message, block, script })
    }

    /// Returns the finding that answers the same question; nothing if the question is no longer asked.
    pub(crate) fn answer<'f>(&self, findings: &'f [Finding]) -> Option<&'f Finding> {
        let is_it = |finding: &&Finding| {
            let code = finding.diagnostic.as_ref().map(|diagnostic| diagnostic.code.to_string());
            code.as_deref() == Some(&*self.code)
                && match self.block {
                    Some(_) => finding.sentence == self.message,
                    None => names(&finding.sentence) == names(&self.message),
                }
        };
        let fails = findings.iter().filter(|finding| finding.verdict == Verdict::Fails);
        fails.into_iter().find(is_it).or_else(|| findings.iter().find(|finding| finding.verdict == Verdict::Open))
    }

    /// Returns whether the spec already contains the sentence as one of its properties.
    pub(crate) fn is_stated(&self, plan: &Plan, sites: &Sites) -> bool {
        sites.properties.iter().any(|property| self.block.as_ref() == Some(&block(property, plan)))
    }
}

/// Returns a property as a separate block.
fn block(property: &Property, plan: &Plan) -> String {
    format!("verify {} {{ {}; }}", plan.groups[property.group as usize].process, property.text)
}

/// Returns whether the mistake is that this property does not hold.
fn is_about(diagnostic: &Diagnostic, property: &Property, plan: &Plan) -> bool {
    let path = &plan.groups[property.group as usize].path;
    let name = path.strip_prefix("main/").unwrap_or(path);
    diagnostic.primary.span == property.span && diagnostic.message.contains(&format!("`{name}`"))
}

/// Returns the names between backquotes.
fn names(text: &str) -> Vec<&str> {
    text.split('`').skip(1).step_by(2).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_as_it_was_written() {
        let script = "start main\nfails main/a\nruns b\nends failed\n".parse().expect("a script");
        let mut test = StoryTest {
            spec: "../a.dca".to_owned(),
            code: "E0817".to_owned(),
            message: "does not hold of `main`: b only after a.done".to_owned(),
            block: Some("verify main { b only after a.done; }".to_owned()),
            script: Some(script),
        };
        assert_eq!(StoryTest::read(&test.text(&["  1  `main` starts".to_owned()])), Ok(test.clone()));
        (test.block, test.script) = (None, None);
        assert_eq!(StoryTest::read(&test.text(&[])), Ok(test));
        assert!(StoryTest::read("spec: a.dca\n").unwrap_err().contains("found"));
        let wrong = StoryTest::read("spec: a.dca\nfound: E0811 stuck\nfly main\n").unwrap_err();
        assert!(wrong.starts_with("line 3 "), "{wrong}");
    }
}
