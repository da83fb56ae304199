//! Renders of training views on their way to density control.

use crate::base::error::Result;
use crate::capture::Alpha;
use crate::capture::photo::colors;
use crate::density::Picture;
use crate::device::{CameraArg, ImageSize, PendingRead};
use crate::pipeline::exposure::exchange;
use crate::pipeline::forward::{Quantity, RenderOptions};
use crate::train::working::Working;

/// A [`Picture`] whose render, depth and photo are being transferred.
#[derive(Debug)]
pub(super) struct PendingPicture {
    camera: CameraArg<f32>,
    background: [f32; 3],
    alpha: Alpha,
    /// Red, green, blue, transmittance with the image's padding.
    image: PendingRead<f32>,
    /// Depth, weighted by opacity, with the padding.
    depth: PendingRead<f32>,
    photo: PendingRead<u8>,
    /// Colour transform of the view, if exposure is compensated.
    transform: Option<PendingRead<f32>>,
}

impl PendingPicture {
    /// Enqueues a view as it is at an iteration, over the background of iteration `background_of`: its render, and the depth of the
    /// same pairs. Does not wait; an overflow of the pairs is told by the status array.
    ///
    /// # Errors
    /// A photo that cannot be read, no room, or the driver's.
    pub(super) fn enqueue(
        on: &mut Working<'_>,
        iteration: u32,
        background_of: u32,
        number: usize,
    ) -> Result<Self> {
        let view = on.views.view(iteration, background_of, number, &[])?;
        let (scene, camera) = (&on.gaussians.scene, view.camera);
        let options = RenderOptions {
            sh_degree: scene.sh_degree,
            background: view.background,
            quantity: Quantity::Color,
            active_only: false,
        };
        let (size, alpha) = (camera.image(), on.views.set.alpha);
        let plane = size.plane();
        let pixels = size.0[0] * size.0[1];
        let photo = on.views.photo(&view);
        let photo = photo.read_later(0, alpha.planes() * pixels)?;
        let forward = &mut on.pipeline.forward;
        forward.fit(scene, &camera)?;
        forward.enqueue(scene, &camera, &options)?;
        let image = forward.frame.image.read_later(0, 4 * plane)?;
        forward.enqueue_depths([0.0; 3])?;
        let depth = forward.frame.image.read_later(0, plane)?;
        let exposure = on.pipeline.exposure.as_ref();
        Ok(Self {
            camera,
            background: view.background,
            alpha,
            image,
            depth,
            photo,
            transform: exposure.map(|e| e.read_transform(number)).transpose()?,
        })
    }

    /// Waits for the transfers; computes errors and mean depths.
    ///
    /// # Errors
    /// The driver's.
    pub(super) fn finish(self) -> Result<Picture> {
        let (camera, alpha, size) = (&self.camera, self.alpha, self.camera.image());
        let (plane, pixels) = (size.plane(), size.0[0] * size.0[1]);
        let image = self.image.arrived()?;
        let cut = |c: usize| without_padding(&image[c * plane..], size);
        let (mut render, transmittance) = ([cut(0), cut(1), cut(2)], cut(3));
        let mut depth = without_padding(&self.depth.arrived()?, size);
        for (z, left) in depth.iter_mut().zip(&transmittance) {
            // Weighted by opacity so far; 0/0 where nothing is.
            *z /= 1.0 - left;
        }
        let bytes = self.photo.wait()?;
        // Image space has no birth where the photo has nothing, whatever fog is there.
        let opaque = |i: usize| f32::from(*bytes.get(3 * pixels + i).unwrap_or(&255)) / 255.0;
        let taken = colors(alpha, &bytes, self.background);
        // What is born has the photo's colour and not that of this iteration's background.
        let free =
            (alpha == Alpha::Transparency).then(|| colors(Alpha::Mask, &bytes, self.background));
        let exchanged = match self.transform {
            None => None,
            Some(transform) => {
                let mut photo = free.clone().unwrap_or_else(|| taken.clone());
                exchange(&transform.wait()?, &mut render, &mut photo);
                Some(photo)
            }
        };
        let error = |i: usize| -> f32 {
            let apart = |c: usize| (render[c][i] - taken[c][i]).abs();
            opaque(i) * (0..3).map(apart).sum::<f32>() / 3.0
        };
        let error = (0..pixels).map(error).collect();
        let masked = match alpha {
            Alpha::Mask => (0..pixels).map(|i| opaque(i) < 0.5).collect(),
            _ => Vec::new(),
        };
        Ok(Picture {
            width: size.0[0],
            intrinsics: camera.intrinsics,
            rotation: camera.w,
            center: camera.center,
            error,
            photo: exchanged.or(free).unwrap_or(taken),
            depth,
            transmittance,
            masked,
        })
    }
}

/// A plane of an image without the padding on its right and below.
fn without_padding(plane: &[f32], size: ImageSize) -> Vec<f32> {
    let ([width, height], [stride, _]) = (size.0, size.padded());
    let rows = plane.chunks_exact(stride).take(height);
    rows.flat_map(|row| &row[..width]).copied().collect()
}
