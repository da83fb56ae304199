//! 8-bit photos, planar: decoding and area-filtered downscaling.

use std::path::Path;

use crate::error::{Error, Result};

/// An 8-bit image, planar: `data[(c·height + y)·width + x]`. With 4 channels the colours are premultiplied by the alpha
/// plane (channel 3), so that the photo over a background b is `rgb + (1 − alpha)·b`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Photo {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// 3 (RGB) or 4 (premultiplied RGBA).
    pub channels: u32,
    /// Planes, `channels × height × width` bytes.
    pub data: Vec<u8>,
}

impl Photo {
    /// Decodes a JPEG, PNG or WebP file and reduces it so that the longest side is at most `max_size` pixels. A photo
    /// that is opaque everywhere has 3 channels, whatever its file has. Returns the photo and the file's own size.
    ///
    /// # Errors
    /// A file that is missing or not an image.
    pub fn open(path: &Path, max_size: u32) -> Result<(Self, [u32; 2])> {
        let wrong = |what: String| {
            Error::input(
                path,
                what,
                "give a JPEG, PNG or WebP image, or remove it from the dataset",
            )
        };
        let reader = image::ImageReader::open(path)
            .and_then(image::ImageReader::with_guessed_format)
            .map_err(|e| wrong(format!("cannot be read: {e}")))?;
        let decoded = reader
            .decode()
            .map_err(|e| wrong(format!("is not an image: {e}")))?;
        let (width, height) = (decoded.width(), decoded.height());
        if width == 0 || height == 0 {
            return Err(wrong("is an image without pixels".into()));
        }
        let rgba = decoded.color().has_alpha().then(|| decoded.to_rgba8());
        let photo = match rgba {
            Some(rgba) if rgba.pixels().any(|p| p.0[3] < 255) => {
                Self::from_interleaved(width, height, 4, rgba.as_raw())
            }
            _ => Self::from_interleaved(width, height, 3, decoded.to_rgb8().as_raw()),
        };
        let (w, h) = fit(width, height, max_size);
        Ok((photo.reduced(w, h), [width, height]))
    }

    /// From interleaved bytes with straight (not premultiplied) alpha; missing bytes count as 0.
    #[must_use]
    pub fn from_interleaved(width: u32, height: u32, channels: u32, bytes: &[u8]) -> Self {
        let n = width as usize * height as usize;
        let c = channels as usize;
        let mut data = vec![0; n * c];
        for (i, pixel) in bytes.chunks_exact(c).take(n).enumerate() {
            let alpha = if c == 4 { u32::from(pixel[3]) } else { 255 };
            for (k, v) in pixel.iter().enumerate() {
                let weight = if k == 3 { 255 } else { alpha };
                data[k * n + i] = ((u32::from(*v) * weight + 127) / 255) as u8;
            }
        }
        Self {
            width,
            height,
            channels,
            data,
        }
    }

    /// Area-filtered reduction: each pixel is the mean of the area it covers, exact to rounding. Sizes that are not
    /// smaller are kept.
    #[must_use]
    pub fn reduced(&self, width: u32, height: u32) -> Self {
        if width >= self.width && height >= self.height {
            return self.clone();
        }
        let columns = coverage(self.width, width);
        let rows = coverage(self.height, height);
        let (w, n) = (
            self.width as usize,
            self.width as usize * self.height as usize,
        );
        let mut data = Vec::with_capacity((self.channels * width * height) as usize);
        for plane in self.data.chunks_exact(n) {
            for (y0, row_weights) in &rows {
                let mut line = vec![0.0f32; w];
                for (k, weight) in row_weights.iter().enumerate() {
                    let from = &plane[(y0 + k) * w..(y0 + k + 1) * w];
                    for (sum, v) in line.iter_mut().zip(from) {
                        *sum += weight * f32::from(*v);
                    }
                }
                for (x0, weights) in &columns {
                    let sum: f32 = weights.iter().zip(&line[*x0..]).map(|(a, b)| a * b).sum();
                    data.push((sum + 0.5) as u8);
                }
            }
        }
        Self {
            width,
            height,
            channels: self.channels,
            data,
        }
    }

    /// The same photo with an (opaque) alpha plane.
    #[must_use]
    pub fn with_alpha(mut self) -> Self {
        if self.channels == 3 {
            self.channels = 4;
            self.data
                .resize(4 * self.width as usize * self.height as usize, 255);
        }
        self
    }

    /// Interleaved 8-bit RGB over a background.
    #[must_use]
    pub fn rgb_over(&self, background: [f32; 3]) -> Vec<u8> {
        let n = self.width as usize * self.height as usize;
        let mut out = Vec::with_capacity(3 * n);
        for i in 0..n {
            let gap = if self.channels == 4 {
                255.0 - f32::from(self.data[3 * n + i])
            } else {
                0.0
            };
            for (c, b) in background.iter().enumerate() {
                out.push(
                    (f32::from(self.data[c * n + i]) + gap * b)
                        .round()
                        .min(255.0) as u8,
                );
            }
        }
        out
    }
}

/// Size with the longest side at most `max_size`, the aspect ratio kept to the pixel.
fn fit(width: u32, height: u32, max_size: u32) -> (u32, u32) {
    let longest = width.max(height);
    if longest <= max_size {
        return (width, height);
    }
    let scale = f64::from(max_size) / f64::from(longest);
    let side = |s: u32| ((f64::from(s) * scale).round() as u32).max(1);
    (side(width), side(height))
}

/// For each of `to` cells, the first of `from` cells it covers and the share of it that each covered cell makes up.
fn coverage(from: u32, to: u32) -> Vec<(usize, Vec<f32>)> {
    let ratio = f64::from(from) / f64::from(to);
    (0..to)
        .map(|k| {
            let (a, b) = (f64::from(k) * ratio, f64::from(k + 1) * ratio);
            let first = a.floor() as usize;
            let last = (b.ceil() as usize).clamp(first + 1, from as usize);
            let weights = (first..last)
                .map(|i| (((i as f64 + 1.0).min(b) - (i as f64).max(a)).max(0.0) / ratio) as f32)
                .collect();
            (first, weights)
        })
        .collect()
}
