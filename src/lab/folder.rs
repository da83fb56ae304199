//! Folders of files that a command leaves beside what it prints.

use std::path::Path;

use serde::Serialize;

use crate::base::error::{Error, Result};

/// Refuses a folder that holds anything, or a path that is no folder.
///
/// # Errors
/// As said.
pub fn check_folder(dir: &Path) -> Result<()> {
    let fix = "choose another with -o";
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

/// The JSON document of one device, or of several as an array; `name` is what an error calls it.
///
/// # Errors
/// None that a user can cause: what is measured can be written.
pub fn one_or_all<T: Serialize>(name: &str, all: &[T]) -> Result<String> {
    let text = match all {
        [one] => serde_json::to_string_pretty(one),
        all => serde_json::to_string_pretty(all),
    };
    text.map_err(|e| Error::Numerics {
        stage: name.into(),
        what: e.to_string(),
    })
}

/// Writes the files, each whole or not at all, into a folder that [`check_folder`] accepts, and makes it if need be.
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
