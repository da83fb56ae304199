//! The scene being trained: a set of 3D Gaussians in raw (unactivated) form.

mod filtered;
pub mod init;
#[doc(hidden)]
pub mod knn;
pub mod morton;
mod orbit;
pub mod refit;
pub(crate) mod sh;
mod splats;

pub use filtered::filters;
pub use orbit::orbit;
pub use splats::{Plane, Splats, sh_coefficients};
