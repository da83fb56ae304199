//! Renders of training views on their way to density control.

use std::borrow::Cow;
use std::sync::Arc;

use crate::base::error::Result;
use crate::capture::Alpha;
use crate::capture::photo::write_colors;
use crate::density::{Colors, Picture};
use crate::device::{Arrived, CameraArg, PendingRead};
use crate::pipeline::forward::{Quantity, RenderOptions};
use crate::pipeline::pass::Pipeline;
use crate::pipeline::stage::exposure::unexposed;
use crate::pipeline::stage::loss::ImagePair;
use crate::pipeline::stage::photo_error::PhotoErrors;
use crate::train::working::Working;

/// A [`Picture`] whose error, depth and photo are being transferred.
#[derive(Debug)]
pub(super) struct PendingPicture {
    camera: CameraArg<f32>,
    alpha: Alpha,
    /// Error and transmittance with the image's padding.
    error: PendingRead<f32>,
    /// Depth, weighted by opacity, with the padding.
    depth: PendingRead<f32>,
    photo: PendingRead<u8>,
    /// Colour transform of the view, if exposure is compensated.
    transform: Option<PendingRead<f32>>,
}

impl PendingPicture {
    /// Enqueues a view as it is at an iteration, over the background of iteration `background_of`: its render, the error of that by
    /// `errors`, and the depth of the same pairs. Does not wait, unless ranks share the Gaussians; an overflow of the pairs is told by the status array.
    ///
    /// # Errors
    /// A photo that cannot be read, no room, or the driver's.
    pub(super) fn enqueue(
        on: &mut Working<'_>,
        errors: &PhotoErrors<f32>,
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
        let pixels = size.pixels[0] * size.pixels[1];
        let taken = &view.photo;
        let photo = taken.read_later(0, alpha.planes() * pixels)?;
        let Pipeline {
            exposure,
            forward,
            share,
            ..
        } = &mut *on.pipeline;
        match share {
            Some(share) => {
                share.divide_evenly(size);
                share.render(forward, scene, &camera, &options)?;
                share.complete(&forward.frame.image, 4, size)?;
            }
            None => {
                forward.fit(scene, &camera)?;
                forward.enqueue(scene, &camera, &options)?;
            }
        }
        let exposure = exposure.as_ref();
        let transform = exposure.map(|e| (&e.stage.transforms, number));
        errors.write(
            &ImagePair::new(&forward.frame, taken, view.background),
            transform,
        )?;
        let error = forward
            .frame
            .image
            .read_later(PhotoErrors::<f32>::PLANE * plane, 2 * plane)?;
        forward.enqueue_depths([0.0; 3])?;
        if let Some(share) = share {
            share.complete(&forward.frame.image, 1, size)?;
        }
        let depth = forward.frame.image.read_later(0, plane)?;
        Ok(Self {
            camera,
            alpha,
            error,
            depth,
            photo,
            transform: exposure.map(|e| e.read_transform(number)).transpose()?,
        })
    }

    /// Waits for the transfers.
    ///
    /// # Errors
    /// The driver's.
    pub(super) fn arrived(self) -> Result<ArrivedPicture> {
        Ok(ArrivedPicture {
            camera: self.camera,
            alpha: self.alpha,
            error: self.error.arrived()?,
            depth: self.depth.arrived()?,
            photo: self.photo.arrived()?,
            transform: self.transform.map(PendingRead::wait).transpose()?,
        })
    }
}

/// A [`PendingPicture`] whose transfers are done.
#[derive(Debug)]
pub(super) struct ArrivedPicture {
    camera: CameraArg<f32>,
    alpha: Alpha,
    error: Arrived<f32>,
    depth: Arrived<f32>,
    photo: Arrived<u8>,
    transform: Option<Vec<f32>>,
}

/// Photo and colour transform of an [`ArrivedPicture`].
#[derive(Debug)]
struct TakenPhoto<'a> {
    alpha: Alpha,
    bytes: &'a [u8],
    transform: Option<&'a [f32]>,
}

impl ArrivedPicture {
    /// The view with its photo.
    pub(super) fn picture(&self) -> Picture<'_> {
        let photo = TakenPhoto {
            alpha: self.alpha,
            bytes: &self.photo,
            transform: self.transform.as_deref(),
        };
        let size = self.camera.image();
        let (error, transmittance) = self.error.split_at(size.plane());
        Picture {
            size: size.pixels,
            stride: size.padded()[0],
            intrinsics: self.camera.intrinsics,
            rotation: self.camera.w,
            center: self.camera.center,
            photo: Arc::new(photo),
            error: Cow::Borrowed(error),
            depth: Cow::Borrowed(&self.depth),
            transmittance: Cow::Borrowed(transmittance),
        }
    }
}

impl Colors for TakenPhoto<'_> {
    fn at(&self, pixel: usize) -> [f32; 3] {
        // What is born has the photo's colour and not that of this iteration's background.
        let alpha = match self.alpha {
            Alpha::Transparency => Alpha::Mask,
            alpha => alpha,
        };
        let mut color = [[0.0]; 3];
        let out = color.each_mut().map(<[f32; 1]>::as_mut_slice);
        write_colors(alpha, self.bytes, [0.0; 3], pixel, out);
        let color = color.map(|[value]| value);
        match self.transform {
            None => color,
            Some(transform) => unexposed(transform, color),
        }
    }

    fn is_masked(&self, pixel: usize) -> bool {
        let opacities = &self.bytes[self.bytes.len() / 4 * 3..];
        self.alpha == Alpha::Mask && f32::from(opacities[pixel]) / 255.0 < 0.5
    }
}
