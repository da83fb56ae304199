//! Panoramas: equirectangular photos of the whole sphere, each of which is cut into the views of the six sides of a cube.
//!
//! A ray's longitude gives x and its latitude y, with the viewing axis in the middle, to the right what is right and above what is above.
//! So do COLMAP's model `EQUIRECTANGULAR` (`src/colmap/sensor/models.h`), nerfstudio's `EQUIRECTANGULAR` (`cameras/cameras.py`, in
//! OpenGL axes) and Metashape's spherical cameras (User Manual, appendix "Camera models").
//!
//! Sides of 90° adjoin exactly: every direction is in one view. Fewer and wider views would stretch their edges (at 45° from the axis a
//! pinhole's pixels see half as much as in the middle, at 60° a quarter), more of them would overlap. A side is a quarter as wide as the
//! panorama, as in COLMAP's `panorama_sfm.py`: the horizon keeps its number of pixels.

use std::f64::consts::PI;
use std::path::Path;

use glam::{DMat3, DVec3};

use crate::base::error::{Error, Result};
use crate::capture::camera::Camera;
use crate::capture::photo::Photo;

/// Samples of a panorama per pixel of a side, along each axis. In the middle of a side a pixel is as wide as 4/π pixels of the panorama,
/// and less everywhere else: samples are at most one pixel apart.
const SAMPLES: usize = 2;

/// Longitude (to the right of the viewing axis, −π to π) and latitude (downwards, −π/2 to π/2) of a ray in a camera's axes, radians.
#[must_use]
pub fn angles(ray: DVec3) -> [f64; 2] {
    let level = (ray.x * ray.x + ray.z * ray.z).sqrt();
    [ray.x.atan2(ray.z), ray.y.atan2(level)]
}

/// Focal lengths (pixels per radian) and principal point fx, fy, cx, cy of a panorama of this size.
pub(super) fn intrinsics(width: u32, height: u32) -> [f64; 4] {
    let [w, h] = [width, height].map(f64::from);
    [w / (2.0 * PI), h / PI, w / 2.0, h / 2.0]
}

/// Side of the cube around a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// Around the viewing axis.
    Front,
    /// 90° to the right of it.
    Right,
    /// Behind the camera.
    Back,
    /// 90° to the left.
    Left,
    /// Above; its lower edge adjoins the front.
    Up,
    /// Below; its upper edge adjoins the front.
    Down,
}

impl Side {
    /// The sides of a cube.
    pub const ALL: [Self; 6] = [
        Self::Front,
        Self::Right,
        Self::Back,
        Self::Left,
        Self::Up,
        Self::Down,
    ];

    /// Name of the side in names of views.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Front => "front",
            Self::Right => "right",
            Self::Back => "back",
            Self::Left => "left",
            Self::Up => "up",
            Self::Down => "down",
        }
    }

    /// Rotation from the panorama's axes to those of the side.
    #[must_use]
    pub fn rotation(self) -> DMat3 {
        let (right, down, forward) = match self {
            Self::Front => (DVec3::X, DVec3::Y, DVec3::Z),
            Self::Right => (DVec3::NEG_Z, DVec3::Y, DVec3::X),
            Self::Back => (DVec3::NEG_X, DVec3::Y, DVec3::NEG_Z),
            Self::Left => (DVec3::Z, DVec3::Y, DVec3::NEG_X),
            Self::Up => (DVec3::X, DVec3::Z, DVec3::NEG_Y),
            Self::Down => (DVec3::X, DVec3::NEG_Z, DVec3::Y),
        };
        DMat3::from_cols(right, down, forward).transpose()
    }

    /// The pinhole camera of the side, `size` pixels wide and high, for the pose of a panorama.
    pub(super) fn camera(self, panorama: &Camera, size: u32) -> Camera {
        let (turn, half) = (self.rotation(), 0.5 * f64::from(size));
        Camera {
            rotation: turn * panorama.rotation,
            translation: turn * panorama.translation,
            fx: half,
            fy: half,
            cx: half,
            cy: half,
            width: size,
            height: size,
        }
    }

    /// The photo of the side, `size` pixels wide and high, from a panorama that is four times as wide: the mean of
    /// bilinear samples in each pixel.
    pub(super) fn photo(self, panorama: &Photo, size: u32) -> Photo {
        let planes = panorama.alpha.planes();
        let back = self.rotation().transpose();
        let n = size as usize;
        let mut data = vec![0; planes * n * n];
        let step = 2.0 / (n * SAMPLES) as f64;
        let at = |k: usize| (k as f64 + 0.5) * step - 1.0;
        for i in 0..n * n {
            let (x, y) = (SAMPLES * (i % n), SAMPLES * (i / n));
            let mut sum = [0.0; 4];
            for k in 0..SAMPLES * SAMPLES {
                let ray = DVec3::new(at(x + k % SAMPLES), at(y + k / SAMPLES), 1.0);
                add_sample(panorama, angles(back * ray), &mut sum[..planes]);
            }
            for (plane, sum) in sum[..planes].iter().enumerate() {
                data[plane * n * n + i] = (sum / (SAMPLES * SAMPLES) as f32).round() as u8;
            }
        }
        Photo {
            width: size,
            height: size,
            alpha: panorama.alpha,
            data,
        }
    }
}

/// Adds the values of a panorama's planes in a direction, bilinearly interpolated: around the sphere, and over the poles.
fn add_sample(panorama: &Photo, [longitude, latitude]: [f64; 2], sum: &mut [f32]) {
    let (w, h) = (panorama.width as usize, panorama.height as usize);
    let x = (longitude / (2.0 * PI) + 0.5) * w as f64 + 0.5;
    let y = (latitude / PI + 0.5) * h as f64 + 0.5;
    let (fx, fy) = (x.fract() as f32, y.fract() as f32);
    // The second of the two columns and rows; the first one before is the last one around the sphere.
    let (right, below) = ((x as usize).min(w), (y as usize).min(h));
    let columns = [(right + w - 1) % w, right % w];
    for (row, weight_y) in [(below.checked_sub(1), 1.0 - fy), (Some(below), fy)] {
        // Beyond a pole lies the other side of the sphere.
        let (row, turned) = match row {
            Some(row) if row < h => (row, 0),
            Some(_) => (h - 1, w / 2),
            None => (0, w / 2),
        };
        for (column, weight_x) in columns.into_iter().zip([1.0 - fx, fx]) {
            let pixel = row * w + (column + turned) % w;
            for (plane, s) in sum.iter_mut().enumerate() {
                *s += weight_x * weight_y * f32::from(panorama.data[plane * w * h + pixel]);
            }
        }
    }
}

/// Width and height of the sides of a panorama, of `max_size` at most.
pub(super) fn side_of([width, _]: [u32; 2], max_size: u32) -> u32 {
    (width / 4).min(max_size).max(1)
}

/// Size to which a panorama is shrunk before sides of this size are cut out.
pub(super) fn shrunk([width, height]: [u32; 2], side: u32) -> [u32; 2] {
    let to = |factor: u32| side.saturating_mul(factor);
    [width.min(to(4)), height.min(to(2))]
}

/// Refuses a panorama that does not show the whole sphere.
///
/// # Errors
/// [`Error::Input`] that names the file, for one that is not twice as wide as high, within the rounding of resized copies.
pub(super) fn check_size(file: &Path, [width, height]: [u32; 2]) -> Result<()> {
    let unlike = u64::from(width).abs_diff(2 * u64::from(height));
    if unlike <= 2 && width >= 4 {
        return Ok(());
    }
    let what = format!(
        "a panorama of {width}×{height} pixels; twice as wide as high expected (equirectangular, of the whole sphere)"
    );
    let fix = "give whole panoramas, or fill up one that was cropped and mask what was added (folder masks)";
    Err(Error::input(file, what, fix))
}
