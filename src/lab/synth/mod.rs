//! Seeded scenes with known truth: exact cameras, points on the true surfaces, photos from a small ray tracer of our own
//! (spheres, boxes and one lamp in 64-bit floats; no code or asset of others).
//!
//! The same arguments give the same bytes. Geometry and shading use + − × ÷ and √ alone, which IEEE 754 defines to the last
//! bit, so this holds across machines too.

mod generate;
mod render;
mod scene;
mod scenes;

pub use crate::lab::synth::generate::{SynthLayout, SynthOptions, SynthReport, generate};
pub use crate::lab::synth::scenes::{CHROME_SPHERE, NAMES};
