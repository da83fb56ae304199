//! Twin of `kernels/noise.cl` (\[MCMC\] Eq. 8).

use super::{LOG_SCALE, Scene64, product, rotation, sigmoid, transpose, unit_quaternion};
use crate::density::NoiseLaw;
use crate::model::Plane;
use crate::rng::Philox;

/// Displacement of Gaussian `i`: rate·Σ·ξ·σ(−k·(o − x₀)), ξ the first three of the host's normal numbers at (seed, stream, i).
#[must_use]
pub fn noise(scene: &Scene64, i: usize, law: &NoiseLaw, seed: u64, stream: u64) -> [f64; 3] {
    let [x, y, z, _] = Philox::normal(seed, stream, i as u64);
    let (q, _) = unit_quaternion(scene.gather(Plane::ROTATION, i));
    let rot = rotation(q);
    let scale: [f64; 3] = scene.gather(Plane::LOG_SCALE, i);
    let scale = scale.map(|l| l.clamp(LOG_SCALE[0], LOG_SCALE[1]).exp());
    let rs: [[f64; 3]; 3] = std::array::from_fn(|r| std::array::from_fn(|k| rot[r][k] * scale[k]));
    let sigma = product(&rs, &transpose(&rs));
    let opacity = sigmoid(scene.planes[Plane::OPACITY][i]);
    let gate = sigmoid(-law.steepness * (opacity - law.opacity));
    product(&sigma, &[[x], [y], [z]]).map(|[v]| law.rate * gate * v)
}
