//! Options of a synthetic dataset.

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};

/// Layout of the files of a dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum SynthLayout {
    /// images/ and sparse/0/*.bin
    Colmap,
    /// images/ and sparse/0/*.txt
    ColmapTxt,
    /// transforms_train.json, transforms_test.json with every eighth view, and points3d.ply
    Transforms,
}

/// Options of [`generate`](crate::lab::synth::generate()). [`SynthOptions::for_scene`] gives the defaults of a scene.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SynthOptions {
    /// Layout of the files.
    pub layout: SynthLayout,
    /// Number of photos, held-out ones included; 2 to 9999.
    pub views: u32,
    /// Width of the photos, pixels; 8 to 8192.
    pub width: u32,
    /// Height of the photos, pixels; 8 to 8192.
    pub height: u32,
    /// Number of sparse points; at most 10 million.
    pub points: u32,
    /// Seed of textures, sub-pixel positions and points. Cameras and solids do not depend on it.
    pub seed: u64,
    /// Rays per pixel, rounded up to a square number; 1 to 1024.
    pub samples: u32,
}

impl Default for SynthOptions {
    /// The defaults of `room`.
    fn default() -> Self {
        Self {
            layout: SynthLayout::Colmap,
            views: 64,
            width: 480,
            height: 360,
            points: 10_000,
            seed: 0,
            samples: 16,
        }
    }
}

impl SynthOptions {
    /// The defaults of a scene: `object` is square and in the transforms layout, all else is [`SynthOptions::default`].
    #[must_use]
    pub fn for_scene(name: &str) -> Self {
        let room = Self::default();
        if name == "object" {
            return Self {
                layout: SynthLayout::Transforms,
                width: 400,
                height: 400,
                ..room
            };
        }
        room
    }

    /// Checks every value against its domain.
    ///
    /// # Errors
    /// [`Error::Config`] that names the option, the value and the domain.
    pub fn validate(&self) -> Result<()> {
        let domains = [
            ("views", self.views, 2, 9999),
            ("width", self.width, 8, 8192),
            ("height", self.height, 8, 8192),
            ("points", self.points, 0, 10_000_000),
            ("samples", self.samples, 1, 1024),
        ];
        for (option, value, low, high) in domains {
            if value < low || value > high {
                return Err(Error::config(
                    option,
                    format!("{value} is not within {low} to {high}"),
                ));
            }
        }
        Ok(())
    }
}
