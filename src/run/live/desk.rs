//! The desk between the connections, which ask, and the thread that has the device, which answers when it has the time.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, SyncSender};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

use serde::Serialize;

use crate::run::live::ask::Ask;
use crate::run::live::curves::{Curves, Points};
use crate::run::live::http::Answer;
use crate::run::live::studio::{Reply, Scenery, reply};
use crate::run::progress::Progress;

/// Largest number of questions that wait.
const MOST: usize = 16;

/// Longest time that a question waits: training compiles kernels and evaluates in between.
const PATIENCE: Duration = Duration::from_secs(60);

/// A question, and the way back to who asked it.
struct Job {
    ask: Ask,
    to: SyncSender<Result<Reply, String>>,
    /// Gone once nobody waits any more.
    waits: Weak<()>,
}

impl Job {
    fn is_waited_for(&self) -> bool {
        self.waits.strong_count() > 0
    }
}

/// State of a run and its curves, as far as they have been told.
#[derive(Debug, Default)]
pub(super) struct Told {
    pub progress: Progress,
    /// Iterations that the checkpoint has.
    pub saved: Option<u32>,
    /// True once training is done, and what comes after it is not.
    pub ending: bool,
    pub curves: Curves,
}

/// The answer to a question about the run.
#[derive(Serialize)]
struct Status<'a> {
    state: &'static str,
    #[serde(flatten)]
    progress: &'a Progress,
    saved: Option<u32>,
    loss: Option<f64>,
    points: Points<'a>,
}

/// Questions, wishes, and what is known of the run.
#[derive(Default)]
pub(super) struct Desk {
    jobs: Mutex<VecDeque<Job>>,
    came: Condvar,
    closed: AtomicBool,
    paused: AtomicBool,
    save: AtomicBool,
    stop: AtomicBool,
    told: Mutex<Told>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The side of the connections.
impl Desk {
    /// Asks, and waits for the reply.
    pub fn ask(&self, ask: Ask) -> Result<Reply, Answer> {
        let (to, back) = mpsc::sync_channel(1);
        let here = Arc::new(());
        {
            let mut jobs = lock(&self.jobs);
            if self.closed.load(Ordering::Relaxed) {
                return Err(Answer::words(503, "the program is ending"));
            }
            jobs.retain(Job::is_waited_for);
            if jobs.len() >= MOST {
                return Err(Answer::words(503, "too many pictures are waited for"));
            }
            let waits = Arc::downgrade(&here);
            jobs.push_back(Job { ask, to, waits });
        }
        self.came.notify_all();
        match back.recv_timeout(PATIENCE) {
            Ok(Ok(reply)) => Ok(reply),
            Ok(Err(what)) => Err(Answer::words(409, &what)),
            Err(_) => Err(Answer::words(503, "no picture can be made now")),
        }
    }

    /// State and curves as JSON, these after an iteration.
    pub fn status(&self, since: Option<u32>) -> Option<Vec<u8>> {
        let told = lock(&self.told);
        let state = match () {
            () if self.stops() => "stopping",
            () if told.ending => "ending",
            () if self.paused() => "paused",
            () => "training",
        };
        let status = Status {
            state,
            progress: &told.progress,
            saved: told.saved,
            loss: told.curves.loss.last(),
            points: told.curves.since(since),
        };
        serde_json::to_vec(&status).ok()
    }

    /// Takes a wish; false if there is none of that name.
    pub fn wish(&self, name: &str) -> bool {
        match name {
            "pause" => self.paused.store(true, Ordering::Relaxed),
            "continue" => self.paused.store(false, Ordering::Relaxed),
            "checkpoint" => self.save.store(true, Ordering::Relaxed),
            "stop" => self.stop.store(true, Ordering::Relaxed),
            _ => return false,
        }
        self.came.notify_all();
        true
    }
}

/// The side of the device.
impl Desk {
    /// True if somebody waits for a reply.
    pub fn asked(&self) -> bool {
        lock(&self.jobs).iter().any(Job::is_waited_for)
    }

    /// Answers the question that has waited longest, if there is one; the time that it took.
    pub fn answer(&self, scenery: &mut dyn Scenery) -> Option<Duration> {
        let job = {
            let mut jobs = lock(&self.jobs);
            jobs.retain(Job::is_waited_for);
            jobs.pop_front()?
        };
        let began = Instant::now();
        let found = reply(&job.ask, scenery).map_err(|e| e.to_string());
        // Who asked may have gone.
        let _ = job.to.send(found);
        Some(began.elapsed())
    }

    /// Waits until somebody asks or wishes, no longer than that.
    pub fn wait(&self, longest: Duration) {
        let jobs = lock(&self.jobs);
        if jobs.is_empty() {
            let waited = self.came.wait_timeout(jobs, longest);
            drop(waited.unwrap_or_else(PoisonError::into_inner));
        }
    }

    /// Changes what is told of the run.
    pub fn tell(&self, change: impl FnOnce(&mut Told)) {
        change(&mut lock(&self.told));
    }

    /// True while the run is to wait.
    pub fn paused(&self) -> bool {
        self.paused.load(Ordering::Relaxed)
    }

    /// True if the run is to end.
    pub fn stops(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// True once for every wish of a checkpoint.
    pub fn takes_checkpoint(&self) -> bool {
        self.save.swap(false, Ordering::Relaxed)
    }

    /// Sends everyone away who waits.
    pub fn close(&self) {
        let mut jobs = lock(&self.jobs);
        self.closed.store(true, Ordering::Relaxed);
        jobs.clear();
    }
}
