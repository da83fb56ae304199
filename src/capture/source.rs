//! Where a view's photo is: in memory, or in its file until somebody needs it.

use std::path::PathBuf;
use std::sync::Arc;

use rayon::prelude::*;

use crate::base::error::{Error, Result};
use crate::capture::decode::{Header, Mask, decode, fitted};
use crate::capture::lens::Undistortion;
use crate::capture::photo::{Alpha, Photo};

/// Photos may take this many bytes where the system does not say how much memory there is.
const UNKNOWN_MEMORY: u64 = 4 << 30;

/// A view's photo.
#[derive(Debug, Clone)]
pub enum PhotoSource {
    /// Decoded already; clones share the pixels.
    Memory(Arc<Photo>),
    /// Decoded anew whenever it is asked for.
    File(PhotoFile),
}

/// An image file, and the size that its photo was found to have when the dataset was read.
#[derive(Debug, Clone)]
pub struct PhotoFile {
    path: PathBuf,
    max_size: u32,
    undistortion: Option<Box<Undistortion>>,
    mask: Mask,
    width: u32,
    height: u32,
    /// 3, or 4 where the photo may have an alpha plane: at first what the header says, then what all photos have.
    channels: u32,
    /// [`digest`] of the mask that the photo was found to have, of one that is white all over where it has none.
    mask_digest: u64,
}

/// A number that changes when a byte does: FNV-1a over words of eight bytes, with the upper half mixed into the lower one.
fn digest(bytes: &[u8]) -> u64 {
    let step = |hash: u64, word: u64| {
        let hash = (hash ^ word).wrapping_mul(0x0100_0000_01b3);
        hash ^ (hash >> 32)
    };
    let mut words = bytes.chunks_exact(8);
    let mut hash = 0xcbf2_9ce4_8422_2325;
    for word in words.by_ref() {
        let word = word.iter().fold(0, |sum, b| sum << 8 | u64::from(*b));
        hash = step(hash, word);
    }
    let rest = words.remainder().iter();
    rest.fold(hash, |hash, b| step(hash, u64::from(*b)))
}

impl From<Photo> for PhotoSource {
    fn from(photo: Photo) -> Self {
        Self::Memory(Arc::new(photo))
    }
}

impl PhotoSource {
    /// The photo; decodes its file where it is not in memory.
    ///
    /// # Errors
    /// A file that is gone, no longer an image, or of another size than when the dataset was read.
    pub fn load(&self) -> Result<Arc<Photo>> {
        match self {
            Self::Memory(photo) => Ok(photo.clone()),
            Self::File(file) => file.load().map(Arc::new),
        }
    }

    /// Channels: 3 (RGB) or 4 (premultiplied RGBA).
    #[must_use]
    pub fn channels(&self) -> u32 {
        match self {
            Self::Memory(photo) => photo.channels,
            Self::File(file) => file.channels,
        }
    }

    /// What the alpha plane of the photo says.
    #[must_use]
    pub fn alpha(&self) -> Alpha {
        match self {
            Self::Memory(photo) => photo.alpha(),
            Self::File(file) => match (file.channels, &file.mask) {
                (4, Mask::None) => Alpha::Transparency,
                (4, _) => Alpha::Mask,
                _ => Alpha::None,
            },
        }
    }

    /// A number that changes when the photo's mask, as it was decoded, does; none without masks.
    #[must_use]
    pub fn mask_digest(&self) -> Option<u64> {
        match self {
            Self::Memory(photo) => photo.mask_plane().map(digest),
            Self::File(file) => (self.alpha() == Alpha::Mask).then_some(file.mask_digest),
        }
    }

    /// Whether the photo's mask leaves nothing of it.
    #[must_use]
    pub fn masked_out(&self) -> bool {
        match self {
            Self::Memory(photo) => photo
                .mask_plane()
                .is_some_and(|mask| mask.iter().all(|m| *m == 0)),
            Self::File(file) => {
                let black = || vec![0; file.width as usize * file.height as usize];
                self.alpha() == Alpha::Mask && file.mask_digest == digest(&black())
            }
        }
    }

    /// Bytes of the decoded photo, `channels × height × width`.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        match self {
            Self::Memory(photo) => photo.data.len() as u64,
            Self::File(file) => file.bytes(),
        }
    }
}

impl PhotoFile {
    pub(super) fn new(
        path: PathBuf,
        header: Header,
        max_size: u32,
        undistortion: Option<Undistortion>,
        mask: Mask,
    ) -> Self {
        let (width, height) = undistortion.map_or((header.width, header.height), |u| {
            (u.target.width, u.target.height)
        });
        let (width, height) = fitted(width, height, max_size);
        Self {
            path,
            max_size,
            undistortion: undistortion.map(Box::new),
            channels: if header.has_alpha || matches!(mask, Mask::File(_)) {
                4
            } else {
                3
            },
            mask,
            width,
            height,
            mask_digest: 0,
        }
    }

    /// [`digest`] of a photo's mask, as [`PhotoFile::load`] would give it; 0 without masks.
    fn mask_digest_of(&self, photo: &Photo) -> u64 {
        let white = || vec![255; photo.width as usize * photo.height as usize];
        match (&self.mask, photo.mask_plane()) {
            (Mask::None, _) => 0,
            (_, Some(plane)) => digest(plane),
            (_, None) => digest(&white()),
        }
    }

    /// Width and height of the decoded photo, pixels.
    pub(super) fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    fn bytes(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height) * u64::from(self.channels)
    }

    /// The photo as decoded, 4 channels only where some pixel is not opaque.
    fn decoded(&self) -> Result<Photo> {
        let photo = decode(
            &self.path,
            self.max_size,
            self.undistortion.as_deref(),
            &self.mask,
        )?;
        if (photo.width, photo.height) == self.size() && photo.channels <= self.channels {
            return Ok(photo);
        }
        Err(Error::input(
            &self.path,
            format!(
                "{}×{} pixels in {} channels; {}×{} in {} were there when the dataset was read",
                photo.width, photo.height, photo.channels, self.width, self.height, self.channels
            ),
            "leave the photos as they are during a run, and start again",
        ))
    }

    /// The photo with the channels that all photos of its dataset have.
    ///
    /// # Errors
    /// As [`PhotoSource::load`].
    pub(crate) fn load(&self) -> Result<Photo> {
        let mut photo = self.decoded()?;
        if self.channels == 4 {
            photo.add_alpha();
            photo.mask = self.mask != Mask::None;
        }
        Ok(photo)
    }

    /// What to say when the decoder gives up without a reason.
    pub(crate) fn undecodable(&self) -> Error {
        Error::input(
            &self.path,
            "the decoder failed on it",
            "replace the file and start again",
        )
    }
}

/// The photos of `files`: in memory where all of them fit into `budget` bytes, else left in their files.
///
/// Every file is decoded here in either case: a broken one is found before training begins, and whether any pixel of any
/// photo is transparent decides for all whether they have an alpha plane.
///
/// # Errors
/// A file that cannot be decoded, or a photo that does not fit into the budget alone.
pub(super) fn read(mut files: Vec<PhotoFile>, budget: u64) -> Result<Vec<PhotoSource>> {
    let with_channels = |files: &mut [PhotoFile], channels: u32| -> u64 {
        files.iter_mut().for_each(|f| f.channels = channels);
        files.iter().map(PhotoFile::bytes).sum()
    };
    let most = if files.iter().any(|f| f.channels == 4) {
        4
    } else {
        3
    };
    let fits = with_channels(&mut files, most) <= budget;
    let decoded: Vec<(bool, Option<Photo>)> = files
        .par_iter_mut()
        .map(|f| {
            let photo = f.decoded()?;
            let transparent = photo.channels == 4;
            if !fits {
                f.mask_digest = f.mask_digest_of(&photo);
            }
            Ok((transparent, fits.then_some(photo)))
        })
        .collect::<Result<_>>()?;
    let alpha = decoded.iter().any(|(transparent, _)| *transparent);
    with_channels(&mut files, if alpha { 4 } else { 3 });
    if let Some(large) = files.iter().find(|f| f.bytes() > budget) {
        return Err(Error::config(
            "--image-budget",
            format!(
                "{budget} bytes; {} alone takes {} (lower --max-size or raise the budget)",
                large.path.display(),
                large.bytes()
            ),
        ));
    }
    let photos = files.into_iter().zip(decoded);
    Ok(photos
        .map(|(file, (_, photo))| match photo {
            Some(mut photo) => {
                if alpha {
                    photo.add_alpha();
                    photo.mask = file.mask != Mask::None;
                }
                photo.into()
            }
            None => PhotoSource::File(file),
        })
        .collect())
}

/// Bytes that photos may take where nothing else is asked for: half of the memory that the system says is available, 4 GiB
/// where it does not say.
pub(super) fn automatic_budget() -> u64 {
    std::fs::read_to_string("/proc/meminfo")
        .ok()
        .and_then(|text| parse_available(&text))
        .map_or(UNKNOWN_MEMORY, |bytes| bytes / 2)
}

/// Bytes of the `MemAvailable` line of `/proc/meminfo` (proc(5)); none where there is no such line.
#[must_use]
pub fn parse_available(text: &str) -> Option<u64> {
    let line = text.lines().find_map(|l| l.strip_prefix("MemAvailable:"))?;
    let kib: u64 = line.split_ascii_whitespace().next()?.parse().ok()?;
    kib.checked_mul(1024)
}
