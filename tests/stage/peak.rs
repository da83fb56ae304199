//! peak: the micro-benchmarks do the work that they are timed for.

use super::*;
use mhsplat::base::constants::PEAK_CHAINS;
use mhsplat::device::{Array, Real};
use mhsplat::lab::error::{Tolerance, compare};
use mhsplat::pipeline::stage::peak::{copy, fma_chains, multiply_add};

/// Lanes of seven work-items after `steps` steps of x → 0.99 x + 0.5.
fn chains<R: Real>(tuning: Tuning, steps: u32) -> Vec<f64> {
    let device = device();
    let kernels = Kernels::new(&device, Defines::new(tuning));
    let stage = kernels.build::<R>("peak").unwrap();
    let out = Array::<R>::zeros(&device, "out", 7 * stage.lanes()).unwrap();
    multiply_add(&stage, 7, steps, [0.99, 0.5], &out).unwrap();
    out.to_vec().unwrap().into_iter().map(Into::into).collect()
}

#[test]
fn chains_agree_with_the_reference() {
    let want = |got: &[f64], steps| vec![fma_chains(PEAK_CHAINS, steps, 0.99, 0.5); got.len()];
    for tuning in [Tuning::CPU, Tuning::GPU] {
        let single = chains::<f32>(tuning, 40);
        compare(&single, &want(&single, 40), Tolerance::all(SINGLE)).unwrap();
        let double = chains::<f64>(tuning, 40);
        compare(&double, &want(&double, 40), Tolerance::all(EXACT)).unwrap();
        // One step less is another result: a loop that was optimised away would be noticed.
        let fewer = chains::<f64>(tuning, 39);
        assert!(compare(&fewer, &want(&double, 40), Tolerance::all(EXACT)).is_err());
    }
}

#[test]
fn a_copy_is_a_copy() {
    let device = device();
    let stage = kernels(&device).build::<f32>("peak").unwrap();
    let values: Vec<f32> = (0..stage.lanes() * 1001).map(|i| i as f32).collect();
    let from = Array::from_slice(&device, "from", &values).unwrap();
    let to = Array::zeros(&device, "to", values.len()).unwrap();
    copy(&stage, &from, &to).unwrap();
    assert_eq!(to.to_vec().unwrap(), values);
    let short = Array::zeros(&device, "short", values.len() - 1).unwrap();
    assert!(copy(&stage, &from, &short).is_err());
}
