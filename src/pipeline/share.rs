//! [`Share`]: one rank's part of a view, where several train one scene. A rank has some rows of the Gaussians, and composites a band of
//! tile rows: it projects its rows, sends them to the bands that they touch, composites and compares its band, and gets the sums of its
//! Gaussians' pairs back. Grendel-GS (Zhao et al. 2024) divides both likewise. Every sum is added in the order in which one rank alone
//! adds it, so that the result has the same bits for any number of ranks and any bands. Between processes its rows travel in two parts, one
//! while the device is at the other.

use std::cell::Cell;
use std::ops::Range;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::base::error::{Error, Result};
use crate::base::process::process_cpu_seconds;
use crate::device::tuning::status;
use crate::device::{Array, CameraArg, Defines, Device, ImageSize, Kernels, Program, Real};
use crate::device::{Section, read_sections, write_sections};
use crate::pipeline::band::BandTiles;
use crate::pipeline::buffers::{GaussianBuffers, ViewBuffers};
use crate::pipeline::forward::{RenderOptions, Renderer};
use crate::pipeline::stage::loss::{HALO, ImagePair, Loss};
use crate::pipeline::stage::route::Route;
use crate::ranks::{Exchange, LEADER, Part, bits_of, flags_of, to_all, to_one};

/// Parts in which records and sums travel over a network: one is on its way while the device is at the other.
const HALVES: usize = 2;

/// Time that a rank works, without that in which it waits for others.
#[derive(Debug, Clone, Copy)]
struct Stopwatch {
    worked: Duration,
    /// End of the last wait.
    since: Instant,
}

/// Seconds that a rank worked.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Worked {
    /// On its rows in a view: projection, and the update before.
    pub rows: f32,
    /// On its band, in the view before.
    pub band: f32,
    /// By all cores since its process began, if that is not the leader's; 0 else.
    pub process: f32,
}

impl Worked {
    fn words(self) -> [u32; 3] {
        [self.rows, self.band, self.process].map(f32::to_bits)
    }

    fn from_words(words: &[u32]) -> Option<Self> {
        let [rows, band, process] = <[u32; 3]>::try_from(words).ok()?.map(f32::from_bits);
        Some(Self {
            rows,
            band,
            process,
        })
    }
}

/// Stages of a view that ranks share, and what lies between them.
#[derive(Debug)]
pub struct Share<R: Real> {
    device: Device,
    exchange: Arc<dyn Exchange>,
    route: Route<R>,
    scan: Program,
    /// Counters of what the leader counts for all; nobody reads them.
    pub uncounted: Array<u32>,
    /// Pairs of the view composited last.
    pairs: usize,
    /// First row of tiles of each rank's band, and the number of rows.
    bands: Vec<u32>,
    /// Pairs of each row of tiles of the view composited last, and how many of them were looked at; at the leader alone.
    pub pairs_by_row: Vec<[u32; 2]>,
    /// Work that each rank told with the view composited last; at the leader alone.
    pub worked_by_rank: Vec<Worked>,
    worked: Worked,
    /// Seconds of the update of the rows after the view before.
    updated: f32,
    stopwatch: Cell<Stopwatch>,
}

impl<R: Real> Share<R> {
    /// Builds the kernels of a rank.
    ///
    /// # Errors
    /// A build failure.
    pub fn new(device: &Device, defines: Defines, exchange: Arc<dyn Exchange>) -> Result<Self> {
        // What goes through the memory of one host takes less time than the launches of one more part.
        let parts = if exchange.apart() { HALVES } else { 1 };
        Self::in_parts(device, defines, exchange, parts)
    }

    /// [`Share::new`] with rows that travel in so many parts, the same number at all ranks.
    ///
    /// # Errors
    /// A build failure.
    pub fn in_parts(
        device: &Device,
        defines: Defines,
        exchange: Arc<dyn Exchange>,
        parts: usize,
    ) -> Result<Self> {
        let kernels = Kernels::new(device, defines);
        Ok(Self {
            route: Route::new(&kernels, [exchange.rank(), exchange.ranks()], parts)?,
            scan: kernels.build::<R>("scan")?,
            uncounted: Array::zeros(device, "status", status::SLOTS)?,
            pairs: 0,
            bands: vec![0; exchange.ranks() + 1],
            pairs_by_row: Vec::new(),
            worked_by_rank: vec![Worked::default(); exchange.ranks()],
            worked: Worked::default(),
            updated: 0.0,
            stopwatch: Cell::new(Stopwatch {
                worked: Duration::ZERO,
                since: Instant::now(),
            }),
            device: device.clone(),
            exchange,
        })
    }

    /// Sets the bands of the next view: the first row of tiles of each rank, and the number of rows.
    pub fn set_bands(&mut self, bands: Vec<u32>) {
        self.bands = bands;
    }

    /// Number of this rank.
    #[must_use]
    pub fn rank(&self) -> usize {
        self.exchange.rank()
    }

    /// Number of ranks.
    #[must_use]
    pub fn ranks(&self) -> usize {
        self.exchange.ranks()
    }

    /// Divides the next view evenly.
    pub fn divide_evenly(&mut self, size: ImageSize) {
        self.bands = self.even_bands(size);
    }

    /// Even bands: the first row of tiles of each rank, and the number of rows.
    fn even_bands(&self, size: ImageSize) -> Vec<u32> {
        let (rows, ranks) = (size.tiles()[1], self.exchange.ranks());
        (0..=ranks).map(|r| (r * rows / ranks) as u32).collect()
    }

    /// This rank's band of the next view.
    #[must_use]
    pub fn own_band(&self) -> Range<usize> {
        self.band(self.rank())
    }

    /// This rank's band where a view is divided evenly.
    #[must_use]
    pub fn even_band(&self, size: ImageSize) -> Range<usize> {
        let (bands, rank) = (self.even_bands(size), self.rank());
        bands[rank] as usize..bands[rank + 1] as usize
    }

    /// Gives every rank the words of each, by rank.
    ///
    /// # Errors
    /// Another rank's failure.
    pub fn tell_all(&self, part: Part, words: Vec<u32>) -> Result<Vec<Vec<u32>>> {
        self.trade(part, to_all(self.exchange.as_ref(), words))
    }

    /// Gives the leader the words of each rank, by rank; others get nothing.
    ///
    /// # Errors
    /// Another rank's failure.
    pub fn tell_leader(&self, part: Part, words: Vec<u32>) -> Result<Vec<Vec<u32>>> {
        self.trade(part, to_one(self.exchange.as_ref(), LEADER, words))
    }

    /// Trades messages; the time of that is no work.
    ///
    /// # Errors
    /// Another rank's failure.
    pub fn trade(&self, part: Part, messages: Vec<Vec<u32>>) -> Result<Vec<Vec<u32>>> {
        self.exchange.begin(part, messages)?;
        self.wait()
    }

    /// Waits for the messages of the oldest part that is on its way; the time of that is no work.
    fn wait(&self) -> Result<Vec<Vec<u32>>> {
        let mut watch = self.stopwatch.get();
        watch.worked += watch.since.elapsed();
        let got = self.exchange.wait();
        watch.since = Instant::now();
        self.stopwatch.set(watch);
        got
    }

    /// Seconds worked since the last call.
    fn lap(&self) -> f32 {
        let watch = self.stopwatch.get();
        let worked = watch.worked + watch.since.elapsed();
        self.stopwatch.set(Stopwatch {
            worked: Duration::ZERO,
            since: Instant::now(),
        });
        worked.as_secs_f32()
    }

    /// Rows of tiles of a rank's band.
    fn band(&self, rank: usize) -> Range<usize> {
        self.bands[rank] as usize..self.bands[rank + 1] as usize
    }

    /// Renders this rank's band of a view of all rows, and the pixel rows beside it that its loss sees. Waits.
    ///
    /// # Errors
    /// No room, another rank's failure, or the driver's.
    pub fn render(
        &mut self,
        forward: &mut Renderer<R>,
        scene: &GaussianBuffers<R>,
        camera: &CameraArg<R>,
        options: &RenderOptions,
    ) -> Result<()> {
        // What lay between two views is no work on them: orders, photos.
        self.lap();
        self.route.set_bands(&self.bands)?;
        let own = self.band(self.exchange.rank());
        forward.frame.fit_gaussians(&self.device, scene.stride)?;
        (forward.frame.camera, forward.frame.band) = (*camera, own);
        self.route.divide(&self.device, scene.count)?;
        let parts = 0..self.parts();
        for part in parts.clone() {
            let rows = self.route.rows(part);
            forward.project_rows(scene, options, rows)?;
            let sent = self.route.send(&self.device, &forward.frame, part)?;
            self.exchange.begin(Part::Records, sent)?;
        }
        self.worked.rows = std::mem::take(&mut self.updated) + self.lap();
        let got: Vec<_> = parts.map(|_| self.wait()).collect::<Result<_>>()?;
        self.route.receive(&self.device, got, &mut forward.frame)?;
        loop {
            forward.intersect_records(options.active_only)?;
            forward.composite(options.background)?;
            let needed = self.trade_borders(&forward.frame)?;
            match needed[self.exchange.rank()] {
                0 if needed.iter().all(|n| *n == 0) => return Ok(()),
                0 => {}
                needed => forward.grow_intersections(needed)?,
            }
        }
    }

    /// Pixel rows of another rank's band, and of those beside it, that this one has: [`HALO`] rows on either side of it.
    fn border(&self, of: usize, owner: usize, size: ImageSize) -> [Range<usize>; 2] {
        let (band, own) = (self.band(of), self.band(owner));
        if band.is_empty() {
            return [0..0, 0..0];
        }
        let tile = size.tile;
        let [first, end] = [band.start, band.end].map(|row| row * tile);
        let above = first.saturating_sub(HALO)..first;
        let below = end..(end + HALO).min(size.padded()[1]);
        [above, below].map(|rows| {
            let start = rows.start.max(own.start * tile);
            start..rows.end.min(own.end * tile).max(start)
        })
    }

    /// Rows of tiles beside another rank's band that this one has.
    fn beside(&self, of: usize, owner: usize, size: ImageSize) -> impl Iterator<Item = usize> {
        let (band, own) = (self.band(of), self.band(owner));
        let above = band.start.checked_sub(1);
        let below = Some(band.end).filter(|row| *row < size.tiles()[1]);
        let rows = [above, below].into_iter().flatten();
        rows.filter(move |row| !band.is_empty() && of != owner && own.contains(row))
    }

    /// Trades the pixel rows beside the bands, and the flags of the tiles there that have pairs; returns the pairs that each rank lacks room for.
    fn trade_borders(&mut self, frame: &ViewBuffers<R>) -> Result<Vec<u32>> {
        let (rank, size, ranks) = (self.exchange.rank(), frame.camera.image(), self.ranks());
        let borders: Vec<Vec<Section<'_>>> = (0..ranks)
            .map(|to| self.border_sections(frame, to, rank))
            .collect::<Result<_>>()?;
        let mut sections = vec![frame.status.section(0, status::SLOTS)?];
        sections.extend(BandTiles::sections(frame)?);
        let before: usize = sections.iter().map(Section::len).sum();
        sections.extend(borders.iter().flatten());
        let mut words = Vec::new();
        read_sections(&sections, 0, &mut words)?;
        let (counters, words) = words.split_at(status::SLOTS);
        let (tiles, mut words) = words.split_at(before - status::SLOTS);
        let tiles = BandTiles::new(frame, tiles);
        self.pairs = counters[status::INTERSECTIONS as usize] as usize;
        if self.exchange.apart() && rank != LEADER {
            self.worked.process = process_cpu_seconds() as f32;
        }
        let needed = counters[status::OVERFLOW as usize];
        let header = [&[needed], self.worked.words().as_slice()].concat();
        let (begins, mut messages) = (header.len(), to_all(self.exchange.as_ref(), header));
        for (to, (message, border)) in messages.iter_mut().zip(&borders).enumerate() {
            let (part, rest) = words.split_at(border.iter().map(Section::len).sum());
            words = rest;
            message.extend(part);
            for row in self.beside(to, rank, size) {
                message.extend(tiles.paired(row));
            }
        }
        messages[LEADER].extend(tiles.pairs_by_row().flatten());
        let got = self.trade(Part::Borders, messages)?;
        if rank == LEADER {
            self.pairs_by_row = vec![[0; 2]; size.tiles()[1]];
        }
        let (mut written, mut marks) = (Vec::new(), Vec::new());
        for (from, message) in got.iter().enumerate() {
            let mut at = begins;
            let mut next = |len: usize| {
                at += len;
                message.get(at - len..at).ok_or_else(short)
            };
            for section in self.border_sections(frame, rank, from)? {
                written.push((section, next(section.len())?));
            }
            for row in self.beside(rank, from, size) {
                marks.push(tiles.marks(row, next(size.tiles()[0])?));
            }
            if rank == LEADER {
                let told = message.get(1..begins).ok_or_else(short)?;
                self.worked_by_rank[from] = Worked::from_words(told).ok_or_else(short)?;
                let band = self.band(from);
                let part = next(2 * band.len())?;
                let rows = self.pairs_by_row[band].as_flattened_mut();
                rows.copy_from_slice(part);
            }
        }
        for (first, starts) in &marks {
            written.push((frame.tile_start.section(*first, starts.len())?, starts));
        }
        write_sections(&written)?;
        let first = |message: &Vec<u32>| message.first().copied().unwrap_or(0);
        Ok(got.iter().map(first).collect())
    }

    /// Pixels of another rank's border that this one has, in all channels.
    fn border_sections<'v>(
        &self,
        frame: &'v ViewBuffers<R>,
        of: usize,
        owner: usize,
    ) -> Result<Vec<Section<'v>>> {
        let size = frame.camera.image();
        let ([stride, _], plane) = (size.padded(), size.plane());
        let borders = self.border(of, owner, size).into_iter();
        let planes = borders.flat_map(|rows| (0..3).map(move |channel| (channel, rows.clone())));
        let section = |(channel, rows): (usize, Range<usize>)| {
            let at = channel * plane + rows.start * stride;
            frame.image.section(at, rows.len() * stride)
        };
        planes.map(section).collect()
    }

    /// Number of parts in which records and sums travel.
    #[must_use]
    pub fn parts(&self) -> usize {
        self.route.parts()
    }

    /// Begins to send the sums of the pairs of this rank's band to the ranks whose Gaussians they are. Waits for its own device alone.
    ///
    /// # Errors
    /// No room, another rank's failure, or the driver's.
    pub fn return_sums(&mut self, frame: &ViewBuffers<R>) -> Result<()> {
        let of = (frame, self.pairs);
        self.route.give_back(&self.device, &self.scan, of)?;
        for part in 0..self.parts() {
            let given = self.route.to_return(part)?;
            self.exchange.begin(Part::Sums, given)?;
        }
        self.worked.band = self.lap();
        Ok(())
    }

    /// Takes the sums of a part of the rows here, in the order of the parts; returns the rows. Waits.
    ///
    /// # Errors
    /// No room, another rank's failure, or the driver's.
    pub fn take_sums(&mut self, part: usize, frame: &mut ViewBuffers<R>) -> Result<Range<usize>> {
        // The step of the part before is taken meanwhile.
        self.device.flush()?;
        let got = self.wait()?;
        let (device, scan) = (&self.device, &self.scan);
        self.route.collect(device, scan, (part, got), frame)?;
        self.updated += self.lap();
        Ok(self.route.rows(part))
    }

    /// Waits for the update of the rows, which is work on them; of what is done while messages are waited for nothing counts.
    ///
    /// # Errors
    /// The driver's.
    pub fn end_update(&mut self) -> Result<()> {
        self.device.finish()?;
        self.updated += self.lap();
        Ok(())
    }

    /// Forgets the time of all work so far: it was on other rows.
    pub fn forget_times(&mut self) {
        self.lap();
        (self.updated, self.worked) = (0.0, Worked::default());
    }

    /// Takes flags of the Gaussians that this rank's band got of the view rendered last to the ranks whose Gaussians they are; returns those of
    /// its own rows, true if any band has them true.
    ///
    /// # Errors
    /// Another rank's failure, or the driver's.
    pub fn return_flags(&self, flags: &[bool]) -> Result<Vec<bool>> {
        let given = (0..self.ranks()).map(|rank| bits_of(&flags[self.route.got(rank)]));
        let got = self.trade(Part::Sums, given.collect())?;
        let mut own = vec![false; self.route.got(self.rank()).len()];
        for (rows, message) in self.route.sent_rows()?.iter().zip(&got) {
            for (row, flag) in rows.iter().zip(flags_of(message, rows.len())?) {
                own[*row as usize] |= flag;
            }
        }
        Ok(own)
    }

    /// Gives every rank the bands of all others of some planes of images.
    ///
    /// # Errors
    /// Another rank's failure, or the driver's.
    pub fn complete(&self, planes: &Array<R>, count: usize, size: ImageSize) -> Result<()> {
        self.bring(planes, count, size, &|own| {
            to_all(self.exchange.as_ref(), own)
        })
    }

    /// Gives the leader the bands of all others of the view rendered last, of which it has the whole image then.
    ///
    /// # Errors
    /// Another rank's failure, or the driver's.
    pub fn show_leader(&self, frame: &mut ViewBuffers<R>) -> Result<()> {
        let size = frame.camera.image();
        let to_leader = |own| to_one(self.exchange.as_ref(), LEADER, own);
        self.bring(&frame.image, 4, size, &to_leader)?;
        if self.rank() == LEADER {
            frame.band = 0..size.tiles()[1];
        }
        Ok(())
    }

    /// Brings bands of some planes of images to those ranks whose messages `address` makes of this one's.
    fn bring(
        &self,
        planes: &Array<R>,
        count: usize,
        size: ImageSize,
        address: &dyn Fn(Vec<u32>) -> Vec<Vec<u32>>,
    ) -> Result<()> {
        let ([stride, _], plane, tile) = (size.padded(), size.plane(), size.tile);
        let rank = self.exchange.rank();
        let rows = |of: usize| {
            let band = self.band(of);
            (band.start * tile * stride, band.len() * tile * stride)
        };
        let (first, len) = rows(rank);
        let mut own = Vec::new();
        let sections = (0..count).map(|k| planes.section(k * plane + first, len));
        read_sections(&sections.collect::<Result<Vec<_>>>()?, 0, &mut own)?;
        let got = self.trade(Part::Images, address(own))?;
        let mut written = Vec::new();
        for (from, message) in got.iter().enumerate().filter(|(from, _)| *from != rank) {
            let (first, len) = rows(from);
            let parts = message.chunks_exact((message.len() / count).max(1));
            for (k, part) in parts.enumerate() {
                written.push((planes.section(k * plane + first, len)?, part));
            }
        }
        write_sections(&written)
    }

    /// Gives the leader the sums of the loss of all bands; true there.
    ///
    /// # Errors
    /// Another rank's failure, or the driver's.
    pub fn sum_loss(&self, loss: &Loss<R>, pair: &ImagePair<'_, R>) -> Result<bool> {
        let (rank, mut own) = (self.exchange.rank(), Vec::new());
        let sections = |of: usize| -> Result<Vec<Section<'_>>> {
            let places = loss.places(pair.size, &self.band(of)).into_iter();
            let section = |place: Range<usize>| loss.partial.section(place.start, place.len());
            places.map(section).collect()
        };
        read_sections(&sections(rank)?, 0, &mut own)?;
        let messages = to_one(self.exchange.as_ref(), LEADER, own);
        let got = self.trade(Part::Loss, messages)?;
        if rank != LEADER {
            return Ok(false);
        }
        let mut written = Vec::new();
        for (from, message) in got.iter().enumerate() {
            let parts = message.chunks_exact((message.len() / 3).max(1));
            written.extend(sections(from)?.into_iter().zip(parts));
        }
        write_sections(&written)?;
        Ok(true)
    }
}

/// The error of a message that ends too soon.
fn short() -> Error {
    Error::numerics("exchange", "a message that is too short")
}
