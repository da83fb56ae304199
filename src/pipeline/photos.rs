//! [`Photos`]: the photos of a run as device arrays. Those left in their files are decoded ahead of their use by threads of
//! their own, and the least recently used give way when the budget is used up.
//!
//! Photos held here count against the budget: one that has given way stays on the device until the kernels
//! already enqueued with it are done, because OpenCL keeps a buffer as long as a command uses it.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Instant;

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};
use crate::capture::{PhotoFile, PhotoSource};
use crate::device::{Array, Device};

/// Photos decoded ahead of the one in use, where the budget has room for so many.
pub const AHEAD: usize = 8;

/// Largest number of decoding threads: more than are looked ahead would have nothing to do.
const MAX_THREADS: usize = AHEAD;

/// Use of the budget for photos.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct PhotoStats {
    /// Bytes of all photos, decoded.
    pub total_bytes: u64,
    /// Bytes that photos decoded on demand may take at one time.
    pub budget_bytes: u64,
    /// Bytes that photos have taken at one time, at most.
    pub peak_bytes: u64,
    /// Photos that were there when they were asked for.
    pub hits: u64,
    /// Photos that had to be waited for.
    pub misses: u64,
    /// Files decoded since training began.
    pub decoded: u64,
    /// Seconds waited for photos.
    pub seconds_waited: f64,
}

/// The photos of one or several sets of views on one device. Cheap to clone; clones share the photos and the budget.
#[derive(Debug, Clone)]
pub struct Photos(Arc<Pool>);

/// Ends the threads when the last owner goes.
#[derive(Debug)]
struct Pool {
    shared: Arc<Shared>,
    threads: Mutex<Vec<JoinHandle<()>>>,
}

#[derive(Debug)]
struct Shared {
    device: Device,
    state: Mutex<State>,
    /// The window, a slot or `closed` has changed.
    changed: Condvar,
    /// Held by the one caller whose wishes the window shows.
    turn: Mutex<()>,
}

#[derive(Debug)]
enum Slot {
    /// On disk only.
    OnDisk,
    /// Being decoded; its bytes count already.
    Decoding,
    Ready(Arc<Array<u8>>),
    /// Decoding failed; the next request returns the error.
    Failed(Error),
}

#[derive(Debug)]
struct Entry {
    /// File to decode it from again; `None` for photos that stay on the device.
    file: Option<PhotoFile>,
    bytes: u64,
    slot: Slot,
    /// When it was last asked for or decoded, by `State::clock`.
    used: u64,
}

#[derive(Debug)]
struct State {
    entries: Vec<Entry>,
    /// The photo in use and those to follow, in the order of need; together within the budget.
    window: VecDeque<usize>,
    /// Bytes of what was decoded on demand and is there or under way, ≤ budget.
    bytes: u64,
    /// Bytes of the photos that stay.
    fixed: u64,
    clock: u64,
    closed: bool,
    stats: PhotoStats,
}

impl Photos {
    /// No photos yet; those decoded on demand will take at most `budget` bytes at one time.
    #[must_use]
    pub fn new(device: &Device, budget: u64) -> Self {
        let state = State {
            entries: Vec::new(),
            window: VecDeque::new(),
            bytes: 0,
            fixed: 0,
            clock: 0,
            closed: false,
            stats: PhotoStats {
                budget_bytes: budget,
                ..PhotoStats::default()
            },
        };
        Self(Arc::new(Pool {
            shared: Arc::new(Shared {
                device: device.clone(),
                state: Mutex::new(state),
                changed: Condvar::new(),
                turn: Mutex::new(()),
            }),
            threads: Mutex::new(Vec::new()),
        }))
    }

    /// The device.
    #[must_use]
    pub fn device(&self) -> &Device {
        &self.0.shared.device
    }

    /// Adds a photo and answers its number. One in memory is uploaded and stays; one in a file waits until it is asked for.
    ///
    /// # Errors
    /// More than the device can allocate, a photo larger than the budget, or no thread to be had.
    pub fn add(&self, photo: PhotoSource) -> Result<usize> {
        let bytes = photo.bytes();
        let (file, slot) = match photo {
            PhotoSource::Memory(photo) => {
                let array = Array::from_slice(self.device(), "photo", &photo.data)?;
                (None, Slot::Ready(Arc::new(array)))
            }
            PhotoSource::File(file) => {
                self.0.start_threads()?;
                (Some(file), Slot::OnDisk)
            }
        };
        let mut state = self.0.shared.lock();
        if file.is_none() {
            state.fixed += bytes;
        } else if bytes > state.stats.budget_bytes {
            return Err(too_large(bytes, state.stats.budget_bytes));
        }
        state.stats.total_bytes += bytes;
        state.entries.push(Entry {
            file,
            bytes,
            slot,
            used: 0,
        });
        state.note_peak();
        Ok(state.entries.len() - 1)
    }

    /// Photo number `photo`, waiting for it if need be, while those of `next` (in the order of their use) are decoded as far
    /// as the budget allows, [`AHEAD`] at most. What was to follow by an earlier call no longer is.
    ///
    /// # Errors
    /// A file that is gone, no longer an image, or of another size than when the dataset was read; more than the device can
    /// allocate.
    pub fn get(
        &self,
        photo: usize,
        next: impl IntoIterator<Item = usize>,
    ) -> Result<Arc<Array<u8>>> {
        let shared = &self.0.shared;
        let _turn = shared.turn.lock().unwrap_or_else(PoisonError::into_inner);
        let mut state = shared.lock();
        state.look_ahead(photo, next);
        shared.changed.notify_all();
        let asked = Instant::now();
        let there = matches!(state.entries[photo].slot, Slot::Ready(_));
        let found = loop {
            if let Some(found) = state.take(photo) {
                break found;
            }
            state = shared.wait(state);
        };
        let stats = &mut state.stats;
        if there {
            stats.hits += 1;
        } else {
            stats.misses += 1;
            stats.seconds_waited += asked.elapsed().as_secs_f64();
        }
        found
    }

    /// Use of the budget so far.
    #[must_use]
    pub fn stats(&self) -> PhotoStats {
        self.0.shared.lock().stats
    }
}

fn too_large(bytes: u64, budget: u64) -> Error {
    Error::config(
        "--image-budget",
        format!("{budget} bytes; one photo takes {bytes} (lower --max-size or raise the budget)"),
    )
}

impl Pool {
    fn start_threads(&self) -> Result<()> {
        let mut threads = self.threads.lock().unwrap_or_else(PoisonError::into_inner);
        let wanted = std::thread::available_parallelism().map_or(1, |n| n.get().min(MAX_THREADS));
        while threads.len() < wanted {
            let shared = self.shared.clone();
            let thread = std::thread::Builder::new()
                .name("photos".into())
                .spawn(move || shared.decode())
                .map_err(|e| Error::io("a thread to decode photos", e))?;
            threads.push(thread);
        }
        Ok(())
    }
}

impl Drop for Pool {
    fn drop(&mut self) {
        self.shared.lock().closed = true;
        self.shared.changed.notify_all();
        let threads = self.threads.get_mut();
        for thread in threads.unwrap_or_else(PoisonError::into_inner).drain(..) {
            // A thread that panicked has nothing left to say.
            let _ = thread.join();
        }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait<'a>(&self, state: MutexGuard<'a, State>) -> MutexGuard<'a, State> {
        self.changed
            .wait(state)
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Decodes photos of the window until the pool closes; the body of each thread.
    fn decode(&self) {
        let mut state = self.lock();
        while !state.closed {
            let Some((photo, file)) = state.claim() else {
                state = self.wait(state);
                continue;
            };
            drop(state);
            // A decoder that panics must not leave the trainer waiting for ever.
            let made = catch_unwind(AssertUnwindSafe(|| self.upload(&file)))
                .unwrap_or_else(|_| Err(file.undecodable()));
            state = self.lock();
            state.put(photo, made);
            self.changed.notify_all();
        }
    }

    fn upload(&self, file: &PhotoFile) -> Result<Array<u8>> {
        Array::from_slice(&self.device, "photo", &file.load()?.data)
    }
}

impl State {
    /// Puts `photo` and as much of `next` as there is room for into the window.
    fn look_ahead(&mut self, photo: usize, next: impl IntoIterator<Item = usize>) {
        let demand = |i: &usize| {
            self.entries[*i]
                .file
                .as_ref()
                .map(|_| self.entries[*i].bytes)
        };
        self.window.clear();
        let mut bytes = 0;
        for i in std::iter::once(photo).chain(next.into_iter().take(AHEAD)) {
            let Some(more) = demand(&i).filter(|_| !self.window.contains(&i)) else {
                continue;
            };
            bytes += more;
            if bytes > self.stats.budget_bytes {
                break;
            }
            self.window.push_back(i);
        }
    }

    /// The first photo of the window that is neither there nor under way, if there is or can be made room for it. Its bytes
    /// are taken.
    fn claim(&mut self) -> Option<(usize, PhotoFile)> {
        let absent = |i: &&usize| matches!(self.entries[**i].slot, Slot::OnDisk);
        let photo = *self.window.iter().find(absent)?;
        let file = self.entries[photo].file.clone()?;
        let bytes = self.entries[photo].bytes;
        while self.bytes + bytes > self.stats.budget_bytes {
            let old = self.least_recent()?;
            self.bytes -= self.entries[old].bytes;
            self.entries[old].slot = Slot::OnDisk;
        }
        self.bytes += bytes;
        self.note_peak();
        self.entries[photo].slot = Slot::Decoding;
        Some((photo, file))
    }

    /// The photo to give way: of those there and not in the window, the least recently used. None while threads are still
    /// at photos that are no longer wanted; then there will be one soon, because the window is within the budget.
    fn least_recent(&self) -> Option<usize> {
        let may_go = |i: &usize| {
            let e = &self.entries[*i];
            e.file.is_some() && matches!(e.slot, Slot::Ready(_)) && !self.window.contains(i)
        };
        (0..self.entries.len())
            .filter(may_go)
            .min_by_key(|i| self.entries[*i].used)
    }

    fn put(&mut self, photo: usize, made: Result<Array<u8>>) {
        self.clock += 1;
        self.stats.decoded += 1;
        let entry = &mut self.entries[photo];
        entry.used = self.clock;
        entry.slot = match made {
            Ok(array) => Slot::Ready(Arc::new(array)),
            Err(error) => {
                self.bytes -= entry.bytes;
                Slot::Failed(error)
            }
        };
    }

    /// The photo, or why there is none; nothing as long as it is on its way.
    fn take(&mut self, photo: usize) -> Option<Result<Arc<Array<u8>>>> {
        self.clock += 1;
        let entry = &mut self.entries[photo];
        match &entry.slot {
            Slot::OnDisk | Slot::Decoding => None,
            Slot::Ready(array) => {
                entry.used = self.clock;
                Some(Ok(array.clone()))
            }
            Slot::Failed(_) => {
                self.window.clear();
                match std::mem::replace(&mut entry.slot, Slot::OnDisk) {
                    Slot::Failed(error) => Some(Err(error)),
                    _ => None,
                }
            }
        }
    }

    fn note_peak(&mut self) {
        self.stats.peak_bytes = self.stats.peak_bytes.max(self.fixed + self.bytes);
    }
}
