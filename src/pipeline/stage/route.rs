//! Visible Gaussians of a rank → the bands of tile rows that they touch, and the sums of their pairs back (`kernels/route.cl`).

use std::mem::size_of;
use std::ops::Range;

use crate::base::constants::SUMS;
use crate::base::error::{Error, Result};
use crate::device::{Array, Device, Element, Kernels, Launch, Program, Projected, Real};
use crate::pipeline::buffers::ViewBuffers;
use crate::pipeline::reference::TILE;
use crate::pipeline::stage::project::Projected64;
use crate::pipeline::stage::scan;

/// Words of a routed Gaussian: its key and its record.
const fn routed_words<R>() -> usize {
    1 + size_of::<Projected<R>>() / size_of::<u32>()
}

/// One part of the rows of a rank: its records on their way to the bands, while the device is at the next part.
#[derive(Debug)]
struct Trip<R: Real> {
    rows: Range<usize>,
    keys: Array<u32>,
    sent: Array<Projected<R>>,
    /// Gaussians that each band gets.
    sent_counts: Vec<usize>,
    /// First of what this rank's own band gets, in `sent`.
    sent_first: usize,
    /// Gaussians that this rank's band got of each rank, in its view.
    got: Vec<Range<usize>>,
}

/// The kernels, and what is on its way between ranks.
#[derive(Debug)]
pub struct Route<R: Real> {
    program: Program,
    rank: usize,
    ranks: usize,
    trips: Vec<Trip<R>>,
    /// Gaussians of this rank that there is room for.
    stride: usize,
    /// First row of tiles of each band, and the number of rows.
    bands: Array<u32>,
    spans: Array<u32>,
    /// Gaussians of each chunk that touch a band.
    chunk_sums: Array<u32>,
    /// First of what each band gets, among what all get.
    firsts: Array<u32>,
    place: Array<u32>,
    starts: Array<u32>,
    offsets: Array<u32>,
    shifts: Array<u32>,
    wanted: Array<u32>,
    before: Array<u32>,
    lengths: Array<u32>,
    row_start: Array<u32>,
    /// The sums before each Gaussian that this rank's band got, of those that go back, and their number.
    back: Vec<u32>,
    /// Sums that go to others, by Gaussian.
    ordered: Array<R>,
    /// Pairs of this rank's own Gaussians in its band.
    own_pairs: usize,
    /// Pairs of its own rows whose sums are there, those of other bands, too.
    there: usize,
}

/// Makes an array hold `len` values, with a quarter to spare where it is to grow. Contents are lost then.
fn fit<T: Element>(device: &Device, array: &mut Array<T>, len: usize) -> Result<()> {
    if array.len() < len {
        *array = Array::zeros(device, array.name(), len + len / 4)?;
    }
    Ok(())
}

impl<R: Real> Route<R> {
    /// Builds the kernels for one of so many ranks, whose rows travel in so many parts.
    pub fn new(kernels: &Kernels, [rank, ranks]: [usize; 2], parts: usize) -> Result<Self> {
        let program = kernels.build::<R>("route")?;
        let device = kernels.device();
        let ints = |name, len| Array::<u32>::zeros(device, name, len);
        let trip = |_| {
            Ok(Trip {
                rows: 0..0,
                keys: ints("sent keys", 0)?,
                sent: Array::zeros(device, "sent", 0)?,
                sent_counts: vec![0; ranks],
                sent_first: 0,
                got: vec![0..0; ranks],
            })
        };
        Ok(Self {
            rank,
            ranks,
            trips: (0..parts).map(trip).collect::<Result<_>>()?,
            stride: 0,
            bands: ints("bands", ranks + 1)?,
            spans: ints("spans", 0)?,
            chunk_sums: ints("route sums", ranks * program.chunks())?,
            firsts: ints("sent firsts", ranks)?,
            place: ints("place", 0)?,
            starts: ints("starts", 0)?,
            offsets: ints("offsets", ranks)?,
            shifts: ints("shifts", ranks)?,
            wanted: ints("wanted", 0)?,
            before: ints("before", 0)?,
            lengths: ints("lengths", 0)?,
            row_start: ints("row_start", 0)?,
            back: vec![0],
            ordered: Array::zeros(device, "ordered", 0)?,
            own_pairs: 0,
            there: 0,
            program,
        })
    }

    /// Sets the bands: the first row of tiles of each, and the number of rows.
    pub fn set_bands(&self, bands: &[u32]) -> Result<()> {
        self.bands.write(0, bands)
    }

    /// Number of parts.
    #[must_use]
    pub fn parts(&self) -> usize {
        self.trips.len()
    }

    /// Rows of a part, since they were divided last.
    #[must_use]
    pub fn rows(&self, part: usize) -> Range<usize> {
        self.trips[part].rows.clone()
    }

    /// Divides so many rows into the parts; each begins a run of the optimiser.
    pub fn divide(&mut self, device: &Device, count: usize) -> Result<()> {
        let (run, parts) = (self.program.defines().tuning.update_run(), self.trips.len());
        // Parts begin apart even where there is no row: PoCL compiles kernels that begin at 0 for themselves, and warming up runs both.
        let first = |k: usize| (k * count / parts + k).next_multiple_of(run);
        for (k, trip) in self.trips.iter_mut().enumerate() {
            let end = if k + 1 == parts { count } else { first(k + 1) };
            trip.rows = first(k)..end.min(count).max(first(k));
        }
        let room = count.max(first(parts));
        if self.stride < room {
            self.stride = room + room / 4;
            fit(device, &mut self.place, self.ranks * self.stride)?;
            fit(device, &mut self.spans, self.stride)?;
        }
        Ok(())
    }

    /// Finds the Gaussians of a part of the rows of a view that each band gets; returns the message for each rank, keys before records. Those
    /// of this rank's own band stay on the device: no word. Waits.
    pub fn send(
        &mut self,
        device: &Device,
        view: &ViewBuffers<R>,
        part: usize,
    ) -> Result<Vec<Vec<u32>>> {
        let (chunks, ranks, rows) = (self.program.chunks(), self.ranks, self.rows(part));
        let over_bands = |launch: Launch<'_>| {
            let group = launch.defines().tuning.tile_group();
            launch.run([chunks * group, ranks], [group, 1])
        };
        self.program
            .launch("route_spans")
            .array(&view.records, rows.end)
            .array(&view.keys, rows.end)
            .uints([rows.start, rows.end])
            .array(&self.spans, rows.end)
            .over_items([rows.len(), 1])?;
        let launch = self.own("route_count", &rows).uints([chunks]);
        over_bands(launch.array(&self.chunk_sums, ranks * chunks))?;
        let counted = self.chunk_sums.read(0, ranks * chunks)?;
        let total = |of: &[u32]| of.iter().map(|n| *n as usize).sum();
        let counts: Vec<usize> = counted.chunks_exact(chunks).map(total).collect();
        let all: usize = counts.iter().sum();
        let firsts: Vec<usize> = (counts.iter())
            .scan(0, |end, n| {
                *end += n;
                Some(*end - n)
            })
            .collect();
        let trip = &mut self.trips[part];
        fit(device, &mut trip.keys, all.max(1))?;
        fit(device, &mut trip.sent, all.max(1))?;
        (trip.sent_first, trip.sent_counts) = (firsts[self.rank], counts);
        let written: Vec<u32> = firsts.iter().map(|first| *first as u32).collect();
        self.firsts.write(0, &written)?;
        let trip = &self.trips[part];
        let launch = self
            .own("route_pack", &rows)
            .uints([chunks])
            .array(&self.chunk_sums, ranks * chunks)
            .array(&view.records, rows.end)
            .array(&view.keys, rows.end)
            .array(&self.firsts, ranks)
            .array(&trip.keys, all)
            .array(&trip.sent, all)
            .uints([self.stride])
            .array(&self.place, ranks * self.stride);
        over_bands(launch)?;
        let message = |(rank, from): (usize, &usize)| {
            let n = trip.sent_counts[rank];
            if rank == self.rank {
                return Ok(Vec::new());
            }
            let mut words = Vec::with_capacity(n * routed_words::<R>());
            trip.keys.append_words(*from, n, &mut words)?;
            trip.sent.append_words(*from, n, &mut words)?;
            Ok(words)
        };
        firsts.iter().enumerate().map(message).collect()
    }

    /// Rows of the view sent last that each band got, in the order in which it got them; waits.
    ///
    /// # Errors
    /// The driver's.
    pub fn sent_rows(&self, view: &ViewBuffers<R>) -> Result<Vec<Vec<u32>>> {
        let (spans, bands) = (self.spans.read(0, view.count)?, self.bands.to_vec()?);
        let rows = |band: &[u32]| -> Vec<u32> {
            let touches = |span: &u32| {
                let [first, last] = [span & 0xffff, span >> 16];
                last >= band[0] && first < band[1] && band[0] < band[1]
            };
            let rows = (0..).zip(&spans).filter(|(_, span)| touches(span));
            rows.map(|(row, _)| row).collect()
        };
        Ok(bands.windows(2).map(rows).collect())
    }

    /// Takes the messages of [`Route::send`] of all ranks for this one, by part: records and keys of a view, one rank's after the other's, in
    /// the order of its rows.
    ///
    /// # Errors
    /// Messages of another shape, no room, or the driver's.
    pub fn receive(
        &mut self,
        device: &Device,
        messages_by_part: &[Vec<Vec<u32>>],
        view: &mut ViewBuffers<R>,
    ) -> Result<()> {
        let mut end = 0;
        for rank in 0..self.ranks {
            for (trip, messages) in self.trips.iter_mut().zip(messages_by_part) {
                let words = messages.get(rank).map_or(0, Vec::len);
                let n = match rank == self.rank {
                    true => trip.sent_counts[rank],
                    false if !words.is_multiple_of(routed_words::<R>()) => {
                        let what = format!("{words} words are no records");
                        return Err(Error::numerics("exchange", what));
                    }
                    false => words / routed_words::<R>(),
                };
                trip.got[rank] = end..end + n;
                end += n;
            }
        }
        view.count = end;
        if view.keys.len() < view.count {
            view.fit_gaussians(device, view.count + view.count / 4)?;
        }
        for (trip, messages) in self.trips.iter().zip(messages_by_part) {
            for (rank, (got, message)) in trip.got.iter().zip(messages).enumerate() {
                let (first, n) = (got.start, got.len());
                if rank == self.rank {
                    let from = trip.sent_first;
                    view.keys.copy_from(first, &trip.keys, from, n)?;
                    view.records.copy_from(first, &trip.sent, from, n)?;
                } else {
                    let (keys, records) = message.split_at(n);
                    view.keys.write_words(first, keys)?;
                    view.records.write_words(first, records)?;
                }
            }
        }
        Ok(())
    }

    /// Gaussians that this rank's band got of a rank, in its view.
    #[must_use]
    pub fn got(&self, rank: usize) -> Range<usize> {
        let of = |trip: &Trip<R>| trip.got[rank].clone();
        let (first, last) = (self.trips.first().map(of), self.trips.last().map(of));
        first.map_or(0, |got| got.start)..last.map_or(0, |got| got.end)
    }

    /// Brings the sums of the pairs of this rank's band into the order of its Gaussians: those of other ranks' to go back
    /// ([`Route::to_return`]), and its own to `home`. Waits.
    pub fn give_back(
        &mut self,
        device: &Device,
        scan: &Program,
        view: &ViewBuffers<R>,
        home: &mut ViewBuffers<R>,
    ) -> Result<()> {
        fit(device, &mut self.lengths, view.count)?;
        fit(device, &mut self.row_start, view.count + 1)?;
        self.band("route_lengths", view)
            .array(&self.lengths, view.count)
            .over_items([view.count, 1])?;
        let lengths = [&self.lengths, &self.row_start];
        scan::sum_pairs(scan, view, view.count, lengths)?;
        let all = view.pairs_found()?;
        self.row_start.write(view.count, &[all])?;
        self.back = self.row_start.read(0, view.count + 1)?;
        let own = self.got(self.rank);
        let [before, after] = [own.start, own.end].map(|at| self.back[at]);
        self.own_pairs = (after - before) as usize;
        self.there = self.own_pairs;
        let others = all as usize - self.own_pairs;
        fit(device, &mut self.ordered, others * SUMS)?;
        // A kernel takes no empty array.
        home.fit_sums(device, self.own_pairs.max(1), 0)?;
        for (rows, base, to) in [
            (0..own.start, 0, &self.ordered),
            (own.clone(), before, &home.sums),
            (own.end..view.count, after - before, &self.ordered),
        ] {
            self.band("route_return", view)
                .uints([rows.start, rows.end])
                .array(&view.isect_start, view.count)
                .array(&self.row_start, view.count)
                .value(base)
                .array(&view.sums, all as usize * SUMS)
                .array(to, 0)
                .over_items([rows.len(), 1])?;
        }
        Ok(())
    }

    /// The message for each rank about its Gaussians of a part: the sums before each of them and all of them, then the sums. Own ones are there:
    /// no word. Waits.
    ///
    /// # Errors
    /// The driver's.
    pub fn to_return(&self, part: usize) -> Result<Vec<Vec<u32>>> {
        let message = |(rank, got): (usize, &Range<usize>)| {
            if rank == self.rank {
                return Ok(Vec::new());
            }
            let starts = &self.back[got.start..=got.end];
            let (first, end) = (starts[0] as usize, starts[got.len()] as usize);
            let gap = if rank < self.rank { 0 } else { self.own_pairs };
            let sums = (end - first) * SUMS;
            let mut words = Vec::with_capacity(starts.len() + sums * size_of::<R>() / 4);
            words.extend(starts);
            self.ordered
                .append_words((first - gap) * SUMS, sums, &mut words)?;
            Ok(words)
        };
        let got = self.trips[part].got.iter();
        got.enumerate().map(message).collect()
    }

    /// Takes the messages of [`Route::to_return`] of all ranks for a part of the rows of a view: pairs and their sums, by bands from top to
    /// bottom. Parts come in their order.
    ///
    /// # Errors
    /// Messages of another shape, no room, or the driver's.
    pub fn collect(
        &mut self,
        device: &Device,
        scan: &Program,
        (part, messages): (usize, &[Vec<u32>]),
        view: &mut ViewBuffers<R>,
    ) -> Result<()> {
        let words = size_of::<R>() / size_of::<u32>() * SUMS;
        let trip = &self.trips[part];
        let (mut offsets, mut shifts, mut came) = (Vec::new(), Vec::new(), Vec::new());
        let (mut place, mut end) = (0, self.there);
        for (rank, (message, n)) in messages.iter().zip(&trip.sent_counts).enumerate() {
            offsets.push(place as u32);
            place += n + 1;
            if rank == self.rank {
                let first = self.got(rank).start;
                shifts.push(0u32.wrapping_sub(self.back[first]));
                continue;
            }
            let Some((starts, sums)) = message.split_at_checked(n + 1) else {
                return Err(Error::numerics("exchange", "a message that is too short"));
            };
            let pairs = starts[*n].wrapping_sub(starts[0]) as usize;
            if sums.len() != pairs * words {
                let what = format!("sums of {} words for {pairs} pairs", sums.len());
                return Err(Error::numerics("exchange", what));
            }
            shifts.push((end as u32).wrapping_sub(starts[0]));
            came.push((rank, starts, end, sums));
            end += pairs;
        }
        self.check_pairs(end)?;
        view.fit_sums(device, end.max(1), self.there)?;
        fit(device, &mut self.starts, place)?;
        fit(device, &mut self.wanted, trip.rows.len().max(1))?;
        fit(device, &mut self.before, trip.rows.len().max(1))?;
        self.offsets.write(0, &offsets)?;
        self.shifts.write(0, &shifts)?;
        let (own, at) = (trip.got[self.rank].clone(), offsets[self.rank] as usize);
        self.starts
            .copy_from(at, &self.row_start, own.start, own.len() + 1)?;
        for (rank, starts, first, sums) in came {
            self.starts.write(offsets[rank] as usize, starts)?;
            view.sums.write_words(first * SUMS, sums)?;
        }
        let rows = trip.rows.clone();
        self.returning("route_pairs", &rows)
            .arrays([&view.isect_counts, &view.isect_start], rows.end)
            .array(&self.wanted, rows.len())
            .over_items([rows.len(), 1])?;
        let places = [&self.wanted, &self.before];
        scan::sum_pairs(scan, view, rows.len(), places)?;
        let together = view.pairs_found()? as usize;
        self.check_pairs(end + together)?;
        view.fit_sums(device, end + together, end)?;
        self.there = end + together;
        self.returning("route_sums", &rows)
            .arrays(places, rows.len())
            .uints([end])
            .array(&view.isect_start, rows.end)
            .array(&view.sums, self.there * SUMS)
            .over_items([rows.len(), 1])
    }

    /// Refuses more pairs than can be numbered.
    fn check_pairs(&self, pairs: usize) -> Result<()> {
        if u32::try_from(pairs).is_ok() {
            return Ok(());
        }
        let what = format!("{pairs} pairs of the Gaussians of one rank in one view");
        let fix = "train with more ranks, or lower --max-size or --max-gaussians";
        Err(Error::device("route", what, fix))
    }

    /// A sweep over rows of a view.
    fn own(&self, kernel: &'static str, rows: &Range<usize>) -> Launch<'_> {
        self.program
            .launch(kernel)
            .array(&self.spans, rows.end)
            .uints([rows.start, rows.end])
            .array(&self.bands, self.ranks + 1)
    }

    /// A sweep over the Gaussians that a band got.
    fn band(&self, kernel: &'static str, view: &ViewBuffers<R>) -> Launch<'_> {
        let rows = view.camera.tiles[1] as usize;
        self.program
            .launch(kernel)
            .array(&view.records, view.count)
            .uints([view.count, view.band.start, view.band.end, rows])
            .array(&view.isect_counts, view.count)
    }

    /// A sweep over rows of a view that takes what has come back.
    fn returning(&self, kernel: &'static str, rows: &Range<usize>) -> Launch<'_> {
        self.own(kernel, rows)
            .uints([self.ranks, self.stride])
            .array(&self.place, self.ranks * self.stride)
            .array(&self.starts, self.ranks)
            .arrays([&self.offsets, &self.shifts], self.ranks)
    }
}

// Definition in f64.

/// Numbers of the Gaussians that a band of tile rows gets, and their first and last pixel row there.
#[must_use]
pub fn route(projected: &[Option<Projected64>], band: [u32; 2]) -> Vec<(usize, [i32; 2])> {
    let [from, to] = band.map(|row| row as i32 * TILE);
    let inside = |(i, g): (usize, &Option<Projected64>)| {
        let [first, last] = g.as_ref()?.bounds[1];
        let cut = [first.max(from), last.min(to - 1)];
        (cut[0] <= cut[1]).then_some((i, cut))
    };
    projected.iter().enumerate().filter_map(inside).collect()
}
