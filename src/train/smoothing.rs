//! [`Smoothing`]: the 3D smoothing filter of Mip-Splatting over a run. It follows the positions at intervals.

use crate::base::constants::FILTER_CHUNKS;
use crate::base::error::Result;
use crate::device::{Array, CameraArg, Kernels, Program};
use crate::pipeline::buffers::{GaussianBuffers, ViewBuffers, ViewSet};
use crate::pipeline::stage::filter;

/// Iterations between two looks at the sampling rates (Mip-Splatting, §6); every density step has one as well.
const INTERVAL: u32 = 100;

/// Computes each Gaussian's smoothing filter from the sampling rates of the training views.
#[derive(Debug)]
pub struct Smoothing {
    stage: Program,
    /// Training cameras at the photos' full size.
    cameras: Array<CameraArg<f32>>,
    largest: Array<f32>,
}

impl Smoothing {
    /// Builds the kernel if the kernels are built with anti-aliasing.
    pub fn new(kernels: &Kernels, views: &ViewSet) -> Result<Option<Self>> {
        if !kernels.defines().anti_alias {
            return Ok(None);
        }
        let device = kernels.device();
        Ok(Some(Self {
            stage: kernels.build::<f32>("filter")?,
            cameras: Array::from_slice(device, "cameras", &views.cameras)?,
            largest: Array::zeros(device, "largest", FILTER_CHUNKS as usize)?,
        }))
    }

    /// True if the filter is recomputed before an iteration.
    #[must_use]
    pub fn due(iteration: u32) -> bool {
        iteration.is_multiple_of(INTERVAL)
    }

    /// Recomputes the filter of a scene from its positions, without waiting.
    pub fn run(&self, scene: &GaussianBuffers, view: &ViewBuffers<f32>) -> Result<()> {
        filter::compute(&self.stage, scene, view, &self.cameras, &self.largest)
    }
}
