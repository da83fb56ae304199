//! Folders of files that a command writes beside what it prints, and their JSON documents.

use std::path::Path;

use serde::Serialize;

use crate::base::error::{Error, Result};

/// Refuses a folder that holds anything, or a path that is not a folder.
///
/// # Errors
/// Such a path.
pub fn check_folder(dir: &Path) -> Result<()> {
    let fix = "choose another folder";
    match std::fs::read_dir(dir) {
        Ok(mut entries) => match entries.next() {
            None => Ok(()),
            Some(_) => Err(Error::input(
                dir,
                "is not empty; nothing is overwritten",
                fix,
            )),
        },
        Err(_) if dir.exists() => Err(Error::input(dir, "is no folder that can be read", fix)),
        Err(_) => Ok(()),
    }
}

/// A JSON document; `name` is what an error calls it.
///
/// # Errors
/// None that a user can cause: what is measured can be written.
pub fn json(name: &str, value: &impl Serialize) -> Result<String> {
    serde_json::to_string_pretty(value).map_err(|e| Error::numerics(name, e))
}

/// The JSON document of one device, or of several as an array.
///
/// # Errors
/// Those of [`json`].
pub fn one_or_all<T: Serialize>(name: &str, all: &[T]) -> Result<String> {
    match all {
        [one] => json(name, one),
        all => json(name, &all),
    }
}

/// Writes the files, each whole or not at all, into a folder that [`check_folder`] accepts; makes the folder if need be.
///
/// # Errors
/// A folder that is refused or cannot be written.
pub fn write_files(dir: &Path, files: &[(&str, String)]) -> Result<()> {
    check_folder(dir)?;
    std::fs::create_dir_all(dir).map_err(|e| Error::io(dir, e))?;
    for (name, text) in files {
        crate::base::files::write_bytes(&dir.join(name), text.as_bytes())?;
    }
    Ok(())
}
