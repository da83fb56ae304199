//! The stress suite: the same stages, compared with the reference on stiff numbers.
//!
//! A family is a series of cases along one measure of stiffness, so that the error is a curve. Every case is a row of the
//! table; a family has one bound on the f32 errors, with its reason. Kernels in f64 are within [`super::check::EXACT`] everywhere.
//!
//! | file | what |
//! |---|---|
//! | `suite.rs` | the suite |
//! | `family.rs` | a family and the parts that all share |
//! | `scenes.rs`, `shapes.rs`, `places.rs` | families of scenes through all stages |
//! | `updates.rs` | the optimiser under extreme gradients |
//! | `frames.rs` | datasets far from the origin or in extreme units |
//! | `sampling.rs` | density control on the host at its extremes |

pub mod family;
mod frames;
mod places;
mod sampling;
pub mod scenes;
mod shapes;
mod suite;
mod updates;

pub use family::{Family, Stiff};
pub use suite::{beside_scenes, stress, verify_family};
