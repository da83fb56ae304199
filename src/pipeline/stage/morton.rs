//! Order of the Gaussians by layers and along the Z curve, without those that are removed (`kernels/morton.cl`).

use crate::base::constants::MORTON_GRID;
use crate::base::error::Result;
use crate::device::tuning::status::SLOTS;
use crate::device::{Array, Kernels, Launch, Program, Real};
use crate::pipeline::buffers::{GaussianBuffers, ViewBuffers};
use crate::pipeline::stage::sort::{Keys, Sort};
use crate::scene::{Plane, morton};

/// Order that rows are to have.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Order {
    /// By layers and Morton codes ([`morton::order`]).
    Morton {
        /// Direction that is up.
        up: [f32; 3],
    },
    /// The one that they have; removed rows are left out.
    Kept,
}

/// The kernels and their scratch.
#[derive(Debug)]
pub struct Morton {
    program: Program,
    boxes: Array<f32>,
    grid: Array<u32>,
}

impl Morton {
    /// Builds the kernels.
    ///
    /// # Errors
    /// The driver's.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let (device, chunks) = (kernels.device(), kernels.defines().tuning.chunks);
        Ok(Self {
            program: kernels.build::<R>("morton")?,
            boxes: Array::zeros(device, "boxes", 6 * chunks)?,
            grid: Array::zeros(device, "grid", 3 * MORTON_GRID)?,
        })
    }

    /// Sorts the rows of a scene, those of `removed` last, into `view.visible`; takes other arrays of the view for scratch, for which
    /// there has to be room. Does not wait.
    ///
    /// # Errors
    /// The driver's.
    pub fn sort<R: Real>(
        &self,
        sort: &Sort,
        scene: &GaussianBuffers<R>,
        removed: &Array<u32>,
        order: Order,
        view: &mut ViewBuffers<R>,
    ) -> Result<()> {
        let (program, count) = (&self.program, scene.count);
        let (ordered, [x, y, z]) = match order {
            Order::Morton { up } => (true, up),
            Order::Kept => (false, morton::NO_UP),
        };
        if ordered {
            self.find_cells(scene)?;
        }
        let (visible, high) = (&mut view.visible, &view.isect_start);
        self.positions("morton_keys", scene)
            .value(x)
            .value(y)
            .value(z)
            .array(&self.grid, 3 * MORTON_GRID)
            .value(i32::from(ordered))
            .arrays([&visible.keys[0], high], count)
            .array(&visible.values[0], count)
            .array(&view.status, SLOTS)
            .over_items([count, 1])?;
        if !removed.is_empty() {
            program
                .launch("morton_remove")
                .array(removed, removed.len())
                .uints([removed.len()])
                .array(high, count)
                .over_items([removed.len(), 1])?;
        }
        visible.sorted = 0;
        if ordered {
            sort.run(visible, &Keys::rows(count, 32), &view.status)?;
        }
        // A sort begins with the first pair of arrays.
        if visible.sorted == 1 {
            visible.values.swap(0, 1);
        }
        program
            .launch("morton_high")
            .array(high, count)
            .uints([count])
            .arrays([&visible.values[0], &visible.keys[0]], count)
            .over_items([count, 1])?;
        let bits = if ordered { 32 } else { 1 };
        sort.run(visible, &Keys::rows(count, bits), &view.status)
    }

    /// Cells per unit of length over the bounding box.
    fn find_cells<R: Real>(&self, scene: &GaussianBuffers<R>) -> Result<()> {
        let chunks = self.program.chunks();
        self.positions("morton_box", scene)
            .uints([chunks])
            .array(&self.boxes, 6 * chunks)
            .over_groups(chunks)?;
        self.program
            .launch("morton_cells")
            .array(&self.boxes, 6 * chunks)
            .uints([chunks])
            .array(&self.grid, 3 * MORTON_GRID)
            .over_groups(3)
    }

    fn positions<R: Real>(&self, kernel: &'static str, scene: &GaussianBuffers<R>) -> Launch<'_> {
        self.program
            .launch(kernel)
            .array(&scene.params, Plane::LOG_SCALE * scene.stride)
            .uints([scene.stride, scene.count])
    }
}

// Definition in f64.

/// Rows in the order of layers and Morton codes ([`morton::order`]), or as they are, without those of `removed`, which rise.
#[must_use]
pub fn kept(positions: [&[f32]; 3], removed: &[u32], order: Order) -> Vec<u32> {
    let mut rows = match order {
        Order::Morton { up } => morton::order(positions, up),
        Order::Kept => (0..positions[0].len() as u32).collect(),
    };
    rows.retain(|row| removed.binary_search(row).is_err());
    rows
}
