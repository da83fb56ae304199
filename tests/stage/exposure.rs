//! exposure: an affine colour transform per image.

use super::*;
use mhsplat::device::Array;
use mhsplat::device::tuning::status::{NON_FINITE, OVERFLOW, SLOTS};
use mhsplat::lab::error::{Tolerance, compare};
use mhsplat::lab::verify::definition::{EXPOSURES, photo};
use mhsplat::pipeline::stage::adam::Step;
use mhsplat::pipeline::stage::exposure::{ENTRIES, Exposures, IDENTITY, apply, backward};
use mhsplat::pipeline::stage::loss::loss;

#[test]
fn agrees_with_the_reference() {
    agrees("exposure");
}

#[test]
fn wrong_images_gradients_and_steps_are_rejected() {
    rejects("exposure", "image", |image| image[5] += 1e-3);
    rejects("exposure", "gradient with respect to the render", |d| {
        d.iter_mut().for_each(|d| *d *= 1.01)
    });
    rejects(
        "exposure",
        "gradient with respect to the transform",
        |grads| grads[7] *= -1.0,
    );
    rejects("exposure", "transforms", |e| e[13] += 1e-3);
    rejects("exposure", "transforms", |e| e[0] += 1e-3);
    // Moments are far smaller than the transforms, and the second ones than the first.
    for moments in ["first moments", "second moments"] {
        rejects("exposure", moments, |m| {
            m.iter_mut().for_each(|m| *m *= 1.001)
        });
    }
}

/// Central differences of the loss of the corrected image by every value of `at`.
fn differences(at: &[f64], loss: impl Fn(&[f64]) -> f64) -> Vec<f64> {
    let h = 1e-5;
    let mut moved = at.to_vec();
    (0..at.len())
        .map(|k| {
            let mut side = |by: f64| {
                moved[k] = at[k] + by;
                loss(&moved)
            };
            let slope = (side(h) - side(-h)) / (2.0 * h);
            moved[k] = at[k];
            slope
        })
        .collect()
}

#[test]
fn the_reference_is_the_derivative_of_the_loss() {
    let case = cases::mild("differences", 30, [21, 13], 1, 41);
    let (photo, lambda, size) = (photo(&case), case.lambdas[0], [21, 13]);
    let image = Reference::new(&case).pass.image;
    let exposure = EXPOSURES[1];
    let of = |image: &[f64], exposure: &[f64; 12]| {
        let l = loss(&apply(image, exposure), &photo, size, lambda);
        (1.0 - lambda) * l.l1 + lambda * (1.0 - l.ssim)
    };
    let gradient = loss(&apply(&image, &exposure), &photo, size, lambda).gradient;
    let (dimage, grads) = backward(&image, &exposure, &gradient);
    // A pixel within the step of the photo's value crosses the corner of |x − y|.
    let bound = Tolerance::all(1e-6).with_flips(2, 1e-3);
    let by_image = differences(&image, |image| of(image, &exposure));
    compare(&dimage, &by_image, bound).unwrap();
    let by_exposure = differences(&exposure, |e| of(&image, e.try_into().unwrap()));
    compare(&grads, &by_exposure, bound).unwrap();
    let mut wrong = grads;
    wrong.swap(1, 4);
    assert!(compare(&wrong, &by_exposure, bound).is_err());
    assert_eq!(apply(&image, &IDENTITY), image);
}

/// Transforms of three views and the status after one step of the second with the same sum everywhere.
fn stepped(sum: f32, overflow: u32) -> (Vec<f32>, Vec<u32>) {
    let device = device();
    let exposures = Exposures::<f32>::new(&kernels(&device), 3, 0).unwrap();
    let mut partial = vec![0.0; exposures.partial.len()];
    let chunks = partial.len() / ENTRIES;
    partial.iter_mut().step_by(chunks).for_each(|p| *p = sum);
    exposures.partial.write(0, &partial).unwrap();
    let status = Array::zeros(&device, "status", SLOTS).unwrap();
    status.write(OVERFLOW as usize, &[overflow]).unwrap();
    let step = Step {
        rate: 0.01,
        constants: [0.9, 0.999, 1e-15],
        t: 1,
    };
    exposures.step(1, &step, &status).unwrap();
    let transforms = exposures.transforms.to_vec().unwrap();
    (transforms, status.to_vec().unwrap())
}

#[test]
fn the_first_step_is_the_rate_in_the_view_rendered_and_their_mean_stays() {
    let (got, _) = stepped(-3e-4, 0);
    for (k, (g, start)) in got.iter().zip(IDENTITY.repeat(3)).enumerate() {
        let moved = if (ENTRIES..2 * ENTRIES).contains(&k) {
            0.01 * 2.0 / 3.0
        } else {
            -0.01 / 3.0
        };
        assert!((f64::from(*g) - start - moved).abs() < 1e-6, "{k}: {g}");
    }
}

#[test]
fn what_is_not_finite_counts_as_zero_and_an_overflow_changes_nothing() {
    let identity = IDENTITY.map(|v| v as f32).repeat(3);
    for bad in [f32::NAN, f32::INFINITY, 1e30] {
        let (got, status) = stepped(bad, 0);
        assert_eq!((got, status[NON_FINITE as usize]), (identity.clone(), 12));
    }
    assert_eq!(stepped(1.0, 777).0, identity);
}
