//! [`Smoothing`]: the 3D smoothing filter of Mip-Splatting over a run. It follows the positions at intervals.

use crate::base::constants::FILTER_CHUNKS;
use crate::base::error::Result;
use crate::device::{Array, CameraArg, Kernels, Program};
use crate::pipeline::buffers::{GaussianBuffers, ViewBuffers, ViewSet};
use crate::pipeline::share::Share;
use crate::pipeline::stage::filter;
use crate::ranks::Part;

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

    /// Recomputes the filter of a scene from its positions; waits where ranks share its rows.
    ///
    /// # Errors
    /// Another rank's failure, or the driver's.
    pub fn run(
        &self,
        scene: &GaussianBuffers,
        view: &ViewBuffers<f32>,
        share: Option<&Share<f32>>,
    ) -> Result<()> {
        let (stage, cameras, largest) = (&self.stage, &self.cameras, &self.largest);
        let Some(share) = share else {
            return filter::compute(stage, scene, view, cameras, largest);
        };
        filter::measure(stage, scene, view, cameras, largest)?;
        let own = largest.to_vec()?.into_iter().map(f32::to_bits);
        let got = share.tell_all(Part::Evidence, own.collect())?;
        let values = got.iter().flatten().map(|v| f32::from_bits(*v));
        largest.write(0, &vec![values.fold(0.0, f32::max); largest.len()])?;
        filter::fill(stage, scene, view, largest)
    }
}
