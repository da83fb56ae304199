//! Image files → [`Photo`]s: decoding and the exact area filter.

use std::path::Path;

use image::{ImageDecoder, ImageReader};

use crate::base::error::{Error, Result};
use crate::capture::lens::Undistortion;
use crate::capture::photo::{Alpha, Photo};

/// A decoder for an image file by its content. EXIF orientation is ignored, as COLMAP and the NeRF tools ignore it, so that
/// pixels stay where the poses expect them.
fn open(file: &Path) -> Result<ImageReader<std::io::BufReader<std::fs::File>>> {
    ImageReader::open(file)
        .and_then(ImageReader::with_guessed_format)
        .map_err(|source| Error::io(file, source))
}

fn not_an_image(file: &Path, reason: &image::ImageError) -> Error {
    Error::input(
        file,
        format!("not a readable image ({reason}); PNG, JPEG or WebP expected"),
        "replace the file or remove its entry from the dataset",
    )
}

/// Size and channels of an image file, from its header.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Header {
    /// Width, pixels, ≥ 1.
    pub width: u32,
    /// Height, pixels, ≥ 1.
    pub height: u32,
    /// True if pixels may be transparent.
    pub has_alpha: bool,
}

/// Reads an image file's header.
///
/// # Errors
/// A file that cannot be opened, is no image, or has no pixel.
pub(crate) fn header(file: &Path) -> Result<Header> {
    let decoder = open(file)?
        .into_decoder()
        .map_err(|e| not_an_image(file, &e))?;
    let (width, height) = decoder.dimensions();
    if width == 0 || height == 0 {
        return Err(Error::input(
            file,
            format!("{width}×{height} pixels; at least 1×1 expected"),
            "replace the file or remove its entry from the dataset",
        ));
    }
    Ok(Header {
        width,
        height,
        has_alpha: decoder.color_type().has_alpha(),
    })
}

/// Decodes a photo, multiplies its mask file into its alpha, removes the lens distortion and shrinks it to a longest side of at
/// most `max_size` pixels. It has an alpha plane, which is `meaning`, only if some pixel is not opaque.
///
/// # Errors
/// A file that cannot be opened, is no image, or has another size than its lens is known for.
pub(crate) fn decode(
    file: &Path,
    max_size: u32,
    undistortion: Option<&Undistortion>,
    mask: Option<&Path>,
    meaning: Alpha,
) -> Result<Photo> {
    let image = open(file)?.decode().map_err(|e| not_an_image(file, &e))?;
    let (mut width, mut height) = (image.width(), image.height());
    let has_alpha = image.color().has_alpha() || mask.is_some();
    let mut bytes = if has_alpha {
        image.into_rgba8().into_raw()
    } else {
        image.into_rgb8().into_raw()
    };
    if let Some(mask) = mask {
        apply_mask(mask, &mut bytes, [width, height])?;
    }
    if let Some(undistortion) = undistortion {
        if (width, height) != undistortion.source_size() {
            return Err(Error::input(
                file,
                format!(
                    "{width}×{height} pixels; another size was there when the dataset was read"
                ),
                "leave the photos as they are during a run, and start again",
            ));
        }
        bytes = undistortion.apply(&bytes, if has_alpha { 4 } else { 3 });
        (width, height) = (undistortion.target.width, undistortion.target.height);
    }
    let opaque = |rgba: &[u8]| rgba.chunks_exact(4).all(|p| p[3] == 255);
    let alpha = match meaning {
        _ if !has_alpha || opaque(&bytes) => Alpha::None,
        Alpha::None => Alpha::Transparency,
        meaning => meaning,
    };
    if has_alpha && alpha == Alpha::None {
        let rgb = bytes.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]);
        bytes = rgb.collect();
    }
    let (w, h) = fitted(width, height, max_size);
    if (w, h) == (width, height) {
        Photo::from_interleaved(width, height, alpha, &bytes)
    } else {
        shrink(width, height, alpha, &bytes, w, h)
    }
}

/// Multiplies a mask file into the alpha of RGBA bytes: black excludes a pixel, white includes it.
fn apply_mask(file: &Path, rgba: &mut [u8], [width, height]: [u32; 2]) -> Result<()> {
    let mask = open(file)?.decode().map_err(|e| not_an_image(file, &e))?;
    if (mask.width(), mask.height()) != (width, height) {
        return Err(Error::input(
            file,
            format!(
                "{}×{} pixels; its photo has {width}×{height}",
                mask.width(),
                mask.height()
            ),
            "give a mask of the photo's size, or remove it",
        ));
    }
    for (pixel, m) in rgba.chunks_exact_mut(4).zip(mask.into_luma8().into_raw()) {
        pixel[3] = ((u32::from(pixel[3]) * u32::from(m) + 127) / 255) as u8;
    }
    Ok(())
}

/// The largest size of the same shape whose longest side is at most `max_size` (never larger than the original).
pub(crate) fn fitted(width: u32, height: u32, max_size: u32) -> (u32, u32) {
    let longest = width.max(height);
    if longest <= max_size {
        return (width, height);
    }
    let side = |s: u32| {
        let exact = f64::from(s) * f64::from(max_size) / f64::from(longest);
        (exact.round() as u32).max(1)
    };
    (side(width), side(height))
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
    let numerics = |what: String| Error::Numerics {
        stage: "area filter".into(),
        what,
    };
    if to_width == 0 || to_height == 0 || to_width > width || to_height > height {
        return Err(numerics(format!(
            "{width}×{height} to {to_width}×{to_height}; a smaller, non-empty target expected"
        )));
    }
    let (w, h, c) = (width as usize, height as usize, alpha.planes());
    let (tw, th) = (to_width as usize, to_height as usize);
    if bytes.len() != w * h * c {
        return Err(numerics(format!(
            "{} bytes for {width}×{height}×{c}",
            bytes.len()
        )));
    }
    let columns = Coverage::new(w, tw);
    let rows = Coverage::new(h, th);
    let mut data = vec![0_u8; tw * th * c];
    let mut line = vec![0.0_f32; tw * c];
    for ty in 0..th {
        let mut sum = vec![0.0_f32; tw * c];
        for (y, weight) in rows.of(ty) {
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
fn shrink_row(row: &[u8], c: usize, columns: &Coverage, out: &mut [f32]) {
    for (tx, target) in out.chunks_exact_mut(c).enumerate() {
        target.fill(0.0);
        for (x, weight) in columns.of(tx) {
            let pixel = &row[x * c..(x + 1) * c];
            let alpha = if c == 4 {
                f32::from(pixel[3]) / 255.0
            } else {
                1.0
            };
            for (k, t) in target.iter_mut().enumerate() {
                let v = f32::from(pixel[k]);
                *t += weight * if k == 3 { v } else { v * alpha };
            }
        }
    }
}

/// Source pixels that each target pixel covers along one axis, and the share of the target that each makes up.
struct Coverage {
    spans: Vec<(usize, Vec<f32>)>,
}

impl Coverage {
    /// Coverage of `from` pixels by `to`. Overlaps are counted in integers of 1/(from·to), so that no rounding decides whether a pixel is covered.
    fn new(from: usize, to: usize) -> Self {
        let spans = (0..to)
            .map(|t| {
                let (start, end) = (t * from, (t + 1) * from);
                let first = start / to;
                let last = end.div_ceil(to);
                let share = |s: usize| {
                    let overlap = end.min((s + 1) * to) - start.max(s * to);
                    (overlap as f64 / from as f64) as f32
                };
                (first, (first..last).map(share).collect())
            })
            .collect();
        Self { spans }
    }

    fn of(&self, t: usize) -> impl Iterator<Item = (usize, f32)> + '_ {
        let (first, weights) = &self.spans[t];
        weights
            .iter()
            .enumerate()
            .map(move |(k, &w)| (first + k, w))
    }
}
