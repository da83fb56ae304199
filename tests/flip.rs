//! FLIP against the authors' program: its definition, and the kernels.
//!
//! The figures below were computed with `nv-flip` 0.1.2, which wraps the authors' C++ (f32), of the pictures that [`pair`]
//! makes: stored, because that crate needs a C++ compiler wherever the tests run.

use crate::device;
use mhsplat::base::constants::FLIP_PIXELS_PER_DEGREE;
use mhsplat::device::tuning::Tuning;
use mhsplat::device::{Array, Defines, ImageSize, Kernels};
use mhsplat::pipeline::photo_array::PhotoArray;
use mhsplat::pipeline::stage::flip::{Flip, error_map};
use mhsplat::pipeline::stage::loss::ImagePair;

/// (pair, pixels per degree, mean, largest error, error of the pixel at a third of the picture)
const EXPECTED: [(&str, f64, f64, f64, f64); 14] = [
    ("equal", 67.0, 0.000000, 0.000000, 0.000000),
    ("equal", 30.0, 0.000000, 0.000000, 0.000000),
    ("noise", 67.0, 0.110657, 0.281301, 0.062239),
    ("noise", 30.0, 0.215010, 0.441328, 0.118183),
    ("shift", 67.0, 0.377313, 0.949130, 0.042556),
    ("shift", 30.0, 0.472020, 0.968527, 0.005493),
    ("colour", 67.0, 1.000000, 1.000000, 1.000000),
    ("colour", 30.0, 1.000000, 1.000000, 1.000000),
    ("dark", 67.0, 0.068353, 0.172785, 0.092812),
    ("dark", 30.0, 0.075667, 0.170732, 0.113329),
    ("wide", 67.0, 0.705761, 0.971030, 0.965225),
    ("wide", 30.0, 0.817427, 0.983359, 0.977571),
    ("single", 67.0, 0.382347, 0.382347, 0.382347),
    ("single", 30.0, 0.382341, 0.382341, 0.382341),
];
/// The authors' program computes in f32: a difference of two filtered pictures that agree carries some 1e-7, which the
/// exponents (a square root, then a power below 1) enlarge.
const TOLERANCE: f64 = 5e-4;

/// Width, height, and two pictures of interleaved RGB8 that any program can make again from integers alone.
pub fn pair(name: &str) -> (usize, usize, Vec<u8>, Vec<u8>) {
    let (width, height) = match name {
        "wide" => (97, 21),
        "single" => (1, 1),
        _ => (48, 36),
    };
    let mut state = 12_345_u32;
    let mut noise = |range: u32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        ((state >> 16) % range) as i32
    };
    let (mut reference, mut test) = (Vec::new(), Vec::new());
    for y in 0..height as i32 {
        for x in 0..width as i32 {
            for c in 0..3 {
                let smooth = 40 + 3 * x + 2 * y * (c + 1) / 2;
                let checks = if (x / 6 + y / 6) % 2 == 0 {
                    200 - 40 * c
                } else {
                    30 + 50 * c
                };
                let (a, b) = match name {
                    "equal" => (checks, checks),
                    "noise" => (smooth, smooth + noise(41) - 20),
                    "shift" => (
                        checks,
                        if ((x + 2) / 6 + y / 6) % 2 == 0 {
                            200 - 40 * c
                        } else {
                            30 + 50 * c
                        },
                    ),
                    "colour" => (if c == 1 { 255 } else { 0 }, if c == 2 { 255 } else { 0 }),
                    "dark" => (checks / 12, smooth / 12),
                    _ => (noise(256), smooth),
                };
                reference.push(a.clamp(0, 255) as u8);
                test.push(b.clamp(0, 255) as u8);
            }
        }
    }
    (width, height, reference, test)
}

fn planar(interleaved: &[u8]) -> Vec<f64> {
    let channel = |c: usize| interleaved.iter().skip(c).step_by(3);
    (0..3)
        .flat_map(|c| channel(c).map(|v| f64::from(*v) / 255.0))
        .collect()
}

fn mean(map: &[f64]) -> f64 {
    map.iter().sum::<f64>() / map.len() as f64
}

/// Mean, largest and one pixel of the map.
fn figures(name: &str, pixels_per_degree: f64) -> [f64; 3] {
    let (width, height, reference, test) = pair(name);
    let (reference, test) = (planar(&reference), planar(&test));
    let map = error_map(&reference, &test, [width, height], pixels_per_degree);
    [
        mean(&map),
        map.iter().copied().fold(0.0, f64::max),
        map[map.len() / 3],
    ]
}

fn agree(found: [f64; 3], expected: [f64; 3]) -> bool {
    let pairs = found.iter().zip(expected);
    pairs.into_iter().all(|(a, b)| (a - b).abs() <= TOLERANCE)
}

#[test]
fn agrees_with_the_authors_program() {
    let mut worst = 0.0_f64;
    for (name, pixels_per_degree, mean, largest, one) in EXPECTED {
        let found = figures(name, pixels_per_degree);
        let expected = [mean, largest, one];
        assert!(agree(found, expected), "{name}: {found:?}, {expected:?}");
        worst = worst.max((found[0] - mean).abs());
    }
    assert!(worst <= 2e-5, "means differ by up to {worst}");
}

#[test]
fn the_comparison_can_fail() {
    // At another distance from the screen, and with the pictures of another pair, the figures are others.
    let at = |name: &str, ppd: f64| {
        let found = EXPECTED.iter().find(|e| e.0 == name && e.1 == ppd).unwrap();
        [found.2, found.3, found.4]
    };
    assert!(!agree(figures("noise", 60.0), at("noise", 67.0)));
    assert!(!agree(figures("shift", 67.0), at("noise", 67.0)));
    assert!(!agree([f64::NAN; 3], at("noise", 67.0)));
}

#[test]
fn symmetric_zero_for_equal_pictures_and_growing_with_the_error() {
    let (width, height, a, b) = pair("noise");
    let (a, b) = (planar(&a), planar(&b));
    let flip =
        |x: &[f64], y: &[f64]| mean(&error_map(x, y, [width, height], FLIP_PIXELS_PER_DEGREE));
    let forth = flip(&a, &b);
    assert!((forth - flip(&b, &a)).abs() < 1e-12);
    assert_eq!(flip(&a, &a), 0.0);
    let half: Vec<f64> = a
        .iter()
        .zip(&b)
        .map(|(x, y)| f64::midpoint(*x, *y))
        .collect();
    let less = flip(&a, &half);
    assert!(0.0 < less && less < forth, "{less} against {forth}");
}

/// Sums over the rows by the kernels, of pictures of interleaved RGB8, the first one rendered and worth the factor.
fn rows(
    tuning: Tuning,
    [width, height]: [usize; 2],
    [render, photo]: [&[u8]; 2],
    factor: f32,
) -> Vec<f64> {
    let tile = tuning.tile as usize;
    let of = |pixels| ImageSize { pixels, tile };
    let (device, size) = (device(), of([width, height]));
    let kernels = Kernels::new(&device, Defines::new(tuning));
    let [stride, rows] = size.padded();
    let mut image = vec![0.0_f32; 3 * stride * rows];
    let mut planes = vec![0; 3 * width * height];
    for (at, value) in render.iter().enumerate() {
        let (c, x, y) = (at % 3, at / 3 % width, at / 3 / width);
        image[(c * rows + y) * stride + x] = factor * f32::from(*value) / 255.0;
        planes[(c * height + y) * width + x] = photo[at];
    }
    let pair = ImagePair {
        image: &Array::from_slice(&device, "image", &image).unwrap(),
        photo: &PhotoArray::whole(Array::from_slice(&device, "photo", &planes).unwrap(), size),
        background: [0.0; 3],
        size,
        band: 0..size.tiles()[1],
        blank: None,
    };
    // With room for larger ones.
    let flip = Flip::<f32>::new(&kernels, of([width + 30, height + 7])).unwrap();
    let sums = flip.rows(&pair).unwrap();
    sums.into_iter().map(f64::from).collect()
}

#[test]
fn the_kernels_agree_with_the_authors_program() {
    for tuning in [Tuning::CPU, Tuning::GPU] {
        for (name, _, expected, ..) in EXPECTED.iter().filter(|e| e.1 == 67.0) {
            let (width, height, reference, test) = pair(name);
            let sums = rows(tuning, [width, height], [&test, &reference], 1.0);
            let mean = sums.iter().sum::<f64>() / (width * height) as f64;
            assert!(
                (mean - expected).abs() <= 2e-5,
                "{name}: {mean}, {expected}"
            );
        }
    }
}

/// Pictures higher than a strip of either style, and as wide as no vector.
#[test]
fn strips_leave_no_trace() {
    let size @ [width, height] = [41, 600];
    let mut state = 7_u32;
    let mut noise = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    let [a, b]: [Vec<u8>; 2] = [0; 2].map(|_| (0..3 * width * height).map(|_| noise()).collect());
    let map = error_map(&planar(&a), &planar(&b), size, FLIP_PIXELS_PER_DEGREE);
    let expected: Vec<f64> = map
        .chunks_exact(width)
        .map(|row| row.iter().sum())
        .collect();
    for tuning in [Tuning::CPU, Tuning::GPU] {
        let sums = rows(tuning, size, [&b, &a], 1.0);
        for (y, (found, expected)) in sums.iter().zip(&expected).enumerate() {
            assert!(
                (found - expected).abs() < 1e-4 * expected,
                "{y}: {found}, {expected}"
            );
        }
    }
}

#[test]
fn an_error_that_is_no_number_is_told() {
    let (width, height, _, test) = pair("noise");
    // Of a black photo no colour differs where what is no number is taken for black.
    let black = vec![0; test.len()];
    for tuning in [Tuning::CPU, Tuning::GPU] {
        let sums = rows(tuning, [width, height], [&test, &black], f32::NAN);
        assert!(sums.iter().all(|sum| sum.is_nan()), "{sums:?}");
    }
}
