//! Photos at a fraction of their size: on the device (`kernels/shrink.cl`), and in the host as they are decoded on demand, with the same bytes.

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

// Definition, exact in integers; photos that are decoded on demand are made by it.

/// The photo at 1/`factor` of its size: means of `factor` × `factor` pixels, rounded to nearest; what does not fill a pixel
/// is left out.
#[must_use]
pub fn shrink(photo: &Photo, factor: u32) -> Photo {
    let (width, height) = (photo.width / factor, photo.height / factor);
    let [across, rows, factor] = [photo.width, photo.height, factor].map(|n| n as usize);
    let area = (factor * factor) as u32;
    let mut data = Vec::with_capacity(photo.alpha.planes() * (width * height) as usize);
    let mut sums = vec![0_u32; width as usize];
    for plane in photo.data.chunks_exact(across * rows) {
        for group in plane.chunks_exact(across * factor) {
            sums.fill(0);
            for row in group.chunks_exact(across) {
                for (sum, cell) in sums.iter_mut().zip(row.chunks_exact(factor)) {
                    *sum += cell.iter().map(|v| u32::from(*v)).sum::<u32>();
                }
            }
            data.extend(sums.iter().map(|sum| ((sum + area / 2) / area) as u8));
        }
    }
    Photo {
        width,
        height,
        alpha: photo.alpha,
        data,
    }
}
