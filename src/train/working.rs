//! [`Working`]: what density control works on.

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
