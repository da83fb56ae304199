//! Types that device arrays hold: numbers, and `repr(C)` structs of `kernels/common.clh` and `kernels/edit.cl`. The tests
//! compare their sizes and offsets with the device's.

use std::fmt::Debug;

use ocl_core::OclPrm;

use crate::base::constants::{NEAR, RECORD_BYTES};
use crate::capture::Camera;
use crate::scene::Edit;

/// A type that device arrays can hold.
pub trait Element: OclPrm {
    /// Name of the type in OpenCL C.
    const NAME: &'static str;
}

macro_rules! element {
    ($($t:ty => $name:literal),*) => { $(impl Element for $t { const NAME: &'static str = $name; })* };
}
element!(f32 => "float", f64 => "double", u32 => "uint", i32 => "int", u8 => "uchar");

/// The kernels' `real`: f32, or f64 for the checks against the reference.
pub trait Real: Element + Into<f64> {
    /// True for f64; the value of `REAL_IS_DOUBLE`.
    const IS_DOUBLE: bool;
    /// The nearest value to `v`.
    fn of(v: f64) -> Self;
}

impl Real for f32 {
    const IS_DOUBLE: bool = false;
    fn of(v: f64) -> Self {
        v as f32
    }
}

impl Real for f64 {
    const IS_DOUBLE: bool = true;
    fn of(v: f64) -> Self {
        v
    }
}

/// A projected Gaussian (`Projected` in `kernels/common.clh`).
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Projected<R> {
    /// Mean x, pixels.
    pub x: R,
    /// Mean y, pixels.
    pub y: R,
    /// ½·log2(e)·Σ′yy/det Σ′, 1/pixel².
    pub a: R,
    /// Σ′xy/Σ′yy.
    pub r: R,
    /// ½·log2(e)/Σ′yy, 1/pixel².
    pub c: R,
    /// log2 of the opacity.
    pub lo: R,
    /// Colour.
    pub rgb: [R; 3],
    /// Camera z, local units.
    pub depth: R,
    /// Inclusive pixel bounds in x, low 16 bits first, high 16 bits last.
    pub bx: u32,
    /// Inclusive pixel bounds in y, likewise.
    pub by: u32,
}
const _: () = assert!(size_of::<Projected<f32>>() == RECORD_BYTES);

/// A camera (`Camera` in `kernels/common.clh`).
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CameraArg<R> {
    /// Rotation from scene to camera, row major.
    pub w: [R; 9],
    /// Translation, local units.
    pub t: [R; 3],
    /// Centre of projection, local units.
    pub center: [R; 3],
    /// fx, fy, cx, cy, pixels.
    pub intrinsics: [R; 4],
    /// x/z and y/z (min, max, min, max) inside which the affine approximation is trusted.
    pub limits: [R; 4],
    /// Near plane, local units.
    pub near: R,
    /// Width and height, pixels.
    pub size: [i32; 2],
    /// Edge of a tile, pixels; for the host alone, as the next.
    pub tile: i32,
    /// Tiles in x.
    pub across: i32,
}

impl<R: Real> CameraArg<R> {
    /// The camera as kernels take it, for images of tiles of so many pixels a side. The field of view is widened by 30 % on each side, as in 3DGS (with the principal
    /// point taken into account).
    #[must_use]
    pub fn new(camera: &Camera, tile: u32) -> Self {
        let (w, h) = (f64::from(camera.width), f64::from(camera.height));
        let (fx, fy, cx, cy) = (camera.fx, camera.fy, camera.cx, camera.cy);
        let (mx, my) = (0.3 * w / (2.0 * fx), 0.3 * h / (2.0 * fy));
        let rows = camera.rotation.transpose().to_cols_array();
        Self {
            w: rows.map(R::of),
            t: camera.translation.to_array().map(R::of),
            center: camera.center().to_array().map(R::of),
            intrinsics: [fx, fy, cx, cy].map(R::of),
            limits: [
                -cx / fx - mx,
                (w - cx) / fx + mx,
                -cy / fy - my,
                (h - cy) / fy + my,
            ]
            .map(R::of),
            near: R::of(NEAR),
            size: [camera.width as i32, camera.height as i32],
            tile: tile as i32,
            across: camera.width.div_ceil(tile) as i32,
        }
    }

    /// The camera of the photo that the shrink stage makes: the same pixel grid, coarser by the scale.
    #[must_use]
    pub fn shrunk(&self, scale: PhotoScale) -> Self {
        let size = self.size.map(|s| scale.of(s as usize) as i32);
        let [num, den] = [scale.num, scale.den].map(|n| n as f64);
        Self {
            intrinsics: self.intrinsics.map(|v| R::of(v.into() * num / den)),
            size,
            across: (size[0] as u32).div_ceil(self.tile.max(1) as u32) as i32,
            ..*self
        }
    }

    /// Width and height of the image.
    #[must_use]
    pub fn image(&self) -> ImageSize {
        ImageSize {
            pixels: self.size.map(|s| s as usize),
            // Nothing has been rendered where there is none.
            tile: self.tile.max(1) as usize,
        }
    }
}

/// Size of a smaller photo over that of the whole, no more than 1: a fraction of small numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct PhotoScale {
    /// Numerator.
    pub num: usize,
    /// Denominator.
    pub den: usize,
}

impl PhotoScale {
    /// The whole size.
    pub const FULL: Self = Self { num: 1, den: 1 };

    /// One over a divisor.
    #[must_use]
    pub const fn one_over(divisor: usize) -> Self {
        Self {
            num: 1,
            den: divisor,
        }
    }

    /// Pixels of a side that the whole has so many pixels of.
    #[must_use]
    pub fn of(self, side: usize) -> usize {
        side * self.num / self.den
    }

    /// The scale halved so many times.
    #[must_use]
    pub fn halved(self, times: u32) -> Self {
        Self {
            den: self.den << times,
            ..self
        }
    }
}

/// Size of an image and of its tiles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ImageSize {
    /// Width and height without padding, pixels.
    pub pixels: [usize; 2],
    /// Edge of a tile, pixels.
    pub tile: usize,
}

impl ImageSize {
    /// Width and height with the padding to whole tiles, pixels.
    #[must_use]
    pub fn padded(self) -> [usize; 2] {
        self.pixels.map(|s| s.next_multiple_of(self.tile))
    }

    /// Pixels of a padded plane.
    #[must_use]
    pub fn plane(self) -> usize {
        self.padded().iter().product()
    }

    /// Tiles in x and y.
    #[must_use]
    pub fn tiles(self) -> [usize; 2] {
        self.pixels.map(|s| s.div_ceil(self.tile))
    }

    /// Number of tiles.
    #[must_use]
    pub fn tile_count(self) -> usize {
        self.tiles().iter().product()
    }
}

// SAFETY: plain old data, any bit pattern is a value, no padding that is read.
unsafe impl<R: Real> OclPrm for Projected<R> {}
// SAFETY: as above.
unsafe impl<R: Real> OclPrm for CameraArg<R> {}
// SAFETY: as above.
unsafe impl OclPrm for Edit {}

impl<R: Real> Element for Projected<R> {
    const NAME: &'static str = "Projected";
}
impl<R: Real> Element for CameraArg<R> {
    const NAME: &'static str = "Camera";
}
impl Element for Edit {
    const NAME: &'static str = "Edit";
}
