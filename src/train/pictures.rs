//! Views rendered for density control beside those of training.

use crate::base::error::Result;
use crate::capture::Alpha;
use crate::capture::photo::colors;
use crate::density::Picture;
use crate::device::{Array, CameraArg};
use crate::pipeline::forward::{Quantity, RenderOptions};
use crate::pipeline::stage::loss::size_of_image;
use crate::train::Trainer;

impl Trainer {
    /// The views that training takes next, as many as density control wants, at the size that they have now. Colour and
    /// depth are rendered: two forward passes a view.
    pub(super) fn pictures(&mut self, progress: f64) -> Result<Vec<Picture>> {
        let count = self.density.pictures(progress).min(self.views.len());
        if count == 0 {
            return Ok(Vec::new());
        }
        let views = self
            .schedule
            .upcoming(self.iteration, count, self.views.len());
        let at = (self.iteration..).zip(views);
        at.map(|(at, view)| self.picture(at, view)).collect()
    }

    /// A view's camera at the size that photos have at an iteration, and by how much that is smaller.
    pub(super) fn camera_at(&self, iteration: u32, view: usize) -> (CameraArg<f32>, usize) {
        let full = self.views.cameras[view];
        let factor = self.schedule.shrink_factor(iteration, size_of_image(&full));
        (full.shrunk(factor), factor)
    }

    /// A view's photo so much smaller; itself at 1.
    pub(super) fn shrunk<'a>(
        &'a self,
        photo: &'a Array<u8>,
        view: usize,
        factor: usize,
    ) -> Result<&'a Array<u8>> {
        self.shrink_photo(photo, view, factor)?;
        Ok(self.at_size(photo, factor))
    }

    /// Makes the smaller photo, if there is to be one.
    pub(super) fn shrink_photo(&self, photo: &Array<u8>, view: usize, factor: usize) -> Result<()> {
        let size = size_of_image(&self.views.cameras[view]);
        match &self.shrink {
            Some(shrink) if factor > 1 => shrink.run(photo, size, factor, &self.small),
            _ => Ok(()),
        }
    }

    /// The photo, or what [`Trainer::shrink_photo`] made of it.
    pub(super) fn at_size<'a>(&'a self, photo: &'a Array<u8>, factor: usize) -> &'a Array<u8> {
        if factor == 1 { photo } else { &self.small }
    }

    /// A view as it is now, over the background of iteration `at`.
    fn picture(&mut self, at: u32, view: usize) -> Result<Picture> {
        let photo = self.views.photo(view, &[])?;
        let (camera, factor) = self.camera_at(self.iteration, view);
        let options = self.options(at, self.scene.sh_degree);
        self.renderer.render(&self.scene, &camera, &options)?;
        let mut seen = self.renderer.read_image(&camera)?;
        let by_depth = RenderOptions {
            quantity: Quantity::Depth,
            background: [0.0; 3],
            ..options
        };
        self.renderer.render(&self.scene, &camera, &by_depth)?;
        let mut depth = self.renderer.read_image(&camera)?.rgb;
        let pixels = seen.width * seen.height;
        depth.truncate(pixels);
        for (z, left) in depth.iter_mut().zip(&seen.transmittance) {
            // Weighted by opacity so far; 0/0 where nothing is.
            *z /= 1.0 - left;
        }
        let photo = self.shrunk(&photo, view, factor)?;
        let alpha = self.views.alpha;
        let bytes = photo.read(0, alpha.planes() * pixels)?;
        // Image space has no birth where the photo has nothing, whatever fog is there.
        let opaque = |i: usize| f32::from(*bytes.get(3 * pixels + i).unwrap_or(&255)) / 255.0;
        let taken = colors(alpha, &bytes, options.background);
        let mut photo = match alpha {
            // What is born has the photo's colour and not that of this iteration's background.
            Alpha::Transparency => colors(Alpha::Mask, &bytes, options.background),
            _ => taken.clone(),
        };
        self.exposed_picture(view, &mut seen.rgb, &mut photo)?;
        let error = |i: usize| -> f32 {
            let apart = |c: usize| (seen.rgb[c * pixels + i] - taken[c][i]).abs();
            opaque(i) * (0..3).map(apart).sum::<f32>() / 3.0
        };
        Ok(Picture {
            width: seen.width,
            intrinsics: camera.intrinsics,
            rotation: camera.w,
            center: camera.center,
            error: (0..pixels).map(error).collect(),
            photo,
            depth,
            transmittance: seen.transmittance,
        })
    }
}
