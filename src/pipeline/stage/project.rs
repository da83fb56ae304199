//! Raw Gaussians → records of one camera (`kernels/project.cl`): EWA splatting, Zwicker et al. 2002; 3DGS, Kerbl et al. 2023,
//! section 4.

use std::ops::Range;

use crate::base::constants::{COLOR_MAX, LOG_SCALE, blur};
use crate::base::error::Result;
use crate::base::math::sigmoid;
use crate::device::{Program, Real};
use crate::pipeline::buffers::{GaussianBuffers, ViewBuffers};
use crate::pipeline::launch::Arguments;
use crate::pipeline::reference::{
    Camera64, Options, Scene64, product, rotation, transpose, unit_quaternion,
};
use crate::scene::{Plane, sh, sh_coefficients};

/// Writes the records and keys of some rows of a view, the first of which begins a vector, and zeroes their numbers of pairs, in whole
/// vectors. The kernel is built for one SH degree.
pub fn write_records<R: Real>(
    stage: &Program,
    scene: &GaussianBuffers<R>,
    view: &ViewBuffers<R>,
    rows: Range<usize>,
) -> Result<()> {
    stage
        .launch("project")
        .gaussians(scene, rows.end)
        .value(view.camera)
        .array(&view.records, scene.stride)
        .arrays([&view.keys, &view.isect_counts], scene.stride)
        .over_rows(rows)
}

/// Makes the depth (local units) the colour of the records of a view.
pub fn depths_for_colors<R: Real>(stage: &Program, view: &ViewBuffers<R>) -> Result<()> {
    stage
        .launch("project_depths")
        .array(&view.keys, view.count)
        .uints([view.count])
        .array(&view.records, view.count)
        .over_items([view.count, 1])
}

// Definition in f64.

/// A projected Gaussian, in the kernels' terms: with u = dx − r·dy, log2 α = lo − (a·u² + c·dy²).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projected64 {
    /// Mean, pixels.
    pub mean: [f64; 2],
    /// ½·log2(e)·Σ′yy/det.
    pub a: f64,
    /// Σ′xy/Σ′yy.
    pub r: f64,
    /// ½·log2(e)/Σ′yy.
    pub c: f64,
    /// log2 of the opacity.
    pub lo: f64,
    /// Colour.
    pub rgb: [f64; 3],
    /// Camera z.
    pub depth: f64,
    /// Inclusive pixel bounds (first, last) in x and y.
    pub bounds: [[i32; 2]; 2],
}

/// The geometry that project and project_grad share.
#[derive(Debug, Clone, Copy)]
pub struct Shape64 {
    /// Camera position.
    pub t: [f64; 3],
    /// x/z and y/z after clamping, each with true if the clamp changes nothing.
    pub ratio: [(f64, bool); 2],
    /// J·W.
    pub jw: [[f64; 3]; 2],
    /// R.
    pub rot: [[f64; 3]; 3],
    /// Scales, after the 3D filter if there is one.
    pub s: [f64; 3],
    /// Squared scales before the 3D filter over those after it.
    pub kept: [f64; 3],
    /// 3D covariance R S Sᵀ Rᵀ.
    pub sigma: [[f64; 3]; 3],
    /// 2D covariance with the blur.
    pub cov: [[f64; 2]; 2],
    /// Its determinant.
    pub det: f64,
    /// Area for the 2D filter; `None` without anti-aliasing.
    pub area: Option<Area64>,
}

/// The area of a projection without the blur, by cofactors of the 3D covariance: det(T Σ Tᵀ) = tᵀ adj(Σ) t with T = J·W, t the
/// cross product of its rows and adj(Σ) = R diag(s_l² s_m²) Rᵀ.
#[derive(Debug, Clone, Copy)]
pub struct Area64 {
    /// t.
    pub cross: [f64; 3],
    /// Rᵀ t.
    pub along: [f64; 3],
    /// s_l² s_m² of the other two axes.
    pub cofactors: [f64; 3],
    /// Determinant of the 2D covariance without the blur.
    pub det0: f64,
}

impl Area64 {
    fn new(jw: &[[f64; 3]; 2], rot: &[[f64; 3]; 3], s: [f64; 3]) -> Self {
        let cross = cross(jw[0], jw[1]);
        let along = std::array::from_fn(|j| (0..3).map(|a| rot[a][j] * cross[a]).sum::<f64>());
        let cofactors = std::array::from_fn(|j| (s[(j + 1) % 3] * s[(j + 2) % 3]).powi(2));
        Self {
            cross,
            along,
            cofactors,
            det0: (0..3).map(|j| cofactors[j] * along[j] * along[j]).sum(),
        }
    }
}

/// Cross product.
#[must_use]
pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

impl Shape64 {
    /// log2 of the part of the opacity that both filters leave: √(Π s²/Π s′²) and √(det0/det); 0 without anti-aliasing.
    #[must_use]
    pub fn log2_left(&self) -> f64 {
        let of = |area: &Area64| {
            0.5 * (self.kept.map(f64::log2).iter().sum::<f64>() + (area.det0 / self.det).log2())
        };
        self.area.as_ref().map_or(0.0, of)
    }
}

/// Camera-space geometry of Gaussian `i`; `None` at or behind the near plane.
#[must_use]
pub fn shape(scene: &Scene64, i: usize, camera: &Camera64) -> Option<Shape64> {
    let t = camera.apply(scene.position(i));
    let log_scales = scene.gather::<3>(Plane::LOG_SCALE, i);
    let bounded = |v: &f64| v.abs() < 1e30;
    let good = t[2] > camera.near && t.iter().chain(&log_scales).all(bounded);
    if !good {
        return None;
    }
    let ratio = std::array::from_fn(|k| {
        let v = t[k] / t[2];
        let [low, high] = camera.limits[k];
        (v.clamp(low, high), v >= low && v <= high)
    });
    let f = camera.focal.map(|f| f / t[2]);
    let j = [
        [f[0], 0.0, -f[0] * ratio[0].0],
        [0.0, f[1], -f[1] * ratio[1].0],
    ];
    let jw = product(&j, &camera.w);
    let own = log_scales.map(|l| l.clamp(LOG_SCALE[0], LOG_SCALE[1]).exp());
    let filter = scene.filter.as_ref().map_or(0.0, |f| f[i]);
    let s = own.map(|s| s.hypot(filter));
    let kept = std::array::from_fn(|k| (own[k] / s[k]).powi(2));
    let (q, _) = unit_quaternion(scene.gather(Plane::ROTATION, i));
    let rot = rotation(q);
    let rs: [[f64; 3]; 3] = std::array::from_fn(|r| std::array::from_fn(|k| rot[r][k] * s[k]));
    let sigma = product(&rs, &transpose(&rs));
    let m = product(&jw, &rs);
    let mut cov = product(&m, &transpose(&m));
    // det(M Mᵀ + b I) by Lagrange's identity: a sum of positive terms, exact for needles too.
    let b = blur(scene.filter.is_some());
    let det =
        cross(m[0], m[1]).iter().map(|c| c * c).sum::<f64>() + b * (cov[0][0] + cov[1][1]) + b * b;
    cov[0][0] += b;
    cov[1][1] += b;
    (det < 1e37 && cov[0][0] < 1e30 && cov[1][1] < 1e30).then_some(Shape64 {
        t,
        kept,
        ratio,
        jw,
        rot,
        s,
        sigma,
        cov,
        det,
        area: scene.filter.is_some().then(|| Area64::new(&jw, &rot, s)),
    })
}

/// Colour of Gaussian `i` before the clamp at 0, and the unit vector from the camera to it with its length.
#[must_use]
pub fn color(
    scene: &Scene64,
    i: usize,
    camera: &Camera64,
    degree: u32,
) -> ([f64; 3], [f64; 3], f64) {
    let x = scene.position(i);
    let d: [f64; 3] = std::array::from_fn(|k| x[k] - camera.center[k]);
    let length = d.iter().map(|v| v * v).sum::<f64>().sqrt();
    let dir = if length > 0.0 {
        d.map(|v| v / length)
    } else {
        [0.0, 0.0, 1.0]
    };
    let basis = sh::basis(dir);
    let rgb = std::array::from_fn(|c| {
        0.5 + (0..sh_coefficients(degree))
            .map(|k| basis[k] * scene.planes[Plane::SH + 3 * k + c][i])
            .sum::<f64>()
    });
    (rgb, dir, length)
}

/// Projection of Gaussian `i`; `None` if it is culled.
#[must_use]
pub fn project(
    scene: &Scene64,
    i: usize,
    camera: &Camera64,
    options: &Options,
) -> Option<Projected64> {
    let o = shape(scene, i, camera)?;
    let log2_e = std::f64::consts::LOG2_E;
    let logit = scene.planes[Plane::OPACITY][i];
    // ln σ(l) for very negative l is l itself; σ would underflow before its logarithm is taken.
    let lo = if logit < -500.0 {
        logit * log2_e
    } else {
        sigmoid(logit).log2()
    };
    let lo = lo + o.log2_left();
    let tau = lo - options.alpha_min.log2();
    if tau.is_nan() || tau <= 0.0 {
        return None;
    }
    let mean = std::array::from_fn(|k| camera.focal[k] * o.t[k] / o.t[2] + camera.principal[k]);
    let mut bounds = [[0; 2]; 2];
    for k in 0..2 {
        let half = (2.0 * std::f64::consts::LN_2 * tau * o.cov[k][k]).sqrt();
        let first = (mean[k] - half - 0.5).ceil().max(0.0);
        let last = (mean[k] + half - 0.5)
            .floor()
            .min(f64::from(camera.size[k] - 1));
        if first.is_nan() || last.is_nan() || first > last {
            return None;
        }
        bounds[k] = [first as i32, last as i32];
    }
    let (rgb, _, _) = color(scene, i, camera, options.sh_degree);
    let projected = Projected64 {
        mean,
        a: 0.5 * log2_e * o.cov[1][1] / o.det,
        r: o.cov[0][1] / o.cov[1][1],
        c: 0.5 * log2_e / o.cov[1][1],
        lo,
        rgb: rgb.map(|v| v.max(0.0)),
        depth: o.t[2],
        bounds,
    };
    let finite = [projected.a, projected.r, projected.c]
        .iter()
        .all(|v| v.is_finite());
    (finite && rgb.iter().all(|v| v.abs() < COLOR_MAX)).then_some(projected)
}

impl Projected64 {
    /// u and dy at a pixel centre.
    #[must_use]
    pub fn offsets(&self, x: i32, y: i32) -> [f64; 2] {
        let dx = f64::from(x) + 0.5 - self.mean[0];
        let dy = f64::from(y) + 0.5 - self.mean[1];
        [dx - self.r * dy, dy]
    }

    /// log2 α at a pixel centre, before the cap.
    #[must_use]
    pub fn log2_alpha(&self, x: i32, y: i32) -> f64 {
        let [u, dy] = self.offsets(x, y);
        self.lo - (self.a * u * u + self.c * dy * dy)
    }
}
