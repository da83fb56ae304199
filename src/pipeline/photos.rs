//! [`Photos`]: the photos of a run as device arrays, at their full size or the fraction of it that is wanted. Those left in
//! their files are decoded ahead of their use by threads of their own, and the least recently used give way when the budget is
//! used up. The rows that are wanted of these are there, and some beside them; those in memory are whole.
//!
//! Photos held here count against the budget: one that has given way stays on the device until the kernels
//! already enqueued with it are done, because OpenCL keeps a buffer as long as a command uses it.

use std::collections::VecDeque;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::Instant;

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};
use crate::capture::{PhotoFile, PhotoSource};
use crate::device::{Array, Defines, Device, ImageSize, Kernels, PhotoScale, Program};
use crate::pipeline::photo_array::PhotoArray;
use crate::pipeline::room::{check_photo, photo_bytes};
use crate::pipeline::stage::shrink;

/// Photos decoded ahead of the one in use, where the budget has room for so many.
pub const AHEAD: usize = 8;

/// Largest number of decoding threads: more than are looked ahead would have nothing to do.
const MAX_THREADS: usize = AHEAD;

/// Part of a photo's rows of tiles that is kept beside those that are needed, on either side: one of so many, rounded up. A rank's band in a
/// view moves by as much from one visit to the next; while it stays within what is kept, no file is decoded again (docs/results/ranks.md).
const SLACK: usize = 24;

/// A photo at a fraction of its size, or a part of that.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Wanted {
    /// Number of the photo.
    pub photo: usize,
    /// Its size over the full one.
    pub scale: PhotoScale,
    /// Pixel rows of the smaller photo that are needed; `None` for all.
    pub rows: Option<Range<usize>>,
}

/// Use of the budget for photos.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct PhotoStats {
    /// Bytes of all photos, decoded.
    pub total_bytes: u64,
    /// Bytes that photos decoded on demand, and smaller ones, may take at one time.
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
    /// Makes smaller photos; built when the first is wanted.
    shrink: OnceLock<Program>,
}

/// Origin of the arrays of a photo.
#[derive(Debug, Clone)]
enum Source {
    /// Whole on the device, where it stays.
    Device(Arc<PhotoArray>),
    /// Decoded from its file whenever it is needed.
    File(PhotoFile),
}

#[derive(Debug)]
enum Slot {
    /// Nothing but what the source has.
    Empty,
    /// Being decoded; the bytes of the whole photo count already.
    Decoding,
    /// The photo at a fraction of its size, or a part of that.
    Ready(PhotoScale, Arc<PhotoArray>),
    /// Decoding failed; the next request returns the error.
    Failed(Error),
}

#[derive(Debug)]
struct Entry {
    source: Source,
    /// Width and height.
    size: ImageSize,
    /// Colours, and the alpha plane.
    planes: usize,
    slot: Slot,
    /// When it was last asked for or decoded, by `State::clock`.
    used: u64,
}

impl Entry {
    /// Width and height at a fraction of the size.
    fn size(&self, scale: PhotoScale) -> [usize; 2] {
        self.size.pixels.map(|side| scale.of(side))
    }

    /// Bytes of so many rows at a fraction of the size.
    fn bytes(&self, scale: PhotoScale, rows: usize) -> u64 {
        let [width, _] = self.size(scale);
        let pixels = [width, rows];
        photo_bytes(self.planes)(ImageSize {
            pixels,
            ..self.size
        })
    }

    /// Bytes of the whole at its full size.
    fn whole(&self) -> u64 {
        self.bytes(PhotoScale::FULL, self.size.pixels[1])
    }

    /// Pixel rows that are needed.
    fn needed(&self, wanted: &Wanted) -> Range<usize> {
        let height = self.size(wanted.scale)[1];
        wanted.rows.clone().unwrap_or(0..height)
    }

    /// Pixel rows that are kept for those that are needed.
    fn kept(&self, wanted: &Wanted) -> Range<usize> {
        let (height, tile) = (self.size(wanted.scale)[1], self.size.tile);
        let slack = height.div_ceil(tile).div_ceil(SLACK) * tile;
        let needed = self.needed(wanted);
        needed.start.saturating_sub(slack)..(needed.end + slack).min(height)
    }

    /// Bytes of what is there or under way beside a source on the device.
    fn held(&self) -> u64 {
        match &self.slot {
            Slot::Empty | Slot::Failed(_) => 0,
            Slot::Decoding => self.whole(),
            Slot::Ready(scale, found) => self.bytes(*scale, found.rows().len()),
        }
    }

    /// True if what is wanted is there.
    fn has(&self, wanted: &Wanted) -> bool {
        match (&self.slot, &self.source) {
            (_, Source::Device(_)) if wanted.scale == PhotoScale::FULL => true,
            (Slot::Ready(scale, found), _) => {
                *scale == wanted.scale && found.has(&self.needed(wanted))
            }
            _ => false,
        }
    }
}

#[derive(Debug)]
struct State {
    entries: Vec<Entry>,
    /// The photo in use and those to follow that are decoded on demand, in the order of need; together within the budget, beside the whole
    /// of any one of them.
    window: VecDeque<Wanted>,
    /// Bytes of what can be made again and is there or under way, ≤ budget.
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
                shrink: OnceLock::new(),
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
    /// A photo larger than a buffer of the device or than the budget, more than the device can allocate, or no thread to be had.
    pub fn add(&self, photo: PhotoSource) -> Result<usize> {
        let (bytes, planes) = (photo.bytes(), photo.alpha().planes());
        let size = ImageSize {
            pixels: photo.size(),
            tile: self.device().tuning().tile as usize,
        };
        check_photo(self.device(), planes, size)?;
        let source = match photo {
            PhotoSource::Memory(photo) => {
                Source::Device(Arc::new(PhotoArray::upload(self.device(), &photo)?))
            }
            PhotoSource::File(file) => {
                self.0.start_threads()?;
                Source::File(file)
            }
        };
        let mut state = self.0.shared.lock();
        match &source {
            Source::Device(_) => state.fixed += bytes,
            Source::File(_) if bytes > state.stats.budget_bytes => {
                return Err(too_large(bytes, state.stats.budget_bytes));
            }
            Source::File(_) => (),
        }
        state.stats.total_bytes += bytes;
        state.entries.push(Entry {
            source,
            size,
            planes,
            slot: Slot::Empty,
            used: 0,
        });
        state.note_peak();
        Ok(state.entries.len() - 1)
    }

    /// A photo, waiting for it if need be, while those of `next` (in the order of their use) are decoded as far as the budget
    /// allows, [`AHEAD`] at most. What was to follow by an earlier call no longer is. There may be more rows than are wanted; of one
    /// that is in memory there are all.
    ///
    /// # Errors
    /// A file that is gone, no longer an image, or of another size than when the dataset was read; more than the device can
    /// allocate.
    pub fn get(
        &self,
        wanted: Wanted,
        next: impl IntoIterator<Item = Wanted>,
    ) -> Result<Arc<PhotoArray>> {
        let shared = &self.0.shared;
        let _turn = shared.turn.lock().unwrap_or_else(PoisonError::into_inner);
        let mut state = shared.lock();
        let source = state.entries[wanted.photo].source.clone();
        let there = matches!(source, Source::Device(_)) || state.has(&wanted);
        state.look_ahead(wanted.clone(), next);
        shared.changed.notify_all();
        let asked = Instant::now();
        let found = match source {
            Source::Device(whole) => shared.beside_whole(&mut state, &wanted, whole),
            Source::File(_) => loop {
                if let Some(found) = state.take(&wanted) {
                    break found.and_then(|found| shared.cut(&mut state, &wanted, found));
                }
                state = shared.wait(state);
            },
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
            let Some((wanted, file)) = state.claim() else {
                state = self.wait(state);
                continue;
            };
            let kept = state.entries[wanted.photo].kept(&wanted);
            drop(state);
            // A decoder that panics must not leave the trainer waiting for ever.
            let made = catch_unwind(AssertUnwindSafe(|| self.decoded(&file, wanted.scale, kept)))
                .unwrap_or_else(|_| Err(file.undecodable()));
            state = self.lock();
            state.put(&wanted, made);
            self.changed.notify_all();
        }
    }

    /// Some rows of a photo from its file, at a fraction of its size.
    fn decoded(
        &self,
        file: &PhotoFile,
        scale: PhotoScale,
        rows: Range<usize>,
    ) -> Result<PhotoArray> {
        let whole = file.load()?;
        let photo = match scale {
            PhotoScale::FULL => whole.rows(rows.clone()),
            scale => shrink::shrink_rows(&whole, scale, rows.clone()),
        };
        let pixels = Array::from_slice(&self.device, "photo", &photo.data)?;
        Ok(PhotoArray::new(pixels, rows))
    }

    /// The rows that are kept of a photo, where the whole of it was there for another use: room for those of others.
    fn cut(
        &self,
        state: &mut State,
        wanted: &Wanted,
        found: Arc<PhotoArray>,
    ) -> Result<Arc<PhotoArray>> {
        let entry = &state.entries[wanted.photo];
        let ([width, height], kept) = (entry.size(wanted.scale), entry.kept(wanted));
        if found.rows().len() < height || kept.len() == height {
            return Ok(found);
        }
        let part = Arc::new(found.part(&self.device, [entry.planes, width], &kept)?);
        state.clear(wanted.photo);
        state.fill(wanted.photo, Slot::Ready(wanted.scale, part.clone()));
        self.changed.notify_all();
        Ok(part)
    }

    /// A photo of which the device has the whole, at a fraction of its size.
    fn smaller(&self, whole: &Array<u8>, entry: &Entry, scale: PhotoScale) -> Result<Array<u8>> {
        let stage = match self.shrink.get() {
            Some(stage) => stage,
            None => {
                let kernels = Kernels::new(&self.device, Defines::new(self.device.tuning()));
                let stage = kernels.build::<f32>("shrink")?;
                self.shrink.get_or_init(|| stage)
            }
        };
        shrink::reduce(
            &self.device,
            stage,
            whole,
            (entry.size, entry.planes),
            scale,
        )
    }

    /// A photo of which the device has the whole; a smaller one is kept for later if there is room for it.
    fn beside_whole(
        &self,
        state: &mut State,
        wanted: &Wanted,
        whole: Arc<PhotoArray>,
    ) -> Result<Arc<PhotoArray>> {
        let kept = &state.entries[wanted.photo].slot;
        match kept {
            Slot::Ready(found, small) if *found == wanted.scale => return Ok(small.clone()),
            _ => state.clear(wanted.photo),
        }
        if wanted.scale == PhotoScale::FULL {
            return Ok(whole);
        }
        let entry = &state.entries[wanted.photo];
        let pixels = entry.size(wanted.scale);
        let bytes = entry.bytes(wanted.scale, pixels[1]);
        let size = ImageSize {
            pixels,
            ..entry.size
        };
        let small = self.smaller(&whole, entry, wanted.scale)?;
        let small = Arc::new(PhotoArray::whole(small, size));
        if state.fixed + state.bytes + bytes <= state.stats.budget_bytes {
            state.fill(wanted.photo, Slot::Ready(wanted.scale, small.clone()));
            state.note_peak();
        }
        Ok(small)
    }
}

impl State {
    /// True if what is wanted is there.
    fn has(&self, wanted: &Wanted) -> bool {
        self.entries[wanted.photo].has(wanted)
    }

    /// Gives up what is there of a photo beside its source.
    fn clear(&mut self, photo: usize) {
        self.bytes -= self.entries[photo].held();
        self.entries[photo].slot = Slot::Empty;
    }

    /// Takes what there is of a photo from now on beside its source.
    fn fill(&mut self, photo: usize, slot: Slot) {
        self.entries[photo].slot = slot;
        self.bytes += self.entries[photo].held();
    }

    /// Puts `wanted` and as much of `next` as there is room for into the window.
    fn look_ahead(&mut self, wanted: Wanted, next: impl IntoIterator<Item = Wanted>) {
        self.window.clear();
        let (mut bytes, mut more) = (0, 0);
        for one in std::iter::once(wanted).chain(next.into_iter().take(AHEAD)) {
            let entry = &self.entries[one.photo];
            let twice = self.window.iter().any(|other| other.photo == one.photo);
            if twice || matches!(entry.source, Source::Device(_)) {
                continue;
            }
            // More rows than are wanted, maybe, are there or under way.
            let stays = entry.has(&one) || matches!(entry.slot, Slot::Decoding);
            let own = match stays {
                true => entry.held(),
                false => entry.bytes(one.scale, entry.kept(&one).len()),
            };
            bytes += own;
            // While it is decoded there is the whole of it.
            more = entry.whole().saturating_sub(own).max(more);
            if bytes + more > self.stats.budget_bytes {
                break;
            }
            self.window.push_back(one);
        }
    }

    /// The first photo of the window that is neither there nor under way, if there is or can be made room for the whole of it. Its bytes
    /// are taken.
    fn claim(&mut self) -> Option<(Wanted, PhotoFile)> {
        let absent = |w: &&Wanted| match &self.entries[w.photo].slot {
            Slot::Empty | Slot::Ready(..) => !self.has(w),
            Slot::Decoding | Slot::Failed(_) => false,
        };
        let wanted = self.window.iter().find(absent)?.clone();
        let Source::File(file) = self.entries[wanted.photo].source.clone() else {
            return None;
        };
        self.clear(wanted.photo);
        let bytes = self.entries[wanted.photo].whole();
        while self.bytes + bytes > self.stats.budget_bytes {
            let old = self.least_recent()?;
            self.clear(old);
        }
        self.fill(wanted.photo, Slot::Decoding);
        self.note_peak();
        Some((wanted, file))
    }

    /// The photo to give way: of those there and not in the window in the size that they have, the least recently used. None while threads
    /// are still at photos that are no longer wanted; then there will be one soon, because the window is within the budget.
    fn least_recent(&self) -> Option<usize> {
        let may_go = |i: &usize| {
            let e = &self.entries[*i];
            let wanted = |w: &Wanted| w.photo == *i && e.has(w);
            matches!(e.slot, Slot::Ready(..)) && !self.window.iter().any(wanted)
        };
        (0..self.entries.len())
            .filter(may_go)
            .min_by_key(|i| self.entries[*i].used)
    }

    fn put(&mut self, wanted: &Wanted, made: Result<PhotoArray>) {
        self.clock += 1;
        self.stats.decoded += 1;
        self.clear(wanted.photo);
        self.entries[wanted.photo].used = self.clock;
        let slot = match made {
            Ok(array) => Slot::Ready(wanted.scale, Arc::new(array)),
            Err(error) => Slot::Failed(error),
        };
        self.fill(wanted.photo, slot);
    }

    /// The photo, or why there is none; nothing as long as it is on its way.
    fn take(&mut self, wanted: &Wanted) -> Option<Result<Arc<PhotoArray>>> {
        self.clock += 1;
        let there = self.has(wanted);
        let entry = &mut self.entries[wanted.photo];
        match &entry.slot {
            Slot::Ready(_, array) if there => {
                entry.used = self.clock;
                Some(Ok(array.clone()))
            }
            Slot::Failed(_) => {
                self.window.clear();
                match std::mem::replace(&mut entry.slot, Slot::Empty) {
                    Slot::Failed(error) => Some(Err(error)),
                    _ => None,
                }
            }
            Slot::Empty | Slot::Decoding | Slot::Ready(..) => None,
        }
    }

    fn note_peak(&mut self) {
        self.stats.peak_bytes = self.stats.peak_bytes.max(self.fixed + self.bytes);
    }
}
