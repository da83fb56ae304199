//! Lens distortion, and photos without it: every training camera is a pinhole.
//!
//! Models and their parameters: COLMAP's documentation, <https://colmap.github.io/cameras.html>, and source
//! (`src/colmap/sensor/models.h`). The sources of these: OpenCV (rational and tangential terms); Kannala, Brandt 2006 (equidistant
//! fisheye); Devernay, Faugeras 2001 (FOV); Weng et al. 1992 (thin prism); Project Aria's Fisheye624; Fitzgibbon 2001 (division);
//! Khomutenko et al. 2016 (EUCM). The pinhole camera of a distorted one
//! is chosen as `colmap image_undistorter` does by default: the same focal lengths, and along each axis the largest size without
//! a pixel that the photo has no light for, between a fifth of the photo's and twice that.

use glam::DVec3;

use crate::capture::camera::Camera;
use crate::capture::panorama::angles;
use crate::capture::photo::nearest;

/// Largest number of Newton steps of an inverse.
const STEPS: usize = 100;
/// Smallest and largest size of an undistorted image, relative to the photo.
const SCALES: (f64, f64) = (0.2, 2.0);
/// Places between two pixels at which a photo is interpolated: in 32 bits a colour's sum of 255 times their square has room.
const PLACES: i64 = 2048;
/// Largest angle of a ray to the axis on a pinhole image, radians.
const WIDEST: f64 = 1.5;
/// Steps of the search for the angle at which a lens folds over.
const SEARCH: u32 = 4096;

/// Lens distortion, a mapping of rays on the plane at depth 1. Fisheyes map the equidistant image of a ray: as far from the centre as its
/// angle θ to the axis.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Lens {
    /// No distortion.
    #[default]
    Pinhole,
    /// Radial factor (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶), and tangential terms p1 and p2.
    Perspective {
        /// k1 to k6.
        radial: [f64; 6],
        /// p1, p2.
        tangential: [f64; 2],
    },
    /// Radial factor 1 + k1 r² + k2 r⁴ + k3 r⁶ + k4 r⁸, tangential terms p1 and p2 in OpenCV's order, and after these x + s y for x.
    Brown {
        /// True for a fisheye.
        fisheye: bool,
        /// k1 to k4.
        radial: [f64; 4],
        /// p1, p2.
        tangential: [f64; 2],
        /// Skew s of the pixels' axes.
        skew: f64,
    },
    /// Distance θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸) from the centre, θ the ray's angle to the axis.
    Fisheye {
        /// k1 to k4.
        radial: [f64; 4],
    },
    /// The same, and in the equidistant image tangential terms p1 and p2 and the terms s1 r² and s2 r² of a thin prism.
    ThinPrismFisheye {
        /// k1 to k4.
        radial: [f64; 4],
        /// p1, p2.
        tangential: [f64; 2],
        /// s1 along x, s2 along y.
        prism: [f64; 2],
    },
    /// Distance θ (1 + k0 θ² + … + k5 θ¹²) from the centre, and in this image tangential terms and those of a thin prism.
    RadTanThinPrismFisheye {
        /// k0 to k5.
        radial: [f64; 6],
        /// p0 along x, p1 along y: the other way round than OpenCV's.
        tangential: [f64; 2],
        /// s0 r² + s1 r⁴ along x, s2 r² + s3 r⁴ along y.
        prism: [f64; 4],
    },
    /// Distance atan(2 r tan(ω/2)) / ω from the centre.
    Fov {
        /// Field of view ω, radians, above 0 and below π.
        omega: f64,
    },
    /// A ray at distance r_d / (1 + k r_d²) for a point r_d from the centre.
    Division {
        /// k.
        radial: f64,
    },
    /// Distance r / (α √(β r² + 1) + 1 − α) from the centre.
    Eucm {
        /// α, 0 to 1.
        alpha: f64,
        /// β, above 0.
        beta: f64,
    },
    /// A panorama of the whole sphere: longitude along x and latitude along y, radians. Here only its half in front of the camera is
    /// mapped; photos of this lens are cut into the sides of a cube ([`panorama`](crate::capture::panorama)).
    Equirectangular,
}

/// Σ k_i x^{i+1} by Horner's scheme.
fn series(k: &[f64], x: f64) -> f64 {
    k.iter().rev().fold(0.0, |sum, k| (sum + k) * x)
}

/// A point by a radial factor, with tangential terms.
fn with_tangent(factor: f64, tangential: [f64; 2], [x, y]: [f64; 2]) -> [f64; 2] {
    let [dx, dy] = tangent(tangential, [x, y]);
    [x * factor + dx, y * factor + dy]
}

/// Tangential distortion of a point, OpenCV's p1 and p2.
fn tangent([p1, p2]: [f64; 2], [x, y]: [f64; 2]) -> [f64; 2] {
    let r2 = x * x + y * y;
    [
        2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y),
    ]
}

impl Lens {
    /// The lens of coefficients in OpenCV's order, k1 k2 p1 p2 k3 k4 k5 k6, or k1 to k4 of a fisheye; missing ones are 0.
    /// Without distortion it is [`Lens::Pinhole`].
    #[must_use]
    pub fn of_coefficients(coefficients: &[f64], fisheye: bool) -> Self {
        let k: [f64; 8] = std::array::from_fn(|i| coefficients.get(i).copied().unwrap_or(0.0));
        if fisheye {
            let radial = [k[0], k[1], k[2], k[3]];
            return Self::Fisheye { radial };
        }
        if k == [0.0; 8] {
            return Self::Pinhole;
        }
        Self::Perspective {
            radial: [k[0], k[1], k[4], k[5], k[6], k[7]],
            tangential: [k[2], k[3]],
        }
    }

    /// True if every coefficient is finite and within its model's domain.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let finite = |parts: &[&[f64]]| parts.iter().all(|part| part.iter().all(|k| k.is_finite()));
        match self {
            Self::Pinhole | Self::Equirectangular => true,
            Self::Perspective { radial, tangential } => finite(&[radial, tangential]),
            Self::Brown {
                radial,
                tangential,
                skew,
                ..
            } => finite(&[radial, tangential, &[*skew]]),
            Self::Fisheye { radial } => finite(&[radial]),
            Self::ThinPrismFisheye {
                radial,
                tangential,
                prism,
            } => finite(&[radial, tangential, prism]),
            Self::RadTanThinPrismFisheye {
                radial,
                tangential,
                prism,
            } => finite(&[radial, tangential, prism]),
            Self::Fov { omega } => *omega > 0.0 && *omega < std::f64::consts::PI,
            Self::Division { radial } => radial.is_finite(),
            Self::Eucm { alpha, beta } => {
                (0.0..=1.0).contains(alpha) && *beta > 0.0 && beta.is_finite()
            }
        }
    }

    /// True for a lens that maps the equidistant image of a ray.
    fn is_fisheye(&self) -> bool {
        matches!(
            self,
            Self::Brown { fisheye: true, .. }
                | Self::Fisheye { .. }
                | Self::ThinPrismFisheye { .. }
                | Self::RadTanThinPrismFisheye { .. }
        )
    }

    /// True if [`Self::bent`] is the whole of the distortion.
    fn is_radial(&self) -> bool {
        matches!(
            self,
            Self::Fisheye { .. } | Self::Fov { .. } | Self::Division { .. } | Self::Eucm { .. }
        )
    }

    /// Image point of the ray through (u, v, 1).
    #[must_use]
    pub fn distort(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        if !self.is_fisheye() {
            return self.warp([u, v]);
        }
        let r = u.hypot(v);
        match r < 1e-12 {
            true => [u, v],
            false => self.warp([u * r.atan() / r, v * r.atan() / r]),
        }
    }

    /// Image point of a point of the equidistant image of a fisheye, of the plane at depth 1 else.
    #[inline]
    fn warp(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let r2 = x * x + y * y;
        match self {
            Self::Pinhole => [x, y],
            Self::Equirectangular => angles(DVec3::new(x, y, 1.0)),
            Self::Perspective { radial, tangential } => {
                let factor = (1.0 + series(&radial[..3], r2)) / (1.0 + series(&radial[3..], r2));
                with_tangent(factor, *tangential, [x, y])
            }
            Self::Brown {
                radial,
                tangential,
                skew,
                ..
            } => {
                let [a, b] = with_tangent(1.0 + series(radial, r2), *tangential, [x, y]);
                [a + skew * b, b]
            }
            Self::ThinPrismFisheye {
                radial,
                tangential,
                prism,
            } => {
                let factor = 1.0 + series(radial, r2);
                let [dx, dy] = tangent(*tangential, [x, y]);
                [
                    x * factor + dx + prism[0] * r2,
                    y * factor + dy + prism[1] * r2,
                ]
            }
            Self::RadTanThinPrismFisheye {
                radial,
                tangential: [p0, p1],
                prism,
            } => {
                let factor = 1.0 + series(radial, r2);
                let [x, y] = [x * factor, y * factor];
                let r2 = x * x + y * y;
                let [dx, dy] = tangent([*p1, *p0], [x, y]);
                [
                    x + dx + series(&prism[..2], r2),
                    y + dy + series(&prism[2..], r2),
                ]
            }
            Self::Fisheye { .. } | Self::Fov { .. } | Self::Division { .. } | Self::Eucm { .. } => {
                let r = r2.sqrt();
                // Next to the centre the image is as large as the slope of `bent` there.
                let at = r.max(1e-9);
                let factor = self.bent(at) / at;
                [x * factor, y * factor]
            }
        }
    }

    /// Distance of the image from the centre for a ray this far off (θ for fisheyes, r else), without what is not radial.
    fn bent(&self, far: f64) -> f64 {
        let square = far * far;
        match self {
            Self::Pinhole => far,
            Self::Equirectangular => far.atan(),
            Self::Perspective { radial, .. } => {
                let below = 1.0 + series(&radial[3..], square);
                if below <= 0.0 {
                    return f64::NAN;
                }
                far * (1.0 + series(&radial[..3], square)) / below
            }
            Self::Brown { radial, .. }
            | Self::Fisheye { radial }
            | Self::ThinPrismFisheye { radial, .. } => far * (1.0 + series(radial, square)),
            Self::RadTanThinPrismFisheye { radial, .. } => far * (1.0 + series(radial, square)),
            Self::Fov { omega } => (2.0 * far * (omega / 2.0).tan()).atan() / omega,
            // The smaller root of r (1 + k r_d²) = r_d; NaN where there is none.
            Self::Division { radial } => 2.0 * far / (1.0 + (1.0 - 4.0 * radial * square).sqrt()),
            Self::Eucm { alpha, beta } => {
                far / (alpha * (beta * square + 1.0).sqrt() + 1.0 - alpha)
            }
        }
    }

    /// Largest distance of a ray from the axis (r or θ) before the image folds over: beyond, two rays share an image point, and
    /// the formula describes no lens.
    #[must_use]
    pub fn fold(&self) -> f64 {
        let widest = match self {
            Self::Pinhole => return f64::INFINITY,
            _ if self.is_fisheye() => WIDEST,
            _ => WIDEST.tan(),
        };
        let at = |k: u32| widest * f64::from(k) / f64::from(SEARCH);
        // NaN does not grow either.
        let grows = |k: &u32| self.bent(at(*k + 1)) > self.bent(at(*k));
        at((0..SEARCH).take_while(grows).count() as u32)
    }

    /// The ray of the image point (x, y); `None` if no ray before the image folds over (`fold`) falls on it.
    #[must_use]
    pub fn undistort(&self, [x, y]: [f64; 2], fold: f64) -> Option<[f64; 2]> {
        let r = x.hypot(y);
        if *self == Self::Pinhole || r < 1e-12 {
            return Some([x, y]);
        }
        // The radial part grows up to the fold: bisection cannot miss.
        let (mut low, mut high) = (0.0, fold);
        let reached = self.bent(fold) >= r;
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if self.bent(middle) < r {
                low = middle;
            } else {
                high = middle;
            }
        }
        let far = 0.5 * (low + high);
        let start = [x * far / r, y * far / r];
        let point = match self.is_radial() {
            true => reached.then_some(start),
            false => self.polish(start, [x, y], fold),
        }?;
        let far = point[0].hypot(point[1]);
        match self.is_fisheye() && far > 1e-12 {
            true => Some(point.map(|c| c * far.tan() / far)),
            false => Some(point),
        }
    }

    /// The point that is warped to an image point by Newton's method, from one that neglects what is not radial.
    fn polish(&self, [mut u, mut v]: [f64; 2], [x, y]: [f64; 2], fold: f64) -> Option<[f64; 2]> {
        for _ in 0..STEPS {
            let [a, b] = self.warp([u, v]);
            let (dx, dy) = (a - x, b - y);
            // Central differences: the step is a small part of what the functions vary over.
            let h = 1e-6 * (1.0 + u.hypot(v));
            let [[xu, yu], [xv, yv]] = [[h, 0.0], [0.0, h]].map(|[du, dv]| {
                let [p, q] = self.warp([u + du, v + dv]);
                let [r, s] = self.warp([u - du, v - dv]);
                [(p - r) / (2.0 * h), (q - s) / (2.0 * h)]
            });
            let determinant = xu * yv - xv * yu;
            if determinant <= 0.0 || !determinant.is_finite() {
                return None;
            }
            let (su, sv) = (
                (yv * dx - xv * dy) / determinant,
                (xu * dy - yu * dx) / determinant,
            );
            (u, v) = (u - su, v - sv);
            if su.hypot(sv) < 1e-12 * (1.0 + u.hypot(v)) {
                return (u.hypot(v) <= fold).then_some([u, v]);
            }
        }
        None
    }
}

/// The resampling of a photo from its lens to a pinhole camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Undistortion {
    lens: Lens,
    fold: f64,
    /// Intrinsics of the photo as it is.
    source: Camera,
    /// The pinhole camera; its pose is the source's.
    pub target: Camera,
}

impl Undistortion {
    /// The resampling for a lens, with the camera's intrinsics at the photo's own size. `None` if no ray falls on one of the
    /// photo's borders, or the result would be less than a fifth of a side.
    #[must_use]
    pub fn new(lens: Lens, source: &Camera) -> Option<Self> {
        let (w, h) = (f64::from(source.width), f64::from(source.height));
        let fold = lens.fold();
        let place = |x: f64, y: f64| {
            let point = [(x - source.cx) / source.fx, (y - source.cy) / source.fy];
            let [u, v] = lens.undistort(point, fold)?;
            Some([source.fx * u + source.cx, source.fy * v + source.cy])
        };
        // Smallest and largest coordinate of a border; points without a ray, as in the corners of a fisheye's photo, do not count.
        let ends = |along: u32, at: &dyn Fn(f64) -> Option<[f64; 2]>, k: usize| {
            let places = (0..along).filter_map(|i| at(f64::from(i) + 0.5));
            let range = places.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], place| {
                [low.min(place[k]), high.max(place[k])]
            });
            (range[0] <= range[1]).then_some(range)
        };
        let left = ends(source.height, &|y| place(0.5, y), 0)?;
        let right = ends(source.height, &|y| place(w - 0.5, y), 0)?;
        let top = ends(source.width, &|x| place(x, 0.5), 1)?;
        let bottom = ends(source.width, &|x| place(x, h - 0.5), 1)?;
        let side = |size: f64, center: f64, low: f64, high: f64| {
            let scale = (center / (center - low)).max((size - 0.5 - center) / (high - center));
            let scale = (1.0 / scale).min(SCALES.1);
            (scale >= SCALES.0).then(|| (scale * size).max(1.0) as u32)
        };
        let width = side(w, source.cx, left[1], right[0])?;
        let height = side(h, source.cy, top[1], bottom[0])?;
        let target = Camera {
            cx: source.cx * f64::from(width) / w,
            cy: source.cy * f64::from(height) / h,
            width,
            height,
            ..*source
        };
        Some(Self {
            lens,
            fold,
            source: *source,
            target,
        })
    }

    /// Width and height of the photo as it is, pixels.
    #[must_use]
    pub fn source_size(&self) -> [u32; 2] {
        [self.source.width, self.source.height]
    }

    /// The photo as the pinhole camera sees it, bilinearly interpolated: from `bytes` of three interleaved channels, or of four of which the
    /// last is straight alpha, in the source's size to the same in the target's. Black, and transparent if there is alpha, beyond the photo.
    #[must_use]
    pub fn apply(&self, bytes: &[u8], channels: usize) -> Vec<u8> {
        match channels {
            4 => self.resampled::<4>(bytes),
            _ => self.resampled::<3>(bytes),
        }
    }

    /// [`Self::apply`] for so many channels.
    fn resampled<const N: usize>(&self, bytes: &[u8]) -> Vec<u8> {
        let width = self.target.width as usize;
        let mut out = vec![0; width * self.target.height as usize * N];
        let (mut places, pixels) = (vec![None; width], bytes.as_chunks::<N>().0);
        for (y, row) in out.chunks_exact_mut((width * N).max(1)).enumerate() {
            self.find_sources(y as f64 + 0.5, &mut places);
            for (place, pixel) in places.iter().zip(row.as_chunks_mut::<N>().0) {
                if let Some(place) = place {
                    self.sample(pixels, *place, pixel);
                }
            }
        }
        out
    }

    /// Finds the points of the photo for the pixels of a row of the pinhole image, in units of [`PLACES`] from the centre of its first
    /// pixel; `None` beyond the fold or the photo.
    fn find_sources(&self, y: f64, places: &mut [Option<[i64; 2]>]) {
        match self.lens {
            // By far the most frequent ones: loops that compilers make vectors of.
            Lens::Perspective { radial, tangential } if radial[3..] == [0.0; 3] => {
                let k = [radial[0], radial[1], radial[2]];
                self.each_source(y, places, |r2, ray| {
                    with_tangent(1.0 + series(&k, r2), tangential, ray)
                });
            }
            lens if lens.is_fisheye() => {
                let fold = self.fold;
                self.each_source(y, places, |r2, ray| match r2.sqrt().atan() <= fold {
                    true => lens.distort(ray),
                    false => [f64::NAN; 2],
                });
            }
            lens => self.each_source(y, places, |_, ray| lens.warp(ray)),
        }
    }

    /// Fills in the points of the photo that `distort` makes of the square of the distance from the axis and the ray.
    fn each_source(
        &self,
        y: f64,
        places: &mut [Option<[i64; 2]>],
        distort: impl Fn(f64, [f64; 2]) -> [f64; 2],
    ) {
        let (t, s) = (&self.target, &self.source);
        let (v, per_pixel) = ((y - t.cy) / t.fy, 1.0 / t.fx);
        let farthest = match self.lens.is_fisheye() {
            true => f64::INFINITY,
            false => self.fold * self.fold,
        };
        let ends = [s.width, s.height].map(|n| f64::from(n) - 0.5);
        for (x, place) in places.iter_mut().enumerate() {
            let u = (x as f64 + 0.5 - t.cx) * per_pixel;
            let r2 = u * u + v * v;
            let [a, b] = distort(r2, [u, v]);
            let at = [s.fx * a + s.cx - 0.5, s.fy * b + s.cy - 0.5];
            // NaN is within nothing.
            let within = |k: usize| at[k] >= -0.5 && at[k] <= ends[k];
            let found = (r2 <= farthest) & within(0) & within(1);
            *place = found.then(|| at.map(|c| (c * PLACES as f64 + 0.5) as i64));
        }
    }

    /// A pixel at a place of the photo, its borders going on to either side.
    fn sample<const N: usize>(&self, pixels: &[[u8; N]], [x, y]: [i64; 2], out: &mut [u8; N]) {
        let (w, h) = (i64::from(self.source.width), i64::from(self.source.height));
        let axis = |at: i64, n: i64| {
            let at = at.clamp(0, (n - 1) * PLACES);
            let low = (at / PLACES).min((n - 2).max(0));
            (low, (low + 1).min(n - 1), (at - low * PLACES) as u32)
        };
        let ((x0, x1, fx), (y0, y1, fy)) = (axis(x, w), axis(y, h));
        let (one, all) = (PLACES as u32, (PLACES * PLACES) as u32);
        let corners = [
            (x0, y0, (one - fx) * (one - fy)),
            (x1, y0, fx * (one - fy)),
            (x0, y1, (one - fx) * fy),
            (x1, y1, fx * fy),
        ];
        let corners = corners.map(|(x, y, weight)| (&pixels[(y * w + x) as usize], weight));
        if N == 3 {
            for (k, o) in out.iter_mut().enumerate() {
                let sum: u32 = corners
                    .iter()
                    .map(|(p, weight)| weight * u32::from(p[k]))
                    .sum();
                *o = ((sum + all / 2) / all) as u8;
            }
            return;
        }
        let mut sum = [0.0; 3];
        let mut weights = 0.0;
        for (pixel, weight) in corners {
            // Colours count as far as they are opaque.
            let opaque = pixel.get(3).map_or(1.0, |a| f64::from(*a) / 255.0);
            let weight = opaque * f64::from(weight) / f64::from(all);
            for (s, v) in sum.iter_mut().zip(pixel) {
                *s += weight * f64::from(*v);
            }
            weights += weight;
        }
        for (o, s) in out.iter_mut().zip(sum) {
            // Of 0/0 it is 0.
            *o = nearest(s / weights);
        }
        if let Some(alpha) = out.get_mut(3) {
            *alpha = nearest(255.0 * weights);
        }
    }
}
