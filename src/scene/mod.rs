//! The scene being trained: a set of 3D Gaussians in raw (unactivated) form.

mod edit;
pub mod formats;
mod gaussians;
pub mod init;
pub mod knn;
pub mod morton;
pub mod orbit;
pub mod sh;
mod smoothing;
pub mod sweep;
pub mod trajectory;

pub use crate::scene::edit::{Edit, OptionalColor};
pub use crate::scene::formats::ply;
pub use crate::scene::gaussians::{Gaussians, Plane, sh_coefficients};
pub use crate::scene::orbit::{Ring, orbit};
pub use crate::scene::smoothing::{filters, without_filter};
pub use crate::scene::trajectory::{Keyframe, Trajectory};
