//! 8-bit photos, planar, and the exact area filter.

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};

/// Meaning of the alpha plane of photos.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Alpha {
    /// Absent alpha plane.
    #[default]
    None,
    /// Opacity of the scene in front of the background: a photo over b is `rgb + (1 − alpha)·b`.
    Transparency,
    /// Weight of each pixel in the comparison of render and photo.
    Mask,
}

impl Alpha {
    /// Planes of a photo: colour, and alpha if there is any.
    #[must_use]
    pub fn planes(self) -> usize {
        if self == Self::None { 3 } else { 4 }
    }

    /// The meaning that those of several photos share which have an alpha plane at all.
    #[must_use]
    pub fn common(photos: impl IntoIterator<Item = Self>) -> Self {
        let mut photos = photos.into_iter();
        photos.find(|a| *a != Self::None).unwrap_or_default()
    }
}

/// An 8-bit image, planar: `data[(c·height + y)·width + x]`. Colours are premultiplied by the alpha plane (channel 3), if
/// there is one, so that the photo over a background b is `rgb + (1 − alpha)·b`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Photo {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Meaning of the fourth plane; without one there are three.
    pub alpha: Alpha,
    /// Planes, 3 or 4 × `height × width` bytes.
    pub data: Vec<u8>,
}

impl Photo {
    /// A photo from interleaved bytes `[height][width][3 or 4]`, as image files have them: RGB, or RGBA with *straight*
    /// alpha, which is multiplied into the colours here.
    ///
    /// # Errors
    /// [`Error::Numerics`] for a side of 0, or a length that is not `width · height` times the planes of `alpha`.
    pub fn from_interleaved(width: u32, height: u32, alpha: Alpha, bytes: &[u8]) -> Result<Self> {
        let n = width as usize * height as usize;
        let c = alpha.planes();
        if n == 0 || n.checked_mul(c) != Some(bytes.len()) {
            let found = bytes.len();
            let what = format!("{found} bytes; {width}×{height} pixels of {c} channels expected");
            return Err(Error::numerics("photo", what));
        }
        let mut data = vec![0; bytes.len()];
        for (i, pixel) in bytes.chunks_exact(c).enumerate() {
            let opacity = pixel.get(3).map_or(255, |a| u32::from(*a));
            for (k, &v) in pixel.iter().enumerate() {
                // Rounded to nearest; exact where alpha is 0 or 255.
                data[k * n + i] = if k == 3 {
                    v
                } else {
                    ((u32::from(v) * opacity + 127) / 255) as u8
                };
            }
        }
        Ok(Self {
            width,
            height,
            alpha,
            data,
        })
    }

    /// Number of pixels.
    fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// The alpha plane, if it has this meaning.
    fn plane(&self, meaning: Alpha) -> Option<&[u8]> {
        let plane = self.data.get(3 * self.pixels()..);
        plane.filter(|_| self.alpha == meaning && meaning != Alpha::None)
    }

    /// The alpha plane, if it is a mask.
    pub(super) fn mask_plane(&self) -> Option<&[u8]> {
        self.plane(Alpha::Mask)
    }

    /// The photo that a render is compared with, interleaved RGB8 `[height][width][3]`: over a background (RGB in [0, 1]) if it
    /// is transparent; times the mask if it has one, independent of the background.
    #[must_use]
    pub fn rgb_over(&self, background: [f32; 3]) -> Vec<u8> {
        let n = self.pixels();
        let mut out = vec![0; 3 * n];
        let alpha = self.plane(Alpha::Transparency);
        for (c, (plane, b)) in self.data.chunks_exact(n.max(1)).zip(background).enumerate() {
            for (i, &v) in plane.iter().enumerate() {
                let behind = alpha.map_or(0.0, |a| f32::from(255 - a[i]) * b);
                out[3 * i + c] = (f32::from(v) + behind).round().clamp(0.0, 255.0) as u8;
            }
        }
        out
    }

    /// Weight of each pixel by the mask, in [0, 1]; empty without a mask.
    #[must_use]
    pub fn counts(&self) -> Vec<f32> {
        let value = |m: &u8| f32::from(*m) / 255.0;
        let mask = self.mask_plane().unwrap_or_default();
        mask.iter().map(value).collect()
    }

    /// A render (interleaved RGB8, of the photo's size) times the photo's mask: the counterpart of [`Photo::rgb_over`].
    #[must_use]
    pub fn counted(&self, mut rgb: Vec<u8>) -> Vec<u8> {
        for (pixel, m) in rgb.chunks_exact_mut(3).zip(self.counts()) {
            for v in pixel {
                *v = (f32::from(*v) * m).round() as u8;
            }
        }
        rgb
    }

    /// The photo for display, interleaved RGB8 with the colours of [`colors`].
    #[must_use]
    pub fn shown(&self, background: [f32; 3]) -> Vec<u8> {
        let planes = colors(self.alpha, &self.data, background);
        let pixel = |i: usize| [0, 1, 2].map(|c| (255.0 * planes[c][i]).round() as u8);
        (0..self.pixels()).flat_map(pixel).collect()
    }

    /// The same photo with an alpha plane of this meaning if it has none: 255 everywhere.
    #[must_use]
    pub fn with_alpha(mut self, alpha: Alpha) -> Self {
        if self.alpha == Alpha::None {
            self.data.resize(alpha.planes() * self.pixels(), 255);
            self.alpha = alpha;
        }
        self
    }
}

/// Red, green and blue in [0, 1] of a photo's planes (laid out as in [`Photo`]): over the background (RGB in [0, 1]) if they
/// are transparent; as without the mask if they have one, but black where the mask is 0.
#[must_use]
pub fn colors(alpha: Alpha, planes: &[u8], background: [f32; 3]) -> [Vec<f32>; 3] {
    let n = planes.len() / alpha.planes();
    let value = |plane: usize, i: usize| f32::from(planes[plane * n + i]) / 255.0;
    let pixel = |c: usize, i: usize| match alpha {
        Alpha::None => value(c, i),
        Alpha::Transparency => value(c, i) + (1.0 - value(3, i)) * background[c],
        Alpha::Mask if planes[3 * n + i] > 0 => (value(c, i) / value(3, i)).min(1.0),
        Alpha::Mask => 0.0,
    };
    std::array::from_fn(|c| (0..n).map(|i| pixel(c, i)).collect())
}

/// Area filter: each target pixel is the mean of the source over exactly the rectangle it covers, with colours
/// premultiplied by alpha before averaging. `bytes` is interleaved with straight alpha; sums are f32, rounded once.
///
/// # Errors
/// Those of [`Photo::from_interleaved`]; also a target of 0 pixels or one larger than the source.
pub fn shrink(
    width: u32,
    height: u32,
    alpha: Alpha,
    bytes: &[u8],
    to_width: u32,
    to_height: u32,
) -> Result<Photo> {
    let bad = |what: String| Err(Error::numerics("area filter", what));
    if to_width == 0 || to_height == 0 || to_width > width || to_height > height {
        return bad(format!(
            "{width}×{height} to {to_width}×{to_height}; a smaller, non-empty target expected"
        ));
    }
    let (w, h, c) = (width as usize, height as usize, alpha.planes());
    let (tw, th) = (to_width as usize, to_height as usize);
    if bytes.len() != w * h * c {
        let found = bytes.len();
        return bad(format!("{found} bytes for {width}×{height}×{c}"));
    }
    let (columns, rows) = (coverage(w, tw), coverage(h, th));
    let mut data = vec![0_u8; tw * th * c];
    let mut line = vec![0.0_f32; tw * c];
    for (ty, covered) in rows.iter().enumerate() {
        let mut sum = vec![0.0_f32; tw * c];
        for (y, weight) in covered {
            shrink_row(&bytes[y * w * c..(y + 1) * w * c], c, &columns, &mut line);
            for (s, v) in sum.iter_mut().zip(&line) {
                *s += weight * v;
            }
        }
        for (i, s) in sum.iter().enumerate() {
            let (tx, k) = (i / c, i % c);
            data[(k * th + ty) * tw + tx] = s.round().clamp(0.0, 255.0) as u8;
        }
    }
    Ok(Photo {
        width: to_width,
        height: to_height,
        alpha,
        data,
    })
}

/// Averages one source row: premultiplied means over each target column, `[target width][channels]`.
fn shrink_row(row: &[u8], c: usize, columns: &[Vec<(usize, f32)>], out: &mut [f32]) {
    for (target, covered) in out.chunks_exact_mut(c).zip(columns) {
        target.fill(0.0);
        for (x, weight) in covered {
            let pixel = &row[x * c..(x + 1) * c];
            let alpha = pixel.get(3).map_or(1.0, |a| f32::from(*a) / 255.0);
            for (k, t) in target.iter_mut().enumerate() {
                let v = f32::from(pixel[k]);
                *t += weight * if k == 3 { v } else { v * alpha };
            }
        }
    }
}

/// Source pixels that each of `to` target pixels covers along an axis of `from`, and the share of the target that each makes up.
/// Overlaps are counted in integers of 1/(from·to), so that no rounding decides whether a pixel is covered.
fn coverage(from: usize, to: usize) -> Vec<Vec<(usize, f32)>> {
    let span = |t: usize| {
        let (start, end) = (t * from, (t + 1) * from);
        let share = |s: usize| {
            let overlap = end.min((s + 1) * to) - start.max(s * to);
            (s, (overlap as f64 / from as f64) as f32)
        };
        (start / to..end.div_ceil(to)).map(share).collect()
    };
    (0..to).map(span).collect()
}
