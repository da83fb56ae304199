//! Noise on the positions (`kernels/noise.cl`): 3DGS-MCMC, Kheradmand et al. 2024, eq. 8.

use crate::base::constants::LOG_SCALE;
use crate::base::error::Result;
use crate::base::math::sigmoid;
use crate::base::rng::Philox;
use crate::density::NoiseLaw;
use crate::device::{Program, Real};
use crate::pipeline::buffers::{GaussianBuffers, ViewBuffers};
use crate::pipeline::launch::Arguments;
use crate::pipeline::reference::{Scene64, product, rotation, transpose, unit_quaternion};
use crate::scene::Plane;

/// Moves the positions by the law, whose rate is in local units here; random numbers are keyed by the seed of the run
/// and a stream (see `Stream::stream`). After an overflow in the view nothing changes.
pub fn perturb<R: Real>(
    stage: &Program,
    scene: &GaussianBuffers<R>,
    view: &ViewBuffers<R>,
    law: &NoiseLaw,
    [seed, stream]: [u64; 2],
) -> Result<()> {
    stage
        .launch("noise")
        .uints([scene.stride, scene.count])
        .uints([scene.shard.map_or(0, |shard| shard.first)])
        .uints([seed, seed >> 32, stream, stream >> 32].map(|word| word as usize))
        .reals::<R>([law.rate, law.steepness, law.opacity])
        .status(view)
        .array(&scene.params, (Plane::OPACITY + 1) * scene.stride)
        .over_gaussians(scene.count)
}

// Definition in f64.

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
