//! seen: which Gaussians views show.

use super::*;
use mhsplat::base::constants::GROUP_BATCH;
use mhsplat::device::{Array, Projected};
use mhsplat::pipeline::buffers::ViewBuffers;
use mhsplat::pipeline::stage::seen::mark;

#[test]
fn agrees_with_the_reference() {
    agrees("seen");
}

#[test]
fn two_gaussians_taken_for_the_other_are_rejected() {
    rejects("seen", "Gaussians", |seen| {
        for flag in &mut seen[..2] {
            *flag = 1.0 - *flag;
        }
    });
}

/// A projected Gaussian at (x, y), of alpha 0.97, within so many pixels.
fn projected([x, y]: [f64; 2], reach: u32, sharpness: f64) -> Projected<f64> {
    let bounds = |at: f64| {
        let at = at as u32;
        at.saturating_sub(reach) | ((at + reach).min(15) << 16)
    };
    Projected {
        x,
        y,
        a: sharpness,
        c: sharpness,
        lo: 0.97_f64.log2(),
        bx: bounds(x),
        by: bounds(y),
        ..Projected::default()
    }
}

/// Flags of the Gaussians, front to back, that one tile of an image of 5 × 5 pixels shows.
fn seen_of(gaussians: &[Projected<f64>], before: &[u32], tuning: Tuning) -> Vec<u32> {
    let device = device();
    let n = gaussians.len();
    let array = |name, values: &[u32]| Array::from_slice(&device, name, values).unwrap();
    let order = (0..n as u32).collect::<Vec<_>>();
    let seen = array("seen", before);
    // Left over from another view.
    let shown = Array::from_slice(&device, "shown", &vec![1; n]).unwrap();
    let mut frame = ViewBuffers::new(&device, &tuning, false).unwrap();
    frame.band = 0..1;
    frame.records = Array::from_slice(&device, "records", gaussians).unwrap();
    frame.isect_owner = array("isect_owner", &order);
    frame.tile_start = array("tile_start", &[0, n as u32]);
    frame.isect_start = array("isect_start", &order);
    frame.isect_counts = array("isect_counts", &vec![1; n]);
    frame.pairs.values[0] = array("order", &order);
    (frame.camera.size, frame.camera.tile, frame.camera.across) = ([5, 5], tuning.tile as i32, 1);
    let kernels = Kernels::new(&device, Defines::new(tuning));
    let stage = kernels.build::<f64>("seen").unwrap();
    mark(&stage, &frame, &shown, &seen).unwrap();
    seen.to_vec().unwrap()
}

fn styles() -> [Tuning; 3] {
    [
        Tuning::for_device(device().info()),
        Tuning::CPU,
        Tuning::GPU,
    ]
}

/// One Gaussian in the padding, three of alpha 0.97 everywhere, one behind them.
#[test]
fn what_is_hidden_or_beside_the_image_is_not_seen() {
    let wide = projected([2.5, 2.5], 15, 1e-6);
    let gaussians = [projected([10.5, 10.5], 1, 10.0), wide, wide, wide, wide];
    for tuning in styles() {
        let seen = |before: [u32; 5]| seen_of(&gaussians, &before, tuning);
        assert_eq!(seen([0; 5]), [0, 1, 1, 1, 0]);
        // What was seen once stays so.
        assert_eq!(seen([1, 0, 0, 0, 1]), [1, 1, 1, 1, 1]);
        assert_eq!(seen([0, 1, 1, 1, 0]), [0, 1, 1, 1, 0]);
    }
}

/// A tile with more pairs than are staged at once, each in a pixel of its own or, the last two, before and behind what is opaque.
#[test]
fn long_lists_are_looked_at_as_far_as_there_is_anything_unseen() {
    let faint = Projected {
        lo: 0.01_f64.log2(),
        ..projected([1.5, 1.5], 1, 10.0)
    };
    let opaque = projected([3.5, 3.5], 0, 1e-6);
    let many = 2 * GROUP_BATCH as usize + 7;
    let mut gaussians = vec![faint; many];
    gaussians.extend([opaque; 4]);
    let seen_but = |unseen: &[usize]| -> Vec<u32> {
        let of = |i| u32::from(!unseen.contains(&i));
        (0..gaussians.len()).map(of).collect()
    };
    for tuning in styles() {
        let [last, hidden] = [many + 2, many + 3];
        let before = seen_but(&[3, last, hidden]);
        assert_eq!(seen_of(&gaussians, &before, tuning), seen_but(&[hidden]));
        let before = seen_but(&[hidden]);
        assert_eq!(seen_of(&gaussians, &before, tuning), before);
    }
}
