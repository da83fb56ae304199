//! [`PhotoArray`]: the rows of a photo that a device has, and their active tiles.

use std::ops::{Deref, Range};
use std::sync::{Arc, OnceLock};

use crate::base::error::Result;
use crate::capture::Photo;
use crate::device::{Array, Device, ImageSize, Program};
use crate::pipeline::stage::active_tiles;

/// Some rows of a photo \[3 or 4, rows, width\] on the device, with its active tiles once they have been marked.
#[derive(Debug)]
pub struct PhotoArray {
    pixels: Array<u8>,
    rows: Range<usize>,
    active_tiles: OnceLock<Arc<Array<u32>>>,
}

impl Deref for PhotoArray {
    type Target = Array<u8>;

    fn deref(&self) -> &Array<u8> {
        &self.pixels
    }
}

impl PhotoArray {
    /// These pixel rows of a photo.
    #[must_use]
    pub fn new(pixels: Array<u8>, rows: Range<usize>) -> Self {
        Self {
            pixels,
            rows,
            active_tiles: OnceLock::new(),
        }
    }

    /// All of a photo of this size.
    #[must_use]
    pub fn whole(pixels: Array<u8>, size: ImageSize) -> Self {
        Self::new(pixels, 0..size.pixels[1])
    }

    /// All of a photo, on the device.
    ///
    /// # Errors
    /// No room for it, or the driver's.
    pub fn upload(device: &Device, photo: &Photo) -> Result<Self> {
        let pixels = Array::from_slice(device, "photo", &photo.data)?;
        Ok(Self::new(pixels, 0..photo.height as usize))
    }

    /// The pixel rows that there are.
    #[must_use]
    pub fn rows(&self) -> &Range<usize> {
        &self.rows
    }

    /// True if these pixel rows are there.
    #[must_use]
    pub fn has(&self, rows: &Range<usize>) -> bool {
        rows.is_empty() || self.rows.start <= rows.start && rows.end <= self.rows.end
    }

    /// A copy of some of the rows, each of so many values in every one of the planes.
    ///
    /// # Errors
    /// No room for them, or the driver's.
    pub fn part(
        &self,
        device: &Device,
        [planes, width]: [usize; 2],
        rows: &Range<usize>,
    ) -> Result<Self> {
        let (all, len) = (self.rows.len() * width, rows.len() * width);
        let part = Array::unset(device, self.pixels.name(), planes * len)?;
        let first = (rows.start - self.rows.start) * width;
        for plane in 0..planes {
            part.copy_from(plane * len, &self.pixels, plane * all + first, len)?;
        }
        Ok(Self::new(part, rows.clone()))
    }

    /// Active tiles of a photo of this size, which has an alpha plane; none where there are no rows of it. Marked by the first call.
    ///
    /// # Errors
    /// No room for them, or the driver's.
    pub fn active_tiles(
        &self,
        device: &Device,
        stage: &Program,
        size: ImageSize,
    ) -> Result<Arc<Array<u32>>> {
        if let Some(found) = self.active_tiles.get() {
            return Ok(found.clone());
        }
        let tiles = active_tiles::mark(device, stage, (&self.pixels, &self.rows), size)?;
        Ok(self.active_tiles.get_or_init(|| Arc::new(tiles)).clone())
    }
}
