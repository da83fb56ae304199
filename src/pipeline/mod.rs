//! One view through the kernels: buffers, photos, the forward and backward passes, one file per stage.

pub mod backward;
pub mod band;
pub mod buffers;
pub mod exposure;
pub mod forward;
mod launch;
pub mod pass;
pub mod photo_array;
pub mod photos;
pub mod reference;
pub mod reference_pass;
pub(crate) mod room;
pub mod scoring;
pub mod share;
pub mod stage;
