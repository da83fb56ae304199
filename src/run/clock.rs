//! The clocks of a run, and the process figures of `/proc`.
//!
//! All start together. `wall` and `all_cpu` run on, unless the run waits for its user; `train` and `cpu` stop while the run evaluates, exports or, in mid-run, compiles
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

/// Seconds since a mark.
fn elapsed(mark: Mark) -> f64 {
    mark.0.elapsed().as_secs_f64()
}

/// CPU seconds of the process since a mark.
fn used(mark: Mark) -> f64 {
    (process_cpu_seconds() - mark.1).max(0.0)
}

/// The clocks of a run. Start it when the dataset's images begin to be read: loading counts.
#[derive(Debug, Clone)]
pub struct Clock {
    /// Spans that have ended.
    before: Reading,
    /// Beginning of the running span of `wall` and `all_cpu`; none while the run waits for its user.
    all: Option<Mark>,
    /// Beginning of the running span of `train` and `cpu`.
    running: Option<Mark>,
}

impl Clock {
    /// Starts all clocks at zero.
    #[must_use]
    pub fn start() -> Self {
        let mark = now();
        Self {
            before: Reading::default(),
            all: Some(mark),
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

    /// Stops all clocks while the run waits for its user; no effect while they are stopped.
    pub fn stop(&mut self) {
        self.pause();
        self.before.wall_seconds = self.wall_seconds();
        self.before.all_cpu_seconds = self.all_cpu_seconds();
        self.all = None;
    }

    /// Lets all clocks run again; no effect on those that run.
    pub fn resume(&mut self) {
        let mark = now();
        self.all.get_or_insert(mark);
        self.running.get_or_insert(mark);
    }

    /// Seconds spent training. Cheap: reads no file, so a progress bar may ask at every iteration.
    #[must_use]
    pub fn train_seconds(&self) -> f64 {
        self.before.train_seconds + self.running.map_or(0.0, elapsed)
    }

    /// CPU seconds over the span of [`Clock::train_seconds`], to 10 ms per span; 0 if the system does not report it.
    #[must_use]
    pub fn cpu_seconds(&self) -> f64 {
        self.before.cpu_seconds + self.running.map_or(0.0, used)
    }

    /// Seconds since the start, without those in which the run waited for its user.
    #[must_use]
    pub fn wall_seconds(&self) -> f64 {
        self.before.wall_seconds + self.all.map_or(0.0, elapsed)
    }

    /// CPU seconds of the process over the span of [`Clock::wall_seconds`]; 0 if the system does not report it.
    #[must_use]
    pub fn all_cpu_seconds(&self) -> f64 {
        self.before.all_cpu_seconds + self.all.map_or(0.0, used)
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
