//! [`PhotoArray`]: a photo on the device and its active tiles.

use std::ops::Deref;
use std::sync::{Arc, OnceLock};

use crate::base::error::Result;
use crate::device::{Array, Device, ImageSize, Program};
use crate::pipeline::stage::active_tiles;

/// A photo \[3 or 4, height, width\] on the device, with its active tiles once they have been marked.
#[derive(Debug)]
pub struct PhotoArray {
    pixels: Array<u8>,
    active_tiles: OnceLock<Arc<Array<u32>>>,
}

impl From<Array<u8>> for PhotoArray {
    fn from(pixels: Array<u8>) -> Self {
        Self {
            pixels,
            active_tiles: OnceLock::new(),
        }
    }
}

impl Deref for PhotoArray {
    type Target = Array<u8>;

    fn deref(&self) -> &Array<u8> {
        &self.pixels
    }
}

impl PhotoArray {
    /// Active tiles of the photo, which is of this size and has an alpha plane; marked by the first call.
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
        let marked = Arc::new(active_tiles::mark(device, stage, &self.pixels, size)?);
        Ok(self.active_tiles.get_or_init(|| marked).clone())
    }
}
