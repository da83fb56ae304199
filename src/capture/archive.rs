//! Datasets in zip archives, which are unpacked into a folder for as long as their photos are read.
//!
//! Format: PKWARE's APPNOTE.TXT 6.3.10, sections 4.3 to 4.5, with Zip64; entries are stored or deflated. An archive comes from somewhere
//! else: nothing of it is written outside of the folder, or is more than its directory says.

use std::fs::{self, File};
use std::io::{self, BufReader, BufWriter, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Component, Path, PathBuf};

use flate2::read::DeflateDecoder;

use crate::base::error::{Error, Result};
use crate::base::files::check_regular;

/// Remedy for an archive that cannot be read.
const PACK: &str = "pack it again as a plain zip archive, or unpack it and give the folder";

/// Bytes of the record at the end, and the longest comment after it.
const END: usize = 22;
const COMMENT: u64 = 0xffff;
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

/// The folder with the content of an archive, removed when this is dropped.
#[derive(Debug)]
pub(super) struct Unpacked {
    archive: PathBuf,
    /// The folder.
    pub folder: PathBuf,
}

impl Drop for Unpacked {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.folder);
    }
}

impl Unpacked {
    /// The archive at `archive`, unpacked into a new folder of the system's folder for temporary files.
    ///
    /// # Errors
    /// [`Error::Input`] that names the archive and the entry: no archive or a damaged one, an entry that is encrypted, a link, of another
    /// method, given twice or leads out of the folder, content out of proportion; [`Error::Io`].
    pub fn new(archive: &Path) -> Result<Self> {
        check_regular(archive)?;
        let entries = Reader::open(archive)?.entries()?;
        let mut key = [0; 8];
        getrandom::fill(&mut key).map_err(|e| Error::io(archive, io::Error::other(e)))?;
        let key = u64::from_le_bytes(key);
        let folder = std::env::temp_dir().join(format!("mhsplat-{key:016x}"));
        let mut options = fs::DirBuilder::new();
        #[cfg(unix)]
        std::os::unix::fs::DirBuilderExt::mode(&mut options, 0o700);
        options.create(&folder).map_err(|e| Error::io(&folder, e))?;
        // From here on it is removed after a failure, too.
        let unpacked = Self {
            archive: archive.to_path_buf(),
            folder,
        };
        let mut reader = Reader::open(archive)?;
        for entry in &entries {
            reader.unpack(entry, &unpacked.folder)?;
        }
        Ok(unpacked)
    }

    /// The same error about the archive instead of the folder, which is gone when it is read.
    pub fn explained(&self, error: Error) -> Error {
        let [folder, archive] = [&self.folder, &self.archive].map(|p| p.display().to_string());
        let named = |path: PathBuf| match path.strip_prefix(&self.folder) {
            Ok(below) if below.as_os_str().is_empty() => self.archive.clone(),
            Ok(below) => self.archive.join(below),
            Err(_) => path,
        };
        let said = |text: String| text.replace(&folder, &archive);
        match error {
            Error::Input { path, what, fix } => Error::Input {
                path: named(path),
                what: said(what),
                fix: said(fix),
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
    sum: u32,
    packed: u64,
    size: u64,
    offset: u64,
}

/// Little-endian numbers of a record that is as long as it must be; 0 beyond its end.
fn number(bytes: &[u8], at: usize, length: usize) -> u64 {
    let bytes = bytes.iter().skip(at).take(length);
    bytes.rev().fold(0, |sum, byte| sum << 8 | u64::from(*byte))
}

/// An archive that is read.
struct Reader<'a> {
    path: &'a Path,
    file: BufReader<File>,
    length: u64,
}

impl<'a> Reader<'a> {
    fn open(path: &'a Path) -> Result<Self> {
        let file = File::open(path).map_err(|e| Error::io(path, e))?;
        let length = file.metadata().map_err(|e| Error::io(path, e))?.len();
        let file = BufReader::new(file);
        Ok(Self { path, file, length })
    }

    fn bad(&self, what: impl Into<String>) -> Error {
        Error::input(self.path, what, PACK)
    }

    /// `length` bytes at an offset; what is to be read there is named in the error if the file ends before.
    fn bytes(&mut self, offset: u64, length: u64, of: &str) -> Result<Vec<u8>> {
        if offset
            .checked_add(length)
            .is_none_or(|end| end > self.length)
        {
            return Err(self.bad(format!(
                "the archive is cut off or damaged: {of} is not in it"
            )));
        }
        let mut bytes = vec![0; length as usize];
        let found = self.file.seek(SeekFrom::Start(offset));
        let found = found.and_then(|_| self.file.read_exact(&mut bytes));
        found.map_err(|e| Error::io(self.path, e))?;
        Ok(bytes)
    }

    /// Offset, length and number of entries of the directory.
    fn directory(&mut self) -> Result<[u64; 3]> {
        let start = self.length.saturating_sub(END as u64 + COMMENT);
        let tail = self.bytes(start, self.length - start, "its end")?;
        let is_end = |at: &usize| {
            let comment = number(&tail, at + 20, 2) as usize;
            tail[*at..].starts_with(b"PK\x05\x06") && at + END + comment <= tail.len()
        };
        let last = (0..(tail.len() + 1).saturating_sub(END)).rev().find(is_end);
        let Some(at) = last else {
            return Err(
                self.bad("no zip archive, or one that is cut off: its directory is not at its end")
            );
        };
        let end = &tail[at..];
        let [disk, disks] = [4, 6].map(|at| number(end, at, 2));
        let found = [number(end, 16, 4), number(end, 12, 4), number(end, 10, 2)];
        let locator = (start + at as u64).checked_sub(20);
        if let Some(locator) = locator
            && let locator = self.bytes(locator, 20, "the locator of its directory")?
            && locator.starts_with(b"PK\x06\x07")
        {
            let end = self.bytes(number(&locator, 8, 8), 56, "the Zip64 end of its directory")?;
            if !end.starts_with(b"PK\x06\x06") {
                return Err(self.bad("the Zip64 end of its directory is damaged"));
            }
            return Ok([48, 40, 32].map(|at| number(&end, at, 8)));
        }
        match disk == 0 && disks == 0 {
            true => Ok(found),
            false => Err(self.bad("one of the parts of a divided archive")),
        }
    }

    /// The files in the archive.
    fn entries(mut self) -> Result<Vec<Entry>> {
        let [offset, length, count] = self.directory()?;
        if length > DIRECTORY {
            let what = format!("a directory of {} MiB", length >> 20);
            return Err(self.bad(format!("{what}; at most {} expected", DIRECTORY >> 20)));
        }
        let directory = self.bytes(offset, length, "its directory")?;
        let (mut rest, mut entries) = (&directory[..], Vec::new());
        let mut found = 0;
        while !rest.is_empty() {
            let [name, extra, comment] = [28, 30, 32].map(|at| number(rest, at, 2) as usize);
            let whole = 46 + name + extra + comment;
            if !rest.starts_with(b"PK\x01\x02") || rest.len() < whole {
                return Err(self.bad(format!("entry {} of its directory is damaged", found + 1)));
            }
            let (header, beyond) = rest.split_at(whole);
            rest = beyond;
            found += 1;
            entries.extend(self.entry(header, [name, extra])?);
        }
        if found != count {
            return Err(self.bad(format!("{found} entries, but its directory counts {count}")));
        }
        let total = entries
            .iter()
            .fold(0_u64, |sum, e| sum.saturating_add(e.size));
        if total > SPARE.saturating_add(LARGEST.saturating_mul(self.length)) {
            return Err(self.bad(format!(
                "{} MiB when it is unpacked, more than {LARGEST} times its size: no archive of photos",
                total >> 20
            )));
        }
        Ok(entries)
    }

    /// The file of a header in the directory, with the lengths of its name and its extra fields; `None` for a folder, and for what macOS
    /// adds.
    fn entry(&self, header: &[u8], [name, extra]: [usize; 2]) -> Result<Option<Entry>> {
        let extra = &header[46 + name..][..extra];
        let name = String::from_utf8_lossy(&header[46..46 + name]).into_owned();
        let bad = |what: &str| Err(self.bad(format!("the entry {name:?} {what}")));
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
        if !path.components().all(plain) || path.file_name().is_none() {
            return bad("leads out of the archive or is no name of a file");
        }
        // Made on Unix, the file's mode is in the upper half; 0o120000 is a symbolic link, 0o100000 a file.
        let unix = number(header, 5, 1) == 3;
        let kind = (number(header, 38, 4) >> 16) & 0o170_000;
        if unix && !matches!(kind, 0 | 0o100_000 | 0o040_000) {
            return bad("is a symbolic link or a device; files expected");
        }
        if name.ends_with(['/', '\\']) || path.starts_with("__MACOSX") {
            return Ok(None);
        }
        let flags = number(header, 8, 2);
        if flags & 0x2041 != 0 {
            return bad("is encrypted");
        }
        let deflated = match number(header, 10, 2) {
            0 => false,
            8 => true,
            other => {
                let what = format!("is compressed by method {other}; deflate (8) or none expected");
                return bad(&what);
            }
        };
        let mut sizes = [24, 20, 42].map(|at| number(header, at, 4));
        let mut long = zip64(extra);
        for size in sizes.iter_mut().filter(|s| **s == 0xffff_ffff) {
            let Some((first, rest)) = long.split_at_checked(8) else {
                return bad("lacks its Zip64 sizes");
            };
            (*size, long) = (number(first, 0, 8), rest);
        }
        let [size, packed, offset] = sizes;
        Ok(Some(Entry {
            name,
            path,
            deflated,
            sum: number(header, 16, 4) as u32,
            packed,
            size,
            offset,
        }))
    }

    /// Writes an entry below a folder.
    fn unpack(&mut self, entry: &Entry, folder: &Path) -> Result<()> {
        let name = &entry.name;
        let archive = self.path;
        let bad = |what: &str| Error::input(archive, format!("the entry {name:?} {what}"), PACK);
        let (damaged, twice) = (bad("is damaged"), bad("is given twice"));
        let unwritten = |e: io::Error| {
            let what = format!(
                "the entry {name:?} cannot be unpacked into {}: {e}",
                folder.display()
            );
            Error::input(
                archive,
                what,
                "make room there, or set TMPDIR to another folder",
            )
        };
        let header = self.bytes(entry.offset, 30, name)?;
        if !header.starts_with(b"PK\x03\x04") {
            return Err(damaged);
        }
        let start = entry.offset + 30 + number(&header, 26, 2) + number(&header, 28, 2);
        if start
            .checked_add(entry.packed)
            .is_none_or(|end| end > self.length)
        {
            return Err(damaged);
        }
        let to = folder.join(&entry.path);
        if let Some(parent) = to.parent() {
            fs::create_dir_all(parent).map_err(|e| match e.kind() {
                ErrorKind::AlreadyExists | ErrorKind::NotADirectory => bad("is below a file"),
                _ => unwritten(e),
            })?;
        }
        let out = File::create_new(&to).map_err(|e| match e.kind() {
            ErrorKind::AlreadyExists => twice,
            _ => unwritten(e),
        })?;
        let seek = self.file.seek(SeekFrom::Start(start));
        seek.map_err(|e| Error::io(self.path, e))?;
        let packed = (&mut self.file).take(entry.packed);
        let mut content: Box<dyn Read + '_> = match entry.deflated {
            true => Box::new(DeflateDecoder::new(packed)),
            false => Box::new(packed),
        };
        let (mut out, mut sum) = (BufWriter::new(out), crc32fast::Hasher::new());
        let (mut left, mut block) = (entry.size, vec![0; 1 << 16]);
        loop {
            let n = content.read(&mut block).map_err(|_| bad("is damaged"))?;
            let Some(after) = left.checked_sub(n as u64) else {
                return Err(bad("is larger than the archive says"));
            };
            if n == 0 {
                break;
            }
            left = after;
            sum.update(&block[..n]);
            let written = out.write_all(&block[..n]);
            written.map_err(unwritten)?;
        }
        out.flush().map_err(unwritten)?;
        match left == 0 && sum.finalize() == entry.sum {
            true => Ok(()),
            false => Err(damaged),
        }
    }
}

/// The Zip64 field among extra fields; empty if there is none.
fn zip64(mut extra: &[u8]) -> &[u8] {
    while extra.len() >= 4 {
        let (header, rest) = extra.split_at(4);
        let length = (number(header, 2, 2) as usize).min(rest.len());
        let (content, beyond) = rest.split_at(length);
        if number(header, 0, 2) == 1 {
            return content;
        }
        extra = beyond;
    }
    &[]
}
