//! Photos and sparse points of a scene.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::capture::Camera;
use crate::capture::colmap::ColmapPoint;
use crate::lab::synth::scene::{Finish, Scene, random};

/// A camera at `at` that looks at `target`, z up in the scene, with a horizontal field of view whose half has tangent `tan`.
pub(super) fn look_at(at: DVec3, target: DVec3, [width, height]: [u32; 2], tan: f64) -> Camera {
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
fn direction(camera: &Camera, x: f64, y: f64) -> DVec3 {
    let d = DVec3::new(
        (x - camera.cx) / camera.fx,
        (y - camera.cy) / camera.fy,
        1.0,
    );
    (camera.rotation.transpose() * d).normalize_or_zero()
}

/// Tone curve from radiance to [0, 1] (Reinhard et al. 2002, Eq. 4, white at 3).
fn tone(c: DVec3) -> DVec3 {
    let c = c.clamp(DVec3::ZERO, DVec3::splat(3.0));
    c * (DVec3::ONE + c / 9.0) / (DVec3::ONE + c)
}

/// Bytes of a toned colour, by a gamma of 2: the square root is exact, `powf` is not.
fn bytes(toned: DVec3) -> [u8; 3] {
    toned
        .to_array()
        .map(|x| (255.0 * x.sqrt() + 0.5).floor().clamp(0.0, 255.0) as u8)
}

/// One photo: `height × width × 3` bytes, or × 4 with straight alpha of a transparent scene.
///
/// Each pixel averages `grid²` rays, one from each cell of a grid over it, at a position in it that depends on nothing but
/// (seed, view, pixel, cell): the result does not depend on the number of threads.
pub(super) fn photo(scene: &Scene, camera: &Camera, view: u64, grid: u32) -> Vec<u8> {
    let channels = if scene.transparent { 4 } else { 3 };
    let row_bytes = camera.width as usize * channels;
    let mut image = vec![0u8; row_bytes * camera.height as usize];
    image
        .par_chunks_exact_mut(row_bytes)
        .enumerate()
        .for_each(|(y, row)| {
            for (x, out) in row.chunks_exact_mut(channels).enumerate() {
                let (color, coverage) = pixel(scene, camera, [view, x as u64, y as u64], grid);
                let [r, g, b] = bytes(color);
                let a = (255.0 * coverage + 0.5).floor() as u8;
                out.copy_from_slice(&[r, g, b, a][..channels]);
            }
        });
    image
}

/// Toned colour of a pixel (mean over the rays that hit a solid) and the share of rays that did.
fn pixel(scene: &Scene, camera: &Camera, key: [u64; 3], grid: u32) -> (DVec3, f64) {
    let [view, x, y] = key;
    let cell = 1.0 / f64::from(grid);
    let (mut sum, mut hits) = (DVec3::ZERO, 0u32);
    for k in 0..grid * grid {
        let jitter = |axis| random(&[scene.seed, view, x, y, u64::from(k), axis]);
        let (column, row) = (f64::from(k % grid), f64::from(k / grid));
        let at_x = x as f64 + cell * (column + jitter(0));
        let at_y = y as f64 + cell * (row + jitter(1));
        if let Some(c) = scene.radiance(camera.center(), direction(camera, at_x, at_y)) {
            // Toned one by one: a mean of raw radiance would leave jagged edges around the lamp.
            sum += tone(c);
            hits += 1;
        }
    }
    let share = f64::from(hits) / f64::from(grid * grid);
    (sum / f64::from(hits.max(1)), share)
}

/// Up to `count` sparse points on surfaces, as structure from motion would have found them, each seen by at least one of the
/// cameras: random pixels of random cameras. The lamp and mirrors have none, because features on them have no fixed position.
/// Fewer are returned only if most pixels see nothing.
pub(super) fn points(scene: &Scene, views: &[(String, Camera)], count: u32) -> Vec<ColmapPoint> {
    const KEY: u64 = 0x706f_696e_7473;
    let wanted = count as usize;
    let mut points: Vec<ColmapPoint> = Vec::with_capacity(wanted);
    // An object fills a third of its photos or so; eight rounds give up only on scenes that are nearly empty.
    for round in 0..8 {
        let missing = wanted - points.len();
        let found: Vec<_> = (0..2 * missing as u64)
            .into_par_iter()
            .map(|i| {
                let pick = |j: u64| random(&[scene.seed, KEY, round, i, j]);
                let (_, camera) = views.get((pick(0) * views.len() as f64) as usize)?;
                let x = pick(1) * f64::from(camera.width);
                let y = pick(2) * f64::from(camera.height);
                let s = scene.hit(camera.center(), direction(camera, x, y))?;
                let color = bytes(tone(scene.diffuse(&s)));
                (s.finish == Finish::Matt).then_some((s.point.to_array(), color))
            })
            .collect();
        for (position, color) in found.into_iter().flatten().take(missing) {
            points.push(ColmapPoint {
                id: points.len() as u64 + 1,
                position,
                color,
                error: 0.0,
            });
        }
    }
    points
}
