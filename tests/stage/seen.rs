//! seen: which Gaussians views show.

use super::*;
use mhsplat::gpu::{Array, Record};
use mhsplat::stage::seen::{Seen, SeenArgs};
use mhsplat::stage::splat::TileLists;

#[test]
fn agrees_with_the_reference() {
    agrees("seen");
}

#[test]
fn a_gaussian_taken_for_unseen_is_rejected() {
    rejects("seen", |out| out.seen[2] = 1.0 - out.seen[2]);
}

/// A record at (x, y), of alpha 0.97, within so many pixels.
fn record([x, y]: [f64; 2], reach: u32, sharpness: f64) -> Record<f64> {
    let bounds = |at: f64| {
        let at = at as u32;
        at.saturating_sub(reach) | ((at + reach).min(15) << 16)
    };
    Record {
        x,
        y,
        a: sharpness,
        c: sharpness,
        lo: 0.97_f64.log2(),
        bx: bounds(x),
        by: bounds(y),
        ..Record::default()
    }
}

/// What is seen of an image of 5 × 5 pixels, front to back: one Gaussian in the padding, three of alpha 0.97 everywhere,
/// one behind them.
fn seen(before: [u32; 5]) -> Vec<u32> {
    let device = device();
    let wide = record([2.5, 2.5], 15, 1e-6);
    let records = [record([10.5, 10.5], 1, 10.0), wide, wide, wide, wide];
    let array = |name, values: &[u32]| Array::from_slice(&device, name, values).unwrap();
    let order = array("order", &[0, 1, 2, 3, 4]);
    let seen = array("seen", &before);
    Seen::new::<f64>(&kernels(&device))
        .unwrap()
        .run(&SeenArgs {
            count: 5,
            lists: TileLists {
                records: &Array::from_slice(&device, "records", &records).unwrap(),
                pair_owner: &order,
                order: &order,
                tile_start: &array("tile_start", &[0, 5]),
                tile_used: &array("tile_used", &[0]),
                tiles: [1, 1],
                image: &Array::zeros(&device, "image", 0).unwrap(),
            },
            size: [5, 5],
            pair_start: &order,
            pair_counts: &array("pair_counts", &[1; 5]),
            // Left over from another view.
            shown: &Array::from_slice(&device, "shown", &[1; 5]).unwrap(),
            seen: &seen,
        })
        .unwrap();
    seen.to_vec().unwrap()
}

#[test]
fn what_is_hidden_or_beside_the_image_is_not_seen() {
    assert_eq!(seen([0; 5]), [0, 1, 1, 1, 0]);
}

#[test]
fn what_was_seen_once_stays_so() {
    assert_eq!(seen([1, 0, 0, 0, 1]), [1, 1, 1, 1, 1]);
    assert_eq!(seen([0, 1, 1, 1, 0]), [0, 1, 1, 1, 0]);
}
