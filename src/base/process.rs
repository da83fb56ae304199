//! Figures of this process, from `/proc`.

/// Clock ticks per second of `/proc/self/stat`: Linux's `USER_HZ`, which is 100 on every architecture Rust's standard
/// library supports. (Asking `sysconf` would need a dependency on libc.)
const TICKS_PER_SECOND: f64 = 100.0;

/// Resolution of [`process_cpu_seconds`], seconds.
pub const CPU_TICK: f64 = 1.0 / TICKS_PER_SECOND;

/// CPU seconds (user + system) of this process so far, over all its threads, ended ones included.
///
/// From fields 14 and 15 of `/proc/self/stat` (proc(5)). The resolution is one tick, 10 ms; the nanosecond figures of
/// `/proc/self/task/*/schedstat` are finer but lose the threads that have ended. 0 without `/proc`.
#[must_use]
pub fn process_cpu_seconds() -> f64 {
    std::fs::read_to_string("/proc/self/stat")
        .ok()
        .and_then(|text| parse_stat(&text))
        .unwrap_or(0.0)
}

/// CPU seconds of one `/proc/*/stat` line; `None` for any other line.
#[must_use]
pub fn parse_stat(text: &str) -> Option<f64> {
    // Field 2 is the program's name in brackets and may itself hold blanks and brackets.
    let (_, rest) = text.rsplit_once(')')?;
    let mut fields = rest.split_ascii_whitespace().skip(11);
    let user: u64 = fields.next()?.parse().ok()?;
    let system: u64 = fields.next()?.parse().ok()?;
    Some(user.saturating_add(system) as f64 / TICKS_PER_SECOND)
}

/// Largest resident set of this process so far in bytes (`VmHWM` of `/proc/self/status`); 0 without `/proc`.
#[must_use]
pub fn peak_rss_bytes() -> u64 {
    std::fs::read_to_string("/proc/self/status")
        .ok()
        .and_then(|text| parse_peak(&text))
        .unwrap_or(0)
}

/// Bytes of the `VmHWM` line of `/proc/*/status`; `None` without such a line.
#[must_use]
pub fn parse_peak(text: &str) -> Option<u64> {
    let line = text.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.split_ascii_whitespace().next()?.parse().ok()?;
    kib.checked_mul(1024)
}
