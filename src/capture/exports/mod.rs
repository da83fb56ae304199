//! Camera exports of other programs: RealityScan's CSV, Metashape's XML, Bundler's text, JSON of OpenSfM and OpenMVG.

mod bundler;
mod metashape;
mod open_mvg;
mod open_sfm;
mod reality_scan;
mod shared;

use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::base::error::{Error, Result};
use crate::capture::assemble::RawScene;
use crate::capture::dataset::Layout;

/// Bytes at the start of a file by which it is recognised.
const HEAD: u64 = 4096;

/// Ending of an export, how its text begins, and what it is.
type Known = (&'static str, fn(&str) -> bool, Layout);

/// The exports that are read.
const KNOWN: [Known; 5] = [
    ("csv", reality_scan::is_header, Layout::RealityScan),
    ("xml", metashape::is_document, Layout::Metashape),
    ("out", bundler::is_bundle, Layout::Bundler),
    ("json", open_sfm::is_reconstruction, Layout::OpenSfm),
    ("json", open_mvg::is_data, Layout::OpenMvg),
];

/// The exports in a folder, by name.
pub(super) fn find(root: &Path) -> Vec<(Layout, PathBuf)> {
    let entries = fs::read_dir(root).into_iter().flatten().flatten();
    let known = |file: PathBuf| Some((recognised(&file)?, file));
    let mut all: Vec<_> = entries.filter_map(|entry| known(entry.path())).collect();
    all.sort_by(|a, b| a.1.cmp(&b.1));
    all
}

/// The program that wrote a file, by its ending and its first lines.
fn recognised(file: &Path) -> Option<Layout> {
    let ending = file.extension()?.to_str()?.to_ascii_lowercase();
    let candidates = KNOWN.iter().filter(|(known, ..)| *known == ending);
    let mut candidates = candidates.peekable();
    candidates.peek()?;
    let file = file.is_file().then(|| File::open(file).ok())??;
    let mut head = Vec::new();
    file.take(HEAD).read_to_end(&mut head).ok()?;
    let head = String::from_utf8_lossy(&head);
    let head = head.trim_start_matches('\u{feff}');
    let found = candidates.find(|(_, begins, _)| begins(head));
    found.map(|(.., layout)| *layout)
}

/// The views and points of the one export in `root`.
///
/// # Errors
/// Several exports; what their readers refuse.
pub(super) fn load(
    root: &Path,
    exports: &[(Layout, PathBuf)],
    asked: Option<&Path>,
) -> Result<RawScene> {
    let [(layout, file)] = exports else {
        let names = exports.iter().filter_map(|(_, file)| file.file_name());
        let names: Vec<_> = names.map(|name| name.to_string_lossy()).collect();
        let what = format!("several files with cameras: {}", names.join(", "));
        return Err(Error::input(root, what, "keep the one that is meant"));
    };
    match layout {
        Layout::Metashape => metashape::load(root, file, asked),
        Layout::Bundler => bundler::load(root, file, asked),
        Layout::OpenSfm => open_sfm::load(root, file, asked),
        Layout::OpenMvg => open_mvg::load(root, file, asked),
        _ => reality_scan::load(root, file, asked),
    }
}
