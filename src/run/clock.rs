//! The clocks of a run, and the process figures of `/proc`.
//!
//! All start together. `wall` and `all_cpu` run on; `train` and `cpu` stop while the run evaluates, exports or, in mid-run, compiles
//! kernels, so that both cover the same span. On shared machines `cpu` is the one to compare by.

use std::time::Instant;

/// Clock ticks per second of `/proc/self/stat`: Linux's `USER_HZ`, which is 100 on every architecture Rust's standard
/// library supports. (Asking `sysconf` would need a dependency on libc.)
const TICKS_PER_SECOND: f64 = 100.0;

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

/// A reading of the clocks, in seconds.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Reading {
    /// Time spent training: evaluation and export left out.
    pub train_seconds: f64,
    /// Time since the start.
    pub wall_seconds: f64,
    /// CPU time of the process over the span of `train_seconds`; 0 if the system does not report it.
    pub cpu_seconds: f64,
    /// CPU time of the process since the start; 0 as before.
    pub all_cpu_seconds: f64,
}

/// Beginning of the running span: the moment, and the CPU seconds of the process then.
type Mark = (Instant, f64);

fn now() -> Mark {
    (Instant::now(), process_cpu_seconds())
}

/// The clocks of a run. Start it when the dataset's images begin to be read: loading counts.
#[derive(Debug, Clone)]
pub struct Clock {
    start: Mark,
    /// Spans that have ended; of `wall_seconds` and `all_cpu_seconds` those of earlier sessions.
    before: Reading,
    running: Option<Mark>,
}

impl Clock {
    /// Starts all clocks at zero.
    #[must_use]
    pub fn start() -> Self {
        let mark = now();
        Self {
            start: mark,
            before: Reading::default(),
            running: Some(mark),
        }
    }

    /// The clocks of a run that goes on, which show more by what an earlier part of it took (from a checkpoint).
    #[must_use]
    pub fn after(mut self, earlier: Reading) -> Self {
        self.before.train_seconds += earlier.train_seconds;
        self.before.wall_seconds += earlier.wall_seconds;
        self.before.cpu_seconds += earlier.cpu_seconds;
        self.before.all_cpu_seconds += earlier.all_cpu_seconds;
        self
    }

    /// Stops `train` and `cpu`; no effect while they are stopped.
    pub fn pause(&mut self) {
        self.before.train_seconds = self.train_seconds();
        self.before.cpu_seconds = self.cpu_seconds();
        self.running = None;
    }

    /// Lets `train` and `cpu` run again; no effect while they run.
    pub fn resume(&mut self) {
        self.running.get_or_insert_with(now);
    }

    /// Leaves seconds in which the run has waited for its user out of the time since the start.
    pub fn leave_out(&mut self, seconds: f64) {
        self.before.wall_seconds -= seconds;
    }

    /// Seconds spent training. Cheap: reads no file, so a progress bar may ask at every iteration.
    #[must_use]
    pub fn train_seconds(&self) -> f64 {
        let span = self.running.map_or(0.0, |m| m.0.elapsed().as_secs_f64());
        self.before.train_seconds + span
    }

    /// CPU seconds over the span of [`Clock::train_seconds`], to 10 ms per span; 0 if the system does not report it.
    #[must_use]
    pub fn cpu_seconds(&self) -> f64 {
        let span = |m: Mark| (process_cpu_seconds() - m.1).max(0.0);
        self.before.cpu_seconds + self.running.map_or(0.0, span)
    }

    /// Seconds since the start.
    #[must_use]
    pub fn wall_seconds(&self) -> f64 {
        self.before.wall_seconds + self.start.0.elapsed().as_secs_f64()
    }

    /// CPU seconds of the process since the start; 0 if the system does not report it.
    #[must_use]
    pub fn all_cpu_seconds(&self) -> f64 {
        self.before.all_cpu_seconds + (process_cpu_seconds() - self.start.1).max(0.0)
    }

    /// All clocks.
    #[must_use]
    pub fn reading(&self) -> Reading {
        Reading {
            train_seconds: self.train_seconds(),
            wall_seconds: self.wall_seconds(),
            cpu_seconds: self.cpu_seconds(),
            all_cpu_seconds: self.all_cpu_seconds(),
        }
    }
}
