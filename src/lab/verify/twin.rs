//! A case through the f64 reference.

use crate::base::constants::NEAR;
use crate::capture::Alpha;
use crate::lab::verify::chain::Case;
use crate::pipeline::chain::{Passage, run as reference};
use crate::pipeline::reference::{Camera64, Options, Scene64};
use crate::scene::filters;

/// The photo over the background, planar \[3, height, width\].
#[must_use]
pub fn photo(case: &Case) -> Vec<f64> {
    let p = &case.photo;
    let n = (p.width * p.height) as usize;
    let value = |c: usize, i: usize| f64::from(p.data[c * n + i]) / 255.0;
    (0..3 * n)
        .map(|at| {
            let (c, i) = (at / n, at % n);
            let gap = if p.alpha == Alpha::Transparency {
                1.0 - value(3, i)
            } else {
                0.0
            };
            value(c, i) + gap * f64::from(case.background[c])
        })
        .collect()
}

/// How far each pixel counts \[height, width\]; none without a mask.
#[must_use]
pub fn mask(case: &Case) -> Option<Vec<f64>> {
    let p = &case.photo;
    let n = (p.width * p.height) as usize;
    let value = |m: &u8| f64::from(*m) / 255.0;
    (p.alpha == Alpha::Mask).then(|| p.data[3 * n..].iter().map(value).collect())
}

/// Camera, scene and options of a case.
#[must_use]
pub fn inputs(case: &Case) -> (Scene64, Camera64, Options) {
    let options = Options {
        alpha_min: case.alpha_min,
        sh_degree: case.sh_degree,
        background: case.background.map(f64::from),
    };
    let mut scene = Scene64::new(&case.splats);
    if !case.filter_views.is_empty() {
        let positions = (0..scene.len()).map(|i| scene.position(i));
        scene.filter = Some(filters(positions, &case.filter_views));
    }
    (scene, Camera64::new(&case.camera, NEAR), options)
}

/// Every stage of the reference on a case.
#[must_use]
pub fn run(case: &Case) -> Passage {
    let (scene, camera, options) = inputs(case);
    let mask = mask(case);
    let photo = photo(case);
    reference(
        &scene,
        &camera,
        &options,
        &photo,
        mask.as_deref(),
        case.lambdas,
    )
}
