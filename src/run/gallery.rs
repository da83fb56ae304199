//! The held-out views that the report shows.

use crate::base::error::Result;
use crate::run::Run;
use crate::run::report::gallery::{GalleryItem, error_map};

/// Held-out views shown in the report.
const GALLERY_VIEWS: usize = 6;

impl Run {
    pub(super) fn gallery(&mut self) -> Result<Vec<GalleryItem>> {
        let Some(evaluator) = &self.evaluator else {
            return Ok(Vec::new());
        };
        let background = self.trainer.schedule().fixed_background();
        let (scene, renderer) = self.trainer.scene_and_renderer();
        let n = evaluator.views().len();
        let shown = n.min(GALLERY_VIEWS);
        let views: Vec<usize> = (0..shown).map(|k| k * n / shown).collect();
        let mut items = Vec::with_capacity(shown);
        for (k, &view) in views.iter().enumerate() {
            let next = &views[k + 1..];
            let Some(score) = evaluator.score(view, next, scene, renderer, background)? else {
                continue;
            };
            let image = renderer.read_image(&evaluator.views().cameras[view])?;
            let render = image.rgb8();
            let photo = evaluator.views().read_photo(view)?;
            let counted = photo.counted(render.clone());
            items.push(GalleryItem {
                view: score.view,
                psnr: score.psnr,
                ssim: score.ssim,
                width: image.width as u32,
                height: image.height as u32,
                error: error_map(&counted, &photo.rgb_over(background))?,
                render,
                photo: photo.shown(background),
            });
        }
        Ok(items)
    }
}
