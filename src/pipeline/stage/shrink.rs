//! Photos at a fraction of their size: on the device (`kernels/shrink.cl`), and in the host as they are decoded on demand, with the same bytes.

use std::ops::Range;

use crate::base::constants::SHRINK_RUN;
use crate::base::error::Result;
use crate::capture::Photo;
use crate::device::{Array, Device, ImageSize, PhotoScale, Program};

/// A photo of so many planes at a fraction of its size.
///
/// # Errors
/// No room for it, or the driver's.
pub fn reduce(
    device: &Device,
    stage: &Program,
    photo: &Array<u8>,
    (size, planes): (ImageSize, usize),
    scale: PhotoScale,
) -> Result<Array<u8>> {
    let [from_w, from_h] = size.pixels;
    let [w, h] = size.pixels.map(|s| scale.of(s));
    let small = Array::zeros(device, "small", planes * w * h)?;
    stage
        .launch("shrink")
        .array(photo, planes * from_w * from_h)
        .ints([from_w, from_h, planes, scale.num, scale.den])
        .array(&small, planes * w * h)
        .over_chunks([w.div_ceil(SHRINK_RUN as usize), planes * h])?;
    Ok(small)
}

// Definition, exact in integers; photos that are decoded on demand are made by it.

/// Input pixels that output pixel `to` covers, each with the length that is covered, in 1/`num` of an input pixel.
fn covered(to: usize, PhotoScale { num, den }: PhotoScale) -> impl Iterator<Item = (usize, u32)> {
    let (start, end) = (to * den, (to + 1) * den);
    let length = move |k: usize| ((k + 1) * num).min(end) - (k * num).max(start);
    (start / num..end.div_ceil(num)).map(move |k| (k, length(k) as u32))
}

/// The photo at a fraction of its size: means over the pixels that one covers, each by the area that is covered, rounded to nearest; what
/// does not fill a pixel is left out.
#[must_use]
pub fn shrink(photo: &Photo, scale: PhotoScale) -> Photo {
    shrink_rows(photo, scale, 0..scale.of(photo.height as usize))
}

/// These rows of [`shrink`].
#[must_use]
pub fn shrink_rows(photo: &Photo, scale: PhotoScale, rows: Range<usize>) -> Photo {
    let [across, down] = [photo.width, photo.height].map(|n| n as usize);
    let width = scale.of(across);
    let area = (scale.den * scale.den) as u32;
    let mut data = Vec::with_capacity(photo.alpha.planes() * width * rows.len());
    let mut sums = vec![0_u32; across];
    for plane in photo.data.chunks_exact((across * down).max(1)) {
        for to in rows.clone() {
            sums.fill(0);
            for (y, height) in covered(to, scale) {
                let row = &plane[y * across..][..across];
                for (sum, v) in sums.iter_mut().zip(row) {
                    *sum += height * u32::from(*v);
                }
            }
            data.extend((0..width).map(|x| {
                let sum: u32 = covered(x, scale).map(|(k, width)| width * sums[k]).sum();
                ((sum + area / 2) / area) as u8
            }));
        }
    }
    Photo {
        width: width as u32,
        height: rows.len() as u32,
        alpha: photo.alpha,
        data,
    }
}
