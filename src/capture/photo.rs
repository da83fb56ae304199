//! 8-bit photos, planar, and the exact area filter.

use std::ops::Range;

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

    /// Some rows of the photo, those that it has.
    pub(crate) fn rows(self, rows: Range<usize>) -> Self {
        let (width, height) = (self.width as usize, self.height as usize);
        let rows = rows.start.min(height)..rows.end.min(height);
        if rows.len() == height {
            return self;
        }
        let planes = self.data.chunks_exact(self.pixels().max(1));
        let part = planes.map(|plane| &plane[rows.start * width..rows.end * width]);
        Self {
            height: rows.len() as u32,
            data: part.collect::<Vec<_>>().concat(),
            ..self
        }
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

/// The byte nearest to a value; 0 for one that is not a number. [`f64::round`] is a call of a function on machines of the least that x86-64 has.
pub(super) fn nearest(value: f64) -> u8 {
    (value + 0.5) as u8
}

/// Red, green and blue in [0, 1] of a photo's planes (laid out as in [`Photo`]): over the background (RGB in [0, 1]) if they
/// are transparent; as without the mask if they have one, but black where the mask is 0.
#[must_use]
pub fn colors(alpha: Alpha, planes: &[u8], background: [f32; 3]) -> [Vec<f32>; 3] {
    let n = planes.len() / alpha.planes();
    let mut out = [(); 3].map(|()| vec![0.0; n]);
    write_colors(
        alpha,
        planes,
        background,
        0,
        out.each_mut().map(Vec::as_mut_slice),
    );
    out
}

/// Writes the colours of the pixels from `first` on, as many as the planes of `out` have room for; see [`colors`].
pub fn write_colors(
    alpha: Alpha,
    planes: &[u8],
    background: [f32; 3],
    first: usize,
    out: [&mut [f32]; 3],
) {
    let n = planes.len() / alpha.planes();
    let value = |v: u8| f32::from(v) / 255.0;
    for (c, out) in out.into_iter().enumerate() {
        let channel = &planes[c * n + first..][..out.len()];
        if alpha == Alpha::None {
            let pixels = out.iter_mut().zip(channel);
            pixels.for_each(|(out, v)| *out = value(*v));
            continue;
        }
        let opacity = &planes[3 * n + first..][..out.len()];
        for ((out, v), a) in out.iter_mut().zip(channel).zip(opacity) {
            *out = match (alpha, *a) {
                (Alpha::Transparency, a) => value(*v) + (1.0 - value(a)) * background[c],
                (_, 0) => 0.0,
                (_, a) => (value(*v) / value(a)).min(1.0),
            };
        }
    }
}

/// Area filter: each target pixel is the mean of the source over exactly the rectangle it covers, with colours
/// premultiplied by alpha before averaging. `bytes` is interleaved with straight alpha; sums are f32, rounded once.
///
/// # Errors
/// A target of 0 pixels or one larger than the source; bytes of another number than the source has.
pub fn shrink(
    width: u32,
    height: u32,
    alpha: Alpha,
    bytes: &[u8],
    to_width: u32,
    to_height: u32,
) -> Result<Photo> {
    let mut small = Shrink::new([width, height], [to_width, to_height], alpha)?;
    let row = width as usize * alpha.planes();
    if bytes.len() != row * height as usize {
        let what = format!("{} bytes for {width}×{height}", bytes.len());
        return Err(Error::numerics("area filter", what));
    }
    for row in bytes.chunks_exact(row) {
        let row: Vec<f32> = row.iter().map(|v| f32::from(*v)).collect();
        small.row(&row);
    }
    small.photo()
}

/// The area filter of [`shrink`], which takes the source row by row.
pub(super) struct Shrink {
    from: [usize; 2],
    to: [usize; 2],
    alpha: Alpha,
    columns: Vec<Vec<(usize, f32)>>,
    /// A source row averaged along itself, `[target width][channels]`.
    line: Vec<f32>,
    /// The target row that is being summed up.
    sum: Vec<f32>,
    /// Rows taken, and target rows finished.
    taken: usize,
    done: usize,
    transparent: bool,
    data: Vec<u8>,
}

impl Shrink {
    /// The filter from one size to another; at the same size the photo stays as it is.
    ///
    /// # Errors
    /// A target of 0 pixels or one larger than the source.
    pub fn new(from: [u32; 2], to: [u32; 2], alpha: Alpha) -> Result<Self> {
        if to.contains(&0) || to[0] > from[0] || to[1] > from[1] {
            let [[w, h], [tw, th]] = [from, to];
            let what = format!("{w}×{h} to {tw}×{th}; a smaller, non-empty target expected");
            return Err(Error::numerics("area filter", what));
        }
        let [from, to] = [from, to].map(|size| size.map(|s| s as usize));
        let line = to[0] * alpha.planes();
        Ok(Self {
            from,
            to,
            alpha,
            columns: coverage(from[0], to[0]),
            line: vec![0.0; line],
            sum: vec![0.0; line],
            taken: 0,
            done: 0,
            transparent: false,
            data: vec![0; line * to[1]],
        })
    }

    /// Takes the next row, interleaved with straight alpha, values from 0 to 255. Rows beyond the last are ignored.
    pub fn row(&mut self, row: &[f32]) {
        let channels = self.alpha.planes();
        // An alpha that is rounded to less than 255 is not opaque.
        self.transparent |= channels == 4 && row.chunks_exact(4).any(|p| p[3] < 254.5);
        match channels {
            4 => shrink_row::<4>(row, &self.columns, &mut self.line),
            _ => shrink_row::<3>(row, &self.columns, &mut self.line),
        }
        let ([_, from], [_, to]) = (self.from, self.to);
        self.taken += 1;
        // The target is smaller: a row belongs to one target row, or ends one and begins the next.
        while self.done < to && self.done * from < self.taken * to {
            let weight = share(from, to, self.done, self.taken - 1);
            for (s, v) in self.sum.iter_mut().zip(&self.line) {
                *s += weight * v;
            }
            if (self.done + 1) * from > self.taken * to {
                return;
            }
            self.end_target_row();
        }
    }

    fn end_target_row(&mut self) {
        let (channels, [width, height]) = (self.alpha.planes(), self.to);
        for (i, s) in self.sum.iter_mut().enumerate() {
            let at = ((i % channels) * height + self.done) * width + i / channels;
            self.data[at] = nearest(f64::from(*s));
            *s = 0.0;
        }
        self.done += 1;
    }

    /// The photo; without an alpha plane if every pixel of the source is opaque.
    ///
    /// # Errors
    /// [`Error::Numerics`] if rows are missing.
    pub fn photo(mut self) -> Result<Photo> {
        if self.done < self.to[1] {
            let what = format!("{} of {} rows", self.taken, self.from[1]);
            return Err(Error::numerics("area filter", what));
        }
        if !self.transparent {
            self.alpha = Alpha::None;
            self.data.truncate(3 * self.to[0] * self.to[1]);
        }
        Ok(Photo {
            width: self.to[0] as u32,
            height: self.to[1] as u32,
            alpha: self.alpha,
            data: self.data,
        })
    }
}

/// Averages one source row: premultiplied means over each target column, `[target width][channels]`.
fn shrink_row<const C: usize>(row: &[f32], columns: &[Vec<(usize, f32)>], out: &mut [f32]) {
    let (pixels, _) = row.as_chunks::<C>();
    let (targets, _) = out.as_chunks_mut::<C>();
    for (target, covered) in targets.iter_mut().zip(columns) {
        let mut sum = [0.0_f32; C];
        for (x, weight) in covered {
            let pixel = &pixels[*x];
            let alpha = pixel.get(3).map_or(1.0, |a| a / 255.0);
            for (k, (t, v)) in sum.iter_mut().zip(pixel).enumerate() {
                *t += weight * if k == 3 { *v } else { v * alpha };
            }
        }
        *target = sum;
    }
}

/// The part of the target `t`, one of `to` along an axis of `from`, that the source `s` makes up. Overlaps are counted in integers
/// of 1/(from·to), so that no rounding decides whether a pixel is covered.
fn share(from: usize, to: usize, t: usize, s: usize) -> f32 {
    let (start, end) = (t * from, (t + 1) * from);
    let overlap = end.min((s + 1) * to).saturating_sub(start.max(s * to));
    (overlap as f64 / from as f64) as f32
}

/// Source pixels that each of `to` target pixels covers along an axis of `from`, and the share of the target that each makes up.
fn coverage(from: usize, to: usize) -> Vec<Vec<(usize, f32)>> {
    let span = |t: usize| {
        let covered = t * from / to..((t + 1) * from).div_ceil(to);
        covered.map(|s| (s, share(from, to, t, s))).collect()
    };
    (0..to).map(span).collect()
}
