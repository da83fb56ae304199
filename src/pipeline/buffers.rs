//! Buffers on the device: the Gaussians, one view between the stages, and the photos of a set of views. `kernels/README.md`
//! has the shapes.

use std::ops::Range;
use std::sync::Arc;

use crate::base::constants::SUMS;
use crate::base::error::{Error, Result};
use crate::capture::{Alpha, Photo, View};
use crate::device::tuning::{Tuning, status};
use crate::device::{Array, CameraArg, Device, ImageSize, PhotoScale, Projected, Real};
use crate::pipeline::photo_array::PhotoArray;
use crate::pipeline::photos::{Photos, Wanted};
use crate::pipeline::room::{Load, ROUND, check_room, image_planes, most_pairs};
use crate::pipeline::stage::scan::Totals;
use crate::scene::{Gaussians, Plane};

/// Tiles that are blank in a render and its photo.
#[derive(Debug, Clone, Copy)]
pub struct Blank<'a> {
    /// Tiles that are neither masked nor clear in the photo.
    pub active_tiles: &'a Array<u32>,
    /// First pair of each tile of the render; not read where photos have masks.
    pub tile_start: &'a Array<u32>,
}

/// Longest side of an image: projected Gaussians hold pixel bounds in 16 bits.
const MAX_PIXELS: usize = 1 << 16;

/// Most counters of pairs by chunk and tile, as long as there are fewer tiles: 32 MiB.
const MAX_COUNTERS: usize = 1 << 23;

/// Names of the keys and values that are sorted by depth.
const VISIBLE: [&str; 2] = ["visible_keys", "visible"];
/// Names of the keys and values that are sorted by tile.
const PAIRS: [&str; 2] = ["pair_tiles", "order"];

/// Raw parameters of a scene on the device.
#[derive(Debug)]
pub struct GaussianBuffers<R: Real = f32> {
    /// Planes in the order of [`Plane`].
    pub params: Array<R>,
    /// Standard deviations of the 3D filter, local units; empty without anti-aliasing.
    pub filter: Array<R>,
    /// Gaussians allocated.
    pub stride: usize,
    /// Gaussians.
    pub count: usize,
    /// SH degree of the stored coefficients.
    pub sh_degree: u32,
    /// The part of a larger set that these are; `None` if they are all.
    pub shard: Option<Shard>,
}

/// Rows of a set of Gaussians of which others have the rest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// Row of the first in the whole set.
    pub first: usize,
    /// Gaussians of the whole set.
    pub all: usize,
}

impl<R: Real> GaussianBuffers<R> {
    /// Uploads a scene, with room for at least `capacity` Gaussians.
    pub fn upload(device: &Device, splats: &Gaussians, capacity: usize) -> Result<Self> {
        let count = splats.len();
        let stride = Self::stride_of(capacity.max(count));
        check_room::<R>(device, "params", splats.planes().len(), stride)?;
        let mut host = vec![R::of(0.0); splats.planes().len() * stride];
        for (p, plane) in splats.planes().iter().enumerate() {
            for (to, v) in host[p * stride..].iter_mut().zip(plane) {
                *to = R::of(f64::from(*v));
            }
        }
        Ok(Self {
            params: Array::from_slice(device, "params", &host)?,
            filter: Array::zeros(device, "filter", 0)?,
            stride,
            count,
            sh_degree: splats.sh_degree(),
            shard: None,
        })
    }

    /// The same with room for the 3D filter: until it is filled in, no Gaussian is filtered, as is right for a scene that has
    /// the filter in its scales and opacities.
    pub fn with_filter(self, device: &Device) -> Result<Self> {
        Ok(Self {
            filter: Array::zeros(device, "filter", self.stride)?,
            ..self
        })
    }

    /// Gaussians of the whole set, of which others may have some.
    #[must_use]
    pub fn all(&self) -> usize {
        self.shard.map_or(self.count, |shard| shard.all)
    }

    /// Number of planes.
    #[must_use]
    pub fn planes(&self) -> usize {
        Plane::count(self.sh_degree)
    }

    /// Reads the first `count` values of one plane.
    pub fn plane(&self, plane: usize) -> Result<Vec<f32>> {
        let values = self.params.read(plane * self.stride, self.count)?;
        Ok(values.into_iter().map(|v| v.into() as f32).collect())
    }

    /// A stride for at least `capacity` Gaussians, with a quarter as many again to grow into.
    #[must_use]
    pub fn grown_stride(capacity: usize) -> usize {
        Self::stride_of(capacity + capacity / 4)
    }

    /// The least stride for so many Gaussians, one at least.
    #[must_use]
    pub fn stride_of(capacity: usize) -> usize {
        capacity.max(1).next_multiple_of(ROUND)
    }
}

/// Gradients of the raw parameters of some Gaussians of a block.
#[derive(Debug, Clone)]
pub struct GradientBlock<'a, R: Real> {
    /// The values; a plane begins at Gaussian `first`.
    pub values: &'a Array<R>,
    /// Number of planes in use.
    pub planes: usize,
    /// Number of Gaussians that a plane has room for, a multiple of 16.
    pub stride: usize,
    /// First Gaussian of the block, a multiple of 16.
    pub first: usize,
    /// Rows of the Gaussians, of the block; the first begins a vector.
    pub rows: Range<usize>,
    /// Views whose gradients the values are the sum of.
    pub views: usize,
}

/// Keys and values to be sorted, twice: a pass of the sort goes from one pair of arrays to the other.
#[derive(Debug)]
pub struct SortBuffers {
    /// Keys.
    pub keys: [Array<u32>; 2],
    /// Values.
    pub values: [Array<u32>; 2],
    /// Index of the pair of arrays that holds the result of the last sort.
    pub sorted: usize,
}

impl SortBuffers {
    /// Room for `len` elements.
    pub fn new(device: &Device, names: [&'static str; 2], len: usize) -> Result<Self> {
        let zeros = |name| Array::zeros(device, name, len);
        Ok(Self {
            keys: [zeros(names[0])?, zeros(names[0])?],
            values: [zeros(names[1])?, zeros(names[1])?],
            sorted: 0,
        })
    }

    /// Values in the order of their keys.
    #[must_use]
    pub fn sorted_values(&self) -> &Array<u32> {
        &self.values[self.sorted]
    }
}

/// Camera of one view and its arrays from projected Gaussians to the image; they grow and never shrink.
#[derive(Debug)]
pub struct ViewBuffers<R: Real> {
    /// Camera of the view rendered last.
    pub camera: CameraArg<R>,
    /// Rows of tiles of the image that are composited here: all, unless ranks share them.
    pub band: Range<usize>,
    /// Gaussians of the view rendered last.
    pub count: usize,
    /// Range of the Gaussians of ranks before this one, which stand behind its own rows here and come first in the order of the whole set; empty
    /// where nobody shares the view.
    pub early: Range<usize>,
    /// Projected Gaussians: mean, conic, opacity, colour.
    pub records: Array<Projected<R>>,
    /// Depth bits or culled.
    pub keys: Array<u32>,
    /// Tile intersections of each Gaussian.
    pub isect_counts: Array<u32>,
    /// First tile intersection of each Gaussian.
    pub isect_start: Array<u32>,
    /// Visible Gaussians by depth.
    pub visible: SortBuffers,
    /// Bit mask and bounds of the tiles of each visible Gaussian, if they are few.
    pub cover: Array<u32>,
    /// Visible Gaussians of each chunk.
    pub chunk_sums: Array<u32>,
    /// First visible Gaussian of each chunk, and the number of all (group style).
    pub chunk_starts: Array<u32>,
    /// Pairs of each chunk.
    pub pair_sums: Array<u32>,
    /// Tiles and emission slots of the tile intersections on their way through the sort; no more than [`ViewBuffers::order`] where
    /// every pair goes straight to its place.
    pub pairs: SortBuffers,
    /// Gaussian of each tile intersection, by emission slot.
    pub isect_owner: Array<u32>,
    /// Partial gradients of each tile intersection (splat_grad); empty when only rendering.
    pub sums: Array<R>,
    /// Colours and transmittance of tiles where segments of their pairs begin, for splat_grad in the group style.
    pub snapshots: Array<R>,
    /// First tile intersection of each tile.
    pub tile_start: Array<u32>,
    /// Tile intersections of each chunk of the visible Gaussians and tile, then those of the chunks before.
    pub tile_counts: Array<u32>,
    /// Tiles of a masked photo that get pairs, or of a transparent one that are not clear; of the photo that they were marked for last.
    pub active_tiles: Arc<Array<u32>>,
    /// Pairs used of each tile.
    pub tile_used: Array<u32>,
    /// Red, green, blue, transmittance.
    pub image: Array<R>,
    /// Counters; see [`status`].
    pub status: Array<u32>,
    /// Pairs that there is room for.
    pub capacity: usize,
    gradients: bool,
    tuning: Tuning,
}

impl<R: Real> ViewBuffers<R> {
    /// Empty arrays; `gradients` says whether the sums of splat_grad will be needed.
    pub fn new(device: &Device, tuning: &Tuning, gradients: bool) -> Result<Self> {
        let ints = |name| Array::<u32>::zeros(device, name, 0);
        Ok(Self {
            camera: CameraArg::default(),
            band: 0..0,
            count: 0,
            early: 0..0,
            records: Array::zeros(device, "records", 0)?,
            keys: ints("keys")?,
            isect_counts: ints("isect_counts")?,
            isect_start: ints("isect_start")?,
            visible: SortBuffers::new(device, VISIBLE, 0)?,
            cover: ints("cover")?,
            chunk_sums: Array::zeros(device, "chunk_sums", tuning.chunks)?,
            chunk_starts: Array::zeros(device, "chunk_starts", tuning.chunks + 1)?,
            pair_sums: Array::zeros(device, "pair_sums", tuning.chunks)?,
            pairs: SortBuffers::new(device, PAIRS, 0)?,
            isect_owner: ints("isect_owner")?,
            sums: Array::zeros(device, "sums", 0)?,
            snapshots: Array::zeros(device, "snapshots", 0)?,
            tile_start: ints("tile_start")?,
            tile_counts: ints("tile_counts")?,
            active_tiles: Arc::new(ints("active_tiles")?),
            tile_used: ints("tile_used")?,
            image: Array::zeros(device, "image", 0)?,
            status: Array::zeros(device, "status", status::SLOTS)?,
            capacity: 0,
            gradients,
            tuning: *tuning,
        })
    }

    /// Makes room for a scene of `stride` Gaussians. Contents are lost.
    pub fn fit_gaussians(&mut self, device: &Device, stride: usize) -> Result<()> {
        if self.keys.len() >= stride {
            return Ok(());
        }
        let ints = |name| Array::<u32>::zeros(device, name, stride);
        self.records = Array::zeros(device, "records", stride)?;
        self.isect_counts = ints("isect_counts")?;
        self.isect_start = ints("isect_start")?;
        self.visible = SortBuffers::new(device, VISIBLE, stride)?;
        self.cover = Array::zeros(device, "cover", 2 * stride)?;
        // The last: they tell that there is room.
        self.keys = ints("keys")?;
        Ok(())
    }

    /// Makes room for `count` Gaussians, if there is none for them, a quarter more where it can be had, and keeps what has been projected of the
    /// first `kept`.
    ///
    /// # Errors
    /// No room; what has been projected is lost then.
    pub fn grow_gaussians(&mut self, device: &Device, count: usize, kept: usize) -> Result<()> {
        if self.keys.len() >= count {
            return Ok(());
        }
        let records = std::mem::replace(&mut self.records, Array::zeros(device, "records", 0)?);
        let none = || Array::zeros(device, "keys", 0);
        let keys = std::mem::replace(&mut self.keys, none()?);
        let pairs = std::mem::replace(&mut self.isect_counts, none()?);
        self.fit_gaussians(device, count + count / 4)
            .or_else(|_| self.fit_gaussians(device, count))?;
        self.records.copy_from(0, &records, 0, kept)?;
        self.keys.copy_from(0, &keys, 0, kept)?;
        self.isect_counts.copy_from(0, &pairs, 0, kept)
    }

    /// Gives up the room for Gaussians and pairs, of which views need fewer from now on; each makes room for its own.
    pub fn release(&mut self, device: &Device) -> Result<()> {
        self.keys = Array::zeros(device, "keys", 0)?;
        self.fit_gaussians(device, ROUND)?;
        self.set_intersections(device, ROUND)
    }

    /// Emission slots of the tile intersections, by tile and depth.
    #[must_use]
    pub fn order(&self) -> &Array<u32> {
        self.pairs.sorted_values()
    }

    /// Tiles of the tile intersections in ascending order, where those are sorted.
    pub(crate) fn tile_of_pairs(&self) -> &Array<u32> {
        &self.pairs.keys[self.pairs.sorted]
    }

    /// True if the sums of splat_grad will be needed.
    pub(crate) fn gradients(&self) -> bool {
        self.gradients
    }

    /// Tile intersections of each visible Gaussian by depth: in the place of the keys that have been sorted.
    pub(crate) fn depth_counts(&self) -> &Array<u32> {
        &self.visible.keys[0]
    }

    /// First tile intersection of each visible Gaussian by depth.
    pub(crate) fn depth_start(&self) -> &Array<u32> {
        &self.visible.keys[1]
    }

    /// Blank tiles of the view enqueued last and of the photo whose active tiles were marked.
    pub(crate) fn blank(&self) -> Blank<'_> {
        Blank {
            active_tiles: &self.active_tiles,
            tile_start: &self.tile_start,
        }
    }

    /// Makes room for `wanted` pairs, or as many as a buffer of the device can hold, if that is no less than `needed`. Contents are lost.
    ///
    /// # Errors
    /// No room for those that are needed, or the driver's.
    pub fn fit_intersections(
        &mut self,
        device: &Device,
        needed: usize,
        wanted: usize,
    ) -> Result<()> {
        if self.capacity >= wanted {
            return Ok(());
        }
        let [width, height] = self.camera.image().pixels;
        let view = Load {
            pairs: needed,
            gaussians: self.count,
            longest: width.max(height),
        };
        let pairs = wanted.min(most_pairs::<R>(
            device,
            &self.tuning,
            self.gradients,
            &view,
        )?);
        match self.capacity >= pairs {
            true => Ok(()),
            false => self.set_intersections(device, pairs),
        }
    }

    /// Room for `pairs` pairs, rounded up, whatever there was before.
    pub fn set_intersections(&mut self, device: &Device, pairs: usize) -> Result<()> {
        // Slots are numbered by 32 bits.
        let most = u32::MAX as usize - (ROUND - 1);
        let pairs = pairs.min(most).next_multiple_of(ROUND);
        let ints = |name| Array::<u32>::zeros(device, name, pairs);
        if self.tuning.group_style {
            self.pairs = SortBuffers::new(device, PAIRS, pairs)?;
        } else {
            self.pairs.values[0] = ints(PAIRS[1])?;
        }
        if self.gradients {
            self.sums = Array::zeros(device, "sums", pairs * SUMS)?;
        }
        if self.gradients && self.tuning.group_style {
            self.snapshots = Array::zeros(device, "snapshots", self.tuning.snapshot_values(pairs))?;
        }
        self.isect_owner = ints("isect_owner")?;
        self.capacity = pairs;
        Ok(())
    }

    /// Makes room for the sums of `pairs` pairs, those that others have composited among them. The first `kept` stay.
    pub fn fit_sums(&mut self, device: &Device, pairs: usize, kept: usize) -> Result<()> {
        if self.sums.len() >= pairs * SUMS {
            return Ok(());
        }
        let room = |pairs: usize| Array::zeros(device, "sums", pairs * SUMS);
        // A quarter to spare where there is room for it.
        let sums = room(pairs + pairs / 4).or_else(|_: Error| room(pairs))?;
        sums.copy_from(0, &self.sums, 0, kept * SUMS)?;
        self.sums = sums;
        Ok(())
    }

    /// Arrays in which the pairs of the view are added up.
    #[must_use]
    pub fn totals(&self) -> Totals<'_> {
        Totals {
            chunk_sums: &self.pair_sums,
            status: &self.status,
            most: self.capacity,
        }
    }

    /// Edge of a tile, pixels.
    #[must_use]
    pub fn tile(&self) -> u32 {
        self.tuning.tile
    }

    /// Number of chunks of the visible Gaussians whose pairs are counted by tile.
    #[must_use]
    pub fn tile_chunks(&self) -> usize {
        let most = MAX_COUNTERS / self.camera.image().tile_count().max(1);
        self.tuning.chunks.min(most).max(1)
    }

    /// Makes room for an image. Contents are lost.
    pub fn fit_image(&mut self, device: &Device, size: ImageSize) -> Result<()> {
        if size.pixels.iter().any(|s| *s < 1 || *s > MAX_PIXELS) {
            let [w, h] = size.pixels;
            return Err(Error::config(
                "image size",
                format!("{w} x {h}; 1 to {MAX_PIXELS} pixels a side expected"),
            ));
        }
        let tiles = size.tile_count();
        if self.tile_used.len() >= tiles {
            return Ok(());
        }
        self.tile_start = Array::zeros(device, "tile_start", tiles + 1)?;
        let counters = match self.tuning.group_style {
            true => 0,
            false => (self.tuning.chunks * tiles).min(MAX_COUNTERS).max(tiles),
        };
        self.tile_counts = Array::zeros(device, "tile_counts", counters)?;
        self.image = image_planes(device, "image", 4, size)?;
        self.tile_used = Array::zeros(device, "tile_used", tiles)?;
        Ok(())
    }
}

/// Cameras of a set of views, and access to their photos on the device.
#[derive(Debug)]
pub struct ViewSet<R: Real = f32> {
    /// Names, as the dataset gives them.
    pub names: Vec<String>,
    /// Cameras.
    pub cameras: Vec<CameraArg<R>>,
    /// Source of the photos, shared with other sets.
    photos: Photos,
    /// The photos' numbers there.
    numbers: Vec<usize>,
    /// Meaning of the photos' alpha plane.
    pub alpha: Alpha,
    /// Largest width and largest height.
    pub largest: ImageSize,
}

impl<R: Real> ViewSet<R> {
    /// Takes views; their photos are added to `photos` one by one, so that pixels that nobody else holds are freed as soon as
    /// they are uploaded.
    ///
    /// # Errors
    /// See [`Photos::add`].
    pub fn new(photos: &Photos, views: impl IntoIterator<Item = View>) -> Result<Self> {
        let (mut names, mut cameras, mut numbers) = (Vec::new(), Vec::new(), Vec::new());
        let mut alphas = Vec::new();
        let tile = photos.device().tuning().tile;
        for view in views {
            alphas.push(view.photo.alpha());
            names.push(view.name);
            cameras.push(CameraArg::<R>::new(&view.camera, tile));
            numbers.push(photos.add(view.photo)?);
        }
        let most = |k: usize| cameras.iter().map(|c| c.size[k].max(1)).max().unwrap_or(1) as usize;
        let largest = ImageSize {
            pixels: [most(0), most(1)],
            tile: tile as usize,
        };
        Ok(Self {
            names,
            alpha: Alpha::common(alphas),
            cameras,
            photos: photos.clone(),
            numbers,
            largest,
        })
    }

    /// At most so many of the views, evenly spread; their photos are those of this set.
    #[must_use]
    pub fn some(&self, most: usize) -> Self {
        let (all, shown) = (self.len(), self.len().min(most));
        let chosen: Vec<usize> = (0..shown).map(|k| k * all / shown).collect();
        Self {
            names: chosen.iter().map(|&v| self.names[v].clone()).collect(),
            cameras: chosen.iter().map(|&v| self.cameras[v]).collect(),
            numbers: chosen.iter().map(|&v| self.numbers[v]).collect(),
            photos: self.photos.clone(),
            ..*self
        }
    }

    /// The photo of a view \[3 or 4, height, width\]; those of the views `next`, in the order of their use, are decoded
    /// meanwhile if they are not there yet.
    ///
    /// # Errors
    /// See [`Photos::get`].
    pub fn photo(&self, view: usize, next: &[usize]) -> Result<Arc<PhotoArray>> {
        self.photo_at(view, next, |_| (PhotoScale::FULL, None))
    }

    /// The same at a fraction of the size, or some rows of that: `part` answers the scale for a view, and the pixel rows that are
    /// needed if those are not all.
    ///
    /// # Errors
    /// See [`Photos::get`].
    pub fn photo_at(
        &self,
        view: usize,
        next: &[usize],
        part: impl Fn(usize) -> (PhotoScale, Option<Range<usize>>),
    ) -> Result<Arc<PhotoArray>> {
        let wanted = |view: usize| {
            let (scale, rows) = part(view);
            Wanted {
                photo: self.numbers[view],
                scale,
                rows,
            }
        };
        let next = next.iter().map(|view| wanted(*view));
        self.photos.get(wanted(view), next)
    }

    /// The photo of a view, read back from the device.
    ///
    /// # Errors
    /// See [`ViewSet::photo`], or the driver's.
    pub fn read_photo(&self, view: usize) -> Result<Photo> {
        let data = self.photo(view, &[])?.to_vec()?;
        let [width, height] = self.cameras[view].size.map(|s| s as u32);
        Ok(Photo {
            width,
            height,
            alpha: self.alpha,
            data,
        })
    }

    /// Source of the photos.
    #[must_use]
    pub fn photos(&self) -> &Photos {
        &self.photos
    }

    /// Number of views.
    #[must_use]
    pub fn len(&self) -> usize {
        self.cameras.len()
    }

    /// True if there is no view.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.cameras.is_empty()
    }
}
