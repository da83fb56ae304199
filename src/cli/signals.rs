//! Signals that end a command in order.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use mhsplat::base::error::{Error, Result};

/// Returns a flag that Ctrl-C, SIGTERM or the end of the session (SIGHUP, unless `nohup` ignores it) sets; a Ctrl-C or SIGTERM after
/// that ends the program at once.
pub fn stop_flag() -> Result<Arc<AtomicBool>> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    let stop = Arc::new(AtomicBool::new(false));
    let fail = |e| Error::io("signal handler", e);
    let signals = [SIGINT, SIGTERM, SIGHUP].into_iter();
    for signal in signals.filter(|signal| *signal != SIGHUP || !ignored(SIGHUP)) {
        // A shell and the kernel both send SIGHUP when a session ends: two of them are no impatience.
        if signal != SIGHUP {
            signal_hook::flag::register_conditional_shutdown(signal, 130, stop.clone())
                .map_err(fail)?;
        }
        signal_hook::flag::register(signal, stop.clone()).map_err(fail)?;
    }
    Ok(stop)
}

/// Returns true if the program was started with a signal ignored.
fn ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|l| l.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|m| u64::from_str_radix(m.trim(), 16).ok());
    mask.is_some_and(|m| m >> (signal - 1) & 1 == 1)
}
