//! Records of a model's files in both forms: binary (little endian) and text.

use std::borrow::Cow;
use std::fmt::Display;
use std::io::Write as _;
use std::path::Path;
use std::str::FromStr;

use crate::base::error::{Error, Result};
use crate::base::files;

/// Fix in the messages about damaged model files.
pub(super) const REBUILD: &str = "export the COLMAP model again";

/// A bounds-checked reader of the fields of a record.
pub(super) struct Fields<'a> {
    /// The file, for messages.
    pub path: &'a Path,
    /// True in a binary file.
    pub binary: bool,
    /// The rest of a binary file or of a line of text.
    rest: &'a [u8],
    /// Bytes of the file.
    length: usize,
    /// "camera 3 of 5" or "line 7", for messages.
    place: String,
}

/// True if the line after the first image of a text file is no image's: then a line of observations, empty or not, follows every image.
/// Some programs write none.
pub(super) fn has_observations(after_first: &str) -> bool {
    let words: Vec<&str> = after_first.split_ascii_whitespace().collect();
    let numbers = |words: &[&str]| words.iter().all(|word| word.parse::<f64>().is_ok());
    let id = |k: usize| words[k].parse::<u32>().is_ok();
    // X, Y and POINT3D_ID of each, where a name may look like numbers, too.
    let observations = words.len().is_multiple_of(3) && numbers(&words);
    let image = words.len() > 9 && id(0) && numbers(&words[1..8]) && id(8);
    observations || !image
}

/// All records of a file. `what` names one of them, `least` is the smallest size of a binary one in bytes; `paired` records of
/// text files are followed by a line of observations each, which is skipped, if [the first](has_observations) is.
///
/// # Errors
/// A missing, truncated or overlong file, and what `read` refuses.
pub(super) fn records<T>(
    path: &Path,
    binary: bool,
    (what, least, paired): (&str, usize, bool),
    read: fn(&mut Fields<'_>) -> Result<T>,
) -> Result<Vec<T>> {
    let bytes = match binary {
        true => files::read(path)?,
        false => files::read_text(path)?,
    };
    let bad = |what: String| Error::input(path, what, REBUILD);
    let mut fields = Fields {
        path,
        binary,
        rest: &bytes,
        length: bytes.len(),
        place: "the count".into(),
    };
    let mut records = Vec::new();
    if binary {
        let count = fields.number("", u64::from_le_bytes)?;
        let left = fields.rest.len();
        // Refused before anything is allocated.
        if count > (left / least) as u64 {
            return Err(bad(format!(
                "{count} records ({what}) are announced, but {left} bytes hold at most {}",
                left / least
            )));
        }
        for i in 0..count {
            fields.place = format!("{what} {i} of {count}");
            records.push(read(&mut fields)?);
        }
        if !fields.rest.is_empty() {
            let left = fields.rest.len();
            return Err(bad(format!("{left} bytes follow after the last {what}")));
        }
        return Ok(records);
    }
    let text = std::str::from_utf8(&bytes).map_err(|_| bad("not UTF-8 text".into()))?;
    let mut lines = text.lines().enumerate().peekable();
    let mut skips = None;
    while let Some((i, line)) = lines.next() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        fields.rest = line.as_bytes();
        fields.place = format!("line {}", i + 1);
        records.push(read(&mut fields)?);
        let mut after = || lines.peek().is_none_or(|(_, line)| has_observations(line));
        if paired && *skips.get_or_insert_with(&mut after) {
            lines.next();
        }
    }
    Ok(records)
}

impl<'a> Fields<'a> {
    fn bad(&self, what: &str) -> Error {
        Error::input(self.path, format!("{}: {what}", self.place), REBUILD)
    }

    fn truncated(&self, needed: u64) -> Error {
        let (place, left) = (&self.place, self.rest.len());
        let at = self.length - left;
        let what = format!(
            "the file ends within {place}: {needed} bytes expected at offset {at}, {left} left"
        );
        Error::input(self.path, what, REBUILD)
    }

    /// The next word of a line.
    pub(super) fn word(&mut self, what: &str) -> Result<Cow<'a, str>> {
        let line = self.rest.trim_ascii_start();
        let end = line.iter().position(u8::is_ascii_whitespace);
        let (word, rest) = line.split_at(end.unwrap_or(line.len()));
        if word.is_empty() {
            return Err(self.bad(&format!("{what} is missing")));
        }
        self.rest = rest;
        Ok(String::from_utf8_lossy(word))
    }

    /// The next number; `what` is its name in text files, `from` reads it in binary ones.
    pub(super) fn number<T: FromStr, const K: usize>(
        &mut self,
        what: &str,
        from: fn([u8; K]) -> T,
    ) -> Result<T> {
        if !self.binary {
            let word = self.word(what)?;
            let number = word.parse();
            return number.map_err(|_| self.bad(&format!("{what} is '{word}'; a number expected")));
        }
        let Some((bytes, rest)) = self.rest.split_first_chunk() else {
            return Err(self.truncated(K as u64));
        };
        self.rest = rest;
        Ok(from(*bytes))
    }

    /// The next `N` numbers.
    pub(super) fn array<T: FromStr + Copy + Default, const K: usize, const N: usize>(
        &mut self,
        what: [&str; N],
        from: fn([u8; K]) -> T,
    ) -> Result<[T; N]> {
        let mut out = [T::default(); N];
        for (v, what) in out.iter_mut().zip(what) {
            *v = self.number(what, from)?;
        }
        Ok(out)
    }

    /// A camera's parameters: `count`, or as many as a line has, which may be one more.
    pub(super) fn params(&mut self, count: usize) -> Result<Vec<f64>> {
        let words = self.rest.split(u8::is_ascii_whitespace);
        let count = if self.binary {
            count
        } else {
            words.filter(|w| !w.is_empty()).count().min(count + 1)
        };
        (0..count)
            .map(|_| self.number("PARAMS", f64::from_le_bytes))
            .collect()
    }

    /// A name: up to a zero byte, or the rest of the line, which may hold spaces.
    pub(super) fn name(&mut self) -> Result<String> {
        let (name, rest) = if self.binary {
            let end = self.rest.iter().position(|b| *b == 0);
            let end = end.ok_or_else(|| self.truncated(self.rest.len() as u64 + 1))?;
            (&self.rest[..end], &self.rest[end + 1..])
        } else {
            (self.rest.trim_ascii(), &[][..])
        };
        if name.is_empty() && !self.binary {
            return Err(self.bad("the NAME is missing"));
        }
        let Ok(name) = std::str::from_utf8(name) else {
            let what = format!("the name of {} is not UTF-8", self.place);
            return Err(Error::input(self.path, what, "rename the photo"));
        };
        self.rest = rest;
        Ok(name.to_owned())
    }

    /// Skips a count and that many entries of `size` bytes in a binary file.
    pub(super) fn skip_list(&mut self, size: u64) -> Result<()> {
        if self.binary {
            let count = self.number("", u64::from_le_bytes)?;
            let length = count.saturating_mul(size);
            if length > self.rest.len() as u64 {
                return Err(self.truncated(length));
            }
            self.rest = &self.rest[length as usize..];
        }
        Ok(())
    }
}

/// The contents of a file that is being written.
pub(super) struct Output {
    /// True for a binary file.
    pub binary: bool,
    /// The contents so far.
    pub bytes: Vec<u8>,
}

impl Output {
    /// The beginning of a file of `count` records; a text file's is a comment on its columns.
    pub(super) fn new(binary: bool, count: usize, comment: &str) -> Self {
        let bytes = if binary {
            (count as u64).to_le_bytes().to_vec()
        } else {
            comment.as_bytes().to_vec()
        };
        Self { binary, bytes }
    }

    /// Adds numbers; `to` gives the bytes of one in a binary file. A text has as many digits as it takes to read the same bits
    /// back.
    pub(super) fn numbers<T: Display + Copy, const K: usize>(
        &mut self,
        values: &[T],
        to: fn(T) -> [u8; K],
    ) {
        for v in values {
            if self.binary {
                self.bytes.extend(to(*v));
            } else {
                let _ = write!(self.bytes, "{v} ");
            }
        }
    }

    /// Adds a name.
    pub(super) fn name(&mut self, name: &str) {
        self.bytes.extend(name.as_bytes());
        self.bytes.push(if self.binary { 0 } else { b' ' });
    }

    /// Ends a record in either form.
    pub(super) fn end(&mut self, binary: &[u8], text: &str) {
        if self.binary {
            self.bytes.extend(binary);
        } else {
            self.bytes.pop();
            self.bytes.extend(text.as_bytes());
        }
    }
}
