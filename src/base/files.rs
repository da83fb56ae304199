//! Atomic files: always the old content or the new one, never half of each. Locks of folders, and ways between them.

use std::ffi::OsString;
use std::fs::{self, File, TryLockError};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{self, BufWriter, Write};
use std::path::{Component, Path, PathBuf};

use crate::base::error::{Error, Result};

/// Ending of temporary files.
const ENDING: &str = ".mhsplat-tmp";

/// Writes a file atomically: `content` fills a temporary file next to it, which then replaces it. A reader, or a run that is
/// killed, sees the old file or the new one. The temporary file is removed after a failure.
///
/// # Errors
/// [`Error::Io`] if the system refuses; [`Error::Input`] for a path without a file name.
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
    // A number of its own keeps two runs with one output from writing into the same temporary file. Process ids repeat from node to node.
    let own = RandomState::new().build_hasher().finish();
    let mut hidden = OsString::from(".");
    hidden.push(name);
    hidden.push(format!(".{own:x}{ENDING}"));
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

/// Flushes the folder of a file, so that its new name survives a power cut. A file system that cannot is ignored.
fn sync_folder(path: &Path) {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
    if let Ok(folder) = File::open(folder.unwrap_or(Path::new("."))) {
        let _ = folder.sync_all();
    }
}

/// A folder that one process alone works in, until this is dropped or the process ends, however it ends.
#[derive(Debug)]
pub struct FolderLock {
    _file: Option<File>,
}

/// File that is locked: network file systems lock files that are open for writing, and no folders.
pub const LOCK_FILE: &str = ".lock";

impl FolderLock {
    /// Takes the lock of a folder. Where the file system cannot lock there is none.
    ///
    /// # Errors
    /// [`Error::Input`] if another process has it.
    pub fn take(folder: &Path) -> Result<Self> {
        let file = File::options()
            .write(true)
            .create(true)
            .truncate(false)
            .open(folder.join(LOCK_FILE));
        let Ok(file) = file else {
            return Ok(Self { _file: None });
        };
        match file.try_lock() {
            Ok(()) => Ok(Self { _file: Some(file) }),
            Err(TryLockError::Error(_)) => Ok(Self { _file: None }),
            Err(TryLockError::WouldBlock) => Err(Error::input(
                folder,
                "another process is at work in this folder",
                "wait for its end or stop it, or choose another folder",
            )),
        }
    }
}

/// Refuses what is no regular file: a pipe might never end.
///
/// # Errors
/// [`Error::Input`] for a pipe, a device or a folder; [`Error::Io`] if the system refuses.
pub fn check_regular(path: &Path) -> Result<()> {
    let found = fs::metadata(path).map_err(|source| Error::io(path, source))?;
    match found.is_file() {
        true => Ok(()),
        false => Err(Error::input(
            path,
            "no regular file",
            "put a file in its place",
        )),
    }
}

/// The bytes of a regular file.
///
/// # Errors
/// Those of [`check_regular`]; [`Error::Io`].
pub fn read(path: &Path) -> Result<Vec<u8>> {
    check_regular(path)?;
    fs::read(path).map_err(|source| Error::io(path, source))
}

/// The bytes of a text file, without the byte-order mark that some programs on Windows begin one with.
///
/// # Errors
/// Those of [`read`].
pub fn read_text(path: &Path) -> Result<Vec<u8>> {
    let mut bytes = read(path)?;
    if bytes.starts_with(b"\xef\xbb\xbf") {
        bytes.drain(..3);
    }
    Ok(bytes)
}

/// Writes bytes atomically.
///
/// # Errors
/// Those of [`write`].
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    write(path, |w| w.write_all(bytes))
}

/// True for a folder that is not there, or holds nothing but files that others are writing.
#[must_use]
pub fn is_free(folder: &Path) -> bool {
    let temporary = |e: io::Result<fs::DirEntry>| {
        e.is_ok_and(|e| e.file_name().to_string_lossy().ends_with(ENDING))
    };
    match fs::read_dir(folder) {
        Ok(mut all) => all.all(temporary),
        Err(error) => error.kind() == io::ErrorKind::NotFound,
    }
}

/// Removes temporary files that killed processes left in a folder; failures are ignored.
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

/// The way from a folder to a file; none if one of them is not there, or they have nothing in common.
pub(crate) fn between(folder: &Path, file: &Path) -> Option<PathBuf> {
    let [folder, file] = [folder, file].map(|path| path.canonicalize().ok());
    let (folder, file) = (folder?, file?);
    let pairs = folder.components().zip(file.components());
    let alike = pairs.take_while(|(a, b)| a == b).count();
    let up = folder
        .components()
        .skip(alike)
        .map(|_| Component::ParentDir);
    (alike > 0).then(|| up.chain(file.components().skip(alike)).collect())
}
