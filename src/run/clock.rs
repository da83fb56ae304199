//! The clocks of a run.
//!
//! All start together. `wall` and `all_cpu` run on, unless the run waits for its user or for a device that is used for the first time; `train` and `cpu` stop while the run evaluates, exports or, in mid-run, compiles
//! kernels, so that both cover the same span. On shared machines `cpu` is the one to compare by.

use std::time::Instant;

use crate::base::process::process_cpu_seconds;

/// A reading of the clocks, in seconds.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Reading {
    /// Time spent training: evaluation and export left out.
    pub train_seconds: f64,
    /// Time since the start.
    pub wall_seconds: f64,
    /// CPU time of all its processes over the span of `train_seconds`; 0 if the system does not report it.
    pub cpu_seconds: f64,
    /// CPU time of all its processes since the start; 0 as before.
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
    /// CPU seconds of the run's other processes that are counted.
    elsewhere: f64,
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
            elsewhere: 0.0,
        }
    }

    /// Counts the CPU time of the run's other processes, which is `seconds` in all so far; they work while the run trains.
    pub fn note_elsewhere(&mut self, seconds: f64) {
        let more = (seconds - self.elsewhere).max(0.0);
        self.before.cpu_seconds += more;
        self.before.all_cpu_seconds += more;
        self.elsewhere += more;
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

    /// Stops all clocks while the run waits for its user or its device; no effect while they are stopped.
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
