//! Visible Gaussians of a rank → the bands of tile rows that they touch, and the sums of their pairs back (`kernels/route.cl`).

use std::mem::size_of;

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

/// The kernels, and what is on its way between ranks.
#[derive(Debug)]
pub struct Route<R: Real> {
    program: Program,
    rank: usize,
    ranks: usize,
    /// Gaussians of this rank that there is room for.
    stride: usize,
    /// First row of tiles of each band, and the number of rows.
    bands: Array<u32>,
    spans: Array<u32>,
    /// Gaussians of each chunk that touch a band.
    chunk_sums: Array<u32>,
    /// First of what each band gets, among what all get.
    firsts: Array<u32>,
    keys: Array<u32>,
    sent: Array<Projected<R>>,
    place: Array<u32>,
    /// Gaussians that each band gets.
    sent_counts: Vec<usize>,
    /// First of what this rank's own band gets.
    sent_first: usize,
    starts: Array<u32>,
    offsets: Array<u32>,
    returned: Array<R>,
    lengths: Array<u32>,
    row_start: Array<u32>,
    ordered: Array<R>,
    /// First of this rank's own sums in `ordered`, pairs.
    own_sums: usize,
}

/// Makes an array hold `len` values, with a quarter to spare where it is to grow. Contents are lost then.
fn fit<T: Element>(device: &Device, array: &mut Array<T>, len: usize) -> Result<()> {
    if array.len() < len {
        *array = Array::zeros(device, array.name(), len + len / 4)?;
    }
    Ok(())
}

impl<R: Real> Route<R> {
    /// Builds the kernels for one of so many ranks.
    pub fn new(kernels: &Kernels, [rank, ranks]: [usize; 2]) -> Result<Self> {
        let program = kernels.build::<R>("route")?;
        let device = kernels.device();
        let ints = |name, len| Array::<u32>::zeros(device, name, len);
        Ok(Self {
            rank,
            ranks,
            own_sums: 0,
            stride: 0,
            bands: ints("bands", ranks + 1)?,
            spans: ints("spans", 0)?,
            chunk_sums: ints("route sums", ranks * program.chunks())?,
            keys: ints("sent keys", 0)?,
            sent: Array::zeros(device, "sent", 0)?,
            place: ints("place", 0)?,
            firsts: ints("sent firsts", ranks)?,
            sent_counts: vec![0; ranks],
            sent_first: 0,
            starts: ints("starts", 0)?,
            offsets: ints("offsets", ranks)?,
            returned: Array::zeros(device, "returned", 0)?,
            lengths: ints("lengths", 0)?,
            row_start: ints("row_start", 0)?,
            ordered: Array::zeros(device, "ordered", 0)?,
            program,
        })
    }

    /// Sets the bands: the first row of tiles of each, and the number of rows.
    pub fn set_bands(&self, bands: &[u32]) -> Result<()> {
        self.bands.write(0, bands)
    }

    /// Finds the Gaussians of a view that each band gets; returns the message for each rank, keys before records. Those of this rank's own
    /// band stay on the device, and their message is their number. Waits.
    pub fn send(&mut self, device: &Device, view: &ViewBuffers<R>) -> Result<Vec<Vec<u32>>> {
        if self.stride < view.count {
            self.stride = view.count + view.count / 4;
            fit(device, &mut self.place, self.ranks * self.stride)?;
            fit(device, &mut self.spans, self.stride)?;
        }
        let (chunks, ranks) = (self.program.chunks(), self.ranks);
        let over_bands = |launch: Launch<'_>| {
            let group = launch.defines().tuning.tile_group();
            launch.run([chunks * group, ranks], [group, 1])
        };
        self.program
            .launch("route_spans")
            .array(&view.records, view.count)
            .array(&view.keys, view.count)
            .uints([view.count])
            .array(&self.spans, view.count)
            .over_items([view.count, 1])?;
        let launch = self.own("route_count", view).uints([chunks]);
        over_bands(launch.array(&self.chunk_sums, ranks * chunks))?;
        let counted = self.chunk_sums.read(0, ranks * chunks)?;
        let total = |of: &[u32]| of.iter().map(|n| *n as usize).sum();
        self.sent_counts = counted.chunks_exact(chunks).map(total).collect();
        let all: usize = self.sent_counts.iter().sum();
        let firsts: Vec<usize> = (self.sent_counts.iter())
            .scan(0, |end, n| {
                *end += n;
                Some(*end - n)
            })
            .collect();
        self.sent_first = firsts[self.rank];
        fit(device, &mut self.keys, all.max(1))?;
        fit(device, &mut self.sent, all.max(1))?;
        let written: Vec<u32> = firsts.iter().map(|first| *first as u32).collect();
        self.firsts.write(0, &written)?;
        let launch = self
            .own("route_pack", view)
            .uints([chunks])
            .array(&self.chunk_sums, ranks * chunks)
            .array(&view.records, view.count)
            .array(&view.keys, view.count)
            .array(&self.firsts, ranks)
            .array(&self.keys, all)
            .array(&self.sent, all)
            .uints([self.stride])
            .array(&self.place, ranks * self.stride);
        over_bands(launch)?;
        let message = |(rank, from): (usize, &usize)| {
            let n = self.sent_counts[rank];
            if rank == self.rank {
                return Ok(vec![n as u32]);
            }
            let mut words = self.keys.read_words(*from, n)?;
            words.extend(self.sent.read_words(*from, n)?);
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

    /// Takes the messages of [`Route::send`] of all ranks for this one: records and keys of a view, one rank's after the other's. Returns
    /// the first Gaussian of each rank, and their number.
    pub fn receive(
        &self,
        device: &Device,
        messages: &[Vec<u32>],
        view: &mut ViewBuffers<R>,
    ) -> Result<Vec<usize>> {
        let mut firsts = vec![0];
        for (rank, message) in messages.iter().enumerate() {
            let n = match rank == self.rank {
                true => message.first().copied().unwrap_or(0) as usize,
                false if !message.len().is_multiple_of(routed_words::<R>()) => {
                    let what = format!("{} words are no records", message.len());
                    return Err(Error::numerics("exchange", what));
                }
                false => message.len() / routed_words::<R>(),
            };
            firsts.push(firsts[rank] + n);
        }
        view.count = firsts[messages.len()];
        if view.keys.len() < view.count {
            view.fit_gaussians(device, view.count + view.count / 4)?;
        }
        for (rank, message) in messages.iter().enumerate() {
            let (first, n) = (firsts[rank], firsts[rank + 1] - firsts[rank]);
            if rank == self.rank {
                let from = self.sent_first;
                view.keys.copy_from(first, &self.keys, from, n)?;
                view.records.copy_from(first, &self.sent, from, n)?;
            } else {
                let (keys, records) = message.split_at(n);
                view.keys.write_words(first, keys)?;
                view.records.write_words(first, records)?;
            }
        }
        Ok(firsts)
    }

    /// The message for each rank whose Gaussians stand in a view from `firsts[rank]` on: first slots and their end, then the sums of
    /// their pairs. This rank's own stay on the device, and its message has the slots alone. Waits.
    pub fn give_back(
        &mut self,
        device: &Device,
        scan: &Program,
        view: &ViewBuffers<R>,
        firsts: &[usize],
    ) -> Result<Vec<Vec<u32>>> {
        fit(device, &mut self.lengths, view.count)?;
        fit(device, &mut self.row_start, view.count)?;
        self.band("route_lengths", view)
            .array(&self.lengths, view.count)
            .over_items([view.count, 1])?;
        let lengths = [&self.lengths, &self.row_start];
        scan::sum_pairs(scan, view, view.count, lengths)?;
        let mut starts = self.row_start.read(0, view.count)?;
        starts.push(view.pairs_found()?);
        let back = starts[view.count] as usize;
        fit(device, &mut self.ordered, back * SUMS)?;
        self.band("route_return", view)
            .array(&view.isect_start, view.count)
            .array(&self.row_start, view.count)
            .array(&view.sums, back * SUMS)
            .array(&self.ordered, back * SUMS)
            .over_items([view.count, 1])?;
        let message = |(rank, pair): (usize, &[usize])| {
            let of = &starts[pair[0]..=pair[1]];
            let (first, end) = (of[0] as usize, of[of.len() - 1] as usize);
            let mut words: Vec<u32> = of.iter().map(|start| start - of[0]).collect();
            if rank != self.rank {
                let sums = &self.ordered;
                words.extend(sums.read_words(first * SUMS, (end - first) * SUMS)?);
            }
            Ok(words)
        };
        self.own_sums = starts[firsts[self.rank]] as usize;
        firsts.windows(2).enumerate().map(message).collect()
    }

    /// Takes the messages of [`Route::give_back`] of all ranks for this one: pairs and their sums of the Gaussians of a view, by bands
    /// from top to bottom.
    ///
    /// # Errors
    /// Messages of another shape.
    pub fn collect(
        &mut self,
        device: &Device,
        scan: &Program,
        messages: &[Vec<u32>],
        view: &mut ViewBuffers<R>,
    ) -> Result<()> {
        let words = size_of::<R>() / size_of::<u32>() * SUMS;
        let (mut starts, mut offsets, mut pairs) = (Vec::new(), Vec::new(), 0);
        let mut parts = Vec::new();
        for (message, sent) in messages.iter().zip(&self.sent_counts) {
            let at = sent + 1;
            let (Some(&end), Some(sums)) = (message.get(at - 1), message.get(at..)) else {
                return Err(Error::numerics("exchange", "a message that is too short"));
            };
            let own = offsets.len() == self.rank;
            if !own && sums.len() != end as usize * words {
                let what = format!("sums of {} words for {end} pairs", sums.len());
                return Err(Error::numerics("exchange", what));
            }
            let all = pairs + end as usize;
            let first = u32::try_from(all).ok().and(u32::try_from(pairs).ok());
            let Some(first) = first else {
                let what = format!("{all} pairs of the Gaussians of one rank in one view");
                let fix = "train with more ranks, or lower --max-size or --max-gaussians";
                return Err(Error::device("route", what, fix));
            };
            offsets.push(starts.len() as u32);
            starts.extend(message[..at].iter().map(|start| start + first));
            parts.push((pairs, end as usize, sums));
            pairs += end as usize;
        }
        fit(device, &mut self.starts, starts.len())?;
        fit(device, &mut self.returned, pairs * SUMS)?;
        // A kernel takes no empty array.
        view.fit_sums(device, pairs.max(1))?;
        self.starts.write(0, &starts)?;
        self.offsets.write(0, &offsets)?;
        for (rank, (first, len, sums)) in parts.into_iter().enumerate() {
            if rank == self.rank {
                let (from, len) = (self.own_sums * SUMS, len * SUMS);
                let own = &self.ordered;
                self.returned.copy_from(first * SUMS, own, from, len)?;
            } else {
                self.returned.write_words(first * SUMS, sums)?;
            }
        }
        self.returning("route_pairs", view)
            .array(&view.isect_counts, view.count)
            .over_items([view.count, 1])?;
        let counts = [&view.isect_counts, &view.isect_start];
        scan::sum_pairs(scan, view, view.count, counts)?;
        self.returning("route_sums", view)
            .array(&self.returned, pairs * SUMS)
            .array(&view.isect_start, view.count)
            .array(&view.sums, pairs * SUMS)
            .over_items([view.count, 1])
    }

    /// A sweep over the Gaussians of a view.
    fn own(&self, kernel: &'static str, view: &ViewBuffers<R>) -> Launch<'_> {
        self.program
            .launch(kernel)
            .array(&self.spans, view.count)
            .uints([view.count])
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

    /// A sweep over the Gaussians of a view that takes what has come back.
    fn returning(&self, kernel: &'static str, view: &ViewBuffers<R>) -> Launch<'_> {
        self.own(kernel, view)
            .uints([self.ranks, self.stride])
            .array(&self.place, self.ranks * self.stride)
            .array(&self.starts, self.ranks)
            .array(&self.offsets, self.ranks)
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
