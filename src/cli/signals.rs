//! Signals that end a command in order.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

use mhsplat::base::error::{Error, Result};
use mhsplat::capture;

/// Time within which a second signal is no impatience: `timeout` and launchers signal a process, and then its group with it.
const ONE_WISH: Duration = Duration::from_millis(500);

/// Returns a flag that Ctrl-C, SIGTERM or the end of the session (SIGHUP, unless `nohup` ignores it) sets; a Ctrl-C or SIGTERM half a
/// second after that ends the program at once.
pub fn stop_flag() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    let mut first = None;
    // A shell and the kernel both send SIGHUP when a session ends: two of them are no impatience.
    listen(move |signal| {
        flag.store(true, Ordering::SeqCst);
        let first: &mut Instant = first.get_or_insert_with(Instant::now);
        signal != SIGHUP && first.elapsed() > ONE_WISH
    })?;
    Ok(stop)
}

/// Lets the same signals end the program at once, without the folder that an archive is unpacked into; nothing changes for another dataset.
pub fn remove_unpacked_at_end(dataset: &Path) -> Result<()> {
    match capture::is_archive(dataset) {
        true => remove_temporary_at_end(),
        false => Ok(()),
    }
}

/// Lets the same signals end the program at once, without its temporary folders.
pub fn remove_temporary_at_end() -> Result<()> {
    listen(|_| true)
}

/// Ends the program, without its temporary folders, at the first signal for which `ends` returns true.
fn listen(ends: impl FnMut(i32) -> bool + Send + 'static) -> Result<()> {
    let mut signals = Signals::new(handled()).map_err(failed)?;
    let wait = move || {
        if signals.forever().any(ends) {
            capture::remove_temporary();
            signal_hook::low_level::exit(130);
        }
    };
    let thread = std::thread::Builder::new().spawn(wait);
    thread.map(drop).map_err(failed)
}

/// The signals that end a command.
fn handled() -> impl Iterator<Item = i32> {
    let signals = [SIGINT, SIGTERM, SIGHUP].into_iter();
    signals.filter(|signal| *signal != SIGHUP || !ignored(SIGHUP))
}

fn failed(error: std::io::Error) -> Error {
    Error::io("signal handler", error)
}

/// Returns true if the program was started with a signal ignored.
fn ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|l| l.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|m| u64::from_str_radix(m.trim(), 16).ok());
    mask.is_some_and(|m| m >> (signal - 1) & 1 == 1)
}
