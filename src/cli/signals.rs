//! Signals that end a command in order.

use std::process::{Child, Command};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use nix::sys::signal::{SigSet, Signal};

use mhsplat::base::error::{Error, Result};
use mhsplat::capture;

/// Time within which a second signal is no impatience: `timeout` and launchers signal a process, and then its group with it.
const ONE_WISH: Duration = Duration::from_millis(500);

/// The flag that the first signal sets, where a command has asked for one.
static STOP: OnceLock<Arc<AtomicBool>> = OnceLock::new();

/// Has one thread wait for Ctrl-C, SIGTERM and the end of the session (SIGHUP, unless `nohup` ignores it), before any other thread begins: they
/// take none of these, nor does this one. Compilers of drivers set handlers over those that there are, after which a second signal would end
/// the process. The first signal ends the program, without its temporary folders, or sets the flag of a command that
/// [has one](stop_flag); then a Ctrl-C or SIGTERM half a second later ends it.
pub fn begin() -> Result<()> {
    let failed = |error| {
        let fix = "raise the limit on processes (ulimit -u, or the container's)";
        Error::device("threads", format!("none can be made ({error})"), fix)
    };
    let signals: SigSet = handled().collect();
    signals
        .thread_block()
        .map_err(|e| Error::io("signals", e.into()))?;
    let thread = std::thread::Builder::new().spawn(move || wait(&signals));
    thread.map(drop).map_err(failed)
}

/// Waits for signals until one ends the program.
fn wait(signals: &SigSet) {
    let mut first = None;
    // A shell and the kernel both send SIGHUP when a session ends: two of them are no impatience.
    let mut ends = |signal: Signal, stop: &AtomicBool| {
        stop.store(true, Ordering::SeqCst);
        let first: &mut Instant = first.get_or_insert_with(Instant::now);
        signal != Signal::SIGHUP && first.elapsed() > ONE_WISH
    };
    loop {
        let signal = signals.wait();
        if signal.is_ok_and(|signal| STOP.get().is_none_or(|stop| ends(signal, stop))) {
            capture::remove_temporary();
            signal_hook::low_level::exit(130);
        }
    }
}

/// Spawns a process that takes signals: it has those blocked that the thread has which spawns it.
pub fn spawn(command: &mut Command) -> std::io::Result<Child> {
    let signals: SigSet = handled().collect();
    signals.thread_unblock()?;
    let child = command.spawn();
    signals.thread_block()?;
    child
}

/// Returns the flag that the first signal sets from now on, in place of ending the program.
pub fn stop_flag() -> Arc<AtomicBool> {
    STOP.get_or_init(Arc::default).clone()
}

/// The signals that end a command.
fn handled() -> impl Iterator<Item = Signal> {
    let signals = [Signal::SIGINT, Signal::SIGTERM, Signal::SIGHUP].into_iter();
    signals.filter(|signal| *signal != Signal::SIGHUP || !ignored(Signal::SIGHUP))
}

/// Returns true if the program was started with a signal ignored.
fn ignored(signal: Signal) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|l| l.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|m| u64::from_str_radix(m.trim(), 16).ok());
    mask.is_some_and(|m| m >> (signal as i32 - 1) & 1 == 1)
}
