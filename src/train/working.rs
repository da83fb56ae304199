//! [`Working`]: what density control works on.

use crate::base::error::Result;
use crate::device::Device;
use crate::pipeline::pass::Pipeline;
use crate::train::gaussians::GaussianState;
use crate::train::smoothing::Smoothing;
use crate::train::views::Views;

/// Parts of a trainer that a density step changes or reads.
#[derive(Debug)]
pub struct Working<'a> {
    /// Device.
    pub device: &'a Device,
    /// Pipeline of training.
    pub pipeline: &'a mut Pipeline,
    /// Gaussians.
    pub gaussians: &'a mut GaussianState,
    /// Training views.
    pub views: &'a Views,
    /// Smoothing filter, if there is one.
    pub smoothing: Option<&'a Smoothing>,
}

impl Working<'_> {
    /// Recomputes the smoothing filter, if there is one.
    ///
    /// # Errors
    /// See [`Smoothing::run`].
    pub fn smooth(&self) -> Result<()> {
        let (scene, pipeline) = (&self.gaussians.scene, &self.pipeline);
        match self.smoothing {
            Some(s) => s.run(scene, &pipeline.forward.frame, pipeline.share.as_ref()),
            None => Ok(()),
        }
    }
}
