//! loss: L1 + SSIM.

use super::*;
use mhsplat::dataset::Alpha;
use mhsplat::gpu::Array;
use mhsplat::stage::loss::{Blank, ImagePair, Loss};

#[test]
fn agrees_with_the_reference() {
    agrees("loss");
}

#[test]
fn a_wrong_gradient_is_rejected() {
    rejects("loss", |out| out.dimage.iter_mut().for_each(|d| *d *= 1.01));
}

#[test]
fn flat_images_stay_finite() {
    let device = device();
    for (level, background) in [(0u8, [0.0; 3]), (255, [1.0; 3]), (128, [0.5; 3])] {
        let mut case = cases::mild("flat", 3, [37, 21], 0, 34);
        case.splats.plane_mut(2).fill(-100.0);
        case.background = background;
        case.photo.data.fill(level);
        let out = chain::run::<f32>(&device, Tuning::CPU, &case).unwrap();
        assert!(out.dimage.iter().all(|d| d.is_finite()));
        assert!(
            out.loss[0] < 0.003 && (out.loss[1] - 1.0).abs() < 1e-3,
            "{level}: {:?}",
            out.loss
        );
    }
}

/// What the loss gives of a picture that is blank but for a corner and one pixel, with alpha or a mask, the blank parts left out or
/// not: L1 and SSIM, the gradient, and the maps of errors.
fn of_a_blank_picture(alpha: Alpha, skip_blank: bool, speck: f64) -> [Vec<f64>; 3] {
    let device = device();
    let [w, h] = [300, 100];
    let defines = Defines {
        alpha,
        skip_blank,
        ..Defines::new(Tuning::for_device(device.info()))
    };
    let loss = Loss::new::<f64>(&Kernels::new(&device, defines)).unwrap();
    let [stride, rows] = [304, 112];
    let corner = |x: usize, y: usize| x < 70 && y < 40;
    let (background, mut photo) = ([0.2, 0.4, 0.9_f32], vec![0u8; 4 * w * h]);
    let mut image = vec![0.0; 3 * stride * rows];
    for (at, x, y) in (0..w * h).map(|at| (at, at % w, at / w)) {
        for c in 0..3 {
            let value = &mut image[(c * rows + y) * stride + x];
            *value = f64::from(background[c]);
            if corner(x, y) {
                photo[c * w * h + at] = ((at * (c + 3)) % 120) as u8;
                *value = ((at * (c + 7)) % 200) as f64 / 200.0;
            }
        }
        photo[3 * w * h + at] = if corner(x, y) { 127 } else { 0 };
    }
    image[(rows + 70) * stride + 230] += speck;
    // A pair in every tile that has part of the corner or the speck.
    let across = stride / 16;
    let tile = |t: usize| [t % across * 16, t / across * 16];
    let live: Vec<u32> = (0..across * rows / 16)
        .map(|t| u32::from(corner(tile(t)[0], tile(t)[1])))
        .collect();
    let pairs = |t: usize| live[t] + u32::from(speck > 0.0 && tile(t) == [224, 64]);
    let ends = (0..live.len()).scan(0, |sum, t| {
        *sum += pairs(t);
        Some(*sum)
    });
    let tile_start: Vec<u32> = std::iter::once(0).chain(ends).collect();
    let array = |name, len| Array::<f64>::zeros(&device, name, len).unwrap();
    let (maps, dimage) = (
        array("maps", 3 * stride * rows),
        array("dimage", image.len()),
    );
    let (partial, out) = (array("partial", loss.partial_len(w, h)), array("losses", 2));
    let pair = ImagePair {
        image: &Array::from_slice(&device, "image", &image).unwrap(),
        photo: &Array::from_slice(&device, "photo", &photo).unwrap(),
        background,
        size: [w, h],
        blank: Some(Blank {
            live: &Array::from_slice(&device, "live", &live).unwrap(),
            tile_start: &Array::from_slice(&device, "tile_start", &tile_start).unwrap(),
        }),
    };
    // What another view has left there.
    maps.write(0, &vec![7.0; 3 * stride * rows]).unwrap();
    dimage.write(0, &vec![7.0; image.len()]).unwrap();
    loss.gradient(&pair, 0.2, &maps, &partial, &dimage).unwrap();
    loss.sum(&pair, &partial, &out, 0).unwrap();
    loss.errors(&pair, &maps, &partial).unwrap();
    let mut errors = maps.read(0, 2 * stride * rows).unwrap();
    // The padding says nothing.
    let inside = |at: usize| at % stride < w && at / stride % rows < h;
    (0..errors.len())
        .filter(|at| !inside(*at))
        .for_each(|at| errors[at] = 0.0);
    [out.to_vec().unwrap(), dimage.to_vec().unwrap(), errors]
}

#[test]
fn leaving_out_what_is_blank_changes_nothing_but_rounding() {
    for alpha in [Alpha::Transparency, Alpha::Mask] {
        for speck in [0.0, 0.1] {
            let [whole, skipped] = [false, true].map(|s| of_a_blank_picture(alpha, s, speck));
            for (a, b) in whole.iter().zip(&skipped) {
                let most = a.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
                let differs = |(a, b): (&f64, &f64)| (a - b).abs() > 1e-12 * most;
                assert!(!a.iter().zip(b).any(differs), "{alpha:?}, {speck}");
            }
            // A speck in what is blank has its gradient, if it counts.
            let at_speck = skipped[1][(112 + 70) * 304 + 230];
            let counts = speck > 0.0 && alpha == Alpha::Transparency;
            assert_eq!(at_speck != 0.0, counts, "{alpha:?}, {speck}");
            let far = |v: &[f64]| v[90 * 304 + 150];
            assert_eq!(far(&skipped[1]), 0.0);
            assert!(skipped[1][20 * 304 + 30] != 0.0);
        }
    }
}
