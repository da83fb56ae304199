//! Views of the report: renders, photos and error maps.

use base64::Engine;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, RgbImage, imageops};

use crate::base::error::{Error, Result};
use crate::evaluate::Evaluator;
use crate::pipeline::forward::Renders;

/// Error at which the map is brightest: mean absolute error over R, G, B of values in [0, 1]; larger errors look the
/// same. One fixed scale, so that maps of different views and runs compare; 0.2 keeps 25–30 dB (0.02–0.04) visible.
pub const ERROR_FULL_SCALE: f64 = 0.2;

/// Longest side of an image in the page, in pixels: two per CSS pixel in a column of three. Larger ones are reduced.
const LONGEST_SIDE: u32 = 640;

/// Largest number of held-out views that are shown.
pub(crate) const GALLERY_VIEWS: usize = 6;

/// One view. The three images are 8-bit RGB, interleaved, row-major, `width · height · 3` bytes each.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct GalleryItem {
    /// Name of the view.
    pub view: String,
    /// True if the view was trained on.
    pub training: bool,
    /// PSNR of the render in dB.
    pub psnr: f64,
    /// SSIM of the render.
    pub ssim: f64,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// The render.
    pub render: Vec<u8>,
    /// The photo.
    pub photo: Vec<u8>,
    /// The error map ([`error_map`]).
    pub error: Vec<u8>,
}

/// Colour of `t` ∈ [0, 1] (clamped; NaN is 1, so that a broken pixel shows): dark blue, purple, red, orange, pale yellow.
///
/// Degree-5 polynomials per channel, fitted by least squares to a path through Oklab (Ottosson 2020) on which lightness
/// is 0.16 + 0.8 t, hue turns from 280° to 460° as t^0.9 and chroma is 0.05 + 0.5 t (1 − t) + 0.06 t. CIE L* of the fit
/// rises steadily from 3 to 96, so the map also reads in grey.
#[must_use]
pub fn colormap(t: f64) -> [u8; 3] {
    const COEFFICIENTS: [[f64; 6]; 3] = [
        [0.036, 1.135, 1.232, 2.399, -8.681, 4.889],
        [0.015, 1.288, -11.42, 31.233, -30.274, 10.119],
        [0.177, -0.06, 11.331, -40.451, 44.843, -15.163],
    ];
    let t = if t.is_nan() { 1.0 } else { t.clamp(0.0, 1.0) };
    COEFFICIENTS.map(|c| {
        let value = c.iter().rev().fold(0.0, |sum, k| sum * t + k);
        (value.clamp(0.0, 1.0) * 255.0).round() as u8
    })
}

/// Error map of `render` against `photo`: per pixel the mean absolute difference over R, G, B in [0, 1], relative to
/// [`ERROR_FULL_SCALE`], through [`colormap`]. All three images are 8-bit RGB, interleaved.
///
/// # Errors
/// [`Error::Numerics`] when the two images differ in length or are not whole pixels.
pub fn error_map(render: &[u8], photo: &[u8]) -> Result<Vec<u8>> {
    if render.len() != photo.len() || !render.len().is_multiple_of(3) {
        let what = format!(
            "render of {} bytes, photo of {}; expected equal multiples of 3",
            render.len(),
            photo.len()
        );
        return Err(Error::numerics("error map", what));
    }
    // 8-bit images have 3 · 255 + 1 different sums: a table saves a polynomial per pixel.
    let table: Vec<[u8; 3]> = (0..=3 * 255)
        .map(|sum| colormap(f64::from(sum) / (3.0 * 255.0 * ERROR_FULL_SCALE)))
        .collect();
    let pixels = render.chunks_exact(3).zip(photo.chunks_exact(3));
    let colors = pixels.flat_map(|(a, b)| {
        let sum: usize = a.iter().zip(b).map(|(x, y)| x.abs_diff(*y) as usize).sum();
        table.get(sum).copied().unwrap_or([255; 3])
    });
    Ok(colors.collect())
}

/// Renders and scores views of an evaluator; those whose masks are 0 everywhere are left out.
///
/// # Errors
/// See [`Evaluator::score`].
pub(crate) fn items(
    evaluator: &Evaluator,
    views: &[usize],
    scene: &mut dyn Renders,
    background: [f32; 3],
) -> Result<Vec<GalleryItem>> {
    let mut items = Vec::with_capacity(views.len());
    for (k, &view) in views.iter().enumerate() {
        let next = &views[k + 1..];
        let Some(score) = evaluator.score(view, next, scene, background)? else {
            continue;
        };
        let image = scene.renderer().read_image()?;
        let render = image.rgb8();
        let photo = evaluator.views().read_photo(view)?;
        let counted = photo.counted(render.clone());
        items.push(GalleryItem {
            view: score.view,
            training: false,
            psnr: score.scores.psnr,
            ssim: score.scores.ssim,
            width: image.width as u32,
            height: image.height as u32,
            error: error_map(&counted, &photo.rgb_over(background))?,
            render,
            photo: photo.shown(background),
        });
    }
    Ok(items)
}

/// An 8-bit RGB image, reduced to at most 640 pixels on the longest side.
///
/// # Errors
/// [`Error::Numerics`] when the bytes do not match the size.
pub(crate) fn picture(name: &str, rgb: &[u8], width: u32, height: u32) -> Result<RgbImage> {
    let expected = u64::from(width) * u64::from(height) * 3;
    let image = RgbImage::from_raw(width, height, rgb.to_vec())
        .filter(|_| expected > 0 && rgb.len() as u64 == expected);
    image.map(reduce).ok_or_else(|| {
        let found = rgb.len();
        let what = format!("{found} bytes, expected {width} × {height} × 3 and not empty");
        Error::numerics(format!("report image {name}"), what)
    })
}

/// An 8-bit RGB image as a PNG data URI, reduced to at most 640 pixels on the longest side.
///
/// # Errors
/// [`Error::Numerics`] when the bytes do not match the size or cannot be encoded.
pub fn data_uri(name: &str, rgb: &[u8], width: u32, height: u32) -> Result<String> {
    let image = picture(name, rgb, width, height)?;
    let mut png = Vec::new();
    PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Adaptive)
        .write_image(
            image.as_raw(),
            image.width(),
            image.height(),
            ExtendedColorType::Rgb8,
        )
        .map_err(|e| Error::numerics(format!("report image {name}"), e))?;
    let text = base64::engine::general_purpose::STANDARD.encode(png);
    Ok(format!("data:image/png;base64,{text}"))
}

fn reduce(image: RgbImage) -> RgbImage {
    let longest = image.width().max(image.height());
    if longest <= LONGEST_SIDE {
        return image;
    }
    let scaled = |side: u32| {
        let exact = f64::from(side) * f64::from(LONGEST_SIDE) / f64::from(longest);
        (exact.round() as u32).max(1)
    };
    let (width, height) = (scaled(image.width()), scaled(image.height()));
    imageops::resize(&image, width, height, imageops::FilterType::Triangle)
}
