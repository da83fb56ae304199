//! Image files row by row: a PNG is decoded as its rows are asked for, other formats and interlaced PNGs as a whole before the first.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use image::error::ImageFormatHint;
use image::{DynamicImage, ImageError, ImageFormat, ImageReader, Limits};

use crate::base::error::{Error, Result};
use crate::base::files::check_regular;
use crate::capture::endings::is_converted;
use crate::capture::memory::{check_memory, decoding_limit};

/// Bytes per pixel of a row and per row of a column that decoding and shrinking take at most.
const PER_SIDE: u64 = 64;

/// 16-bit levels per 8-bit level.
const WORDS: f32 = 257.0;

/// Image formats that are read, for messages.
pub(super) const READ: &str = "PNG, JPEG, WebP, EXR, HDR or BMP";

/// A reader of an image file by its content. EXIF orientation is ignored, as COLMAP and the NeRF tools ignore it, so that
/// pixels stay where the poses expect them.
pub(super) fn open(file: &Path) -> Result<ImageReader<BufReader<File>>> {
    check_regular(file)?;
    let opened = ImageReader::open(file).and_then(ImageReader::with_guessed_format);
    let mut reader = opened.map_err(|source| Error::io(file, source))?;
    // A header may announce more than there is memory.
    let mut limits = Limits::default();
    limits.max_alloc = Some(decoding_limit());
    reader.limits(limits);
    Ok(reader)
}

/// The error of a file that the decoder refuses.
pub(super) fn not_an_image(file: &Path, reason: &ImageError) -> Error {
    if matches!(reason, ImageError::Limits(_)) {
        return Error::input(
            file,
            format!(
                "larger than {} MiB when it is decoded, what each thread may take of the available memory",
                decoding_limit() >> 20
            ),
            "scale the photo down, save it as a PNG that is not interlaced, which is read row by row, or use a machine with more memory",
        );
    }
    if let ImageError::Unsupported(of) = reason
        && let ImageFormatHint::Exact(format) = of.format_hint()
        && !format.reading_enabled()
    {
        let what = format!("a photo in the format {format:?}; {READ} expected");
        let ending = file.extension().and_then(|e| e.to_str());
        let fix = match ending.filter(|_| is_converted(file)) {
            Some(ending) => format!(
                "convert all in their folder, with ImageMagick: mogrify -colorspace sRGB -format png -depth 16 *.{ending} (the PNGs are found by the names of these)"
            ),
            None => format!("save it as {READ}, and name it so in the dataset"),
        };
        return Error::input(file, what, fix);
    }
    unreadable(file, reason)
}

fn unreadable(file: &Path, reason: &dyn std::fmt::Display) -> Error {
    Error::input(
        file,
        format!("not a readable image ({reason}); {READ} expected"),
        "replace the file or remove its entry from the dataset",
    )
}

/// Pixels of a file, from which rows are taken.
enum Pixels {
    /// Decoded as they are asked for.
    Png(Box<png::Reader<BufReader<File>>>),
    /// All, one channel after the other, row after row.
    Whole(DynamicImage),
}

/// An image file and its next row.
pub(super) struct Rows {
    file: PathBuf,
    pixels: Pixels,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Channels of the file: grey, or RGB, either with alpha or without.
    channels: usize,
    /// Bytes of a value, 1, 2, or 4 of linear light.
    depth: usize,
    /// True if colours are stored multiplied by alpha.
    premultiplied: bool,
    next: usize,
    /// The values of a row in the file's channels.
    row: Vec<f32>,
}

impl Rows {
    /// The rows of an image file.
    ///
    /// # Errors
    /// No image, or one that is too large: as a whole, or with rows that are.
    pub fn open(file: &Path) -> Result<Self> {
        let reader = open(file)?;
        let premultiplied = reader.format() == Some(ImageFormat::OpenExr);
        let bad = |e: png::DecodingError| not_an_image(file, &from_png(e));
        if reader.format() == Some(ImageFormat::Png) {
            let bytes = usize::try_from(decoding_limit()).unwrap_or(usize::MAX);
            let limits = png::Limits { bytes };
            let mut decoder = png::Decoder::new_with_limits(reader.into_inner(), limits);
            decoder.set_ignore_text_chunk(true);
            decoder.set_transformations(png::Transformations::EXPAND);
            let (info, fix) = (
                decoder.read_header_info().map_err(bad)?,
                "scale the photo down",
            );
            let size = [info.width, info.height];
            if !info.interlaced {
                let sides = u64::from(size[0]) + u64::from(size[1]);
                check_memory(file, PER_SIDE * sides, "a row of it", fix)?;
                let reader = decoder.read_info().map_err(bad)?;
                let (color, bits) = reader.output_color_type();
                return Ok(Self {
                    file: file.to_path_buf(),
                    pixels: Pixels::Png(Box::new(reader)),
                    size,
                    channels: color.samples(),
                    depth: 1 + usize::from(bits == png::BitDepth::Sixteen),
                    premultiplied: false,
                    next: 0,
                    row: Vec::new(),
                });
            }
        }
        if premultiplied {
            // The decoder holds it twice.
            let (width, height) = open(file)?
                .into_dimensions()
                .map_err(|e| not_an_image(file, &e))?;
            let bytes = 32 * u64::from(width) * u64::from(height);
            check_memory(file, bytes, "decoding it", "scale the photo down")?;
        }
        let image = open(file)?.decode().map_err(|e| not_an_image(file, &e))?;
        let channels = usize::from(image.color().channel_count());
        Ok(Self {
            file: file.to_path_buf(),
            size: [image.width(), image.height()],
            channels,
            depth: usize::from(image.color().bytes_per_pixel()) / channels,
            premultiplied,
            pixels: Pixels::Whole(image),
            next: 0,
            row: Vec::new(),
        })
    }

    /// Bytes of the photo that are in memory: all, or none that count.
    pub fn in_memory(&self) -> u64 {
        match &self.pixels {
            Pixels::Whole(image) => image.as_bytes().len() as u64,
            Pixels::Png(_) => 0,
        }
    }

    /// True if pixels may be transparent.
    pub fn has_alpha(&self) -> bool {
        matches!(self.channels, 2 | 4)
    }

    /// Takes the values of the next row, 0 to 255, interleaved in the file's channels; 16-bit and float values keep their fractions.
    ///
    /// # Errors
    /// The file ends before the row does, or is damaged there.
    fn next(&mut self) -> Result<()> {
        let length = self.size[0] as usize * self.channels * self.depth;
        let start = self.next * length;
        self.next += 1;
        let word: fn([u8; 2]) -> u16;
        let found = match &mut self.pixels {
            Pixels::Png(reader) => {
                word = u16::from_be_bytes;
                let row = reader.next_row();
                let row = row.map_err(|e| not_an_image(&self.file, &from_png(e)))?;
                row.map(|row| row.data())
            }
            Pixels::Whole(image) => {
                word = u16::from_ne_bytes;
                image.as_bytes().get(start..)
            }
        };
        let Some(bytes) = found.and_then(|row| row.get(..length)) else {
            return Err(unreadable(&self.file, &"a row is missing"));
        };
        self.row.clear();
        match self.depth {
            1 => self.row.extend(bytes.iter().map(|v| f32::from(*v))),
            4 => {
                let (values, _) = bytes.as_chunks();
                let value = |b: &[u8; 4]| f32::from_ne_bytes(*b);
                self.row.extend(values.iter().map(value));
                let pixels = self.row.chunks_exact_mut(self.channels);
                pixels.for_each(|pixel| encode(pixel, self.premultiplied));
            }
            _ => {
                let words = bytes.chunks_exact(2);
                let value = |b: &[u8]| f32::from(word([b[0], b[1]])) / WORDS;
                self.row.extend(words.map(value));
            }
        }
        Ok(())
    }

    /// Writes the next row into `out`, interleaved RGB, or RGBA if `out` has 4 channels; what has no alpha is opaque.
    ///
    /// # Errors
    /// Those of [`Self::next`].
    pub fn colors(&mut self, out: &mut [f32]) -> Result<()> {
        self.next()?;
        let to = out.len() / self.size[0] as usize;
        if self.channels == to {
            out.copy_from_slice(&self.row);
            return Ok(());
        }
        let pixels = self.row.chunks_exact(self.channels);
        for (pixel, out) in pixels.zip(out.chunks_exact_mut(to.max(1))) {
            let [r, g, b, a] = match *pixel {
                [l] => [l, l, l, 255.0],
                [l, a] => [l, l, l, a],
                [r, g, b] => [r, g, b, 255.0],
                [r, g, b, a, ..] => [r, g, b, a],
                [] => [0.0; 4],
            };
            for (o, v) in out.iter_mut().zip([r, g, b, a]) {
                *o = v;
            }
        }
        Ok(())
    }

    /// The brightness of the next row's pixels, whole numbers from 0 to 255 (luma of BT.709).
    ///
    /// # Errors
    /// Those of [`Self::next`].
    pub fn brightness(&mut self) -> Result<Vec<f32>> {
        self.next()?;
        let luma = |pixel: &[f32]| match *pixel {
            [r, g, b, ..] => {
                let [r, g, b] = [r, g, b].map(|v| v.round() as u32);
                ((2126 * r + 7152 * g + 722 * b) / 10_000) as f32
            }
            _ => pixel.first().map_or(0.0, |v| v.round()),
        };
        Ok(self.row.chunks_exact(self.channels).map(luma).collect())
    }
}

/// Turns a pixel of linear light into sRGB from 0 to 255 with straight alpha: colours are divided by alpha if they are `premultiplied`,
/// values beyond 0 and 1 cut, and those that are no numbers 0. Source: IEC 61966-2-1.
fn encode(pixel: &mut [f32], premultiplied: bool) {
    let alpha = pixel.get(3).map_or(1.0, |a| a.clamp(0.0, 1.0));
    let scale = match premultiplied && alpha > 0.0 {
        true => alpha.recip(),
        false => 1.0,
    };
    for (k, v) in pixel.iter_mut().enumerate() {
        let light = if k == 3 { *v } else { *v * scale };
        // NaN, too, is 0.
        let light = if light > 0.0 { light.min(1.0) } else { 0.0 };
        let level = match light {
            alpha if k == 3 => alpha,
            dark if dark <= 0.003_130_8 => 12.92 * dark,
            bright => 1.055 * bright.powf(1.0 / 2.4) - 0.055,
        };
        *v = 255.0 * level;
    }
}

/// The error of the PNG decoder as that of all of them.
fn from_png(error: png::DecodingError) -> ImageError {
    use image::error::{DecodingError, LimitError, LimitErrorKind};
    match error {
        png::DecodingError::LimitsExceeded => {
            ImageError::Limits(LimitError::from_kind(LimitErrorKind::InsufficientMemory))
        }
        other => ImageError::Decoding(DecodingError::new(ImageFormat::Png.into(), other)),
    }
}
