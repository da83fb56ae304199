//! The scene files of a run.

use std::path::Path;

use crate::base::error::Result;
use crate::capture::{Dataset, Frame};
use crate::config::SceneFormat;
use crate::scene::formats::{self, SceneFile};
use crate::scene::{Gaussians, ply};

/// The scene files of a run, and what is to be said about them and the one that it began with.
pub(super) struct Exports {
    /// Position of the local frame in the dataset's own.
    frame: Frame,
    up: Option<[f64; 3]>,
    pub(super) remarks: Vec<String>,
}

impl Exports {
    /// Exports into the frame of a dataset.
    pub(super) fn new(dataset: &Dataset) -> Self {
        Self {
            frame: dataset.frame,
            up: dataset.up().map(|up| up.to_array()),
            remarks: Vec::new(),
        }
    }

    fn scene(&self, splats: &Gaussians, filter: &[f32]) -> Result<SceneFile> {
        let up = self.up;
        Ok(SceneFile {
            up,
            ..SceneFile::trained(splats, filter)?
        })
    }

    /// Writes `scene.ply` into the run's folder.
    ///
    /// # Errors
    /// Those of [`ply::write_scene`].
    pub(super) fn write(&self, dir: &Path, splats: &Gaussians, filter: &[f32]) -> Result<()> {
        let scene = self.scene(splats, filter)?;
        ply::write_scene(&dir.join("scene.ply"), &scene, &self.frame)
    }

    /// Writes the scene in other formats beside `scene.ply`.
    ///
    /// # Errors
    /// Those of [`formats::write`].
    pub(super) fn write_others(
        &mut self,
        dir: &Path,
        asked: &[SceneFormat],
        (splats, filter): (Gaussians, Vec<f32>),
    ) -> Result<()> {
        let scene = self.scene(&splats, &filter)?;
        for format in asked {
            let file = dir.join(format!("scene{}", formats::ending(*format)));
            let lost = formats::write(&file, *format, &scene, &self.frame)?;
            let lost = lost
                .iter()
                .map(|what| format!("{}: {what}", file.display()));
            self.remarks.extend(lost);
        }
        Ok(())
    }
}
