//! Files and folders of tests, as `gather` asks for them.

use language::Content;
use std::path::Path;

/// Returns the content at a path.
pub(crate) fn content(path: &Path) -> Result<Content, String> {
    if let Ok(text) = std::fs::read_to_string(path) {
        return Ok(Content::File(text));
    }
    let entries = std::fs::read_dir(path).map_err(|_error| "no such file".to_owned())?;
    let names = entries.filter_map(|entry| Some(entry.ok()?.file_name().to_string_lossy().into_owned()));
    Ok(Content::Folder(names.collect()))
}
