//! [`GaussianState`]: everything that training keeps per Gaussian. Every operation on the set is here and treats all of it.

use crate::base::error::{Error, Result};
use crate::device::{Array, Device, Program};
use crate::pipeline::buffers::{GaussianBuffers, restride};
use crate::pipeline::stage::edit;
use crate::scene::{self, Gaussians, Plane};

/// Number of arrays of parameters and their moments.
const OPTIMIZED: usize = 3;

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
}

/// Host copy of position, log-scale, rotation and opacity logit \[11\]\[stride\], read at once.
#[derive(Debug, Clone)]
pub struct Geometry {
    values: Vec<f32>,
    stride: usize,
    count: usize,
}

impl Geometry {
    /// Values of a plane below [`Plane::SH`].
    #[must_use]
    pub fn plane(&self, plane: usize) -> &[f32] {
        &self.values[plane * self.stride..][..self.count]
    }

    /// Positions after edits that leave `rows` rows.
    #[must_use]
    pub fn positions_after(&self, edits: &[scene::Edit], rows: usize) -> [Vec<f32>; 3] {
        std::array::from_fn(|k| {
            let mut plane = self.plane(Plane::POSITION + k).to_vec();
            plane.resize(rows, 0.0);
            for edit in edits {
                plane[edit.dst as usize] = edit.position[k];
            }
            plane
        })
    }
}

/// The error of a saved state that does not fit.
pub(super) fn mismatch(what: String) -> Error {
    Error::numerics("checkpoint", what)
}

impl GaussianState {
    /// Uploads Gaussians with room for `capacity`; moments and statistics are zero.
    pub fn new(
        device: &Device,
        splats: &Gaussians,
        capacity: usize,
        rows: usize,
        smoothed: bool,
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
            smoothed,
        )
    }

    /// Arrays with a value per Gaussian and plane, each with its number of planes; the first [`OPTIMIZED`] are parameters and
    /// moments.
    fn arrays(&mut self) -> [(&mut Array<f32>, usize); 5] {
        let planes = self.scene.planes();
        let smoothed = usize::from(!self.scene.filter.is_empty());
        let [moment1, moment2] = &mut self.moments;
        [
            (&mut self.scene.params, planes),
            (moment1, planes),
            (moment2, planes),
            (&mut self.scene.filter, smoothed),
            (&mut self.statistics, self.rows),
        ]
    }

    /// Makes room for `rows` Gaussians; the new ones are zero.
    pub fn grow(&mut self, device: &Device, rows: usize) -> Result<()> {
        let from = self.scene.stride;
        if rows <= from {
            return Ok(());
        }
        let to = GaussianBuffers::<f32>::grown_stride(rows);
        for (array, planes) in self.arrays() {
            if planes > 0 {
                *array = restride(device, array, planes, from, to)?;
            }
        }
        self.scene.stride = to;
        Ok(())
    }

    /// Applies the edits of a density step, which leave `rows` rows, and puts them in `order` if there is one. The statistics start
    /// anew, and the smoothing filter is to be computed again. `stage` is a build of `kernels/edit.cl`.
    pub fn edit(
        &mut self,
        device: &Device,
        stage: &Program,
        edits: &[scene::Edit],
        rows: usize,
        logit_limit: Option<f32>,
        order: Option<&[u32]>,
    ) -> Result<()> {
        self.grow(device, rows)?;
        self.statistics.clear()?;
        let edits = Array::from_slice(device, "edits", edits)?;
        self.scene.count = rows;
        let (scene, moments) = (&self.scene, self.moments.each_ref());
        edit::write_rows(stage, scene, moments, &edits)?;
        if let Some(limit) = logit_limit {
            edit::limit_opacity(stage, scene, moments, f64::from(limit))?;
        }
        match order {
            Some(order) => self.gather(device, stage, order, OPTIMIZED),
            None => Ok(()),
        }
    }

    /// Keeps the Gaussians of `order`, in that order, with everything that belongs to them.
    pub fn reorder(&mut self, device: &Device, stage: &Program, order: &[u32]) -> Result<()> {
        self.gather(device, stage, order, usize::MAX)
    }

    fn gather(
        &mut self,
        device: &Device,
        stage: &Program,
        order: &[u32],
        arrays: usize,
    ) -> Result<()> {
        let (stride, count) = (self.scene.stride, order.len());
        let order = Array::from_slice(device, "row order", order)?;
        for (array, planes) in self.arrays().into_iter().take(arrays) {
            if planes > 0 {
                let to = Array::zeros(device, array.name(), planes * stride)?;
                edit::gather_rows(stage, &order, [planes, stride], [array, &to])?;
                *array = to;
            }
        }
        self.scene.count = count;
        Ok(())
    }

    /// Makes room for the coefficients of a higher SH degree, which are zero, as are their moments.
    pub fn raise_sh_degree(&mut self, device: &Device, degree: u32) -> Result<()> {
        let stride = self.scene.stride;
        let [from, to] = [self.scene.sh_degree, degree].map(|d| Plane::count(d) * stride);
        let [moment1, moment2] = &mut self.moments;
        for array in [&mut self.scene.params, moment1, moment2] {
            let new = Array::zeros(device, array.name(), to)?;
            new.copy_from(0, array, 0, from)?;
            *array = new;
        }
        self.scene.sh_degree = degree;
        Ok(())
    }

    /// Reads position, scale, rotation and opacity in one transfer.
    pub fn geometry(&self) -> Result<Geometry> {
        Ok(Geometry {
            values: self.scene.params.read(0, Plane::SH * self.scene.stride)?,
            stride: self.scene.stride,
            count: self.scene.count,
        })
    }

    /// Reads the statistics \[rows\]\[N\].
    pub fn read_statistics(&self) -> Result<Vec<Vec<f32>>> {
        self.planes(&self.statistics, self.rows)
    }

    /// Reads the smoothing filter \[N\]; empty without anti-aliasing.
    pub fn read_filter(&self) -> Result<Vec<f32>> {
        match self.scene.filter.is_empty() {
            true => Ok(Vec::new()),
            false => self.scene.filter.read(0, self.scene.count),
        }
    }

    fn planes(&self, array: &Array<f32>, planes: usize) -> Result<Vec<Vec<f32>>> {
        let (stride, count) = (self.scene.stride, self.scene.count);
        let row = |k: usize| array.read(k * stride, count);
        (0..planes).map(row).collect()
    }

    /// Reads everything but the parameters.
    pub fn rows(&self) -> Result<GaussianRows> {
        let planes = self.scene.planes();
        Ok(GaussianRows {
            moment1: self.planes(&self.moments[0], planes)?,
            moment2: self.planes(&self.moments[1], planes)?,
            statistics: self.read_statistics()?,
            filter: self.read_filter()?,
        })
    }

    /// Continues with the rows of a checkpoint.
    ///
    /// # Errors
    /// Rows of another shape, or the driver's.
    pub fn restore(&self, rows: &GaussianRows) -> Result<()> {
        let (stride, count) = (self.scene.stride, self.scene.count);
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
        for (array, planes) in [
            (&self.moments[0], &rows.moment1),
            (&self.moments[1], &rows.moment2),
            (&self.statistics, &rows.statistics),
        ] {
            for (p, plane) in planes.iter().enumerate() {
                array.write(p * stride, plane)?;
            }
        }
        match wanted {
            0 => Ok(()),
            _ => self.scene.filter.write(0, &rows.filter),
        }
    }
}
