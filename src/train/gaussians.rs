//! [`GaussianState`]: everything that training keeps per Gaussian. Every operation on the set is here and treats all of it.

use std::ops::Range;

use crate::base::error::{Error, Result};
use crate::device::{Array, Arrived, Device, PendingRead, Program};
use crate::pipeline::buffers::{GaussianBuffers, GradientBlock};
use crate::pipeline::room::{check_memory, check_room, restride};
use crate::pipeline::share::Share;
use crate::pipeline::stage::edit;
use crate::ranks::Part;
use crate::scene::{self, Gaussians, Plane};

/// Number of arrays of parameters and their moments.
const OPTIMIZED: usize = 3;
/// Planes that change their order at a time: no fewer than a snapshot has.
const SCRATCH: usize = 16;

/// Parameters, optimiser moments, 3D smoothing filter and error statistics of all Gaussians on the device.
#[derive(Debug)]
pub struct GaussianState {
    /// Parameters and smoothing filter.
    pub scene: GaussianBuffers,
    /// First and second moments \[planes, stride\].
    pub moments: [Array<f32>; 2],
    /// Statistics that density control has gathered since its last step \[rows, stride\].
    pub statistics: Array<f32>,
    /// Rows of the statistics.
    pub rows: usize,
    /// Sums of the gradients of the views of a batch so far \[planes, stride\]; empty unless views come in batches.
    gradients: Array<f32>,
    batched: bool,
    /// Planes on their way to another order or to the host \[[`SCRATCH`], stride\]; empty before the first change.
    scratch: Array<f32>,
}

/// Arrays that go with Gaussians to other places.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Carried {
    /// Parameters and moments. The statistics and the smoothing filter stay as they are: they are to start anew.
    Optimized,
    /// Everything that belongs to them.
    All,
}

impl Carried {
    /// Number of arrays, the first ones.
    fn arrays(self) -> usize {
        match self {
            Self::Optimized => OPTIMIZED,
            Self::All => usize::MAX,
        }
    }
}

/// Rows of a checkpoint, in the order of the Gaussians.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GaussianRows {
    /// First moments, planes as in [`Gaussians`].
    pub moment1: Vec<Vec<f32>>,
    /// Second moments.
    pub moment2: Vec<Vec<f32>>,
    /// Statistics of density control \[rows\]\[N\].
    pub statistics: Vec<Vec<f32>>,
    /// Standard deviations of the smoothing filter \[N\], local units; empty without anti-aliasing.
    pub filter: Vec<f32>,
    /// Sums of the gradients of a batch that has begun, planes as in [`Gaussians`]; empty between batches.
    pub gradients: Vec<Vec<f32>>,
}

/// Position, log-scale, rotation, opacity logit and the statistics of all Gaussians as they were at one time \[11 + rows\]\[N\].
#[derive(Debug)]
pub struct Snapshot {
    values: Values,
    count: usize,
}

#[derive(Debug)]
enum Values {
    Read(Arrived<f32>),
    /// Put together from those of several ranks.
    Joined(Vec<f32>),
}

/// A snapshot on its way to the host.
#[derive(Debug)]
pub enum PendingSnapshot {
    /// The transfer from this device, and the number of Gaussians.
    Coming(PendingRead<f32>, usize),
    /// One that is there.
    Here(Snapshot),
}

impl PendingSnapshot {
    /// Waits for the values.
    ///
    /// # Errors
    /// The driver's.
    pub fn wait(self) -> Result<Snapshot> {
        match self {
            Self::Coming(values, count) => Ok(Snapshot {
                values: Values::Read(values.arrived()?),
                count,
            }),
            Self::Here(snapshot) => Ok(snapshot),
        }
    }

    /// The snapshot of the rows of all ranks, each of which gives its own; waits.
    ///
    /// # Errors
    /// Another rank's failure, or the driver's.
    pub fn of_all(self, share: &Share<f32>) -> Result<Self> {
        let Self::Coming(own, count) = self else {
            return Ok(self);
        };
        let own = own.arrived()?;
        let mut words = vec![count as u32];
        words.extend(own.iter().map(|v| v.to_bits()));
        let planes = own.len().checked_div(count).unwrap_or(0);
        let got = share.tell_all(Part::Evidence, words)?;
        let counts: Vec<usize> = got
            .iter()
            .map(|m| m.first().map_or(0, |n| *n as usize))
            .collect();
        // A rank without rows does not see how many planes the others have.
        let filled = got.iter().zip(&counts).filter(|(_, n)| **n > 0);
        let planes = filled.fold(planes, |_, (m, n)| (m.len() - 1) / n);
        let mut values = Vec::new();
        for plane in 0..planes {
            for (message, n) in got.iter().zip(&counts) {
                let part = message.get(1 + plane * n..1 + (plane + 1) * n);
                let part =
                    part.ok_or_else(|| Error::numerics("exchange", "a message that is too short"))?;
                values.extend(part.iter().map(|v| f32::from_bits(*v)));
            }
        }
        Ok(Self::Here(Snapshot {
            values: Values::Joined(values),
            count: counts.iter().sum(),
        }))
    }
}

impl Snapshot {
    /// Values of a plane below [`Plane::SH`].
    #[must_use]
    pub fn plane(&self, plane: usize) -> &[f32] {
        let values: &[f32] = match &self.values {
            Values::Read(values) => values,
            Values::Joined(values) => values,
        };
        &values[plane * self.count..][..self.count]
    }

    /// Values of a row of the statistics.
    #[must_use]
    pub fn statistics(&self, row: usize) -> &[f32] {
        self.plane(Plane::SH + row)
    }
}

/// The error of a saved state that does not fit.
pub(super) fn mismatch(what: String) -> Error {
    Error::numerics("checkpoint", what)
}

impl GaussianState {
    /// Uploads Gaussians with room for `capacity`, a smoothing filter if they are `smoothed` and sums of gradients if views are
    /// `batched`; moments and statistics are zero.
    pub fn new(
        device: &Device,
        splats: &Gaussians,
        capacity: usize,
        rows: usize,
        [smoothed, batched]: [bool; 2],
    ) -> Result<Self> {
        let mut scene = GaussianBuffers::upload(device, splats, capacity)?;
        if smoothed {
            scene = scene.with_filter(device)?;
        }
        let len = scene.planes() * scene.stride;
        Ok(Self {
            moments: [
                Array::zeros(device, "moment1", len)?,
                Array::zeros(device, "moment2", len)?,
            ],
            statistics: Array::zeros(device, "statistics", rows * scene.stride)?,
            gradients: Array::zeros(device, "gradients", if batched { len } else { 0 })?,
            batched,
            scratch: Array::zeros(device, "scratch", 0)?,
            rows,
            scene,
        })
    }

    /// A state of no Gaussians with the same planes and rows, for kernels that are only to be built.
    pub fn empty(&self, device: &Device, sh_degree: u32) -> Result<Self> {
        let smoothed = !self.scene.filter.is_empty();
        Self::new(
            device,
            &Gaussians::zeros(sh_degree, 0),
            0,
            self.rows,
            [smoothed, self.batched],
        )
    }

    /// The sums of the gradients of so many views of a batch, of some rows.
    #[must_use]
    pub fn gradients(&self, views: usize, rows: Range<usize>) -> GradientBlock<'_, f32> {
        GradientBlock {
            values: &self.gradients,
            planes: self.scene.planes(),
            stride: self.scene.stride,
            first: 0,
            rows,
            views,
        }
    }

    /// Forgets the gradients of a batch that has begun.
    pub fn clear_gradients(&self) -> Result<()> {
        self.gradients.clear()
    }

    /// Arrays with a value per Gaussian and plane, each with its number of planes, the first [`OPTIMIZED`] being parameters and moments;
    /// and the scratch.
    fn arrays(&mut self) -> ([(&mut Array<f32>, usize); 6], &mut Array<f32>) {
        let [params, moments1, moments2, filter, statistics, gradients] =
            self.held().map(|held| held.1);
        let [moment1, moment2] = &mut self.moments;
        let arrays = [
            (&mut self.scene.params, params),
            (moment1, moments1),
            (moment2, moments2),
            (&mut self.scene.filter, filter),
            (&mut self.statistics, statistics),
            (&mut self.gradients, gradients),
        ];
        (arrays, &mut self.scratch)
    }

    /// The same arrays, to be read.
    fn held(&self) -> [(&Array<f32>, usize); 6] {
        let planes = self.scene.planes();
        let smoothed = usize::from(!self.scene.filter.is_empty());
        let [moment1, moment2] = &self.moments;
        [
            (&self.scene.params, planes),
            (moment1, planes),
            (moment2, planes),
            (&self.scene.filter, smoothed),
            (&self.statistics, self.rows),
            (&self.gradients, if self.batched { planes } else { 0 }),
        ]
    }

    /// Refuses more Gaussians than a device has memory for, with what belongs to them.
    pub fn check_memory(&self, device: &Device, rows: usize) -> Result<()> {
        if rows <= self.scene.stride {
            return Ok(());
        }
        let planes = self.held().iter().map(|(_, planes)| planes).sum();
        let room = GaussianBuffers::<f32>::grown_stride(rows);
        check_memory([rows, room, planes], device.info().global_memory)
    }

    /// Makes room for `rows` Gaussians; the new ones are zero.
    pub fn grow(&mut self, device: &Device, rows: usize) -> Result<()> {
        let from = self.scene.stride;
        if rows <= from {
            return Ok(());
        }
        let to = GaussianBuffers::<f32>::grown_stride(rows);
        for (array, planes) in self.arrays().0 {
            if planes > 0 {
                *array = restride(device, array, planes, from, to)?;
            }
        }
        self.scene.stride = to;
        Ok(())
    }

    /// Gives up what is beyond the first `rows` Gaussians, and the room beyond `capacity`.
    pub fn shrink(&mut self, device: &Device, rows: usize, capacity: usize) -> Result<()> {
        let from = self.scene.stride;
        let to = GaussianBuffers::<f32>::stride_of(capacity.max(rows));
        if to >= from {
            self.scene.count = rows;
            return Ok(());
        }
        for (array, planes) in self.arrays().0 {
            if planes > 0 {
                *array = restride(device, array, planes, from, to)?;
            }
        }
        self.scratch = Array::zeros(device, "scratch", 0)?;
        (self.scene.stride, self.scene.count) = (to, rows);
        Ok(())
    }

    /// Gives up the room beyond a quarter to grow into, if it is much.
    pub fn shrink_far(&mut self, device: &Device) -> Result<()> {
        let count = self.scene.count;
        let least = GaussianBuffers::<f32>::grown_stride(count);
        match 4 * self.scene.stride > 5 * least {
            true => self.shrink(device, count, least),
            false => Ok(()),
        }
    }

    /// Applies the edits of a density step, which leave `rows` rows. The statistics start anew, and the smoothing filter is to be computed
    /// again. `stage` is a build of `kernels/edit.cl`.
    pub fn edit(
        &mut self,
        device: &Device,
        stage: &Program,
        edits: &[scene::Edit],
        rows: usize,
        logit_limit: Option<f32>,
    ) -> Result<()> {
        self.grow(device, rows)?;
        self.statistics.clear()?;
        let edits = Array::from_slice(device, "edits", edits)?;
        self.scene.count = rows;
        let (scene, moments) = (&self.scene, self.moments.each_ref());
        edit::write_rows(stage, scene, moments, &edits)?;
        match logit_limit {
            Some(limit) => edit::limit_opacity(stage, scene, moments, f64::from(limit)),
            None => Ok(()),
        }
    }

    /// Keeps the first `kept` Gaussians of an order, in that order.
    pub fn reorder(
        &mut self,
        device: &Device,
        stage: &Program,
        kept: (&Array<u32>, usize),
        carried: Carried,
    ) -> Result<()> {
        self.fit_scratch(device)?;
        let stride = self.scene.stride;
        let (arrays, scratch) = self.arrays();
        for (array, planes) in arrays.into_iter().take(carried.arrays()) {
            for first in (0..planes).step_by(SCRATCH) {
                let some = SCRATCH.min(planes - first);
                edit::gather_rows(stage, kept, [first, some, stride], [array, scratch])?;
                array.copy_from(first * stride, scratch, 0, some * stride)?;
            }
        }
        self.scene.count = kept.1;
        Ok(())
    }

    fn fit_scratch(&mut self, device: &Device) -> Result<()> {
        let len = SCRATCH * self.scene.stride;
        if self.scratch.len() < len {
            check_room::<f32>(device, "scratch", SCRATCH, self.scene.stride)?;
            self.scratch = Array::unset(device, "scratch", len)?;
        }
        Ok(())
    }

    /// Enqueues the transfer of position, scale, rotation, opacity and statistics as they are once everything enqueued so far is done.
    pub fn snapshot(&mut self, device: &Device, stage: &Program) -> Result<PendingSnapshot> {
        self.fit_scratch(device)?;
        let (count, planes) = (self.scene.count, Plane::SH + self.rows);
        edit::pack(
            stage,
            &self.scene,
            (&self.statistics, self.rows),
            &self.scratch,
        )?;
        let values = self.scratch.read_later(0, planes * count)?;
        Ok(PendingSnapshot::Coming(values, count))
    }

    /// Makes room for the coefficients of a higher SH degree, which are zero, as are their moments and gradients.
    pub fn raise_sh_degree(&mut self, device: &Device, degree: u32) -> Result<()> {
        let stride = self.scene.stride;
        let [from, to] = [self.scene.sh_degree, degree].map(|d| Plane::count(d) * stride);
        let [moment1, moment2] = &mut self.moments;
        let summed = self.batched.then_some(&mut self.gradients);
        for array in [&mut self.scene.params, moment1, moment2]
            .into_iter()
            .chain(summed)
        {
            check_room::<f32>(device, array.name(), to / stride, stride)?;
            let new = Array::unset(device, array.name(), to)?;
            new.copy_from(0, array, 0, from)?;
            new.clear_range(from, to - from)?;
            *array = new;
        }
        self.scene.sh_degree = degree;
        Ok(())
    }

    /// The arrays that some rows carry, as words: array by array and plane by plane. `stage` is a build of `kernels/edit.cl`.
    pub fn pick_words(
        &mut self,
        device: &Device,
        stage: &Program,
        rows: &[u32],
        carried: Carried,
    ) -> Result<Vec<u32>> {
        if rows.is_empty() {
            return Ok(Vec::new());
        }
        self.fit_scratch(device)?;
        let order = Array::from_slice(device, "row order", rows)?;
        let stride = self.scene.stride;
        let (arrays, scratch) = self.arrays();
        let mut words = Vec::new();
        for (array, planes) in arrays.into_iter().take(carried.arrays()) {
            for first in (0..planes).step_by(SCRATCH) {
                let some = SCRATCH.min(planes - first);
                let kept = (&order, rows.len());
                edit::gather_rows(stage, kept, [first, some, stride], [array, scratch])?;
                for plane in 0..some {
                    scratch.append_words(plane * stride, rows.len(), &mut words)?;
                }
            }
        }
        Ok(words)
    }

    /// Everything that belongs to some rows, as words: array by array and plane by plane.
    pub fn read_words(&self, rows: Range<usize>) -> Result<Vec<u32>> {
        let (stride, len) = (self.scene.stride, rows.len());
        let mut words = Vec::new();
        for (array, planes) in self.held() {
            for plane in 0..planes {
                array.append_words(plane * stride + rows.start, len, &mut words)?;
            }
        }
        Ok(words)
    }

    /// Writes what [`GaussianState::read_words`] or [`GaussianState::pick_words`] has read from a state of as many planes.
    ///
    /// # Errors
    /// Another number of words, or the driver's.
    pub fn write_words(&self, rows: Range<usize>, words: &[u32], carried: Carried) -> Result<()> {
        let (stride, len) = (self.scene.stride, rows.len());
        let held = || self.held().into_iter().take(carried.arrays());
        let planes: usize = held().map(|(_, planes)| planes).sum();
        if words.len() != planes * len {
            let what = format!("{} words for {planes} planes of {len} rows", words.len());
            return Err(Error::numerics("rows", what));
        }
        let mut parts = words.chunks_exact(len.max(1));
        for (array, planes) in held() {
            for (plane, part) in (0..planes).zip(&mut parts) {
                array.write_words(plane * stride + rows.start, part)?;
            }
        }
        Ok(())
    }

    /// All Gaussians with everything that belongs to them: the rows here, then those of others, of which [`GaussianState::read_words`] has
    /// read the words; with the sums of gradients only amidst a batch.
    ///
    /// # Errors
    /// Words of other planes, the driver's, or non-finite parameters.
    pub fn joined(&self, others: &[Vec<u32>], amidst: bool) -> Result<(Gaussians, GaussianRows)> {
        let (stride, count, held) = (self.scene.stride, self.scene.count, self.held());
        let all: usize = held.iter().map(|(_, planes)| planes).sum();
        if others.iter().any(|words| !words.len().is_multiple_of(all)) {
            return Err(Error::numerics(
                "rows",
                "words of other planes than those here",
            ));
        }
        let mut before = 0;
        let arrays = held.map(|(array, planes)| {
            let first = before;
            before += planes;
            let plane = |k: usize| {
                let mut values = array.read(k * stride, count)?;
                for words in others {
                    let len = words.len() / all;
                    let part = &words[(first + k) * len..][..len];
                    values.extend(part.iter().map(|v| f32::from_bits(*v)));
                }
                Ok(values)
            };
            (0..planes).map(plane).collect::<Result<Vec<Vec<f32>>>>()
        });
        let [params, moment1, moment2, filter, statistics, gradients] = arrays;
        let rows = GaussianRows {
            moment1: moment1?,
            moment2: moment2?,
            statistics: statistics?,
            filter: filter?.pop().unwrap_or_default(),
            gradients: if amidst { gradients? } else { Vec::new() },
        };
        Ok((Gaussians::new(self.scene.sh_degree, params?)?, rows))
    }

    /// Everything that belongs to some rows of Gaussians in the host's memory, as [`GaussianState::read_words`] has it of rows here; what `kept`
    /// lacks is zero.
    ///
    /// # Errors
    /// Other planes than those here.
    pub fn words_of(
        &self,
        (splats, kept): (&Gaussians, &GaussianRows),
        rows: Range<usize>,
    ) -> Result<Vec<u32>> {
        let filter = std::slice::from_ref(&kept.filter);
        let filter = if kept.filter.is_empty() { &[] } else { filter };
        let sources: [&[Vec<f32>]; 6] = [
            splats.planes(),
            &kept.moment1,
            &kept.moment2,
            filter,
            &kept.statistics,
            &kept.gradients,
        ];
        let mut words = Vec::new();
        for (values, (array, planes)) in sources.into_iter().zip(self.held()) {
            if values.is_empty() {
                words.resize(words.len() + planes * rows.len(), 0);
                continue;
            }
            let some = values.iter().map(|plane| plane.get(rows.clone()));
            let some: Option<Vec<&[f32]>> = some.collect();
            let Some(some) = some.filter(|some| some.len() == planes) else {
                let (found, name) = (values.len(), array.name());
                return Err(mismatch(format!(
                    "{found} planes of {name}, {} wide; {planes} expected of {} rows",
                    values.iter().map(Vec::len).min().unwrap_or(0),
                    splats.len()
                )));
            };
            words.extend(some.into_iter().flatten().map(|v| v.to_bits()));
        }
        Ok(words)
    }

    /// Refuses the rows of a checkpoint of `count` Gaussians that are of another shape.
    ///
    /// # Errors
    /// Those.
    pub fn check_rows(&self, rows: &GaussianRows, count: usize) -> Result<()> {
        if rows.statistics.len() != self.rows {
            let (found, wanted) = (rows.statistics.len(), self.rows);
            return Err(mismatch(format!(
                "{found} rows of error statistics; {wanted} expected"
            )));
        }
        let wanted = match self.scene.filter.is_empty() {
            true => 0,
            false => count,
        };
        if rows.filter.len() != wanted {
            let found = rows.filter.len();
            return Err(mismatch(format!(
                "3D filter of {found} Gaussians; {wanted} expected"
            )));
        }
        Ok(())
    }

    /// Continues with the rows of a checkpoint.
    ///
    /// # Errors
    /// Rows of another shape, or the driver's.
    pub fn restore(&self, rows: &GaussianRows) -> Result<()> {
        self.check_rows(rows, self.scene.count)?;
        let stride = self.scene.stride;
        for (array, planes) in [
            (&self.moments[0], &rows.moment1),
            (&self.moments[1], &rows.moment2),
            (&self.statistics, &rows.statistics),
            (&self.gradients, &rows.gradients),
        ] {
            for (p, plane) in planes.iter().enumerate() {
                array.write(p * stride, plane)?;
            }
        }
        match rows.filter.len() {
            0 => Ok(()),
            _ => self.scene.filter.write(0, &rows.filter),
        }
    }
}
