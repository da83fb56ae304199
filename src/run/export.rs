//! The scene files of a run, and the page that shows the scene.

use std::path::Path;

use glam::DVec3;

use crate::base::error::Result;
use crate::capture::{Dataset, Frame};
use crate::config::SceneFormat;
use crate::evaluate::Evaluator;
use crate::run::record::FinalRecord;
use crate::run::viewer::{self, SCENE_PAGE, ScenePage, SceneView, write_scene_page};
use crate::scene::formats::{self, SceneFile, Sphere};
use crate::scene::{Gaussians, ply};

/// The scene files of a run, and what is to be said about them and the one that it began with.
pub(super) struct Exports {
    /// Position of the local frame in the dataset's own.
    frame: Frame,
    up: Option<[f64; 3]>,
    cameras: Option<Sphere>,
    /// [`Plan::behind`](crate::train::Plan::behind).
    background: Option<[f32; 3]>,
    /// Cameras of the scene's page, held-out ones first, with their photos from the first export on.
    pub(super) views: Vec<SceneView>,
    /// Sentence about cameras that the page does not list.
    listed: Option<String>,
    /// Sentence about photos that the page does not have.
    pictured: Option<String>,
    pub(super) remarks: Vec<String>,
}

impl Exports {
    /// Exports into the frame of a dataset, with a colour behind the scene.
    pub(super) fn new(dataset: &Dataset, background: Option<[f32; 3]>) -> Self {
        let (views, listed) = viewer::scene_views(dataset);
        // Cameras in one place say nothing about the size of the local frame's unit.
        let apart = dataset.views().any(|v| v.camera.center().length() > 0.5);
        let unit = Sphere {
            center: DVec3::ZERO,
            radius: 1.0,
        };
        Self {
            frame: dataset.frame,
            up: dataset.up().map(|up| up.to_array()),
            cameras: apart.then_some(unit),
            background,
            views,
            listed,
            pictured: None,
            remarks: formats::rounded(&dataset.frame).into_iter().collect(),
        }
    }

    /// Adds the photos of held-out views to those of the page, some of them evenly where there are many, and the scores of the last
    /// evaluation. A photo that cannot be read is left out: the scene is to be saved whatever becomes of photos.
    pub(super) fn add_views(
        &mut self,
        evaluator: Option<&Evaluator>,
        scores: Option<&FinalRecord>,
        background: [f32; 3],
    ) {
        viewer::add_scores(&mut self.views, scores);
        let Some(evaluator) = evaluator else {
            return;
        };
        let n = evaluator.views().len();
        let shown = n.min(viewer::MAX_PHOTOS);
        let uri = |k: usize, name: &str| {
            let photo = evaluator.views().read_photo(k)?;
            let rgb = photo.shown(background);
            viewer::photo_uri(name, &rgb, photo.width, photo.height)
        };
        let mut there = 0;
        for k in (0..shown).map(|k| k * n / shown) {
            let view = &mut self.views[k];
            if view.photo.is_none() {
                view.photo = uri(k, &view.name).ok();
            }
            there += usize::from(view.photo.is_some());
        }
        self.pictured = (there < n)
            .then(|| format!("The page has the photos of {there} of {n} held-out views."));
    }

    fn scene(&self, splats: &Gaussians, filter: &[f32]) -> Result<SceneFile> {
        Ok(SceneFile {
            up: self.up,
            cameras: self.cameras,
            background: self.background,
            ..SceneFile::trained(splats, filter)?
        })
    }

    /// Writes the page that shows the scene, then `scene.ply`, into the run's folder; the sentences on what the page leaves out.
    ///
    /// # Errors
    /// Those of [`write_scene_page`] and [`ply::write_scene`].
    pub(super) fn write(
        &self,
        dir: &Path,
        title: &str,
        background: [f32; 3],
        splats: &Gaussians,
        filter: &[f32],
    ) -> Result<Vec<String>> {
        let scene = self.scene(splats, filter)?;
        let remarks: Vec<String> = self.listed.iter().chain(&self.pictured).cloned().collect();
        let page = ScenePage {
            title,
            splats: &scene.splats,
            anti_aliased: scene.anti_aliased,
            background,
            views: &self.views,
            remarks: &remarks,
            max_bytes: viewer::MAX_BYTES,
        };
        let remarks = write_scene_page(&dir.join(SCENE_PAGE), &page)?;
        ply::write_scene(&dir.join("scene.ply"), &scene, &self.frame)?;
        Ok(remarks)
    }

    /// Writes the scene in other formats beside `scene.ply`. One that cannot hold it, or be written, is remarked and spoils nothing else.
    ///
    /// # Errors
    /// Those of [`SceneFile::trained`].
    pub(super) fn write_others(
        &mut self,
        dir: &Path,
        asked: &[SceneFormat],
        (splats, filter): (Gaussians, Vec<f32>),
    ) -> Result<()> {
        let scene = self.scene(&splats, &filter)?;
        for format in asked {
            let file = dir.join(format!("scene{}", formats::ending(*format)));
            let name = file.display();
            match formats::write(&file, *format, &scene, &self.frame) {
                Ok(lost) => {
                    let lost = lost.iter().map(|what| format!("{name}: {what}"));
                    self.remarks.extend(lost);
                }
                Err(error) => self
                    .remarks
                    .push(format!("{name} was not written: {error}")),
            }
        }
        Ok(())
    }
}
