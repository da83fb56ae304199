//! The synthetic case: a seeded cloud of any size, seen from a circle, and an optimiser that changes nothing.

use std::path::PathBuf;

use glam::{DMat3, DVec3};

use crate::base::rng::{Philox, Stream};
use crate::capture::{Alpha, Camera, Dataset, Frame, Layout, Lens, Photo, Points, View, up_axis};
use crate::config::{AntiAliasing, OptimizerConfig, Sampler, TrainConfig, WorkConfig};
use crate::lab::verify::cases::{Case, mild};
use crate::scene::{Gaussians, Plane};

/// Name of the cases that differ in nothing but their size.
pub(super) const SYNTHETIC: &str = "synthetic";
/// Views of every case.
pub const VIEWS: u32 = 8;
/// SH degree of the cloud.
pub const SH_DEGREE: u32 = 3;

fn uniform(i: usize, what: u64) -> [f64; 4] {
    Philox::uniform(7, Stream::Synthetic.stream(1), (i as u64) << 4 | what)
}

/// `n` Gaussians in a unit cube. Their size falls as 1/√n, so that they cover the picture alike for every `n`; at 100,000
/// and 800 pixels each touches about three tiles.
#[must_use]
pub fn cloud(n: usize) -> Gaussians {
    let mut s = Gaussians::zeros(SH_DEGREE, n);
    let scale = (1.0 / (n as f64).sqrt()).ln();
    for i in 0..n {
        let [x, y, z, opacity] = uniform(i, 0);
        let size = uniform(i, 1);
        s.scatter(Plane::POSITION, i, [x, y, z].map(|v| (v - 0.5) as f32));
        s.scatter(
            Plane::LOG_SCALE,
            i,
            [0, 1, 2].map(|k| (scale + 1.5 * (size[k] - 0.5)) as f32),
        );
        s.scatter(Plane::ROTATION, i, uniform(i, 2).map(|v| (v - 0.5) as f32));
        s.scatter(Plane::OPACITY, i, [(6.0 * opacity - 3.0) as f32]);
        for p in Plane::SH..Plane::count(SH_DEGREE) {
            s.scatter(p, i, [(uniform(i, 3)[p % 4] - 0.5) as f32]);
        }
    }
    s.in_morton_order(up_axis(&circle(1)).as_vec3().into())
}

/// [`VIEWS`] cameras on a circle around the unit cube, `size` pixels wide and high.
#[must_use]
pub fn circle(size: u32) -> Vec<Camera> {
    (0..VIEWS)
        .map(|k| {
            let angle = f64::from(k) * std::f64::consts::TAU / f64::from(VIEWS);
            let eye = 1.4 * DVec3::new(angle.cos(), 0.2, angle.sin());
            let z = -eye.normalize();
            let x = DVec3::Y.cross(z).normalize();
            let rotation = DMat3::from_cols(x, z.cross(x), z).transpose();
            Camera {
                rotation,
                translation: -(rotation * eye),
                fx: f64::from(size),
                fy: f64::from(size),
                cx: f64::from(size) / 2.0,
                cy: f64::from(size) / 2.0,
                width: size,
                height: size,
            }
        })
        .collect()
}

/// A photo of no meaning for a camera.
#[must_use]
pub fn photo(camera: &Camera) -> Photo {
    let pixels = 3 * camera.width as usize * camera.height as usize;
    Photo {
        width: camera.width,
        height: camera.height,
        alpha: Alpha::None,
        data: (0..pixels).map(|i| (i * 31 % 251) as u8).collect(),
    }
}

/// A dataset with such a photo for every camera.
#[must_use]
pub fn dataset(cameras: &[Camera]) -> Dataset {
    let view = |(k, camera): (usize, &Camera)| View {
        name: format!("{k}"),
        camera: *camera,
        lens: Lens::Pinhole,
        photo: photo(camera).into(),
    };
    Dataset {
        path: PathBuf::new(),
        layout: Layout::Transforms,
        place: String::new(),
        remarks: Vec::new(),
        train: cameras.iter().enumerate().map(view).collect(),
        test: Vec::new(),
        points: Points::default(),
        swept: None,
        frame: Frame::IDENTITY,
        undistorted: 0,
        missing: Vec::new(),
        outliers: Vec::new(),
        masked_out: Vec::new(),
        image_budget: u64::MAX,
        digests: None,
    }
}

/// A configuration under which every iteration does its work on the same scene: learning rates of zero, no density
/// control, every SH band from the start.
#[must_use]
pub fn still(sh_degree: u32) -> TrainConfig {
    TrainConfig {
        work: WorkConfig {
            resolution_levels: 0,
            ..WorkConfig::default()
        },
        optimizer: OptimizerConfig {
            lr_position: 0.0,
            lr_position_final: 0.0,
            lr_sh0: 0.0,
            lr_sh: 0.0,
            lr_opacity: 0.0,
            lr_scale: 0.0,
            lr_rotation: 0.0,
            sh_interval: 0,
            ..OptimizerConfig::default()
        },
        sampler: Sampler::None,
        anti_aliasing: AntiAliasing::Off,
        sh_degree,
        ..TrainConfig::default()
    }
}

/// The cloud in its first view, for a passage through all stages.
#[must_use]
pub fn case(gaussians: usize, size: u32, alpha_min: f64) -> Case {
    let camera = circle(size)[0];
    Case {
        family: "precision",
        splats: cloud(gaussians),
        photo: photo(&camera),
        camera,
        alpha_min,
        ..mild("precision", 1, [size; 2], SH_DEGREE, 0)
    }
}
