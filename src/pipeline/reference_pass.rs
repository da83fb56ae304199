//! The definitions in f64 one after the other: loss and gradient of a scene in one view.

use crate::base::constants::LOG_SCALE;
use crate::base::math::sigmoid;
use crate::pipeline::reference::{Camera64, Options, Scene64, TILE};
use crate::pipeline::stage::bin::bin;
use crate::pipeline::stage::loss::{Loss64, loss};
use crate::pipeline::stage::project::{Projected64, project};
use crate::pipeline::stage::project_grad::project_grad;
use crate::pipeline::stage::splat::splat;
use crate::pipeline::stage::splat_grad::splat_grad;
use crate::scene::Plane;

/// Results of every stage.
#[derive(Debug, Clone)]
pub struct ReferencePass {
    /// Projected Gaussians; `None` where culled.
    pub projected: Vec<Option<Projected64>>,
    /// Gaussians of each tile of [`TILE`] pixels a side.
    pub tiles: Vec<Vec<u32>>,
    /// Image \[3, height, width\].
    pub image: Vec<f64>,
    /// Transmittance \[height, width\].
    pub transmittance: Vec<f64>,
    /// Loss.
    pub loss: Loss64,
    /// Sums of each visible Gaussian.
    pub sums: Vec<Option<[f64; 9]>>,
    /// Gradients of the raw parameters.
    pub grads: Scene64,
}

/// λ·(1 − SSIM) + (1 − λ)·L1 and the regularisers, with weights λ, λ_o, λ_s.
#[must_use]
pub fn total(scene: &Scene64, l1: f64, ssim: f64, lambdas: [f64; 3]) -> f64 {
    let n = scene.len() as f64;
    let opacity: f64 = scene.planes[Plane::OPACITY]
        .iter()
        .map(|l| sigmoid(*l))
        .sum::<f64>()
        / n;
    let scale: f64 = scene.planes[Plane::LOG_SCALE..Plane::ROTATION]
        .iter()
        .flatten()
        .map(|l| l.clamp(LOG_SCALE[0], LOG_SCALE[1]).exp())
        .sum::<f64>()
        / (3.0 * n);
    (1.0 - lambdas[0]) * l1 + lambdas[0] * (1.0 - ssim) + lambdas[1] * opacity + lambdas[2] * scale
}

/// Records, Gaussians of each tile, image \[3, height, width\] and transmittance \[height, width\].
type Forward = (Vec<Option<Projected64>>, Vec<Vec<u32>>, Vec<f64>, Vec<f64>);

/// Results of the forward stages.
#[must_use]
pub fn render(scene: &Scene64, camera: &Camera64, options: &Options) -> Forward {
    let projected: Vec<_> = (0..scene.len())
        .map(|i| project(scene, i, camera, options))
        .collect();
    let tiles = bin(&projected, camera, TILE, options.alpha_min);
    let (image, transmittance) = splat(&projected, &tiles, camera, options);
    (projected, tiles, image, transmittance)
}

/// Loss alone, for finite differences.
#[must_use]
pub fn loss_of(
    scene: &Scene64,
    camera: &Camera64,
    options: &Options,
    photo: &[f64],
    lambdas: [f64; 3],
) -> f64 {
    let (_, _, image, _) = render(scene, camera, options);
    let l = loss(&image, photo, camera.size.map(|s| s as usize), lambdas[0]);
    total(scene, l.l1, l.ssim, lambdas)
}

/// Results of all stages.
#[must_use]
pub fn run(
    scene: &Scene64,
    camera: &Camera64,
    options: &Options,
    photo: &[f64],
    mask: Option<&[f64]>,
    lambdas: [f64; 3],
) -> ReferencePass {
    let pixels = camera.pixels();
    let counts = |at: usize| mask.map_or(1.0, |m| m[at % pixels]);
    let (projected, tiles, image, transmittance) = render(scene, camera, options);
    let masked: Vec<f64> = image
        .iter()
        .enumerate()
        .map(|(at, v)| v * counts(at))
        .collect();
    let mut loss = loss(&masked, photo, camera.size.map(|s| s as usize), lambdas[0]);
    for (at, g) in loss.gradient.iter_mut().enumerate() {
        *g *= counts(at);
    }
    let sums = splat_grad(&projected, &tiles, camera, options, &loss.gradient);
    let sums: Vec<Option<[f64; 9]>> = sums
        .into_iter()
        .zip(&projected)
        .map(|(s, r)| r.as_ref().map(|_| s))
        .collect();
    let grads = project_grad(scene, camera, options, &sums, [lambdas[1], lambdas[2]]);
    ReferencePass {
        projected,
        tiles,
        image,
        transmittance,
        loss,
        sums,
        grads,
    }
}
