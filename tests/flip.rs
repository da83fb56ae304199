//! FLIP against the authors' program, and what it must refuse.
//!
//! The figures below were computed with `nv-flip` 0.1.2, which wraps the authors' C++ (f32), of the pictures that [`pair`]
//! makes: stored, because that crate needs a C++ compiler wherever the tests run.

use mhsplat::evaluate::flip::{PIXELS_PER_DEGREE, error_map, flip};

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

fn planar(interleaved: &[u8]) -> Vec<f32> {
    let channel = |c: usize| interleaved.iter().skip(c).step_by(3);
    (0..3)
        .flat_map(|c| channel(c).map(|v| f32::from(*v) / 255.0))
        .collect()
}

/// Mean, largest and one pixel of the map.
fn figures(name: &str, pixels_per_degree: f64) -> [f64; 3] {
    let (width, height, reference, test) = pair(name);
    let (reference, test) = (planar(&reference), planar(&test));
    let map = error_map(&reference, &test, width, height, pixels_per_degree).unwrap();
    let mean = map.iter().sum::<f64>() / map.len() as f64;
    [
        mean,
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
    let forth = flip(&a, &b, width, height, &[]).unwrap();
    let back = flip(&b, &a, width, height, &[]).unwrap();
    assert!((forth - back).abs() < 1e-12);
    assert_eq!(flip(&a, &a, width, height, &[]).unwrap(), 0.0);
    let half: Vec<f32> = a
        .iter()
        .zip(&b)
        .map(|(x, y)| f32::midpoint(*x, *y))
        .collect();
    let less = flip(&a, &half, width, height, &[]).unwrap();
    assert!(0.0 < less && less < forth, "{less} against {forth}");
}

#[test]
fn tall_pictures_are_those_of_their_parts() {
    // Worked on by strips of 96 rows: the map of the whole in its upper and lower part is that of these parts, as far as no
    // filter reaches over the cut.
    let [width, height, cut, reach] = [24, 300, 150, 10];
    let value = |i: usize, k: usize| ((i * k) % 251) as f32 / 250.0;
    let picture = |k: usize| -> Vec<f32> { (0..3 * width * height).map(|i| value(i, k)).collect() };
    let (a, b) = (picture(7919), picture(104_729));
    let rows = |p: &[f32], from: usize, to: usize| -> Vec<f32> {
        let planes = p.chunks_exact(width * height);
        planes
            .flat_map(|plane| plane[from * width..to * width].to_vec())
            .collect()
    };
    let map = |from: usize, to: usize| {
        let (a, b) = (rows(&a, from, to), rows(&b, from, to));
        error_map(&a, &b, width, to - from, PIXELS_PER_DEGREE).unwrap()
    };
    let (whole, upper, lower) = (map(0, height), map(0, cut), map(cut, height));
    let alike = |x: &[f64], y: &[f64]| x.iter().zip(y).all(|(x, y)| (x - y).abs() < 1e-12);
    let near = (cut - reach) * width;
    assert!(alike(&whole[..near], &upper[..near]));
    let far = (cut + reach) * width;
    assert!(alike(&whole[far..], &lower[reach * width..]));
    assert!(
        !alike(&whole[..cut * width], &upper),
        "at the cut they differ"
    );
}

#[test]
fn what_is_no_picture_is_refused() {
    let gray = vec![0.5; 12];
    assert!(error_map(&gray, &gray, 2, 2, PIXELS_PER_DEGREE).is_ok());
    for (width, height, ppd) in [(2, 3, 67.0), (0, 2, 67.0), (2, 2, 0.0), (2, 2, f64::NAN)] {
        assert!(error_map(&gray, &gray, width, height, ppd).is_err());
    }
    for value in [f32::NAN, f32::INFINITY, -0.01, 1.01] {
        let mut bad = gray.clone();
        bad[7] = value;
        assert!(flip(&gray, &bad, 2, 2, &[]).is_err(), "{value}");
        assert!(flip(&bad, &gray, 2, 2, &[]).is_err(), "{value}");
    }
}
