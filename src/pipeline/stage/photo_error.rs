//! Error of each pixel of a render against its photo (`kernels/photo_error.cl`).

use crate::base::error::Result;
use crate::capture::Alpha;
use crate::device::{Array, Kernels, Program, Real};
use crate::pipeline::stage::exposure::{ENTRIES, IDENTITY, apply};
use crate::pipeline::stage::loss::ImagePair;

/// The kernel, and the transform of views that have none.
#[derive(Debug)]
pub struct PhotoErrors<R: Real> {
    program: Program,
    identity: Array<R>,
}

impl<R: Real> PhotoErrors<R> {
    /// Plane of the image that the errors are written to; that of the transmittance is the next, and both can be read at once.
    pub const PLANE: usize = 2;

    /// Builds the kernel.
    pub fn new(kernels: &Kernels) -> Result<Self> {
        let identity = IDENTITY.map(R::of);
        Ok(Self {
            program: kernels.build::<R>("photo_error")?,
            identity: Array::from_slice(kernels.device(), "exposures", &identity)?,
        })
    }

    /// Writes the errors of a render in the place of its blue; `transform` is an array of transforms and the number of the view's.
    pub fn write(
        &self,
        pair: &ImagePair<'_, R>,
        transform: Option<(&Array<R>, usize)>,
    ) -> Result<()> {
        let (transforms, number) = transform.unwrap_or((&self.identity, 0));
        pair.images(self.program.launch("photo_error"))
            .reals::<R>(pair.background.map(f64::from))
            .array(transforms, ENTRIES * (number + 1))
            .uints([number])
            .over_groups(pair.size.pixels[1])
    }
}

// Definition in f64.

/// Error of each pixel of an image \[3, pixels\] under a transform against a photo \[3, pixels\], which is over the background if it
/// is transparent and premultiplied if it has a mask; `alpha` is the meaning of `opacity` \[pixels\].
#[must_use]
pub fn photo_error(
    image: &[f64],
    exposure: &[f64; ENTRIES],
    photo: &[f64],
    (alpha, opacity): (Alpha, &[f64]),
) -> Vec<f64> {
    let (n, seen) = (image.len() / 3, apply(image, exposure));
    let weight = |i: usize| {
        if alpha == Alpha::None {
            1.0
        } else {
            opacity[i]
        }
    };
    let taken = |at: usize| match (alpha, weight(at % n)) {
        (Alpha::Mask, 0.0) => 0.0,
        (Alpha::Mask, mask) => (photo[at] / mask).min(1.0),
        _ => photo[at],
    };
    let apart = |at: usize| (seen[at] - taken(at)).abs();
    let error = |i: usize| weight(i) * (apart(i) + apart(n + i) + apart(2 * n + i)) / 3.0;
    (0..n).map(error).collect()
}
