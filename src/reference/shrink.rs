//! Twin of `kernels/shrink.cl`.

use crate::dataset::Photo;

/// The photo at 1/`factor` of its size: means of `factor` × `factor` pixels, rounded to nearest; what does not fill a pixel
/// is left out.
#[must_use]
pub fn shrink(photo: &Photo, factor: u32) -> Photo {
    let (width, height) = (photo.width / factor, photo.height / factor);
    let mut data = Vec::new();
    for plane in 0..photo.channels {
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
        mask: photo.mask,
        width,
        height,
        channels: photo.channels,
        data,
    }
}
