//! Visible Gaussians of a rank → the bands of tile rows that they touch, and the sums of their pairs back (`kernels/route.cl`).

use std::mem::size_of;
use std::ops::Range;

use crate::base::constants::SUMS;
use crate::base::error::{Error, Result};
use crate::device::tuning::status;
use crate::device::{Array, Device, Element, Kernels, Launch, Program, Projected, Real};
use crate::device::{read_sections, write_sections};
use crate::pipeline::buffers::ViewBuffers;
use crate::pipeline::stage::project::Projected64;
use crate::pipeline::stage::scan::{self, Totals};

/// Words of a routed Gaussian: its key and its record.
const fn routed_words<R>() -> usize {
    1 + size_of::<Projected<R>>() / size_of::<u32>()
}

/// One part of the rows of a rank: its records on their way to the bands, while the device is at the next part.
#[derive(Debug)]
struct Trip<R: Real> {
    rows: Range<usize>,
    /// Keys and records for other ranks' bands.
    keys: Array<u32>,
    sent: Array<Projected<R>>,
    /// Gaussians of each chunk that touch each band.
    chunk_sums: Array<u32>,
    /// Gaussians that each band gets.
    sent_counts: Vec<usize>,
    /// Gaussians that this rank's band got of each other rank, in the view.
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
    /// Rows of this rank, which come first in the view.
    own: usize,
    /// First row of tiles of each band, and the number of rows.
    bands: Array<u32>,
    spans: Array<u32>,
    place: Array<u32>,
    starts: Array<u32>,
    offsets: Array<u32>,
    shifts: Array<u32>,
    wanted: Array<u32>,
    before: Array<u32>,
    /// Sums of chunks, and their total.
    chunk_totals: Array<u32>,
    status: Array<u32>,
    lengths: Array<u32>,
    row_start: Array<u32>,
    /// The sums before each Gaussian of other ranks that this rank's band got, of those that go back, and their number.
    back: Vec<u32>,
    /// Sums that go to others, by Gaussian.
    ordered: Array<R>,
    /// Pairs whose sums are there: those of this rank's band, and those of its own rows in other bands that have come.
    there: usize,
    /// The most that there have been.
    most: usize,
    /// Messages of records and of sums that have been received, to be written over by the next that are sent.
    spare: [Vec<Vec<u32>>; 2],
}

/// Place of messages of records in [`Route::spare`].
const RECORDS: usize = 0;
/// Place of messages of sums there.
const RETURNED: usize = 1;

/// Runs a sweep over chunks and so many ranks.
fn over_bands(launch: Launch<'_>, chunks: usize, ranks: usize) -> Result<()> {
    let group = launch.defines().tuning.tile_group();
    launch.run([chunks * group, ranks], [group, 1])
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
                chunk_sums: ints("route sums", ranks * program.chunks())?,
                sent_counts: vec![0; ranks],
                got: vec![0..0; ranks],
            })
        };
        Ok(Self {
            rank,
            ranks,
            trips: (0..parts).map(trip).collect::<Result<_>>()?,
            stride: 0,
            own: 0,
            bands: ints("bands", ranks + 1)?,
            spans: ints("spans", 0)?,
            place: ints("place", 0)?,
            starts: ints("starts", 0)?,
            offsets: ints("offsets", ranks)?,
            shifts: ints("shifts", ranks)?,
            wanted: ints("wanted", 0)?,
            before: ints("before", 0)?,
            chunk_totals: ints("chunk_totals", program.chunks())?,
            status: ints("status", status::SLOTS)?,
            lengths: ints("lengths", 0)?,
            row_start: ints("row_start", 0)?,
            back: vec![0],
            ordered: Array::zeros(device, "ordered", 0)?,
            there: 0,
            most: 0,
            spare: [Vec::new(), Vec::new()],
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
        self.own = count;
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
    /// of this rank's own band stay where they are, cut to it: no word. Waits.
    pub fn send(
        &mut self,
        device: &Device,
        view: &ViewBuffers<R>,
        part: usize,
    ) -> Result<Vec<Vec<u32>>> {
        let (chunks, ranks, rows) = (self.program.chunks(), self.ranks, self.rows(part));
        // The numbers of pairs will take their place, while they are still asked for.
        self.spans
            .copy_from(rows.start, &view.isect_counts, rows.start, rows.len())?;
        let sums = &self.trips[part].chunk_sums;
        let launch = self.over_rows("route_count", &rows).uints([chunks]);
        over_bands(launch.array(sums, ranks * chunks), chunks, ranks)?;
        let counted = sums.read(0, ranks * chunks)?;
        let total = |of: &[u32]| of.iter().map(|n| *n as usize).sum();
        let counts: Vec<usize> = counted.chunks_exact(chunks).map(total).collect();
        let before: usize = counts[..self.rank].iter().sum();
        let others = counts.iter().sum::<usize>() - counts[self.rank];
        let trip = &mut self.trips[part];
        fit(device, &mut trip.keys, others.max(1))?;
        fit(device, &mut trip.sent, others.max(1))?;
        trip.sent_counts = counts;
        let trip = &self.trips[part];
        let to = (&trip.keys, &trip.sent);
        self.pack(part, (0..self.rank, 0), view, to)?;
        self.pack(part, (self.rank + 1..ranks, before), view, to)?;
        let (mut end, mut messages) = (0, Vec::new());
        for (rank, n) in trip.sent_counts.iter().enumerate() {
            if rank == self.rank {
                messages.push(Vec::new());
                continue;
            }
            let mut words = self.spare[RECORDS].pop().unwrap_or_default();
            let sections = [trip.keys.section(end, *n)?, trip.sent.section(end, *n)?];
            read_sections(&sections, 0, &mut words)?;
            messages.push(words);
            end += n;
        }
        self.over_rows("route_stay", &rows)
            .uints([self.rank])
            .array(&view.records, rows.end)
            .arrays([&view.keys, &view.isect_counts], rows.end)
            .over_items([rows.len(), 1])?;
        Ok(messages)
    }

    /// Writes the keys and the records of a part of the rows of a view that some ranks' bands get, from a place on.
    fn pack(
        &self,
        part: usize,
        (ranks, first): (Range<usize>, usize),
        view: &ViewBuffers<R>,
        (keys, records): (&Array<u32>, &Array<Projected<R>>),
    ) -> Result<()> {
        let (chunks, rows, trip) = (self.program.chunks(), self.rows(part), &self.trips[part]);
        let end = first + trip.sent_counts[ranks.clone()].iter().sum::<usize>();
        // Of no Gaussians it is launched, too: warming up compiles it so.
        if ranks.is_empty() {
            return Ok(());
        }
        let launch = self
            .over_rows("route_pack", &rows)
            .uints([chunks])
            .array(&trip.chunk_sums, self.ranks * chunks)
            .array(&view.records, rows.end)
            .array(&view.keys, rows.end)
            .uints([ranks.start, first])
            .array(keys, end)
            .array(records, end)
            .uints([self.stride])
            .array(&self.place, self.ranks * self.stride);
        over_bands(launch, chunks, ranks.len())
    }

    /// Rows of the view sent last that each band got, in the order in which it got them; those in the own band are all. Waits.
    ///
    /// # Errors
    /// The driver's.
    pub fn sent_rows(&self) -> Result<Vec<Vec<u32>>> {
        let (spans, bands) = (self.spans.read(0, self.own)?, self.bands.to_vec()?);
        let rows = |band: &[u32]| -> Vec<u32> {
            let touches = |span: &u32| {
                let [first, end] = [span & 0xffff, span >> 16];
                end > band[0] && first < band[1] && band[0] < band[1]
            };
            let rows = (0..).zip(&spans).filter(|(_, span)| touches(span));
            rows.map(|(row, _)| row).collect()
        };
        let mut sent: Vec<Vec<u32>> = bands.windows(2).map(rows).collect();
        sent[self.rank] = (0..self.own as u32).collect();
        Ok(sent)
    }

    /// Takes the messages of [`Route::send`] of all ranks for this one, by part: records and keys behind the rows of the view, one rank's after the
    /// other's, in the order of its rows.
    ///
    /// # Errors
    /// Messages of another shape, no room, or the driver's.
    pub fn receive(
        &mut self,
        device: &Device,
        messages_by_part: Vec<Vec<Vec<u32>>>,
        view: &mut ViewBuffers<R>,
    ) -> Result<()> {
        let mut end = self.own;
        for rank in 0..self.ranks {
            if rank == self.rank {
                view.early = self.own..end;
                continue;
            }
            for (trip, messages) in self.trips.iter_mut().zip(&messages_by_part) {
                let words = messages.get(rank).map_or(0, Vec::len);
                if !words.is_multiple_of(routed_words::<R>()) {
                    let what = format!("{words} words are no records");
                    return Err(Error::numerics("exchange", what));
                }
                let n = words / routed_words::<R>();
                trip.got[rank] = end..end + n;
                end += n;
            }
        }
        view.count = end;
        view.grow_gaussians(device, view.count, self.own)?;
        let mut written = Vec::new();
        for (trip, messages) in self.trips.iter().zip(&messages_by_part) {
            for (rank, (got, message)) in trip.got.iter().zip(messages).enumerate() {
                let (first, n) = (got.start, got.len());
                if rank != self.rank {
                    let (keys, records) = message.split_at(n);
                    written.push((view.keys.section(first, n)?, keys));
                    written.push((view.records.section(first, n)?, records));
                }
            }
        }
        write_sections(&written)?;
        self.keep(RECORDS, messages_by_part.into_iter().flatten());
        Ok(())
    }

    /// Keeps messages of others to be written over.
    fn keep(&mut self, kind: usize, messages: impl Iterator<Item = Vec<u32>>) {
        let (spare, most) = (&mut self.spare[kind], (self.ranks - 1) * self.trips.len());
        spare.extend(messages.filter(|m| m.capacity() > 0));
        spare.truncate(most);
    }

    /// Gaussians that this rank's band got of a rank, in the view; of its own rows those that are elsewhere, too.
    #[must_use]
    pub fn got(&self, rank: usize) -> Range<usize> {
        if rank == self.rank {
            return 0..self.own;
        }
        let of = |trip: &Trip<R>| trip.got[rank].clone();
        let (first, last) = (self.trips.first().map(of), self.trips.last().map(of));
        first.map_or(0, |got| got.start)..last.map_or(0, |got| got.end)
    }

    /// Brings the sums of the pairs of this rank's band that are of other ranks' Gaussians into the order of these, to go back
    /// ([`Route::to_return`]); its own stay where they are, among the `pairs` of the view. Waits.
    pub fn give_back(
        &mut self,
        device: &Device,
        scan: &Program,
        (view, pairs): (&ViewBuffers<R>, usize),
    ) -> Result<()> {
        let (own, count) = (self.own, view.count);
        let others = count - own;
        fit(device, &mut self.lengths, others)?;
        fit(device, &mut self.row_start, others)?;
        let lengths = [&self.lengths, &self.row_start];
        let over = |kernel| {
            let launch = self.program.launch(kernel).uints([own, count]);
            launch.array(&view.isect_counts, count)
        };
        let (band, rows) = (&view.band, view.camera.image().tiles()[1]);
        over("route_lengths")
            .array(&view.records, count)
            .uints([band.start, band.end, rows])
            .array(&self.lengths, others)
            .over_items([others, 1])?;
        scan::sum_pairs(scan, &self.totals(), others, lengths)?;
        let sections = [
            self.row_start.section(0, others)?,
            self.status.section(status::INTERSECTIONS as usize, 1)?,
        ];
        read_sections(&sections, 0, &mut self.back)?;
        let back = self.back[others] as usize;
        self.there = pairs;
        fit(device, &mut self.ordered, back * SUMS)?;
        over("route_return")
            .array(&view.isect_start, count)
            .arrays(lengths, others)
            .array(&view.sums, pairs * SUMS)
            .array(&self.ordered, back * SUMS)
            .over_items([others, 1])
    }

    /// The message for each rank about its Gaussians of a part: the sums before each of them and all of them, then the sums. Own ones are there:
    /// no word. Waits.
    ///
    /// # Errors
    /// The driver's.
    pub fn to_return(&mut self, part: usize) -> Result<Vec<Vec<u32>>> {
        let mut messages = Vec::new();
        for (rank, got) in self.trips[part].got.iter().enumerate() {
            if rank == self.rank {
                messages.push(Vec::new());
                continue;
            }
            let starts = &self.back[got.start - self.own..=got.end - self.own];
            let (first, end) = (starts[0] as usize, starts[got.len()] as usize);
            let mut words = self.spare[RETURNED].pop().unwrap_or_default();
            // What is there is written over.
            if words.len() < starts.len() {
                words.resize(starts.len(), 0);
            }
            words[..starts.len()].copy_from_slice(starts);
            let sums = self.ordered.section(first * SUMS, (end - first) * SUMS)?;
            read_sections(&[sums], starts.len(), &mut words)?;
            messages.push(words);
        }
        Ok(messages)
    }

    /// Takes the messages of [`Route::to_return`] of all ranks for a part of the rows of a view: pairs and their sums, by bands from top to
    /// bottom, those of this rank's own band among them. Parts come in their order, once for each render.
    ///
    /// # Errors
    /// Messages of another shape, no room, or the driver's.
    pub fn collect(
        &mut self,
        device: &Device,
        scan: &Program,
        (part, messages): (usize, Vec<Vec<u32>>),
        view: &mut ViewBuffers<R>,
    ) -> Result<()> {
        let words = size_of::<R>() / size_of::<u32>() * SUMS;
        let trip = &self.trips[part];
        let (mut offsets, mut shifts, mut came) = (Vec::new(), Vec::new(), Vec::new());
        let (mut place, mut end) = (0, self.there);
        for (rank, (message, n)) in messages.iter().zip(&trip.sent_counts).enumerate() {
            offsets.push(place as u32);
            if rank == self.rank {
                shifts.push(0);
                continue;
            }
            place += n + 1;
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
        // Room for what is to be put together, too, by the views before.
        view.fit_sums(device, end.max(self.most).max(1), self.there)
            .or_else(|_| view.fit_sums(device, end, self.there))?;
        fit(device, &mut self.starts, place.max(1))?;
        fit(device, &mut self.wanted, trip.rows.len().max(1))?;
        fit(device, &mut self.before, trip.rows.len().max(1))?;
        let mut written = vec![
            (self.offsets.section(0, self.ranks)?, &*offsets),
            (self.shifts.section(0, self.ranks)?, &*shifts),
        ];
        for (rank, starts, first, sums) in came {
            let at = offsets[rank] as usize;
            written.push((self.starts.section(at, starts.len())?, starts));
            let pairs = sums.len() / words;
            written.push((view.sums.section(first * SUMS, pairs * SUMS)?, sums));
        }
        write_sections(&written)?;
        let rows = trip.rows.clone();
        self.keep(RETURNED, messages.into_iter());
        self.returning("route_pairs", part)
            .arrays([&view.isect_counts, &view.isect_start], rows.end)
            .array(&self.wanted, rows.len())
            .over_items([rows.len(), 1])?;
        let places = [&self.wanted, &self.before];
        scan::sum_pairs(scan, &self.totals(), rows.len(), places)?;
        let together = self.status.read(status::INTERSECTIONS as usize, 1)?[0] as usize;
        self.check_pairs(end + together)?;
        view.fit_sums(device, end + together, end)?;
        self.there = end + together;
        self.most = self.most.max(self.there);
        self.returning("route_sums", part)
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
        let what =
            format!("{pairs} pairs of one view in the band and of the Gaussians of one rank");
        let fix = "train with more ranks, or lower --max-size or --max-gaussians";
        Err(Error::device("route", what, fix))
    }

    /// A sweep over rows of a view.
    fn over_rows(&self, kernel: &'static str, rows: &Range<usize>) -> Launch<'_> {
        self.program
            .launch(kernel)
            .array(&self.spans, rows.end)
            .uints([rows.start, rows.end])
            .array(&self.bands, self.ranks + 1)
    }

    /// A sweep over a part of the rows of a view that takes what has come back.
    fn returning(&self, kernel: &'static str, part: usize) -> Launch<'_> {
        self.over_rows(kernel, &self.rows(part))
            .uints([self.ranks, self.rank, self.stride])
            .array(&self.place, self.ranks * self.stride)
            .array(&self.starts, 1)
            .arrays([&self.offsets, &self.shifts], self.ranks)
    }

    /// Arrays in which pairs that come and go are added up.
    fn totals(&self) -> Totals<'_> {
        Totals {
            chunk_sums: &self.chunk_totals,
            status: &self.status,
            most: u32::MAX as usize,
        }
    }
}

// Definition in f64.

/// Numbers of the Gaussians that a band of rows of tiles of so many pixels a side gets, and their first and last pixel row there.
#[must_use]
pub fn route(
    projected: &[Option<Projected64>],
    tile: i32,
    band: [u32; 2],
) -> Vec<(usize, [i32; 2])> {
    let [from, to] = band.map(|row| row as i32 * tile);
    let inside = |(i, g): (usize, &Option<Projected64>)| {
        let [first, last] = g.as_ref()?.bounds[1];
        let cut = [first.max(from), last.min(to - 1)];
        (cut[0] <= cut[1]).then_some((i, cut))
    };
    projected.iter().enumerate().filter_map(inside).collect()
}
