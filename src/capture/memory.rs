//! Memory that photos may take.

use crate::base::error::{Error, Result};
use std::path::Path;

/// Bytes that photos may take if the system does not report its memory.
const UNKNOWN_MEMORY: u64 = 4 << 30;

/// Bytes that one photo may take when it is decoded, however little memory is available.
const LEAST_DECODED: u64 = 512 << 20;

/// Bytes that one photo may take when it is decoded: half of the available memory, shared by the threads.
pub(super) fn decoding_limit() -> u64 {
    (automatic_budget() / rayon::current_num_threads() as u64).max(LEAST_DECODED)
}

/// Refuses a photo of which more bytes would be in memory than a thread may take.
///
/// # Errors
/// [`Error::Input`] that names `file`, `part` (of the photo, that has to be in memory) and `fix`.
pub(super) fn check_memory(file: &Path, bytes: u64, part: &str, fix: &str) -> Result<()> {
    let limit = decoding_limit();
    if bytes <= limit {
        return Ok(());
    }
    let what = format!(
        "{part} takes {} MiB, and each thread may take {} MiB of the available memory",
        bytes >> 20,
        limit >> 20
    );
    Err(Error::input(file, what, fix))
}

/// Default budget of photos in bytes: half of the memory that the system reports as available, 4 GiB if it reports none.
pub(super) fn automatic_budget() -> u64 {
    std::fs::read_to_string("/proc/meminfo")
        .ok()
        .and_then(|text| parse_available(&text))
        .map_or(UNKNOWN_MEMORY, |bytes| bytes / 2)
}

/// Bytes of the `MemAvailable` line of `/proc/meminfo` (proc(5)); `None` without such a line.
#[must_use]
pub fn parse_available(text: &str) -> Option<u64> {
    let line = text.lines().find_map(|l| l.strip_prefix("MemAvailable:"))?;
    let kib: u64 = line.split_ascii_whitespace().next()?.parse().ok()?;
    kib.checked_mul(1024)
}
