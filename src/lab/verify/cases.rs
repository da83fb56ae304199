//! [`Case`]: inputs of a pass through all stages; seeded scenes, exact in f32.

use glam::{DMat3, DVec3};

use crate::base::constants::ALPHA_MIN;
use crate::base::rng::{Philox, Stream};
use crate::capture::{Alpha, Camera, Photo};
use crate::pipeline::stage::adam::LearningRates;
use crate::scene::{Edit, Gaussians, OptionalColor, Plane};

/// Bound on f32 kernels on well-conditioned scenes.
pub const SINGLE: f64 = 1e-5;
/// Bound on f32 kernels on needles 1000 times longer than thick.
pub const SINGLE_NEEDLES: f64 = 1e-4;

/// Inputs of a pass through all stages.
#[derive(Debug, Clone)]
pub struct Case {
    /// Family of cases that it belongs to.
    pub family: &'static str,
    /// Name of the case.
    pub name: String,
    /// Bound on the errors of f32 kernels, relative to the largest value of a quantity.
    pub bound: f64,
    /// Scene (f32 values, so that both precisions start from the same numbers).
    pub splats: Gaussians,
    /// Camera.
    pub camera: Camera,
    /// Photo, of the camera's size.
    pub photo: Photo,
    /// Cameras whose sampling rates limit the 3D filter; no anti-aliasing if empty.
    pub filter_views: Vec<Camera>,
    /// Background colour.
    pub background: [f32; 3],
    /// Contributions below this alpha are dropped.
    pub alpha_min: f64,
    /// SH degree in use.
    pub sh_degree: u32,
    /// λ, λ_o, λ_s.
    pub lambdas: [f64; 3],
    /// Learning rates of the optimiser step.
    pub rates: LearningRates,
    /// Rows written after the step.
    pub edits: Vec<Edit>,
    /// Gaussians with broken parameters, whose own numbers are not compared; their effect on others is.
    pub invalid: Vec<usize>,
    /// Bound on the loss's error maps in f32; `None` if it is that of the case.
    pub error_map_bound: Option<f64>,
}

/// Adam's constants in every case: β₁, β₂, ε. They are exact in f32, like those of a configuration: 1 − β₂ of a rounded 0.999
/// is off by 1.3e-5 of itself, and every second moment with it.
pub const ADAM: [f64; 3] = [0.9_f32 as f64, 0.999_f32 as f64, 1e-15];

fn uniform(seed: u64, index: usize, what: u64) -> [f64; 4] {
    let at = (index as u64) << 8 | what;
    Philox::uniform(seed, Stream::Synthetic.stream(0), at)
}

fn camera(size: [u32; 2]) -> Camera {
    let [w, h] = size.map(f64::from);
    let rotation = DMat3::from_rotation_y(0.1) * DMat3::from_rotation_x(-0.2);
    Camera {
        rotation,
        translation: DVec3::new(0.1, -0.05, 3.0),
        fx: 1.1 * w,
        fy: 1.05 * w,
        cx: 0.47 * w,
        cy: 0.55 * h,
        width: size[0],
        height: size[1],
    }
}

fn cloud(n: usize, sh_degree: u32, seed: u64) -> Gaussians {
    let mut s = Gaussians::zeros(sh_degree, n);
    for i in 0..n {
        let [x, y, z, far] = uniform(seed, i, 0);
        let scale = uniform(seed, i, 1);
        let spread = if far > 0.9 { 8.0 } else { 2.0 };
        let position = [x, y, z].map(|v| (spread * (v - 0.5)) as f32);
        let log_scale = [0, 1, 2].map(|k| (2.0 * scale[k] - 3.2) as f32);
        let rotation = uniform(seed, i, 2).map(|v| (v - 0.5) as f32);
        s.scatter(Plane::POSITION, i, position);
        s.scatter(Plane::LOG_SCALE, i, log_scale);
        s.scatter(Plane::ROTATION, i, rotation);
        s.scatter(Plane::OPACITY, i, [(6.0 * scale[3] - 2.0) as f32]);
        for p in Plane::SH..Plane::count(sh_degree) {
            let [u, ..] = uniform(seed, i, 3 + p as u64);
            s.scatter(p, i, [(1.2 * u - 0.4) as f32]);
        }
    }
    s
}

/// Well-conditioned Gaussians in front of the camera, some beside and behind it; a noisy photo; edits in place
/// and of copies, with a colour of their own and without.
#[must_use]
pub fn mild(name: &str, n: usize, size: [u32; 2], sh_degree: u32, seed: u64) -> Case {
    let [w, h] = size;
    let data = (0..3 * (w * h) as usize)
        .map(|i| (255.0 * uniform(seed, i, 255)[0]) as u8)
        .collect();
    let last = n.saturating_sub(1) as u32;
    let edit = |src: u32, dst: u32, color: OptionalColor| Edit {
        src,
        dst,
        position: [0.25, -0.5, 0.75],
        log_scale: [-3.0, -2.0, -1.0],
        opacity_logit: 0.5,
        color,
    };
    let (own, colored) = (OptionalColor::NONE, OptionalColor::some([0.75, -0.25, 1.5]));
    Case {
        family: "mild",
        name: name.into(),
        bound: SINGLE,
        splats: cloud(n, sh_degree, seed),
        camera: camera(size),
        photo: Photo {
            width: w,
            height: h,
            alpha: Alpha::None,
            data,
        },
        filter_views: Vec::new(),
        background: [0.2, 0.5, 0.1],
        alpha_min: ALPHA_MIN,
        sh_degree,
        lambdas: [0.2, 0.01, 0.01],
        rates: LearningRates {
            position: 1e-3,
            scale: 5e-3,
            rotation: 1e-3,
            opacity: 0.025,
            sh0: 2.5e-3,
            sh: 1e-4,
        },
        edits: if n < 5 {
            vec![edit(0, 0, own)]
        } else {
            vec![
                edit(0, last, own),
                edit(0, 0, own),
                edit(1, 1, colored),
                edit(2, last - 1, colored),
            ]
        },
        invalid: Vec::new(),
        error_map_bound: None,
    }
}

/// Gaussians a thousand times longer than thick, at all angles.
#[must_use]
pub fn needles(n: usize, size: [u32; 2], seed: u64) -> Case {
    let mut case = mild("needles 1000:1", n, size, 1, seed);
    (case.family, case.bound) = ("needles", SINGLE_NEEDLES);
    for i in 0..n {
        let long = uniform(seed, i, 4)[0] as f32;
        case.splats
            .scatter(Plane::LOG_SCALE, i, [-0.5 - long, -7.4 - long, -7.4]);
    }
    case
}

impl Case {
    /// The same with anti-aliasing. The 3D filter follows the case's camera, a nearer one of a third of its focal length, and
    /// one that sees the scene from the side, all with `finer` times the pixels in width and height: if that is much, the 3D
    /// filter hardly changes even thin Gaussians, and the 2D filter acts alone.
    #[must_use]
    pub fn anti_aliased(mut self, finer: u32) -> Self {
        let [w, h] = [self.camera.width, self.camera.height];
        let camera = self.camera.scaled_to(finer * w, finer * h);
        let near = Camera {
            translation: 0.7 * camera.translation,
            fx: camera.fx / 3.0,
            fy: camera.fy / 3.0,
            ..camera
        };
        let side = Camera {
            rotation: DMat3::from_rotation_y(1.4) * camera.rotation,
            ..camera
        };
        self.filter_views = vec![camera, near, side];
        self.family = "anti-aliasing";
        self
    }

    /// The same with a photo that has a premultiplied alpha plane.
    #[must_use]
    pub fn with_alpha(self) -> Self {
        let alpha = |i: usize| match i % 3 {
            0 => 255,
            _ => i * 37 % 256,
        };
        self.with_plane("alpha", Alpha::Transparency, alpha)
    }

    /// The same with a mask: 1 in the photo's right half, 0 in its left, in between at the border.
    #[must_use]
    pub fn with_mask(self) -> Self {
        let w = self.photo.width as usize;
        let slope = |i: usize| (i % w * 8).saturating_sub(4 * w).min(w) * 255 / w.max(1);
        self.with_plane("mask", Alpha::Mask, slope)
    }

    /// The same with a fourth plane of the photo, by which the others are multiplied.
    fn with_plane(
        mut self,
        family: &'static str,
        alpha: Alpha,
        value: impl Fn(usize) -> usize,
    ) -> Self {
        let photo = &mut self.photo;
        let n = (photo.width * photo.height) as usize;
        let plane: Vec<u8> = (0..n).map(|i| value(i) as u8).collect();
        for (at, v) in photo.data.iter_mut().enumerate() {
            *v = (u32::from(*v) * u32::from(plane[at % n]) / 255) as u8;
        }
        photo.data.extend(plane);
        (photo.alpha, self.family) = (alpha, family);
        self
    }
}
