//! [`mpi`]: ranks that are processes, launched together by MPI (`mpirun`, `srun`).

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread::{Builder, Thread, park_timeout, yield_now};
use std::time::{Duration, Instant};

use mpi::request::{Request, StaticScope};
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, Destination, MatchedReceiveVec, Source};
use mpi::{Tag, Threading};

use crate::base::error::{Error, Result};
use crate::ranks::exchange::{Exchange, LEADER, Meter, Part, check_number, nothing_begun};

/// Number of looks before it counts that nobody waits: who trades waits right after it has begun.
const FIRST: u32 = 20;
/// Number of looks for a message that is waited for before the first pause.
const EAGER: u32 = 200;
/// Pause between two looks after that.
const PAUSE: Duration = Duration::from_micros(40);
/// Longest pause between two looks while nobody waits: this rank computes, maybe on all its cores.
const IDLE_PAUSE: Duration = Duration::from_micros(500);
/// Tag of what ranks trade.
const TRADE: Tag = 0;
/// Tag of the leader's signs of life.
const ALIVE: Tag = 1;
/// Longest time between two of those.
const SIGN_INTERVAL: Duration = Duration::from_secs(10);
/// Longest time between two looks that counts as waiting: in a longer one this process was suspended, and maybe the whole job.
const LONGEST_LOOK: Duration = Duration::from_secs(1);

/// A task of the thread that has MPI.
enum Task {
    Trade(Vec<Vec<u32>>, SyncSender<Vec<Vec<u32>>>),
    End(SyncSender<()>),
    Abort,
}

/// This process's end of an exchange. MPI is asked by one thread alone: that is all that every library offers.
#[derive(Debug)]
struct Process {
    rank: usize,
    ranks: usize,
    tasks: Mutex<Sender<Task>>,
    /// Messages that have not been waited for, the oldest first.
    begun: Mutex<VecDeque<(Part, Answer)>>,
    meter: Meter,
    now: Arc<Now>,
    /// The thread that has MPI.
    thread: Thread,
}

/// Messages from all ranks, once they are there.
type Answer = Receiver<Vec<Vec<u32>>>;

/// The state of a process that the thread looks at which has MPI.
#[derive(Debug, Default)]
struct Now {
    /// Reason that this process cannot go on, once it cannot: what is on its way is not waited for then.
    failed: OnceLock<String>,
    /// True while messages are waited for.
    waits: AtomicBool,
}

/// Time for which a rank is waited for, the leader for a sign of life: it may write a report meanwhile. And what takes the sentence on the end of
/// the job, before it is aborted.
#[derive(Debug, Clone, Copy)]
pub struct Patience {
    /// Seconds.
    pub seconds: f64,
    /// Takes the sentence.
    pub tell: fn(&str),
}

/// The exchange of the processes that this one was launched with.
///
/// # Errors
/// MPI does not start, or no thread can be made.
pub fn mpi(patience: Patience) -> Result<Arc<dyn Exchange>> {
    let (tasks, to_do) = channel();
    let (begun, ready) = sync_channel(1);
    let now = Arc::new(Now::default());
    let seen = now.clone();
    let work = move || serve(&to_do, &begun, (patience, &seen));
    let thread = Builder::new().name("mpi".to_owned()).spawn(work);
    let fix = "start it with mpirun or srun, as docs/guide/clusters.md shows";
    let thread =
        thread.map_err(|e| Error::device("MPI", format!("no thread can be made: {e}"), fix))?;
    match ready.recv() {
        Ok([rank, ranks]) => Ok(Arc::new(Process {
            rank,
            ranks,
            tasks: Mutex::new(tasks),
            begun: Mutex::default(),
            meter: Meter::default(),
            now,
            thread: thread.thread().clone(),
        })),
        Err(_) => Err(Error::device("MPI", "it does not start", fix)),
    }
}

/// Starts MPI and does what is asked of it.
fn serve(
    tasks: &Receiver<Task>,
    begun: &SyncSender<[usize; 2]>,
    (patience, now): (Patience, &Now),
) {
    let Some((universe, _)) = mpi::initialize_with_threading(Threading::Serialized) else {
        return;
    };
    let world = universe.world();
    let numbers = [world.rank(), world.size()].map(|n| n as usize);
    if begun.send(numbers).is_err() {
        return;
    }
    let mut signs = Signs::new(&world, patience);
    loop {
        match tasks.recv_timeout(signs.interval) {
            Ok(Task::Trade(messages, answer)) => {
                let got = trade((&world, &mut signs), messages, (patience, now));
                let _ = answer.send(got);
            }
            Err(RecvTimeoutError::Timeout) => signs.give(&world),
            Ok(Task::End(ended)) => {
                drop(signs);
                drop(universe);
                let _ = ended.send(());
                return;
            }
            Ok(Task::Abort) => abort(&world, (patience, now)),
            // An end in disorder: the others are not waited for, as the end of MPI would.
            Err(RecvTimeoutError::Disconnected) => {
                std::mem::forget(universe);
                return;
            }
        }
    }
}

/// Signs of life that the leader gives to all others, whatever it does.
struct Signs {
    interval: Duration,
    given: Instant,
    /// The last one for each rank; a further one only once that has gone.
    sent: Vec<Option<Request<'static, [u32], StaticScope>>>,
}

impl Signs {
    fn new(world: &SimpleCommunicator, patience: Patience) -> Self {
        let others = 1..world.size();
        let leads = world.rank() as usize == LEADER;
        Self {
            interval: SIGN_INTERVAL
                .min(Duration::from_secs_f64(patience.seconds.min(600.0) / 20.0)),
            given: Instant::now(),
            sent: others.filter(|_| leads).map(|_| None).collect(),
        }
    }

    /// Gives one to each rank if it is time; nothing but at the leader.
    fn give(&mut self, world: &SimpleCommunicator) {
        if self.given.elapsed() < self.interval {
            return;
        }
        self.given = Instant::now();
        for (to, sent) in (1..).zip(&mut self.sent) {
            let left = sent.take().and_then(|request| request.test().err());
            let to = world.process_at_rank(to);
            *sent = left.or_else(|| Some(to.immediate_send_with_tag(StaticScope, &[], ALIVE)));
        }
    }

    /// Takes the leader's that have come; true if there were any.
    fn taken(world: &SimpleCommunicator) -> bool {
        let leader = world.process_at_rank(LEADER as i32);
        let next = || leader.immediate_matched_probe_with_tag(ALIVE);
        let signs = std::iter::from_fn(next).map(MatchedReceiveVec::matched_receive_vec::<u32>);
        signs.count() > 0
    }
}

impl Drop for Signs {
    fn drop(&mut self) {
        // A request that is dropped before it is done panics; who does not take a sign any more has ended.
        let left = self.sent.iter_mut().filter_map(Option::take);
        left.filter_map(|request| request.test().err())
            .for_each(std::mem::forget);
    }
}

/// Ends the job if this process has failed.
fn abort(world: &SimpleCommunicator, (patience, now): (Patience, &Now)) {
    if let Some(why) = now.failed.get() {
        (patience.tell)(why);
        world.abort(2);
    }
}

/// Sends a message to each rank and waits for one from each.
fn trade(
    (world, signs): (&SimpleCommunicator, &mut Signs),
    mut messages: Vec<Vec<u32>>,
    (patience, now): (Patience, &Now),
) -> Vec<Vec<u32>> {
    let rank = world.rank() as usize;
    let mut got = vec![None; messages.len()];
    got[rank] = Some(std::mem::take(&mut messages[rank]));
    mpi::request::scope(|scope| {
        let others = messages.iter().enumerate().filter(|(to, _)| *to != rank);
        let mut sent: Vec<_> = others
            .map(|(to, message)| {
                let process = world.process_at_rank(to as i32);
                let request = process.immediate_send_with_tag(scope, message.as_slice(), TRADE);
                (to, request)
            })
            .collect();
        let (mut waited, mut without_sign) = (Duration::ZERO, Duration::ZERO);
        let (mut looked, mut looks) = (Instant::now(), 0);
        loop {
            let mut any = false;
            for (from, place) in got.iter_mut().enumerate().filter(|(_, g)| g.is_none()) {
                let from = world.process_at_rank(from as i32);
                if let Some(found) = from.immediate_matched_probe_with_tag(TRADE) {
                    *place = Some(found.matched_receive_vec().0);
                    any = true;
                }
            }
            let left = sent.into_iter();
            let left = left.filter_map(|(to, request)| Some((to, request.test().err()?)));
            sent = left.collect();
            let missing = (0..got.len()).filter(|from| got[*from].is_none());
            let missing: Vec<usize> = missing.chain(sent.iter().map(|(to, _)| *to)).collect();
            if missing.is_empty() {
                break;
            }
            looks = if any { 0 } else { looks + 1 };
            let eager = match now.waits.load(Ordering::Relaxed) {
                true => EAGER,
                false => FIRST,
            };
            match looks {
                0 => {}
                _ if looks <= eager => yield_now(),
                _ if eager == FIRST => park_timeout(IDLE_PAUSE),
                _ => park_timeout(PAUSE),
            }
            abort(world, (patience, now));
            signs.give(world);
            let look = looked.elapsed().min(LONGEST_LOOK);
            looked = Instant::now();
            waited += look;
            without_sign = match missing.contains(&LEADER) && !Signs::taken(world) {
                true => without_sign + look,
                false => Duration::ZERO,
            };
            let silent = |other: &usize| match *other {
                LEADER => without_sign.as_secs_f64(),
                _ => waited.as_secs_f64(),
            };
            let late = missing
                .iter()
                .find(|other| silent(other) > patience.seconds);
            if let Some(late) = late {
                let seconds = silent(late);
                (patience.tell)(&format!(
                    "rank {late} has not answered rank {rank} for {seconds:.0} s; the job ends"
                ));
                world.abort(3);
            }
        }
    });
    got.into_iter().map(Option::unwrap_or_default).collect()
}

impl Process {
    fn ask(&self, task: Task) -> Result<()> {
        let tasks = self.tasks.lock().unwrap_or_else(PoisonError::into_inner);
        tasks.send(task).map_err(|_| gone())
    }
}

impl Exchange for Process {
    fn rank(&self) -> usize {
        self.rank
    }

    fn ranks(&self) -> usize {
        self.ranks
    }

    fn apart(&self) -> bool {
        true
    }

    fn begin(&self, part: Part, messages: Vec<Vec<u32>>) -> Result<()> {
        check_number(&messages, self.ranks)?;
        // MPI counts by 31 bits.
        if messages.iter().any(|m| i32::try_from(m.len()).is_err()) {
            let what = "a message of 8 GiB or more; take more ranks, or fewer Gaussians";
            return Err(Error::numerics("exchange", what));
        }
        self.meter.send(self.rank, part, &messages);
        let (answer, got) = sync_channel(1);
        self.ask(Task::Trade(messages, answer))?;
        let mut begun = self.begun.lock().unwrap_or_else(PoisonError::into_inner);
        begun.push_back((part, got));
        Ok(())
    }

    fn wait(&self) -> Result<Vec<Vec<u32>>> {
        let mut begun = self.begun.lock().unwrap_or_else(PoisonError::into_inner);
        let (part, got) = begun.pop_front().ok_or_else(nothing_begun)?;
        let since = Instant::now();
        self.now.waits.store(true, Ordering::Relaxed);
        // It may pause.
        self.thread.unpark();
        let got = got.recv().map_err(|_| gone());
        self.now.waits.store(false, Ordering::Relaxed);
        let got = got?;
        self.meter.wait(part, since);
        Ok(got)
    }

    fn meter(&self) -> &Meter {
        &self.meter
    }

    fn fail(&self, why: &str) {
        let why = format!("error: rank {}: {why}", self.rank);
        let _ = self.now.failed.set(why);
        if self.ask(Task::Abort).is_ok() {
            // Until then.
            std::thread::sleep(Duration::from_secs(10));
        }
    }

    fn end(&self) {
        let (ended, wait) = sync_channel(1);
        if self.ask(Task::End(ended)).is_ok() {
            let _ = wait.recv();
        }
    }
}

/// The error of an exchange that has ended.
fn gone() -> Error {
    Error::numerics("exchange", "MPI has ended")
}
