//! XML, as much of it as charts use: elements and attributes.

/// An element.
#[derive(Debug)]
pub(super) struct Element {
    /// The name without the prefix of a namespace.
    pub(super) name: String,
    attributes: Vec<(String, String)>,
    pub(super) children: Vec<Self>,
    /// Whether there is neither text nor an element in it.
    pub(super) is_empty: bool,
}

impl Element {
    pub(super) fn get(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(other, _)| other == name).map(|(_, value)| value.as_str())
    }

    pub(super) fn child(&self, name: &str) -> Option<&Self> {
        self.children.iter().find(|child| child.name == name)
    }

    /// Looks at an element and all inside it.
    pub(super) fn walk(&self, look: &mut impl FnMut(&Self) -> Result<(), String>) -> Result<(), String> {
        look(self)?;
        self.children.iter().try_for_each(|child| child.walk(look))
    }
}

/// Returns the root of a document.
///
/// # Errors
/// If a tag or a comment has no end.
pub(super) fn parse(text: &str) -> Result<Element, String> {
    let mut open: Vec<Element> = vec![];
    let mut rest = text;
    while let Some(start) = rest.find('<') {
        if let Some(element) = open.last_mut().filter(|_| !rest[..start].trim().is_empty()) {
            element.is_empty = false;
        }
        rest = &rest[start..];
        let skipped = [("<!--", "-->"), ("<?", "?>"), ("<![CDATA[", "]]>"), ("<!", ">")];
        if let Some((_, end)) = skipped.iter().find(|(begin, _)| rest.starts_with(begin)) {
            rest = &rest[rest.find(end).ok_or("a comment without an end")? + end.len()..];
            continue;
        }
        let end = tag_end(rest).ok_or("a tag without an end")?;
        let tag = &rest[1..end];
        rest = &rest[end + 1..];
        let is_closed = tag.ends_with('/');
        if !tag.starts_with('/') {
            open.push(element(tag.trim_end_matches('/')));
        }
        if is_closed || tag.starts_with('/') {
            let element = open.pop().ok_or("an end without a beginning")?;
            match open.last_mut() {
                None => return Ok(element),
                Some(parent) => {
                    parent.is_empty = false;
                    parent.children.push(element);
                }
            }
        }
    }
    Err("a document without an end".into())
}

/// Where a tag ends: at the first `>` outside quotes.
fn tag_end(text: &str) -> Option<usize> {
    let mut quote = None;
    text.char_indices().find_map(|(place, c)| {
        match (quote, c) {
            (None, '>') => return Some(place),
            (None, '"' | '\'') => quote = Some(c),
            (Some(open), c) if open == c => quote = None,
            _ => {}
        }
        None
    })
}

fn element(tag: &str) -> Element {
    let tag = tag.trim();
    let (name, mut rest) = tag.split_once(char::is_whitespace).unwrap_or((tag, ""));
    let name = name.rsplit(':').next().unwrap_or(name).to_owned();
    let mut attributes = vec![];
    while let Some((key, after)) = rest.split_once('=') {
        let after = after.trim_start();
        let Some(quote) = after.chars().next() else { break };
        let Some((value, after)) = after[1..].split_once(quote) else { break };
        attributes.push((key.trim().to_owned(), plain(value)));
        rest = after;
    }
    Element { name, attributes, children: vec![], is_empty: true }
}

fn plain(value: &str) -> String {
    let entities = [("&lt;", "<"), ("&gt;", ">"), ("&quot;", "\""), ("&apos;", "'"), ("&amp;", "&")];
    entities.iter().fold(value.to_owned(), |value, (entity, c)| value.replace(entity, c))
}
