//! Datasets in zip archives, which are unpacked into a folder for as long as their photos are read.
//!
//! Entries are stored or deflated. An archive comes from somewhere else: nothing of it is written outside of the folder, or is more than its
//! directory says.

use std::fs::{self, File};
use std::io::{self, BufWriter, ErrorKind, Read, Write};
use std::path::{Component, Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use flate2::read::DeflateDecoder;
use rawzip::{
    CompressionMethod, FileReader, ZipArchive, ZipArchiveEntryWayfinder, ZipFileHeaderRecord,
};

use crate::base::error::{Error, Result};
use crate::base::files::check_regular;

/// Beginning of the remedy for a folder of several datasets.
pub(super) const ONE_OF_THEM: &str = "give one of them";

/// Remedy for an archive that cannot be read.
const PACK: &str = "pack it again as a plain zip archive, or unpack it and give the folder";

/// Largest directory that is read, bytes; half a million photos have less.
const DIRECTORY: u64 = 64 << 20;
/// Content may be so many times as large as the archive, and `SPARE` bytes more: photos are compressed already, models five to one.
const LARGEST: u64 = 100;
const SPARE: u64 = 64 << 20;

/// True for the path of a zip archive, by its ending.
#[must_use]
pub fn is_archive(path: &Path) -> bool {
    let ending = path.extension().and_then(|e| e.to_str());
    ending.is_some_and(|e| e.eq_ignore_ascii_case("zip")) && path.is_file()
}

/// Temporary folders that are there now. It is locked while an archive is unpacked into one of them, or one removed.
static FOLDERS: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

fn folders() -> MutexGuard<'static, Vec<PathBuf>> {
    // Paths are right whatever panicked.
    FOLDERS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes all temporary folders before the program ends: who unpacks an archive or drops its folder waits from now on.
pub fn remove_temporary() {
    let mut all = folders();
    all.drain(..).for_each(remove);
    std::mem::forget(all);
}

fn remove(folder: PathBuf) {
    let _ = fs::remove_dir_all(folder);
}

/// A new folder in the system's folder for temporary files, for this user alone, removed when this is dropped.
#[derive(Debug)]
pub struct Temporary {
    /// The folder.
    pub folder: PathBuf,
}

impl Temporary {
    /// An empty one.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn new() -> Result<Self> {
        let mut key = [0; 8];
        let place = std::env::temp_dir();
        getrandom::fill(&mut key).map_err(|e| Error::io(&place, io::Error::other(e)))?;
        let key = u64::from_le_bytes(key);
        let folder = place.join(format!("mhsplat-{key:016x}"));
        let mut options = fs::DirBuilder::new();
        #[cfg(unix)]
        std::os::unix::fs::DirBuilderExt::mode(&mut options, 0o700);
        let mut all = folders();
        options.create(&folder).map_err(|e| Error::io(&folder, e))?;
        all.push(folder.clone());
        Ok(Self { folder })
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        let mut all = folders();
        all.retain(|folder| *folder != self.folder);
        remove(self.folder.clone());
    }
}

/// The folder with the content of an archive, removed when this is dropped.
#[derive(Debug)]
pub(super) struct Unpacked {
    archive: PathBuf,
    /// The folder with the content, which goes with it.
    pub place: Temporary,
}

impl Unpacked {
    /// The archive at `archive`, unpacked into a new folder of the system's folder for temporary files.
    ///
    /// # Errors
    /// [`Error::Input`] that names the archive and the entry: no archive or a damaged one, an entry that is encrypted, a link, of another
    /// method, given twice or leads out of the folder, content out of proportion; [`Error::Io`].
    pub fn new(archive: &Path) -> Result<Self> {
        check_regular(archive)?;
        let reader = Reader::open(archive)?;
        let entries = reader.entries()?;
        // From here on it is removed after a failure, too.
        let unpacked = Self {
            archive: archive.to_path_buf(),
            place: Temporary::new()?,
        };
        for entry in &entries {
            let _writing = folders();
            reader.unpack(entry, &unpacked.place.folder)?;
        }
        Ok(unpacked)
    }

    /// The same error about the archive instead of the folder, which is gone when it is read.
    pub fn explained(&self, error: Error) -> Error {
        let [folder, archive] =
            [&self.place.folder, &self.archive].map(|p| p.display().to_string());
        let named = |path: PathBuf| match path.strip_prefix(&self.place.folder) {
            Ok(below) if below.as_os_str().is_empty() => self.archive.clone(),
            Ok(below) => self.archive.join(below),
            Err(_) => path,
        };
        let said = |text: String| text.replace(&folder, &archive);
        match error {
            Error::Input { path, what, fix } => Error::Input {
                path: named(path),
                what: said(what),
                fix: match fix.starts_with(ONE_OF_THEM) {
                    true => "unpack it and give one of its folders, or pack one alone".into(),
                    false => said(fix),
                },
            },
            Error::Config { option, what } => Error::Config {
                option,
                what: said(what),
            },
            Error::Io { path, source } => Error::Io {
                path: named(path),
                source,
            },
            other => other,
        }
    }
}

/// A file in an archive, as the directory has it.
struct Entry {
    /// Name, as it is told.
    name: String,
    /// Path below the folder.
    path: PathBuf,
    deflated: bool,
    size: u64,
    place: ZipArchiveEntryWayfinder,
}

/// An archive that is read.
struct Reader<'a> {
    path: &'a Path,
    archive: ZipArchive<FileReader>,
    /// Bytes of the file.
    length: u64,
}

/// The error of an archive: that of the system where it does not read the file, else that of the file, in words.
fn unread(path: &Path, reason: io::Error, what: impl FnOnce(&io::Error) -> String) -> Error {
    match reason.raw_os_error() {
        Some(_) => Error::io(path, reason),
        None => bad(path, what(&reason)),
    }
}

/// The error of the archive reader as one of reading.
fn reading(error: rawzip::Error) -> io::Error {
    let text = error.to_string();
    match error.into_kind() {
        rawzip::ErrorKind::IO(error) => error,
        _ => io::Error::other(text),
    }
}

/// The error of an archive that cannot be read.
fn bad(path: &Path, what: impl Into<String>) -> Error {
    Error::input(path, what, PACK)
}

impl<'a> Reader<'a> {
    fn open(path: &'a Path) -> Result<Self> {
        let file = File::open(path).map_err(|e| Error::io(path, e))?;
        let length = file.metadata().map_err(|e| Error::io(path, e))?.len();
        let mut buffer = vec![0; rawzip::RECOMMENDED_BUFFER_SIZE];
        let archive = ZipArchive::from_file(file, &mut buffer).map_err(|e| {
            unread(path, reading(e), |e| {
                format!("no zip archive, or one that is cut off or damaged ({e})")
            })
        })?;
        Ok(Self {
            path,
            archive,
            length,
        })
    }

    /// The files in the archive.
    fn entries(&self) -> Result<Vec<Entry>> {
        let archive = &self.archive;
        let directory = archive
            .eocd_offset()
            .saturating_sub(archive.directory_offset());
        if directory > DIRECTORY {
            let what = format!("a directory of {} MiB", directory >> 20);
            let what = format!("{what}; at most {} expected", DIRECTORY >> 20);
            return Err(bad(self.path, what));
        }
        let mut buffer = vec![0; rawzip::MAX_CENTRAL_DIRECTORY_RECORD_SIZE];
        let mut records = archive.entries(&mut buffer);
        let (mut entries, mut found) = (Vec::new(), 0);
        loop {
            let record = records.next_entry().map_err(|e| {
                unread(self.path, reading(e), |e| {
                    format!("entry {} of its directory is damaged ({e})", found + 1)
                })
            })?;
            let Some(record) = record else {
                break;
            };
            found += 1;
            entries.extend(self.entry(&record)?);
        }
        let count = archive.entries_hint();
        if found != count {
            let what = format!("{found} entries, but its directory counts {count}");
            return Err(bad(self.path, what));
        }
        let total = entries
            .iter()
            .fold(0_u64, |sum, e| sum.saturating_add(e.size));
        if total > SPARE.saturating_add(LARGEST.saturating_mul(self.length)) {
            let what = format!(
                "{} MiB when it is unpacked, more than {LARGEST} times its size: no archive of photos",
                total >> 20
            );
            return Err(bad(self.path, what));
        }
        Ok(entries)
    }

    /// The file of a record in the directory; `None` for a folder, and for what macOS adds.
    fn entry(&self, record: &ZipFileHeaderRecord<'_>) -> Result<Option<Entry>> {
        let name = String::from_utf8_lossy(record.file_path().as_bytes()).into_owned();
        let refused = |what: &str| Err(bad(self.path, format!("the entry {name:?} {what}")));
        let path = PathBuf::from(name.replace('\\', "/"));
        let plain = |c: Component<'_>| match c {
            // On Windows a colon leads to a drive or a stream.
            Component::Normal(part) => {
                let part = part.to_string_lossy();
                let colon = cfg!(windows) && part.contains(':');
                !colon && !part.contains('\0')
            }
            Component::CurDir => true,
            _ => false,
        };
        let folder = name.ends_with(['/', '\\']);
        if !path.components().all(plain) || (path.file_name().is_none() && !folder) {
            return refused("leads out of the archive or is no name of a file");
        }
        // Kinds of files on Unix: 0o100000 is a file, 0o040000 a folder.
        if !matches!(record.mode().value() & 0o170_000, 0 | 0o100_000 | 0o040_000) {
            return refused("is a symbolic link or a device; files expected");
        }
        if folder || path.starts_with("__MACOSX") {
            return Ok(None);
        }
        let flags = record.flags();
        if flags.is_encrypted() || flags.has_strong_encryption() || flags.is_masked() {
            return refused("is encrypted");
        }
        let deflated = match record.compression_method() {
            CompressionMethod::STORE => false,
            CompressionMethod::DEFLATE => true,
            other => {
                let what = format!("is compressed by method {other}; deflate or none expected");
                return refused(&what);
            }
        };
        Ok(Some(Entry {
            path,
            deflated,
            size: record.uncompressed_size_hint(),
            place: record.wayfinder(),
            name,
        }))
    }

    /// Writes an entry below a folder.
    fn unpack(&self, entry: &Entry, folder: &Path) -> Result<()> {
        let name = &entry.name;
        let refused = |what: &str| bad(self.path, format!("the entry {name:?} {what}"));
        let unwritten = |e: io::Error| {
            let what = format!(
                "the entry {name:?} cannot be unpacked into {}: {e}",
                folder.display()
            );
            let fix = "make room there, or set TMPDIR to another folder";
            Error::input(self.path, what, fix)
        };
        let found = self.archive.get_entry(entry.place);
        let damaged = |e| unread(self.path, e, |_| format!("the entry {name:?} is damaged"));
        let found = found.map_err(|e| damaged(reading(e)))?;
        let to = folder.join(&entry.path);
        if let Some(parent) = to.parent() {
            fs::create_dir_all(parent).map_err(|e| match e.kind() {
                ErrorKind::AlreadyExists | ErrorKind::NotADirectory => refused("is below a file"),
                _ => unwritten(e),
            })?;
        }
        let out = File::create_new(&to).map_err(|e| match e.kind() {
            ErrorKind::AlreadyExists => refused("is given twice"),
            _ => unwritten(e),
        })?;
        let packed = found.reader();
        let content: Box<dyn Read + '_> = match entry.deflated {
            true => Box::new(DeflateDecoder::new(packed)),
            false => Box::new(packed),
        };
        // A read beyond the size that the archive says is an error, and so is the last one if size or checksum are others.
        let mut content = found.verifying_reader(content);
        let (mut out, mut block) = (BufWriter::new(out), vec![0; 1 << 16]);
        loop {
            let n = content.read(&mut block).map_err(damaged)?;
            if n == 0 {
                break;
            }
            let written = out.write_all(&block[..n]);
            written.map_err(unwritten)?;
        }
        out.flush().map_err(unwritten)
    }
}
