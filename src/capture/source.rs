//! Sources of photos: memory, or an image file that is decoded on demand.

use std::path::PathBuf;
use std::sync::Arc;

use rayon::prelude::*;

use crate::base::error::{Error, Result};
use crate::base::hash::Fnv;
use crate::capture::decode::{Header, decode, fitted};
use crate::capture::lens::Undistortion;
use crate::capture::photo::{Alpha, Photo};

/// Bytes that photos may take if the system does not report its memory.
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
    mask: Option<PathBuf>,
    width: u32,
    height: u32,
    /// Alpha plane of the photo: at first as its header has it, then as all photos of the dataset do.
    alpha: Alpha,
    /// [`digest`] of the photo's mask, of an all-white one if it has none.
    mask_digest: u64,
}

/// A number that changes when a byte does: FNV-1a over words of eight bytes, with the upper half mixed into the lower one.
fn digest(bytes: &[u8]) -> u64 {
    let mut hash = Fnv::default();
    let mut take = |word| {
        hash.word(word);
        hash.0 ^= hash.0 >> 32;
    };
    let words = bytes.chunks_exact(8);
    let rest = words.remainder();
    for word in words {
        take(word.iter().fold(0, |sum, b| sum << 8 | u64::from(*b)));
    }
    rest.iter().for_each(|b| take(u64::from(*b)));
    hash.0
}

impl From<Photo> for PhotoSource {
    fn from(photo: Photo) -> Self {
        Self::Memory(Arc::new(photo))
    }
}

impl PhotoSource {
    /// The photo; decodes its file unless it is in memory.
    ///
    /// # Errors
    /// A file that is gone, no longer an image, or of another size than when the dataset was read.
    pub fn load(&self) -> Result<Arc<Photo>> {
        match self {
            Self::Memory(photo) => Ok(photo.clone()),
            Self::File(file) => file.load().map(Arc::new),
        }
    }

    /// Meaning of the photo's alpha plane.
    #[must_use]
    pub fn alpha(&self) -> Alpha {
        match self {
            Self::Memory(photo) => photo.alpha,
            Self::File(file) => file.alpha,
        }
    }

    /// A number that changes when the photo's mask, as it was decoded, does; `None` without masks.
    #[must_use]
    pub fn mask_digest(&self) -> Option<u64> {
        match self {
            Self::Memory(photo) => photo.mask_plane().map(digest),
            Self::File(file) => (file.alpha == Alpha::Mask).then_some(file.mask_digest),
        }
    }

    /// True if the photo's mask is 0 everywhere.
    #[must_use]
    pub fn masked_out(&self) -> bool {
        match self {
            Self::Memory(photo) => photo
                .mask_plane()
                .is_some_and(|mask| mask.iter().all(|m| *m == 0)),
            Self::File(file) => {
                let black = || vec![0; file.width as usize * file.height as usize];
                file.alpha == Alpha::Mask && file.mask_digest == digest(&black())
            }
        }
    }

    /// Size of the decoded photo in bytes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        match self {
            Self::Memory(photo) => photo.data.len() as u64,
            Self::File(file) => file.bytes(),
        }
    }
}

impl PhotoFile {
    /// The photo of an image file with an optional mask file; `meaning` is that of alpha in the whole dataset.
    pub(super) fn new(
        path: PathBuf,
        header: Header,
        max_size: u32,
        undistortion: Option<Undistortion>,
        mask: Option<PathBuf>,
        meaning: Alpha,
    ) -> Self {
        let (width, height) = undistortion.map_or((header.width, header.height), |u| {
            (u.target.width, u.target.height)
        });
        let (width, height) = fitted(width, height, max_size);
        Self {
            path,
            max_size,
            undistortion: undistortion.map(Box::new),
            alpha: if header.has_alpha || mask.is_some() {
                meaning
            } else {
                Alpha::None
            },
            mask,
            width,
            height,
            mask_digest: 0,
        }
    }

    /// [`digest`] of a photo's mask, an all-white one if it has none; 0 without masks.
    fn mask_digest_of(&self, photo: &Photo) -> u64 {
        let white = || vec![255; photo.width as usize * photo.height as usize];
        match (self.alpha, photo.mask_plane()) {
            (Alpha::Mask, Some(plane)) => digest(plane),
            (Alpha::Mask, None) => digest(&white()),
            _ => 0,
        }
    }

    /// Width and height of the decoded photo, pixels.
    pub(super) fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    fn bytes(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height) * self.alpha.planes() as u64
    }

    /// The photo as decoded, with an alpha plane only if some pixel is not opaque.
    fn decoded(&self) -> Result<Photo> {
        let photo = decode(
            &self.path,
            self.max_size,
            self.undistortion.as_deref(),
            self.mask.as_deref(),
            self.alpha,
        )?;
        let known = photo.alpha == Alpha::None || photo.alpha == self.alpha;
        if (photo.width, photo.height) == self.size() && known {
            return Ok(photo);
        }
        Err(Error::input(
            &self.path,
            format!(
                "{}×{} pixels in {} channels; {}×{} in {} were there when the dataset was read",
                photo.width,
                photo.height,
                photo.alpha.planes(),
                self.width,
                self.height,
                self.alpha.planes()
            ),
            "leave the photos as they are during a run, and start again",
        ))
    }

    /// The photo with the alpha plane that all photos of its dataset have.
    ///
    /// # Errors
    /// Those of [`PhotoSource::load`].
    pub(crate) fn load(&self) -> Result<Photo> {
        Ok(self.decoded()?.with_alpha(self.alpha))
    }

    /// The error of a decoder that failed without a reason.
    pub(crate) fn undecodable(&self) -> Error {
        Error::input(
            &self.path,
            "the decoder failed on it",
            "replace the file and start again",
        )
    }
}

/// The photos of `files`: in memory if all of them fit into `budget` bytes, else left in their files.
///
/// Every file is decoded here in either case: a broken one is found before training begins, and whether any pixel of any
/// photo is transparent decides for all whether they have an alpha plane.
///
/// # Errors
/// A file that cannot be decoded, or a photo that does not fit into the budget alone.
pub(super) fn read(mut files: Vec<PhotoFile>, budget: u64) -> Result<Vec<PhotoSource>> {
    let may_be = Alpha::common(files.iter().map(|f| f.alpha));
    files.iter_mut().for_each(|f| f.alpha = may_be);
    let fits = files.iter().map(PhotoFile::bytes).sum::<u64>() <= budget;
    let decoded: Vec<(Alpha, Option<Photo>)> = files
        .par_iter_mut()
        .map(|f| {
            let photo = f.decoded()?;
            if !fits {
                f.mask_digest = f.mask_digest_of(&photo);
            }
            Ok((photo.alpha, fits.then_some(photo)))
        })
        .collect::<Result<_>>()?;
    let alpha = Alpha::common(decoded.iter().map(|d| d.0));
    files.iter_mut().for_each(|f| f.alpha = alpha);
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
            Some(photo) => photo.with_alpha(alpha).into(),
            None => PhotoSource::File(file),
        })
        .collect())
}

/// Default budget of photos in bytes: half of the memory that the system reports as available, 4 GiB if it reports none.
pub(super) fn automatic_budget() -> u64 {
    std::fs::read_to_string("/proc/meminfo")
        .ok()
        .and_then(|text| parse_available(&text))
        .map_or(UNKNOWN_MEMORY, |bytes| bytes / 2)
}

/// Bytes of the `MemAvailable` line of `/proc/meminfo` (proc(5)); `None` without such a line.
#[must_use]
pub fn parse_available(text: &str) -> Option<u64> {
    let line = text.lines().find_map(|l| l.strip_prefix("MemAvailable:"))?;
    let kib: u64 = line.split_ascii_whitespace().next()?.parse().ok()?;
    kib.checked_mul(1024)
}
