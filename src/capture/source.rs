//! Sources of photos: memory, or an image file that is decoded on demand.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use image::ImageDecoder;
use rayon::prelude::*;

use crate::base::error::{Error, Result};
use crate::capture::archive::Unpacked;
use crate::capture::digests::digest;
use crate::capture::lens::Undistortion;
use crate::capture::memory::check_memory;
pub use crate::capture::memory::parse_available;
use crate::capture::panorama::{self, Side};
use crate::capture::photo::{Alpha, Photo, Shrink, nearest};
use crate::capture::rows::{Rows, not_an_image, open};

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

/// The way from the pixels of a file to a view's photo.
#[derive(Debug, Clone)]
pub(super) enum Resampling {
    /// Shrunk to the view's size alone.
    Shrinking,
    /// Lens distortion removed, then shrunk.
    Lens(Box<Undistortion>),
    /// Shrunk, then the side of a panorama cut out.
    Side(Side),
}

/// An image file, and the size that its photo was found to have when the dataset was read.
#[derive(Debug, Clone)]
pub struct PhotoFile {
    path: PathBuf,
    max_size: u32,
    resampling: Resampling,
    mask: MaskFile,
    width: u32,
    height: u32,
    /// Alpha plane of the photo: at first as its header has it, then as all photos of the dataset do.
    alpha: Alpha,
    /// [`digest()`] of the photo's mask, of an all-white one if it has none.
    mask_digest: u64,
    /// The folder of an archive that the file is in.
    unpacked: Option<Arc<Unpacked>>,
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

    /// Width and height of the decoded photo, pixels.
    #[must_use]
    pub fn size(&self) -> [usize; 2] {
        let (width, height) = match self {
            Self::Memory(photo) => (photo.width, photo.height),
            Self::File(file) => file.size(),
        };
        [width, height].map(|side| side as usize)
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

/// Rows of a photo with its mask multiplied into its alpha.
struct Masked {
    rows: Rows,
    mask: Option<Rows>,
    inverted: bool,
    inverted_alpha: bool,
    /// Interleaved channels of a row: RGB, or RGBA.
    channels: usize,
}

impl Masked {
    /// The rows of a photo and of its mask.
    ///
    /// # Errors
    /// A file that cannot be read; a mask of another size.
    fn open(photo: &Path, mask: &MaskFile) -> Result<Self> {
        let rows = Rows::open(photo)?;
        let of_mask = mask.path.as_ref();
        if let Some(file) = of_mask {
            // Before it is decoded.
            let Header { width, height, .. } = header(file)?;
            let [w, h] = rows.size;
            if [width, height] != rows.size {
                let what = format!("{width}×{height} pixels; its photo has {w}×{h}");
                let fix = "give a mask of the photo's size, or remove it";
                return Err(Error::input(file, what, fix));
            }
        }
        Ok(Self {
            inverted_alpha: mask.inverted_alpha && rows.has_alpha(),
            channels: 3 + usize::from(rows.has_alpha() || of_mask.is_some()),
            rows,
            mask: of_mask.map(|file| Rows::open(file)).transpose()?,
            inverted: mask.inverted,
        })
    }

    /// Hands over each row: interleaved values from 0 to 255 with straight alpha.
    ///
    /// # Errors
    /// Those of [`Rows::colors`].
    fn each(&mut self, mut take: impl FnMut(&[f32])) -> Result<()> {
        let [width, height] = self.rows.size.map(|s| s as usize);
        let mut row = vec![0.0; width * self.channels];
        for _ in 0..height {
            self.rows.colors(&mut row)?;
            if self.inverted_alpha {
                row.chunks_exact_mut(4).for_each(|p| p[3] = 255.0 - p[3]);
            }
            if let Some(mask) = &mut self.mask {
                // Black excludes a pixel, white includes it, or the other way round.
                for (pixel, m) in row.chunks_exact_mut(4).zip(mask.brightness()?) {
                    let m = if self.inverted { 255.0 - m } else { m };
                    pixel[3] = (pixel[3] * m / 255.0).round();
                }
            }
            take(&row);
        }
        Ok(())
    }
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
        resampling: Resampling,
        mask: MaskFile,
        meaning: Alpha,
    ) -> Self {
        let size = [header.width, header.height];
        let [width, height] = match &resampling {
            Resampling::Shrinking => fitted(size, max_size),
            Resampling::Lens(u) => fitted([u.target.width, u.target.height], max_size),
            Resampling::Side(_) => [panorama::side_of(size, max_size); 2],
        };
        let has_alpha = header.has_alpha || mask.path.is_some();
        Self {
            path,
            max_size,
            resampling,
            alpha: if has_alpha { meaning } else { Alpha::None },
            mask,
            width,
            height,
            mask_digest: 0,
            unpacked: None,
        }
    }

    /// Keeps the folder of an archive for as long as the photo may be read.
    pub(super) fn keep(&mut self, unpacked: &Arc<Unpacked>) {
        self.unpacked = Some(unpacked.clone());
    }

    /// Width and height of the decoded photo, pixels.
    pub(super) fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    fn bytes(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height) * self.alpha.planes() as u64
    }

    /// The decoded photo, its mask multiplied into its alpha, without lens distortion, shrunk: to the size of the view, or of the
    /// panorama that this is a side of. It has an alpha plane only if some pixel is not opaque.
    fn whole(&self) -> Result<Photo> {
        let mut source = Masked::open(&self.path, &self.mask)?;
        let size = source.rows.size;
        let view = [self.width, self.height];
        let (to, unlike) = match &self.resampling {
            Resampling::Shrinking => (view, fitted(size, self.max_size) != view),
            Resampling::Lens(undistortion) => (view, size != undistortion.source_size()),
            Resampling::Side(_) => {
                let unlike = panorama::side_of(size, self.max_size) != self.width;
                (panorama::shrunk(size, self.width), unlike)
            }
        };
        if unlike {
            return Err(self.changed(size, source.channels));
        }
        let photo = u64::from(to[0]) * u64::from(to[1]) * source.channels as u64;
        check_memory(&self.path, photo, "the photo", "lower --max-size")?;
        let meaning = match self.alpha {
            _ if source.channels == 3 => Alpha::None,
            Alpha::None => Alpha::Transparency,
            meaning => meaning,
        };
        let photo = match &self.resampling {
            Resampling::Lens(undistortion) => self.undistorted(source, undistortion, meaning)?,
            Resampling::Shrinking | Resampling::Side(_) => {
                let mut small = Shrink::new(size, to, meaning)?;
                source.each(|row| small.row(row))?;
                small.photo()?
            }
        };
        if photo.alpha != Alpha::None && photo.alpha != self.alpha {
            return Err(self.changed(to, photo.alpha.planes()));
        }
        Ok(photo)
    }

    /// The view's photo from [`Self::whole`].
    fn part(&self, whole: &Arc<Photo>) -> Arc<Photo> {
        match self.resampling {
            Resampling::Side(side) => Arc::new(side.photo(whole, self.width)),
            _ => whole.clone(),
        }
    }

    /// The error of a photo that is another one than when the dataset was read.
    fn changed(&self, [width, height]: [u32; 2], channels: usize) -> Error {
        let what = format!(
            "{width}×{height} pixels in {channels} channels; {}×{} in {} were there when the dataset was read",
            self.width,
            self.height,
            self.alpha.planes()
        );
        let fix = "leave the photos as they are during a run, and start again";
        Error::input(&self.path, what, fix)
    }

    /// The photo without lens distortion, shrunk to its size. Resampling takes the whole photo, in 8 bits.
    fn undistorted(
        &self,
        mut source: Masked,
        undistortion: &Undistortion,
        meaning: Alpha,
    ) -> Result<Photo> {
        let target = [undistortion.target.width, undistortion.target.height];
        let pixels = |[w, h]: [u32; 2]| u64::from(w) * u64::from(h);
        let channels = source.channels;
        let from = pixels(source.rows.size) * channels as u64;
        // A photo that is decoded as a whole is there beside what is taken from it, and gone before the rest.
        let decoded = source.rows.in_memory();
        let bytes = from + decoded.max(pixels(target) * channels as u64);
        let part = "the photo has lens distortion, which is removed at its full size: this";
        let fix = "scale the photo down, undistort it first, or use a machine with more memory";
        check_memory(&self.path, bytes, part, fix)?;
        let mut whole = Vec::with_capacity(from as usize);
        source.each(|row| whole.extend(row.iter().map(|v| nearest(f64::from(*v)))))?;
        drop(source);
        let bytes = undistortion.apply(&whole, channels);
        drop(whole);
        let mut small = Shrink::new(target, [self.width, self.height], meaning)?;
        let row = target[0] as usize * channels;
        for row in bytes.chunks_exact(row.max(1)) {
            let row: Vec<f32> = row.iter().map(|v| f32::from(*v)).collect();
            small.row(&row);
        }
        small.photo()
    }

    /// The photo with the alpha plane that all photos of its dataset have.
    ///
    /// # Errors
    /// Those of [`PhotoSource::load`].
    pub(crate) fn load(&self) -> Result<Photo> {
        let whole = self.whole().map_err(|error| self.explained(error))?;
        let part = self.part(&Arc::new(whole));
        // Nobody else has it: what it was cut from is gone.
        Ok(with_alpha(part, self.alpha))
    }

    /// The error of a decoder that failed without a reason.
    pub(crate) fn undecodable(&self) -> Error {
        let fix = "replace the file and start again";
        self.explained(Error::input(&self.path, "the decoder failed on it", fix))
    }

    /// The same error, about the archive if the photo comes from one.
    fn explained(&self, error: Error) -> Error {
        match &self.unpacked {
            Some(unpacked) => unpacked.explained(error),
            None => error,
        }
    }
}

/// A photo with an alpha plane; copied only if it is shared.
fn with_alpha(photo: Arc<Photo>, alpha: Alpha) -> Photo {
    Arc::unwrap_or_clone(photo).with_alpha(alpha)
}

/// Part of a photo that is to be known when its dataset has been read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Asked {
    /// Its pixels.
    Photo,
    /// Its alpha plane.
    Alpha,
    /// Nothing: it is opaque by its header.
    Nothing,
}

/// The alpha of each photo of a group that one file has, and the photo if it is asked for; calls `told` after each that was decoded.
///
/// # Errors
/// A file that cannot be decoded.
fn decode(
    group: &mut [(&mut PhotoFile, Asked)],
    told: impl Fn(),
) -> Result<Vec<(Alpha, Option<Arc<Photo>>)>> {
    let read = group[0].1 != Asked::Nothing;
    let whole = read.then(|| group[0].0.whole()).transpose()?.map(Arc::new);
    let parts = group.iter_mut().map(|(file, asked)| {
        let photo = whole.as_ref().map(|whole| file.part(whole));
        if *asked != Asked::Photo && file.alpha == Alpha::Mask {
            let white = || digest(&vec![255; file.width as usize * file.height as usize]);
            let mask = photo.as_ref().and_then(|photo| photo.mask_plane());
            file.mask_digest = mask.map_or_else(white, digest);
        }
        if read {
            told();
        }
        let alpha = photo.as_ref().map_or(Alpha::None, |photo| photo.alpha);
        (alpha, photo.filter(|_| *asked == Asked::Photo))
    });
    Ok(parts.collect())
}

/// The photos of `files`: the `needed` ones in memory if all of them fit into `budget` bytes, all others left in their files.
///
/// Those that are needed, or may have an alpha plane, are decoded here in either case: a broken one is found before training begins, and one transparent
/// pixel of any photo decides for all that they have an alpha plane.
///
/// # Errors
/// A file that cannot be decoded, or a photo that does not fit into the budget alone.
pub(super) fn read(
    mut files: Vec<PhotoFile>,
    needed: Range<usize>,
    budget: u64,
    progress: Option<fn(usize, usize)>,
) -> Result<Vec<PhotoSource>> {
    let opaque: Vec<bool> = files.iter().map(|f| f.alpha == Alpha::None).collect();
    // What all of them have if any has.
    let may_be = Alpha::common(files.iter().map(|f| f.alpha));
    files.iter_mut().for_each(|f| f.alpha = may_be);
    let bytes = files[needed.clone()].iter().map(PhotoFile::bytes);
    let fits = bytes.sum::<u64>() <= budget;
    let asked = opaque
        .iter()
        .enumerate()
        .map(|(i, opaque)| match (needed.contains(&i), opaque) {
            (true, _) if fits => Asked::Photo,
            (false, true) => Asked::Nothing,
            _ => Asked::Alpha,
        });
    let mut asked: Vec<(&mut PhotoFile, Asked)> = files.iter_mut().zip(asked).collect();
    let all = asked.iter().filter(|a| a.1 != Asked::Nothing).count();
    let done = AtomicUsize::new(0);
    let told = || {
        if let Some(progress) = progress {
            progress(done.fetch_add(1, Ordering::Relaxed) + 1, all);
        }
    };
    // The sides of a panorama stand together unless another name comes between theirs, are all needed or none is, and are cut from one decoding.
    let decoded = asked
        .par_chunk_by_mut(|a, b| a.0.path == b.0.path)
        .map(|group| decode(group, told))
        .collect::<Result<Vec<_>>>()?
        .concat();
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
            Some(photo) => with_alpha(photo, alpha).into(),
            None => PhotoSource::File(file),
        })
        .collect())
}
