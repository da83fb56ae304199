//! The 3D filter of Mip-Splatting over a run: it follows the positions at intervals.

use crate::base::constants::FILTER_CHUNKS;
use crate::base::error::{Error, Result};
use crate::device::{Array, CameraArg, Kernels};
use crate::pipeline::buffers::{Scene, ViewSet};
use crate::pipeline::stage::filter::Filter;
use crate::train::Trainer;

/// Iterations between two looks at the sampling rates (Mip-Splatting, §6); after a density step there is one anyway.
const INTERVAL: u32 = 100;

/// The stage, and what it reads.
#[derive(Debug)]
pub(super) struct FilterStage {
    stage: Filter,
    /// Of the training views, at the photos' full size.
    cameras: Array<CameraArg<f32>>,
    largest: Array<f32>,
}

/// The stage and room for its result, if the kernels are built with anti-aliasing.
pub(super) fn stage(
    kernels: &Kernels,
    scene: Scene,
    views: &ViewSet,
) -> Result<(Scene, Option<FilterStage>)> {
    if !kernels.defines().anti_alias {
        return Ok((scene, None));
    }
    let device = kernels.device();
    let stage = FilterStage {
        stage: Filter::new::<f32>(kernels)?,
        cameras: Array::from_slice(device, "cameras", &views.cameras)?,
        largest: Array::zeros(device, "largest", FILTER_CHUNKS as usize)?,
    };
    Ok((scene.with_filter(device)?, Some(stage)))
}

impl Trainer {
    /// Fills in the filter of a scene by its positions, without waiting; nothing without anti-aliasing.
    pub(super) fn refresh_filter(&self, scene: &Scene) -> Result<()> {
        let Some(f) = &self.filter else {
            return Ok(());
        };
        f.stage
            .run(scene, &self.renderer.frame, &f.cameras, &f.largest)
    }

    /// Refreshes the filter if that is due before an iteration and no density step has just done it.
    pub(super) fn filter_at(&self, iteration: u32) -> Result<()> {
        if iteration.is_multiple_of(INTERVAL) && self.last_density != Some(iteration) {
            self.refresh_filter(&self.scene)?;
        }
        Ok(())
    }

    /// Room for the filter of as many Gaussians as there is room for parameters; what it held is lost.
    pub(super) fn fit_filter(&mut self) -> Result<()> {
        if self.filter.is_some() && self.scene.filter.len() < self.scene.stride {
            self.scene.filter = Array::zeros(&self.device, "filter", self.scene.stride)?;
        }
        Ok(())
    }

    /// Gives a scene of the same Gaussians the filter that this one has.
    pub(super) fn copy_filter(&self, scene: &mut Scene) -> Result<()> {
        let len = self.scene.filter.len();
        scene.filter = Array::zeros(&self.device, "filter", len)?;
        scene.filter.copy_from(0, &self.scene.filter, 0, len)
    }

    /// Standard deviations of the filter \[N\], local units; empty without anti-aliasing.
    ///
    /// # Errors
    /// The driver's.
    pub(super) fn read_filter(&self) -> Result<Vec<f32>> {
        match &self.filter {
            None => Ok(Vec::new()),
            Some(_) => self.scene.filter.read(0, self.scene.count),
        }
    }

    /// Goes on with the filter of a checkpoint.
    ///
    /// # Errors
    /// A filter without anti-aliasing or none with it, or the driver's.
    pub(super) fn restore_filter(&self, filter: &[f32]) -> Result<()> {
        let wanted = self.filter.as_ref().map_or(0, |_| self.scene.count);
        if filter.len() != wanted {
            return Err(Error::Numerics {
                stage: "checkpoint".into(),
                what: format!("3D filter of {} Gaussians; {wanted} expected", filter.len()),
            });
        }
        if wanted == 0 {
            return Ok(());
        }
        self.scene.filter.write(0, filter)
    }
}
