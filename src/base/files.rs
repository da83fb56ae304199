//! Files that are either the old ones or the new ones, never half of each.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::Path;

use crate::base::error::{Error, Result};

/// Ending of temporary files.
const ENDING: &str = ".mhsplat-tmp";

/// Writes a file through `content` into a temporary one next to it, which then takes its place: a reader, or a run that is
/// killed, sees the old file or the new one. The temporary file is removed when something fails.
///
/// # Errors
/// [`Error::Io`] where the system refuses; [`Error::Input`] for a path without a file name.
pub fn write(
    path: &Path,
    content: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<()> {
    let Some(name) = path.file_name() else {
        return Err(Error::input(
            path,
            "not a file name",
            "give a file to write",
        ));
    };
    // The process id keeps two runs with one output from writing into the same temporary file.
    let mut hidden = OsString::from(".");
    hidden.push(name);
    hidden.push(format!(".{}{ENDING}", std::process::id()));
    let temporary = path.with_file_name(hidden);
    let written = File::create(&temporary).and_then(|file| {
        let mut writer = BufWriter::with_capacity(1 << 20, file);
        content(&mut writer)?;
        writer.flush()?;
        writer.get_ref().sync_all()?;
        fs::rename(&temporary, path)?;
        sync_folder(path);
        Ok(())
    });
    written.map_err(|source| {
        let _ = fs::remove_file(&temporary);
        Error::io(path, source)
    })
}

/// Has the new name on the disk, too: after a power cut the folder may else still name the old file. Not every file system can;
/// the new file is in its place either way.
fn sync_folder(path: &Path) {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
    if let Ok(folder) = File::open(folder.unwrap_or(Path::new("."))) {
        let _ = folder.sync_all();
    }
}

/// [`write`] for bytes that are there already.
///
/// # Errors
/// As [`write`].
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    write(path, |w| w.write_all(bytes))
}

/// Removes what a killed process left half written in a folder. What cannot be removed stays.
pub fn sweep(folder: &Path) {
    let Ok(entries) = fs::read_dir(folder) else {
        return;
    };
    for entry in entries.flatten() {
        if entry.file_name().to_string_lossy().ends_with(ENDING) {
            let _ = fs::remove_file(entry.path());
        }
    }
}
