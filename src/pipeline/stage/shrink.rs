//! Photos at a fraction of their size (`kernels/shrink.cl`).

use crate::base::constants::SHRINK_RUN;
use crate::base::error::Result;
use crate::capture::Photo;
use crate::device::{Array, Device, ImageSize, Program};

/// A photo of so many planes at 1/`factor` of its size.
///
/// # Errors
/// No room for it, or the driver's.
pub fn reduce(
    device: &Device,
    stage: &Program,
    photo: &Array<u8>,
    (size, planes): (ImageSize, usize),
    factor: usize,
) -> Result<Array<u8>> {
    let [from_w, from_h] = size.0;
    let [w, h] = size.0.map(|s| s / factor);
    let small = Array::zeros(device, "small", planes * w * h)?;
    stage
        .launch("shrink")
        .array(photo, planes * from_w * from_h)
        .ints([from_w, from_h, planes, factor])
        .array(&small, planes * w * h)
        .over_chunks([w.div_ceil(SHRINK_RUN as usize), planes * h])?;
    Ok(small)
}

// Definition in f64.

/// The photo at 1/`factor` of its size: means of `factor` × `factor` pixels, rounded to nearest; what does not fill a pixel
/// is left out.
#[must_use]
pub fn shrink(photo: &Photo, factor: u32) -> Photo {
    let (width, height) = (photo.width / factor, photo.height / factor);
    let mut data = Vec::new();
    for plane in 0..photo.alpha.planes() as u32 {
        for y in 0..height {
            for x in 0..width {
                let cell = (0..factor * factor).map(|k| {
                    let (px, py) = (x * factor + k % factor, y * factor + k / factor);
                    f64::from(photo.data[((plane * photo.height + py) * photo.width + px) as usize])
                });
                let mean = cell.sum::<f64>() / f64::from(factor * factor);
                data.push((mean + 0.5).floor() as u8);
            }
        }
    }
    Photo {
        width,
        height,
        alpha: photo.alpha,
        data,
    }
}
