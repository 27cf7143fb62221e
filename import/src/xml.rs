//! Reads XML within limits: no entities, no external files, limited size and depth.

use language::Source;
use roxmltree::{Document, ParsingOptions};

/// The longest file, in bytes.
pub(crate) const TEXT_MAX: usize = 8 * 1024 * 1024;
/// The most elements, attributes and texts of a file. A chart of 1,000 states has some ten thousand.
pub(crate) const NODES_MAX: u32 = 200_000;
/// The deepest nesting of elements. A spec nests at most 64 levels, and most elements become one.
pub(crate) const DEPTH_MAX: usize = 48;

/// An element, or another node of a document.
pub(crate) type Node<'a> = roxmltree::Node<'a, 'a>;

/// A file with its root element.
#[derive(Clone, Copy, Debug)]
pub(crate) struct File<'a> {
    pub(crate) name: &'a str,
    pub(crate) root: Node<'a>,
}

/// A file cannot be imported.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("cannot import `{file}`, line {line}, column {column}: {why}")]
pub struct ImportError {
    /// The name of the file.
    pub file: String,
    /// The line of the first wrong element, from 1.
    pub line: u32,
    /// Its column, from 1.
    pub column: u32,
    /// The reason.
    pub why: String,
}

impl ImportError {
    /// Returns an error about an element.
    pub(crate) fn at(file: &str, node: Node<'_>, why: impl Into<String>) -> Self {
        let (line, column) = place(node);
        Self { file: file.into(), line, column, why: why.into() }
    }
}

/// Returns the line and the column of a node, from 1.
pub(crate) fn place(node: Node<'_>) -> (u32, u32) {
    let position = node.document().text_pos_at(node.range().start);
    (position.row, position.col)
}

/// Reads a file.
///
/// # Errors
/// The file is too long, is not XML, declares entities, or has too many or too deep elements.
pub(crate) fn parse(source: &Source) -> Result<Document<'_>, ImportError> {
    let wrong = |line, column, why: String| ImportError { file: source.name.clone(), line, column, why };
    if source.text.len() > TEXT_MAX {
        let why = format!("the file has {} bytes; at most {TEXT_MAX} are read", source.text.len());
        return Err(wrong(1, 1, why));
    }
    if let Some(offset) = too_deep(&source.text) {
        let lines = source.text[..offset].split('\n');
        let (count, last) = lines.fold((0_u32, ""), |(count, _), line| (count.saturating_add(1), line));
        let column = u32::try_from(last.chars().count()).unwrap_or(u32::MAX).saturating_add(1);
        return Err(wrong(count, column, format!("elements are nested more than {DEPTH_MAX} deep")));
    }
    let options = ParsingOptions { allow_dtd: false, nodes_limit: NODES_MAX, ..ParsingOptions::default() };
    Document::parse_with_options(&source.text, options).map_err(|error| {
        let position = error.pos();
        wrong(position.row, position.col, error.to_string())
    })
}

/// Returns where the first element begins that is nested too deeply. The parser itself has no limit of the depth.
///
/// Comments, CDATA and quotes are skipped as XML has them. In a text that is not XML the result may be wrong, and then the
/// parser refuses the text.
fn too_deep(text: &str) -> Option<usize> {
    let mut depth = 0_usize;
    let mut from = 0;
    while let Some(found) = text[from..].find('<') {
        let start = from + found;
        let rest = &text[start..];
        let skipped = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>"), ("<!", ">")];
        if let Some((begin, end)) = skipped.iter().find(|(begin, _)| rest.starts_with(begin)) {
            from = start + begin.len() + rest[begin.len()..].find(end)? + end.len();
            continue;
        }
        let end = tag_end(rest)?;
        if rest.starts_with("</") {
            depth = depth.saturating_sub(1);
        } else if !rest[..end].ends_with('/') {
            depth += 1;
            if depth > DEPTH_MAX {
                return Some(start);
            }
        }
        from = start + end + 1;
    }
    None
}

/// Where a tag ends: at the first `>` outside quotes.
fn tag_end(tag: &str) -> Option<usize> {
    let mut quote = None;
    tag.char_indices().find_map(|(offset, character)| match (quote, character) {
        (None, '>') => Some(offset),
        (None, '"' | '\'') => {
            quote = Some(character);
            None
        }
        (Some(open), _) if open == character => {
            quote = None;
            None
        }
        (None | Some(_), _) => None,
    })
}

/// Returns the number of a node in its document.
pub(crate) fn number(node: Node<'_>) -> u32 {
    node.id().get()
}

/// Returns the elements directly inside a node.
pub(crate) fn elements(node: Node<'_>) -> impl Iterator<Item = Node<'_>> {
    node.children().filter(|child| child.is_element())
}

/// Returns the name of an element without its namespace.
pub(crate) fn tag<'a>(node: Node<'a>) -> &'a str {
    node.tag_name().name()
}
