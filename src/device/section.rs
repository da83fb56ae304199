//! [`Section`]: a part of an array as 32-bit words. Several sections are read or written with one wait: on a CPU a wait takes as long as copying some
//! 100 kB, because threads go to sleep and are woken.

use std::sync::Arc;

use ocl_core::{self as core, Event, Mem};

use crate::base::error::{Error, Result};
use crate::device::context::Inner;
use crate::device::error::{BUG, LOST, device_error};

/// A part of an array, of whole 32-bit words.
#[derive(Debug, Clone, Copy)]
pub struct Section<'a> {
    pub(super) device: &'a Arc<Inner>,
    pub(super) mem: &'a Mem,
    pub(super) name: &'static str,
    /// First word.
    pub(super) first: usize,
    /// Words.
    pub(super) len: usize,
}

impl Section<'_> {
    /// Number of words.
    #[must_use]
    pub fn len(&self) -> usize {
        self.len
    }

    /// True if there is no word.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Waits for transfers that are under way, of which one has failed to begin.
    fn failed(&self, what: &str, error: &core::Error) -> Error {
        // The memory of those must not go before they have ended.
        let _ = core::finish(&self.device.queue());
        device_error(&format!("{what} {}", self.name), error, LOST)
    }
}

/// Reads sections, one after the other, into `words` from word `at` on, after everything enqueued so far; with them it ends. Words that are there
/// already are written over, which is faster than to make room anew. All sections are of arrays of one device.
///
/// # Errors
/// The driver's.
pub fn read_sections(sections: &[Section<'_>], at: usize, words: &mut Vec<u32>) -> Result<()> {
    words.resize(at + sections.iter().map(Section::len).sum::<usize>(), 0);
    let mut rest = &mut words[at..];
    let last = sections.iter().rposition(|section| !section.is_empty());
    for (k, section) in sections.iter().enumerate() {
        let (part, others) = rest.split_at_mut(section.len);
        rest = others;
        if part.is_empty() {
            continue;
        }
        // SAFETY: the last read, or after an error the end of the queue, which is in order, is waited for while `words` is borrowed; any bits
        // are a word.
        unsafe {
            core::enqueue_read_buffer(
                &section.device.queue(),
                section.mem,
                Some(k) == last,
                section.first,
                part,
                None::<&Event>,
                None::<&mut Event>,
            )
        }
        .map_err(|e| section.failed("read", &e))?;
    }
    Ok(())
}

/// Writes words to sections, and waits until the words may be reused. All are of arrays of one device.
///
/// # Errors
/// Another number of words than a section has, or the driver's.
pub fn write_sections(parts: &[(Section<'_>, &[u32])]) -> Result<()> {
    for (section, words) in parts {
        if words.len() != section.len {
            let what = format!("{} words for a section of {}", words.len(), section.len);
            return Err(Error::device(section.name, what, BUG));
        }
    }
    let last = parts.iter().rposition(|(section, _)| !section.is_empty());
    for (k, (section, words)) in parts.iter().enumerate() {
        if words.is_empty() {
            continue;
        }
        // SAFETY: the last write, or after an error the end of the queue, which is in order, is waited for while the words are borrowed; any
        // bits are a value.
        unsafe {
            core::enqueue_write_buffer(
                &section.device.queue(),
                section.mem,
                Some(k) == last,
                section.first,
                words,
                None::<&Event>,
                None::<&mut Event>,
            )
        }
        .map_err(|e| section.failed("write", &e))?;
    }
    Ok(())
}
