//! morton: the order of rows by layers and along the Z curve, to the bit that of the host's f64.

use super::*;
use mhsplat::base::rng::{Philox, Stream};
use mhsplat::device::Array;
use mhsplat::pipeline::buffers::{GaussianBuffers, ViewBuffers};
use mhsplat::pipeline::stage::morton::{Morton, Order, kept};
use mhsplat::pipeline::stage::sort::Sort;
use mhsplat::scene::{Plane, morton};

/// Rows that the device keeps, in its order.
fn sorted(device: &Device, planes: &[Vec<f32>; 3], removed: &[u32], order: Order) -> Vec<u32> {
    let kernels = Kernels::new(device, Defines::new(device.tuning()));
    let (n, stage) = (planes[0].len(), Morton::new::<f32>(&kernels).unwrap());
    let stride = n.next_multiple_of(256);
    let mut params = vec![0.0f32; stride * Plane::count(0)];
    for (k, plane) in planes.iter().enumerate() {
        params[k * stride..][..n].copy_from_slice(plane);
    }
    let scene = GaussianBuffers::<f32> {
        params: Array::from_slice(device, "params", &params).unwrap(),
        filter: Array::zeros(device, "filter", 0).unwrap(),
        stride,
        count: n,
        sh_degree: 0,
        shard: None,
    };
    let tuning = kernels.defines().tuning;
    let mut view = ViewBuffers::new(device, &tuning, false).unwrap();
    view.fit_gaussians(device, stride).unwrap();
    let sort = Sort::new::<f32>(&kernels).unwrap();
    let gone = Array::from_slice(device, "removed", removed).unwrap();
    stage.sort(&sort, &scene, &gone, order, &mut view).unwrap();
    let rows = view.visible.sorted_values();
    rows.read(0, n - removed.len()).unwrap()
}

/// Morton order in layers of a direction that no axis has.
const ORDER: Order = Order::Morton {
    up: [0.48, 0.6, -0.64],
};

/// Both styles have the definition's order.
fn agrees_to_the_bit(planes: [Vec<f32>; 3], removed: &[u32], order: Order) {
    let want = kept(planes.each_ref().map(Vec::as_slice), removed, order);
    for tuning in [Tuning::CPU, Tuning::GPU] {
        let device = device().with_tuning(tuning);
        assert!(
            sorted(&device, &planes, removed, order) == want,
            "{order:?}, group style {}",
            tuning.group_style
        );
    }
}

/// Numbers of both signs over `decades` powers of ten.
fn numbers(n: usize, stream: u64, decades: f64) -> Vec<f32> {
    let of = |i: u64| {
        let [u, v, ..] = Philox::uniform(3, Stream::Synthetic.stream(2) + stream, i);
        let size = 10f64.powf(decades * (v - 0.5));
        ((u - 0.5) * size) as f32
    };
    (0..n as u64).map(of).collect()
}

#[test]
fn the_order_is_that_of_f64_to_the_bit() {
    for (n, decades) in [(70_000, 0.0), (40_000, 3.0), (20_000, 40.0), (300, 76.0)] {
        let planes = [0, 1, 2].map(|k| numbers(n, k, decades));
        agrees_to_the_bit(planes, &[], ORDER);
    }
}

#[test]
fn coordinates_at_the_borders_of_cells_are_in_the_cell_of_f64() {
    // Multiples of the cell's edge and their neighbours in f32, in boxes whose edges divide into cells without rest and with one.
    for extent in [262_143.0f32, 1.0, 3.0, 1e-20, 1e30] {
        let edge = f64::from(extent) / 262_143.0;
        let mut x = vec![0.0, extent];
        for cell in (1..262_143u32).step_by(991) {
            let border = (f64::from(cell) * edge) as f32;
            x.extend([border, border.next_up(), border.next_down()]);
        }
        let y = x.iter().rev().copied().collect();
        let z = x.iter().map(|v| -v).collect();
        agrees_to_the_bit([x, y, z], &[], ORDER);
    }
}

#[test]
fn what_has_no_place_in_the_box_is_where_the_host_puts_it() {
    let odd = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.0, -0.0];
    let tiny = [f32::from_bits(1), -f32::from_bits(1), f32::MIN_POSITIVE];
    let huge = [f32::MAX, f32::MIN, 1.0, -1.0];
    let x: Vec<f32> = odd.into_iter().chain(tiny).chain(huge).collect();
    let mut y = x.clone();
    y.rotate_left(4);
    agrees_to_the_bit([x.clone(), y, vec![7.5; 12]], &[], ORDER);
    agrees_to_the_bit([vec![f32::NAN; 12], vec![f32::NAN; 12], x], &[], ORDER);
    let denormal: Vec<f32> = (0..900).map(|i| f32::from_bits(i * 977 % 900)).collect();
    let none = vec![0.0; 900];
    agrees_to_the_bit([denormal, none.clone(), none], &[], ORDER);
}

#[test]
fn removed_rows_are_left_out() {
    let planes = [0, 1, 2].map(|k| numbers(5000, k, 1.0));
    let removed: Vec<u32> = (0..5000).filter(|i| i % 7 == 3).collect();
    for order in [ORDER, Order::Kept] {
        agrees_to_the_bit(planes.clone(), &removed, order);
    }
    let all: Vec<u32> = (0..5000).collect();
    agrees_to_the_bit(planes, &all, Order::Kept);
}

#[test]
fn another_order_is_noticed() {
    let planes = [0, 1, 2].map(|k| numbers(300, k, 1.0));
    let at = planes.each_ref().map(Vec::as_slice);
    let rows = sorted(&device(), &planes, &[], ORDER);
    assert_ne!(rows, kept(at, &[], Order::Kept));
    assert_ne!(rows, kept([at[1], at[0], at[2]], &[], ORDER));
    let flat = Order::Morton { up: morton::NO_UP };
    assert_ne!(rows, kept(at, &[], flat));
}
