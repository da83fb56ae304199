//! From scenes to pixels and sparse points.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::capture::Camera;
use crate::lab::synth::hash::{hash, random};
use crate::lab::synth::scene::{Finish, Ray, Scene};

/// Calls of [`Scene::diffuse`] that are averaged for the colour of a sparse point.
const POINT_SAMPLES: u64 = 16;

/// 2⁻³²: half a hash as a number in [0, 1).
const HALF: f64 = 1.0 / (1u64 << 32) as f64;

/// A surface sample: what structure from motion would have found there.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    /// Where.
    pub position: DVec3,
    /// Displayed colour of the evenly scattered light.
    pub color: [u8; 3],
}

/// A camera at `at` that looks at `target`, z up in the scene, with a horizontal field of view whose half has tangent `tan`.
pub(super) fn look_at(at: DVec3, target: DVec3, width: u32, height: u32, tan: f64) -> Camera {
    let forward = (target - at).normalize_or_zero();
    let right = forward.cross(DVec3::Z).normalize_or_zero();
    let down = forward.cross(right);
    let rotation = DMat3::from_cols(right, down, forward).transpose();
    let focal = 0.5 * f64::from(width) / tan;
    Camera {
        rotation,
        translation: -(rotation * at),
        fx: focal,
        fy: focal,
        cx: 0.5 * f64::from(width),
        cy: 0.5 * f64::from(height),
        width,
        height,
    }
}

/// Direction of the ray through (x, y) in pixels, in the scene's frame, |d| = 1.
pub(super) fn direction(camera: &Camera, x: f64, y: f64) -> DVec3 {
    let d = DVec3::new(
        (x - camera.cx) / camera.fx,
        (y - camera.cy) / camera.fy,
        1.0,
    );
    (camera.rotation.transpose() * d).normalize_or_zero()
}

/// Radiance to display value in [0, 1]: the rational fit of the ACES curve by Narkowicz (2015), then a gamma of 2, whose square
/// root is exact where `powf` is not.
fn display(linear: DVec3) -> DVec3 {
    let tone = tone(linear);
    DVec3::new(tone.x.sqrt(), tone.y.sqrt(), tone.z.sqrt())
}

fn tone(c: DVec3) -> DVec3 {
    let x = c.max(DVec3::ZERO).min(DVec3::splat(1e4)) * 0.8;
    let a = x * (2.51 * x + 0.03);
    let b = x * (2.43 * x + 0.59) + 0.14;
    (a / b).clamp(DVec3::ZERO, DVec3::ONE)
}

fn bytes(c: DVec3) -> [u8; 3] {
    let byte = |x: f64| (255.0 * x + 0.5).floor().clamp(0.0, 255.0) as u8;
    [byte(c.x), byte(c.y), byte(c.z)]
}

/// Renders one photo: `height × width × 3` bytes, or × 4 with straight alpha if `alpha`.
///
/// Each pixel averages `grid²` rays, one from each cell of a grid over it, at a place in it that depends on nothing but (seed, view,
/// pixel, cell): the result does not depend on the number of threads.
pub(super) fn photo(
    scene: &Scene,
    camera: &Camera,
    key: [u64; 2],
    grid: u32,
    alpha: bool,
) -> Vec<u8> {
    let channels = if alpha { 4 } else { 3 };
    let row_bytes = camera.width as usize * channels;
    let mut image = vec![0u8; row_bytes * camera.height as usize];
    image
        .par_chunks_exact_mut(row_bytes)
        .enumerate()
        .for_each(|(y, row)| {
            for (x, out) in row.chunks_exact_mut(channels).enumerate() {
                let (color, cover) = pixel(scene, camera, [x as u64, y as u64], key, grid);
                for (byte, value) in out.iter_mut().zip(bytes(color)) {
                    *byte = value;
                }
                if let Some(a) = out.get_mut(3) {
                    *a = (255.0 * cover + 0.5).floor() as u8;
                }
            }
        });
    image
}

/// Displayed colour of a pixel (mean over the rays that hit something) and the share of rays that did.
fn pixel(scene: &Scene, camera: &Camera, at: [u64; 2], key: [u64; 2], grid: u32) -> (DVec3, f64) {
    let origin = camera.center();
    let cell = 1.0 / f64::from(grid);
    let (mut sum, mut hits) = (DVec3::ZERO, 0u32);
    let mut ray = Ray::default();
    let base = hash(&[key[0], key[1], at[0], at[1]]);
    let turn = (base % u64::from(grid)) as u32;
    for k in 0..grid * grid {
        let number = u64::from(k);
        ray.number = number;
        let jitter = hash(&[base, number]);
        let (right, down) = (
            (jitter >> 32) as f64 * HALF,
            (jitter & 0xffff_ffff) as f64 * HALF,
        );
        // Multi-jittered (Chiu, Shirley & Wang 1994): cells of one column keep to different strips of it, rows alike, so that
        // upright and level edges come out smooth.
        let (column, row) = (k % grid, k / grid);
        let inner_x = cell * (f64::from((row + turn) % grid) + right);
        let inner_y = cell * (f64::from((column + turn) % grid) + down);
        let x = at[0] as f64 + cell * (f64::from(column) + inner_x);
        let y = at[1] as f64 + cell * (f64::from(row) + inner_y);
        if let Some(c) = scene.radiance(origin, direction(camera, x, y), &mut ray) {
            // Toned one by one: a mean of raw highlights would leave jagged edges around them.
            sum += tone(c);
            hits += 1;
        }
    }
    if hits == 0 {
        return (DVec3::ZERO, 0.0);
    }
    let mean = sum / f64::from(hits);
    let shown = DVec3::new(mean.x.sqrt(), mean.y.sqrt(), mean.z.sqrt());
    (shown, f64::from(hits) / f64::from(grid * grid))
}

/// Up to `count` surface samples, each seen by at least one camera: random pixels of random cameras. Lamps and mirrors have
/// none, as features on them have no fixed place. Fewer come back only if most pixels see nothing.
pub(super) fn points(scene: &Scene, cameras: &[Camera], count: u32, seed: u64) -> Vec<Sample> {
    if cameras.is_empty() {
        return Vec::new();
    }
    let wanted = count as usize;
    let mut samples: Vec<Sample> = Vec::with_capacity(wanted);
    // An object fills a third of its pictures or so; eight rounds give up only on scenes that are nearly empty.
    for round in 0..8u64 {
        let missing = wanted - samples.len();
        if missing == 0 {
            break;
        }
        let tries = 2 * missing as u64;
        let found: Vec<Option<Sample>> = (0..tries)
            .into_par_iter()
            .map(|i| {
                let pick = |j: u64| random(&[seed, 0x706f_696e_7473, round, i, j]);
                let index = (pick(0) * cameras.len() as f64) as usize;
                let camera = cameras.get(index)?;
                let (x, y) = (
                    pick(1) * f64::from(camera.width),
                    pick(2) * f64::from(camera.height),
                );
                sample(scene, camera.center(), direction(camera, x, y))
            })
            .collect();
        samples.extend(found.into_iter().flatten().take(missing));
    }
    samples
}

fn sample(scene: &Scene, origin: DVec3, d: DVec3) -> Option<Sample> {
    let s = scene.hit(origin, d)?;
    if matches!(s.material.finish, Finish::Glowing(_) | Finish::Metal) {
        return None;
    }
    let mut ray = Ray::default();
    let mut light = DVec3::ZERO;
    for number in 0..POINT_SAMPLES {
        ray.number = number;
        light += scene.diffuse(&s, &mut ray);
    }
    Some(Sample {
        position: s.point,
        color: bytes(display(light / POINT_SAMPLES as f64)),
    })
}
