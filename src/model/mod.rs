//! The scene being trained: a set of 3D Gaussians in raw (unactivated) form.

pub mod init;
mod splats;

pub use splats::{Plane, Splats, sh_coefficients};
