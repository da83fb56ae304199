//! Renders of training views on their way to density control.

use std::borrow::Cow;
use std::sync::Arc;

use rayon::prelude::*;

use crate::base::error::Result;
use crate::capture::Alpha;
use crate::capture::photo::write_colors;
use crate::density::{Colors, Picture};
use crate::device::{Arrived, CameraArg, PendingRead};
use crate::pipeline::forward::{Quantity, RenderOptions};
use crate::pipeline::stage::exposure::{exposed, unexposed};
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

    /// Waits for the transfers.
    ///
    /// # Errors
    /// The driver's.
    pub(super) fn arrived(self) -> Result<ArrivedPicture> {
        Ok(ArrivedPicture {
            camera: self.camera,
            background: self.background,
            alpha: self.alpha,
            image: self.image.arrived()?,
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
    background: [f32; 3],
    alpha: Alpha,
    image: Arrived<f32>,
    depth: Arrived<f32>,
    photo: Arrived<u8>,
    transform: Option<Vec<f32>>,
}

/// Photo and colour transform of an [`ArrivedPicture`].
#[derive(Debug)]
struct TakenPhoto<'a> {
    alpha: Alpha,
    background: [f32; 3],
    bytes: &'a [u8],
    transform: Option<&'a [f32]>,
}

impl ArrivedPicture {
    /// The view with its photo; computes errors.
    pub(super) fn picture(&self) -> Picture<'_> {
        let photo = TakenPhoto {
            alpha: self.alpha,
            background: self.background,
            bytes: &self.photo,
            transform: self.transform.as_deref(),
        };
        let size = self.camera.image();
        let ([width, height], [stride, _], plane) = (size.0, size.padded(), size.plane());
        let (pixels, image) = (width * height, &*self.image);
        let planes = [0, 1, 2].map(|c| &image[c * plane..][..plane]);
        let mut error = vec![0.0; pixels];
        let rows = error.par_chunks_mut(width).enumerate();
        rows.for_each_init(
            || [(); 3].map(|()| vec![0.0; width]),
            |taken, (row, errors)| {
                let render = planes.map(|values| &values[row * stride..][..width]);
                photo.errors(row * width, render, taken, errors);
            },
        );
        let masked = match self.alpha {
            Alpha::Mask => (0..pixels).map(|i| photo.opacity(i) < 0.5).collect(),
            _ => Vec::new(),
        };
        Picture {
            size: size.0,
            stride,
            intrinsics: self.camera.intrinsics,
            rotation: self.camera.w,
            center: self.camera.center,
            photo: Arc::new(photo),
            error,
            depth: Cow::Borrowed(&self.depth),
            transmittance: Cow::Borrowed(&image[3 * plane..]),
            masked,
        }
    }
}

impl TakenPhoto<'_> {
    /// Opacity at pixel `i`, in [0, 1].
    fn opacity(&self, i: usize) -> f32 {
        match self.alpha {
            Alpha::None => 1.0,
            _ => f32::from(self.bytes[self.bytes.len() / 4 * 3 + i]) / 255.0,
        }
    }

    /// Writes the errors of a row of the render, whose first pixel is `first`; `taken` is scratch space for a row.
    fn errors(
        &self,
        first: usize,
        render: [&[f32]; 3],
        taken: &mut [Vec<f32>; 3],
        errors: &mut [f32],
    ) {
        let out = taken.each_mut().map(Vec::as_mut_slice);
        write_colors(self.alpha, self.bytes, self.background, first, out);
        let width = errors.len();
        let ([r, g, b], taken) = (render, taken.each_ref().map(|plane| &plane[..width]));
        for (i, error) in errors.iter_mut().enumerate() {
            let mut seen = [r[i], g[i], b[i]];
            if let Some(transform) = self.transform {
                seen = exposed(transform, seen);
            }
            let apart = |c: usize| (seen[c] - taken[c][i]).abs();
            *error = apart(0) + apart(1) + apart(2);
        }
        if self.alpha != Alpha::None {
            // Image space has no birth where the photo has nothing, whatever fog is there.
            let opacities = (first..).map(|i| self.opacity(i));
            errors.iter_mut().zip(opacities).for_each(|(e, o)| *e *= o);
        }
        errors.iter_mut().for_each(|e| *e /= 3.0);
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
        write_colors(alpha, self.bytes, self.background, pixel, out);
        let color = color.map(|[value]| value);
        match self.transform {
            None => color,
            Some(transform) => unexposed(transform, color),
        }
    }
}
