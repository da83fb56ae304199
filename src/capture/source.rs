//! Sources of photos: memory, or an image file that is decoded on demand.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use image::{DynamicImage, ImageDecoder, ImageError, ImageReader, Limits};
use rayon::prelude::*;

use crate::base::error::{Error, Result};
use crate::base::files::check_regular;
use crate::base::hash::Fnv;
use crate::capture::lens::Undistortion;
use crate::capture::photo::{Alpha, Photo, shrink};

/// Bytes that photos may take if the system does not report its memory.
const UNKNOWN_MEMORY: u64 = 4 << 30;

/// The same, however little memory is available.
const LEAST_DECODED: u64 = 512 << 20;

/// Bytes that one photo may take when it is decoded: half of the available memory, shared by the threads.
fn decoding_limit() -> u64 {
    (automatic_budget() / rayon::current_num_threads() as u64).max(LEAST_DECODED)
}

/// A decoder for an image file by its content. EXIF orientation is ignored, as COLMAP and the NeRF tools ignore it, so that
/// pixels stay where the poses expect them.
fn open(file: &Path) -> Result<ImageReader<std::io::BufReader<std::fs::File>>> {
    check_regular(file)?;
    let opened = ImageReader::open(file).and_then(ImageReader::with_guessed_format);
    let mut reader = opened.map_err(|source| Error::io(file, source))?;
    // A header may announce more than there is memory.
    let mut limits = Limits::default();
    limits.max_alloc = Some(decoding_limit());
    reader.limits(limits);
    Ok(reader)
}

fn decoded(file: &Path) -> Result<DynamicImage> {
    open(file)?.decode().map_err(|e| not_an_image(file, &e))
}

fn not_an_image(file: &Path, reason: &ImageError) -> Error {
    if matches!(reason, ImageError::Limits(_)) {
        return Error::input(
            file,
            format!(
                "larger than {} MiB when it is decoded, what each thread may take of the available memory",
                decoding_limit() >> 20
            ),
            "scale the photo down, or use a machine with more memory",
        );
    }
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

/// A view's photo.
#[derive(Debug, Clone)]
pub enum PhotoSource {
    /// Decoded already; clones share the pixels.
    Memory(Arc<Photo>),
    /// Decoded anew whenever it is asked for.
    File(PhotoFile),
}

/// A photo's mask, if it has any.
#[derive(Debug, Clone)]
pub(super) struct MaskFile {
    /// The file of the mask.
    pub path: Option<PathBuf>,
    /// True if the file is black where the photo counts.
    pub inverted: bool,
    /// True if the photo's own alpha is a mask of this kind.
    pub inverted_alpha: bool,
}

/// An image file, and the size that its photo was found to have when the dataset was read.
#[derive(Debug, Clone)]
pub struct PhotoFile {
    path: PathBuf,
    max_size: u32,
    undistortion: Option<Box<Undistortion>>,
    mask: MaskFile,
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
        let pixels = self.bytes() as usize / self.alpha().planes();
        self.mask_digest()
            .is_some_and(|found| found == digest(&vec![0; pixels]))
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

/// Multiplies a mask file into the alpha of RGBA bytes: black excludes a pixel, white includes it, or the other way round if `inverted`.
fn apply_mask(
    file: &Path,
    inverted: bool,
    rgba: &mut [u8],
    [width, height]: [u32; 2],
) -> Result<()> {
    let mask = decoded(file)?;
    if (mask.width(), mask.height()) != (width, height) {
        let (w, h) = (mask.width(), mask.height());
        let what = format!("{w}×{h} pixels; its photo has {width}×{height}");
        let fix = "give a mask of the photo's size, or remove it";
        return Err(Error::input(file, what, fix));
    }
    for (pixel, m) in rgba.chunks_exact_mut(4).zip(mask.into_luma8().into_raw()) {
        let m = if inverted { 255 - m } else { m };
        pixel[3] = ((u32::from(pixel[3]) * u32::from(m) + 127) / 255) as u8;
    }
    Ok(())
}

/// The largest size of the same shape whose longest side is at most `max_size` (never larger than the original).
fn fitted([width, height]: [u32; 2], max_size: u32) -> [u32; 2] {
    let longest = width.max(height);
    [width, height].map(|s| {
        let exact = f64::from(s) * f64::from(max_size) / f64::from(longest);
        if longest <= max_size {
            s
        } else {
            (exact.round() as u32).max(1)
        }
    })
}

impl PhotoFile {
    /// The photo of an image file with an optional mask file; `meaning` is that of alpha in the whole dataset.
    pub(super) fn new(
        path: PathBuf,
        header: Header,
        max_size: u32,
        undistortion: Option<Undistortion>,
        mask: MaskFile,
        meaning: Alpha,
    ) -> Self {
        let size = undistortion.map_or([header.width, header.height], |u| {
            [u.target.width, u.target.height]
        });
        let [width, height] = fitted(size, max_size);
        let has_alpha = header.has_alpha || mask.path.is_some();
        Self {
            path,
            max_size,
            undistortion: undistortion.map(Box::new),
            alpha: if has_alpha { meaning } else { Alpha::None },
            mask,
            width,
            height,
            mask_digest: 0,
        }
    }

    /// Width and height of the decoded photo, pixels.
    pub(super) fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    fn bytes(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height) * self.alpha.planes() as u64
    }

    /// The decoded photo, its mask multiplied into its alpha, without lens distortion, shrunk to its size. It has an alpha plane
    /// only if some pixel is not opaque.
    fn decoded(&self) -> Result<Photo> {
        let changed = |what: String| {
            let fix = "leave the photos as they are during a run, and start again";
            Err(Error::input(&self.path, what, fix))
        };
        let image = decoded(&self.path)?;
        let (mut width, mut height) = (image.width(), image.height());
        let own_alpha = image.color().has_alpha();
        let has_alpha = own_alpha || self.mask.path.is_some();
        let mut bytes = if has_alpha {
            image.into_rgba8().into_raw()
        } else {
            image.into_rgb8().into_raw()
        };
        if self.mask.inverted_alpha && own_alpha {
            bytes.chunks_exact_mut(4).for_each(|p| p[3] = 255 - p[3]);
        }
        if let Some(mask) = &self.mask.path {
            apply_mask(mask, self.mask.inverted, &mut bytes, [width, height])?;
        }
        if let Some(undistortion) = &self.undistortion {
            if (width, height) != undistortion.source_size() {
                return changed(format!(
                    "{width}×{height} pixels; another size was there when the dataset was read"
                ));
            }
            bytes = undistortion.apply(&bytes, if has_alpha { 4 } else { 3 });
            (width, height) = (undistortion.target.width, undistortion.target.height);
        }
        let mut alpha = Alpha::None;
        if has_alpha && bytes.chunks_exact(4).any(|p| p[3] < 255) {
            alpha = match self.alpha {
                Alpha::None => Alpha::Transparency,
                meaning => meaning,
            };
        } else if has_alpha {
            let rgb = bytes.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]);
            bytes = rgb.collect();
        }
        let [w, h] = fitted([width, height], self.max_size);
        let known = alpha == Alpha::None || alpha == self.alpha;
        if (w, h) != self.size() || !known {
            return changed(format!(
                "{w}×{h} pixels in {} channels; {}×{} in {} were there when the dataset was read",
                alpha.planes(),
                self.width,
                self.height,
                self.alpha.planes()
            ));
        }
        if (w, h) == (width, height) {
            Photo::from_interleaved(w, h, alpha, &bytes)
        } else {
            shrink(width, height, alpha, &bytes, w, h)
        }
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
pub(super) fn read(
    mut files: Vec<PhotoFile>,
    budget: u64,
    progress: Option<fn(usize, usize)>,
) -> Result<Vec<PhotoSource>> {
    let may_be = Alpha::common(files.iter().map(|f| f.alpha));
    files.iter_mut().for_each(|f| f.alpha = may_be);
    let fits = files.iter().map(PhotoFile::bytes).sum::<u64>() <= budget;
    let (all, done) = (files.len(), AtomicUsize::new(0));
    let decoded: Vec<(Alpha, Option<Photo>)> = files
        .par_iter_mut()
        .map(|f| {
            let photo = f.decoded()?;
            if !fits && f.alpha == Alpha::Mask {
                let white = || vec![255; photo.data.len() / 3];
                f.mask_digest = photo.mask_plane().map_or_else(|| digest(&white()), digest);
            }
            if let Some(progress) = progress {
                progress(done.fetch_add(1, Ordering::Relaxed) + 1, all);
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
