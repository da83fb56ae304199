//! Pages of the measuring commands: marked as such, so that a page may be replaced and nothing else.

use std::path::Path;

use crate::base::error::{Error, Result};

/// What marks a page as one that may be replaced.
pub const GENERATOR: &str = "<!-- written by mhsplat, which may replace it -->";

/// Refuses a path at which something else than such a page is.
///
/// # Errors
/// As said.
pub fn check_page(path: &Path) -> Result<()> {
    if !path.exists() {
        return Ok(());
    }
    let ours = std::fs::read_to_string(path).is_ok_and(|text| text.contains(GENERATOR));
    if ours {
        return Ok(());
    }
    Err(Error::input(
        path,
        "exists, and is no page of a comparison; nothing else is overwritten",
        "choose another file with -o",
    ))
}

/// Writes the page; replaces an earlier one, but nothing else.
///
/// # Errors
/// A path that [`check_page`] refuses or that cannot be written.
pub fn write_page(path: &Path, page: &str) -> Result<()> {
    check_page(path)?;
    crate::base::files::write_bytes(path, page.as_bytes())
}
