//! PlayCanvas' SOG, version 2, in one file (`.sog`), read: <https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog>.
//!
//! A zip archive of lossless WebP images, whose pixels are bytes of the Gaussians in turn, and of `meta.json`, which has their ranges and
//! codebooks: positions (16 bits, of the logarithm of 1 + |x|), log-scales and colours (a codebook of 256 values each), opacities
//! (8 bits), rotations (the three smaller components, 8 bits) and SH (a palette of coefficients, which are bytes of a codebook).

use std::io::{Cursor, Read};
use std::path::Path;

use flate2::read::DeflateDecoder;
use image::codecs::webp::WebPDecoder;
use image::{ColorType, DynamicImage, ImageDecoder};
use rawzip::{CompressionMethod, ZipArchive};
use serde::Deserialize;

use crate::base::error::{Error, Result};
use crate::capture::Frame;
use crate::scene::formats::scene_file::{SceneFile, from_smallest_three, limited_logit, localized};
use crate::scene::gaussians::{Plane, sh_coefficients};

/// First bytes of a zip archive.
pub(super) const MAGIC: [u8; 4] = *b"PK\x03\x04";
/// File of the archive that describes the others.
const META: &str = "meta.json";
/// Fourth byte of a rotation whose largest component is the first; those of the others follow.
const LARGEST_FIRST: u8 = 252;
/// Palette entries in a row of the image of SH coefficients.
const ENTRIES: usize = 64;
/// Bytes of an archive that a Gaussian takes at least.
const LEAST: usize = 8;
/// Content of a file may be so many times as large as the archive: images are compressed already.
const LARGEST: u64 = 8;

/// The content of `meta.json`.
#[derive(Deserialize)]
struct Meta {
    version: u32,
    count: usize,
    #[serde(default)]
    antialias: bool,
    means: Range,
    scales: Book,
    quats: Plain,
    sh0: Book,
    #[serde(rename = "shN")]
    bands: Option<Bands>,
}

#[derive(Deserialize)]
struct Range {
    mins: [f64; 3],
    maxs: [f64; 3],
    files: [String; 2],
}

#[derive(Deserialize)]
struct Book {
    codebook: Vec<f64>,
    files: [String; 1],
}

#[derive(Deserialize)]
struct Plain {
    files: [String; 1],
}

#[derive(Deserialize)]
struct Bands {
    bands: u32,
    codebook: Vec<f64>,
    files: [String; 2],
}

/// An archive in memory.
struct Bundle<'a> {
    path: &'a Path,
    bytes: &'a [u8],
}

/// An image: width, pixels.
struct Texture {
    width: usize,
    pixels: Vec<[u8; 4]>,
}

impl Bundle<'_> {
    /// An error about a damaged file.
    fn bad(&self, what: impl Into<String>) -> Error {
        Error::input(self.path, what, "export the SOG file again")
    }

    /// The content of a file of the archive, found by its whole name.
    fn file(&self, name: &str) -> Result<Vec<u8>> {
        let damaged = |e: rawzip::Error| self.bad(format!("a damaged archive ({e})"));
        let archive = ZipArchive::from_slice(self.bytes).map_err(damaged)?;
        let mut entries = archive.entries();
        let record = loop {
            match entries.next_entry().map_err(damaged)? {
                Some(record) if record.file_path().as_bytes() == name.as_bytes() => break record,
                Some(_) => {}
                None if name == META => {
                    let what = format!("a zip archive without {META}, which no SOG file lacks");
                    let fix = "give a scene file; a dataset is another argument";
                    return Err(Error::input(self.path, what, fix));
                }
                None => return Err(self.bad(format!("no {name} in the archive"))),
            }
        };
        let (method, size) = (record.compression_method(), record.uncompressed_size_hint());
        if size > LARGEST.saturating_mul(self.bytes.len() as u64) {
            return Err(self.bad(format!("{name} is said to have {size} bytes")));
        }
        let entry = archive.get_entry(record.wayfinder()).map_err(damaged)?;
        let packed: Box<dyn Read + '_> = match method {
            CompressionMethod::STORE => Box::new(entry.data()),
            CompressionMethod::DEFLATE => Box::new(DeflateDecoder::new(entry.data())),
            other => return Err(self.bad(format!("{name} is compressed by method {other}"))),
        };
        let mut content = Vec::new();
        // A read beyond the size that the archive says is an error, and so is another checksum.
        let mut verified = entry.verifying_reader(packed);
        let read = verified.read_to_end(&mut content);
        read.map_err(|e| self.bad(format!("{name} is damaged ({e})")))?;
        Ok(content)
    }

    /// An image of the archive, of `fewest` pixels or not many more.
    fn texture(&self, name: &str, fewest: usize) -> Result<Texture> {
        let content = self.file(name)?;
        let broken = |e: image::ImageError| self.bad(format!("{name}: {e}"));
        let decoder = WebPDecoder::new(Cursor::new(content)).map_err(broken)?;
        let (width, height) = decoder.dimensions();
        let pixels = width as usize * height as usize;
        // Sides are rounded up to whole blocks.
        if pixels < fewest || pixels > 2 * fewest + (1 << 16) {
            let what = format!("{name} has {width} × {height} pixels for {fewest} values");
            return Err(self.bad(what));
        }
        if !matches!(decoder.color_type(), ColorType::Rgb8 | ColorType::Rgba8) {
            return Err(self.bad(format!("{name} is no image of 8-bit colours")));
        }
        let image = DynamicImage::from_decoder(decoder).map_err(broken)?;
        Ok(Texture {
            width: width as usize,
            pixels: image.into_rgba8().pixels().map(|p| p.0).collect(),
        })
    }

    /// The 256 values of a codebook.
    fn codebook(&self, values: &[f64]) -> Result<[f32; 256]> {
        let values: Vec<f32> = values.iter().map(|v| *v as f32).collect();
        let book: Option<[f32; 256]> = values.try_into().ok();
        let finite = book.filter(|book| book.iter().all(|v| v.is_finite()));
        finite.ok_or_else(|| self.bad("a codebook that has not 256 numbers"))
    }

    /// Adds the planes of SH coefficients above the constant one.
    fn bands(&self, bands: &Bands, count: usize, planes: &mut Vec<Vec<f32>>) -> Result<()> {
        if !(1..=3).contains(&bands.bands) {
            let what = format!(
                "{} bands of spherical harmonics; 1 to 3 expected",
                bands.bands
            );
            return Err(self.bad(what));
        }
        let book = self.codebook(&bands.codebook)?;
        let labels = self.texture(&bands.files[1], count)?;
        let label = |p: &[u8; 4]| usize::from(u16::from_le_bytes([p[0], p[1]]));
        let labels: Vec<usize> = labels.pixels[..count].iter().map(label).collect();
        let entries = labels.iter().max().map_or(1, |most| most + 1);
        let coefficients = sh_coefficients(bands.bands) - 1;
        let rows = entries.div_ceil(ENTRIES);
        let width = ENTRIES * coefficients;
        let palette = self.texture(&bands.files[0], rows * width)?;
        if palette.width != width {
            let what = format!("{} has {} pixels in a row", bands.files[0], palette.width);
            return Err(self.bad(format!("{what}; {width} expected")));
        }
        for k in 0..3 * coefficients {
            let (coefficient, channel) = (k / 3, k % 3);
            let of = |label: &usize| {
                let at = label / ENTRIES * width + label % ENTRIES * coefficients + coefficient;
                book[usize::from(palette.pixels[at][channel])]
            };
            planes.push(labels.iter().map(of).collect());
        }
        Ok(())
    }
}

/// True for a zip archive that says of itself that its scene was trained with anti-aliasing.
pub(super) fn is_anti_aliased(path: &Path, bytes: &[u8]) -> bool {
    let bundle = Bundle { path, bytes };
    bundle.meta().is_ok_and(|meta| meta.antialias)
}

impl Bundle<'_> {
    fn meta(&self) -> Result<Meta> {
        let text = self.file(META)?;
        serde_json::from_slice(&text).map_err(|e| self.bad(format!("{META}: {e}")))
    }
}

/// Reads a file.
///
/// # Errors
/// [`Error::Input`] for an archive without `meta.json`, a damaged one, another version.
pub(super) fn read(path: &Path, bytes: &[u8], frame: &Frame) -> Result<SceneFile> {
    let bundle = Bundle { path, bytes };
    let meta = bundle.meta()?;
    let count = meta.count;
    if meta.version != 2 {
        let what = format!("SOG of version {}; 2 expected", meta.version);
        return Err(Error::input(path, what, "convert it with splat-transform"));
    }
    // Real files have more bytes of each Gaussian.
    if count > bytes.len() / LEAST {
        let what = format!(
            "{META} announces {count} Gaussians; {} bytes hold fewer",
            bytes.len()
        );
        return Err(bundle.bad(what));
    }
    let mut planes: Vec<Vec<f32>> = vec![Vec::new(); Plane::count(0)];
    let [low, high] = &meta.means.files;
    let (low, high) = (bundle.texture(low, count)?, bundle.texture(high, count)?);
    let scales = bundle.texture(&meta.scales.files[0], count)?;
    let colors = bundle.texture(&meta.sh0.files[0], count)?;
    let [scale_book, color_book] = [&meta.scales, &meta.sh0].map(|b| bundle.codebook(&b.codebook));
    let (scale_book, color_book) = (scale_book?, color_book?);
    for k in 0..3 {
        let [least, most] = [meta.means.mins[k], meta.means.maxs[k]];
        let position = |(low, high): (&[u8; 4], &[u8; 4])| {
            let share = f64::from(u16::from_le_bytes([low[k], high[k]])) / 65_535.0;
            let v = least + (most - least) * share;
            (v.signum() * v.abs().exp_m1()) as f32
        };
        let pairs = low.pixels.iter().zip(&high.pixels).take(count);
        planes[Plane::POSITION + k] = pairs.map(position).collect();
        let of = |book: &[f32; 256], texture: &Texture| -> Vec<f32> {
            let pixels = texture.pixels[..count].iter();
            pixels.map(|p| book[usize::from(p[k])]).collect()
        };
        planes[Plane::LOG_SCALE + k] = of(&scale_book, &scales);
        planes[Plane::SH + k] = of(&color_book, &colors);
    }
    let opacity = |p: &[u8; 4]| limited_logit(f64::from(p[3]) / 255.0);
    planes[Plane::OPACITY] = colors.pixels[..count].iter().map(opacity).collect();
    let rotations = bundle.texture(&meta.quats.files[0], count)?;
    for (i, &[a, b, c, largest]) in rotations.pixels[..count].iter().enumerate() {
        let Some(largest) = largest.checked_sub(LARGEST_FIRST) else {
            return Err(bundle.bad(format!("no rotation of Gaussian {i}")));
        };
        let component = |v: u8| (f64::from(v) / 127.5 - 1.0) * 0.5_f64.sqrt();
        let q = from_smallest_three(usize::from(largest), [a, b, c].map(component));
        for (plane, v) in planes[Plane::ROTATION..].iter_mut().zip(q) {
            plane.push(v as f32);
        }
    }
    let degree = match &meta.bands {
        Some(bands) => {
            bundle.bands(bands, count, &mut planes)?;
            bands.bands
        }
        None => 0,
    };
    let splats = localized(path, degree, planes, frame)?;
    Ok(SceneFile {
        anti_aliased: meta.antialias,
        ..SceneFile::new(splats)
    })
}
