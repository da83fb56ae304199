//! loss: L1 + SSIM.

use super::*;
use std::ops::Range;

use mhsplat::capture::Alpha;
use mhsplat::device::{Array, ImageSize};
use mhsplat::pipeline::buffers::Blank;
use mhsplat::pipeline::photo_array::PhotoArray;
use mhsplat::pipeline::stage::active_tiles::mark;
use mhsplat::pipeline::stage::loss::{Beside, HALO, ImagePair, Loss, photo_rows};

#[test]
fn agrees_with_the_reference() {
    agrees("loss");
}

#[test]
fn a_wrong_gradient_is_rejected() {
    rejects("loss", "gradient", |d| {
        d.iter_mut().for_each(|d| *d *= 1.01)
    });
}

#[test]
fn flat_images_stay_finite() {
    for (level, background) in [(0u8, [0.0; 3]), (255, [1.0; 3]), (128, [0.5; 3])] {
        let mut case = cases::mild("flat", 3, [37, 21], 0, 34);
        case.splats.plane_mut(2).fill(-100.0);
        case.background = background;
        case.photo.data.fill(level);
        let out = run(Tuning::CPU, &case);
        assert!(out.got("loss", "gradient").iter().all(|d| d.is_finite()));
        let loss = out.got("loss", "L1, SSIM");
        assert!(
            loss[0] < 0.003 && (loss[1] - 1.0).abs() < 1e-3,
            "{level}: {loss:?}"
        );
    }
}

/// An image of this size in the tiles of a tuning.
fn sized(pixels: [usize; 2], tuning: Tuning) -> ImageSize {
    let tile = tuning.tile as usize;
    ImageSize { pixels, tile }
}

/// All rows of a photo.
fn whole(photo: &[u8], size: ImageSize) -> PhotoArray {
    let pixels = Array::from_slice(&device(), "photo", photo).unwrap();
    PhotoArray::whole(pixels, size)
}

/// A picture that is blank but for a corner and one pixel: render, photo with alpha or a mask, and which tiles are active and have pairs.
struct Blankish {
    image: Vec<f64>,
    photo: Vec<u8>,
    active_tiles: Vec<u32>,
    tile_start: Vec<u32>,
}

/// Width and height, padded and not, and the background.
const W: usize = 310;
const H: usize = 120;
const STRIDE: usize = 320;
const ROWS: usize = 128;
const BACKGROUND: [f32; 3] = [0.2, 0.4, 0.9];

fn blankish(speck: f64, edge: usize) -> Blankish {
    let corner = |x: usize, y: usize| x < 70 && y < 40;
    let (mut image, mut photo) = (vec![0.0; 3 * STRIDE * ROWS], vec![0u8; 4 * W * H]);
    for (at, x, y) in (0..W * H).map(|at| (at, at % W, at / W)) {
        for c in 0..3 {
            let value = &mut image[(c * ROWS + y) * STRIDE + x];
            *value = f64::from(BACKGROUND[c]);
            if corner(x, y) {
                photo[c * W * H + at] = ((at * (c + 3)) % 120) as u8;
                *value = ((at * (c + 7)) % 200) as f64 / 200.0;
            }
        }
        photo[3 * W * H + at] = if corner(x, y) { 127 } else { 0 };
    }
    image[(ROWS + 70) * STRIDE + 230] += speck;
    // A pair in every tile that has part of the corner or the speck.
    let across = STRIDE / edge;
    let tile = |t: usize| [t % across * edge, t / across * edge];
    let active_tiles: Vec<u32> = (0..across * ROWS / edge)
        .map(|t| u32::from(corner(tile(t)[0], tile(t)[1])))
        .collect();
    let mut tile_start = vec![0];
    for (t, active_tiles) in active_tiles.iter().enumerate() {
        let pairs = active_tiles + u32::from(speck > 0.0 && tile(t) == [224, 64]);
        tile_start.push(tile_start[t] + pairs);
    }
    Blankish {
        image,
        photo,
        active_tiles,
        tile_start,
    }
}

/// The maps of errors, those of the channels added up.
fn mean_errors(loss: &Loss<f64>, plane: usize) -> Vec<f64> {
    let maps = loss.error_maps().unwrap();
    let all = maps.read(0, loss.error_planes() * plane).unwrap();
    let mut sets = all.chunks_exact(2 * plane);
    let mut sum = sets.next().unwrap().to_vec();
    for set in sets {
        sum.iter_mut().zip(set).for_each(|(sum, v)| *sum += v);
    }
    sum
}

/// Results of the loss stage, the blank parts left out or not: L1 and SSIM, the gradient, and the maps of errors.
fn of_blankish(
    alpha: Alpha,
    skip_blank: bool,
    tuning: Tuning,
    picture: &Blankish,
) -> [Vec<f64>; 3] {
    let device = device();
    let defines = Defines {
        alpha,
        skip_blank,
        ..Defines::new(tuning)
    };
    let size = sized([W, H], tuning);
    assert_eq!(size.padded(), [STRIDE, ROWS]);
    let edge = size.tile;
    let loss = Loss::<f64>::new(&Kernels::new(&device, defines), size, true).unwrap();
    // What another view has left there.
    for used in [&loss.maps, &loss.partial, loss.error_maps().unwrap()] {
        used.write(0, &vec![7.0; used.len()]).unwrap();
    }
    let used = |name, len| Array::from_slice(&device, name, &vec![7.0; len]).unwrap();
    let (dimage, out) = (used("dimage", 3 * STRIDE * ROWS), used("losses", 2));
    let flags = |name, values: &[u32]| Array::from_slice(&device, name, values).unwrap();
    let (active_tiles, tile_start) = (
        flags("active_tiles", &picture.active_tiles),
        flags("tile_start", &picture.tile_start),
    );
    let pair = ImagePair {
        image: &Array::from_slice(&device, "image", &picture.image).unwrap(),
        photo: &whole(&picture.photo, size),
        background: BACKGROUND,
        size,
        band: 0..size.tiles()[1],
        blank: Some(Blank {
            active_tiles: &active_tiles,
            tile_start: &tile_start,
        }),
    };
    let beside = Beside {
        losses: Some((&out, 0)),
        errors: false,
    };
    loss.gradient(&pair, 0.2, &dimage, beside).unwrap();
    if loss.fuses() {
        // Errors are of everything, and take nothing from the gradient.
        let with_errors = used("dimage", 3 * STRIDE * ROWS);
        let also = Beside {
            losses: None,
            errors: true,
        };
        loss.gradient(&pair, 0.2, &with_errors, also).unwrap();
        let [got, want] = [&with_errors, &dimage].map(|image| image.to_vec().unwrap());
        let has_pairs = |at: usize| {
            let tile = at / STRIDE % ROWS / edge * (STRIDE / edge) + at % STRIDE / edge;
            picture.tile_start[tile] < picture.tile_start[tile + 1]
        };
        assert!((0..got.len()).all(|at| !has_pairs(at) || got[at].to_bits() == want[at].to_bits()));
        let beside = mean_errors(&loss, STRIDE * ROWS);
        loss.errors(&pair.clone().everywhere()).unwrap();
        assert_eq!(mean_errors(&loss, STRIDE * ROWS), beside);
    } else {
        loss.sum(&pair, &out, 0).unwrap();
    }
    loss.errors(&pair).unwrap();
    let mut errors = mean_errors(&loss, STRIDE * ROWS);
    // The padding says nothing.
    let inside = |at: usize| at % STRIDE < W && at / STRIDE % ROWS < H;
    (0..errors.len())
        .filter(|at| !inside(*at))
        .for_each(|at| errors[at] = 0.0);
    [out.to_vec().unwrap(), dimage.to_vec().unwrap(), errors]
}

/// The device's own, and others that cut an image otherwise.
fn strips() -> Vec<Tuning> {
    let cut = |(vector_width, block_width, strip)| Tuning {
        vector_width,
        block_width,
        strip,
        ..Tuning::CPU
    };
    let all = [(16, 4, 400), (16, 4, 48), (8, 4, 8), (4, 2, 24), (1, 1, 40)];
    let own = Tuning::for_device(device().info());
    // That of runs that began with it.
    let small = Tuning {
        tile: 16,
        strip: 400,
        ..Tuning::CPU
    };
    let others = [own, small, Tuning::GPU];
    all.into_iter().map(cut).chain(others).collect()
}

#[test]
fn leaving_out_what_is_blank_changes_nothing_but_rounding() {
    for (alpha, speck) in [
        (Alpha::Transparency, 0.0),
        (Alpha::Transparency, 0.1),
        (Alpha::Mask, 0.0),
        (Alpha::Mask, 0.1),
    ] {
        for tuning in strips() {
            let edge = tuning.tile as usize;
            let picture = blankish(speck, edge);
            let case = format!("{alpha:?}, {speck}, {tuning:?}");
            let of = |skip| of_blankish(alpha, skip, tuning, &picture);
            let [whole, skipped] = [false, true].map(of);
            for (a, b) in whole.iter().zip(&skipped) {
                let most = a.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
                let differs = |(a, b): (&f64, &f64)| (a - b).abs() > 1e-12 * most;
                assert!(!a.iter().zip(b).any(differs), "{case}");
            }
            // A speck in what is blank has its gradient, if it counts.
            let at_speck = skipped[1][(ROWS + 70) * STRIDE + 230];
            let counts = speck > 0.0 && alpha == Alpha::Transparency;
            assert_eq!(at_speck != 0.0, counts, "{case}");
            assert_eq!(skipped[1][90 * STRIDE + 150], 0.0, "{case}");
            // Where there are Gaussians, or may be, no bit changes.
            let active_tiles = |at: usize| {
                let tile = at / STRIDE % ROWS / edge * (STRIDE / edge) + at % STRIDE / edge;
                picture.active_tiles[tile] > 0
            };
            let same = |at: usize| whole[1][at].to_bits() == skipped[1][at].to_bits();
            assert!(
                (0..skipped[1].len()).all(|at| !active_tiles(at) || same(at)),
                "{case}"
            );
            assert!(skipped[1][20 * STRIDE + 30] != 0.0, "{case}");
        }
    }
}

/// Sums, and gradient and maps of errors without their padding, of two noisy pictures of this size, whose padding is noise in the render, too.
fn of_noise(tuning: Tuning, pixels: [usize; 2]) -> [Vec<f64>; 3] {
    let (device, size) = (device(), sized(pixels, tuning));
    let ([w, h], [stride, _]) = (size.pixels, size.padded());
    let (plane, pixels) = (size.plane(), size.pixels[0] * size.pixels[1]);
    let noise = |at: usize| {
        let (c, x, y) = (at / plane, at % stride, at % plane / stride);
        ((c * 91 + y * 53 + x * 37) % 251) as f64 / 200.0
    };
    let image: Vec<f64> = (0..3 * plane).map(noise).collect();
    let photo: Vec<u8> = (0..3 * pixels).map(|at| (at * 53 % 256) as u8).collect();
    let pair = ImagePair {
        image: &Array::from_slice(&device, "image", &image).unwrap(),
        photo: &whole(&photo, size),
        background: BACKGROUND,
        size,
        band: 0..size.tiles()[1],
        blank: None,
    };
    // Images of a run are of several sizes.
    let largest = sized(size.pixels.map(|side| side + 20), tuning);
    let kernels = Kernels::new(&device, Defines::new(tuning));
    let loss = Loss::<f64>::new(&kernels, largest, true).unwrap();
    let used = |name, len| Array::from_slice(&device, name, &vec![7.0; len]).unwrap();
    let (dimage, out) = (used("dimage", 3 * plane), used("losses", 2));
    let beside = Beside {
        losses: Some((&out, 0)),
        errors: true,
    };
    loss.gradient(&pair, 0.2, &dimage, beside).unwrap();
    let alone = Array::zeros(&device, "alone", 4).unwrap();
    loss.sum(&pair, &alone, 1).unwrap();
    let sums = alone.read(2, 2).unwrap();
    if loss.fuses() {
        // Beside the gradient there is what there is alone.
        assert_eq!(out.to_vec().unwrap(), sums);
        let beside = mean_errors(&loss, plane);
        loss.errors(&pair).unwrap();
        assert_eq!(mean_errors(&loss, plane), beside);
    }
    loss.errors(&pair).unwrap();
    let errors = mean_errors(&loss, plane);
    let inside = |at: &usize| at % stride < w && at % plane / stride < h;
    let cut =
        |all: Vec<f64>| -> Vec<f64> { (0..all.len()).filter(inside).map(|at| all[at]).collect() };
    let gradient = dimage.to_vec().unwrap();
    assert!((0..gradient.len()).all(|at| inside(&at) || gradient[at] == 0.0));
    [sums, cut(gradient), cut(errors)]
}

#[test]
fn every_cut_and_style_gives_the_same_gradient() {
    // Of whole tiles, padded, and smaller than the window.
    for size in [[320, 128], [75, 50], [17, 33], [7, 3]] {
        let mut tunings = strips().into_iter();
        let [sums, gradient, errors] = of_noise(tunings.next().unwrap(), size);
        for tuning in tunings {
            let case = format!("{size:?}, {tuning:?}");
            let [other_sums, other_gradient, other_errors] = of_noise(tuning, size);
            assert_eq!(gradient, other_gradient, "{case}");
            assert_eq!(errors, other_errors, "{case}");
            let differs = |(a, b): (&f64, &f64)| (a - b).abs() > 1e-13;
            assert!(!sums.iter().zip(&other_sums).any(differs), "{case}");
        }
    }
}

/// A noisy picture with blank tiles: render, photo with alpha or a mask, and first pairs of the tiles.
fn patchy(size: ImageSize) -> (Vec<f64>, Vec<u8>, Vec<u32>) {
    let ([w, h], [stride, rows]) = (size.pixels, size.padded());
    let (across, edge) = (size.tiles()[0], size.tile);
    let blank = |tile: usize| tile * 7 % 5 > 1;
    let (mut image, mut photo) = (vec![0.5; 3 * stride * rows], vec![0; 4 * w * h]);
    for (at, x, y) in (0..w * h).map(|at| (at, at % w, at / w)) {
        let noisy = !blank(y / edge * across + x / edge);
        for c in 0..3 {
            image[(c * rows + y) * stride + x] = match noisy {
                true => ((at * 37 + c * 11) % 251) as f64 / 200.0,
                false => f64::from(BACKGROUND[c]),
            };
        }
        for c in (0..4).filter(|_| noisy) {
            photo[c * w * h + at] = ((at * 53 + c * 29) % 120) as u8 + u8::from(c == 3);
        }
    }
    let mut tile_start = vec![0];
    for tile in 0..size.tile_count() {
        tile_start.push(tile_start[tile] + u32::from(!blank(tile)));
    }
    (image, photo, tile_start)
}

/// Results of a band, of some pixel rows of the photo: its gradient, its maps of errors, and the sums of its strips.
fn of_band(
    (alpha, tuning): (Alpha, Tuning),
    size: ImageSize,
    band: &Range<usize>,
    rows: &Range<usize>,
) -> [Vec<u64>; 3] {
    let device = device();
    let (image, photo, tile_start) = patchy(size);
    let ([w, h], plane) = (size.pixels, size.plane());
    let defines = Defines {
        alpha,
        skip_blank: alpha != Alpha::None,
        ..Defines::new(tuning)
    };
    let kernels = Kernels::new(&device, defines);
    let photo = whole(&photo[..alpha.planes() * w * h], size)
        .part(&device, [alpha.planes(), w], rows)
        .unwrap();
    assert_eq!(photo.len(), alpha.planes() * w * rows.len());
    let tiles = match alpha {
        Alpha::None => Array::zeros(&device, "active_tiles", size.tile_count()).unwrap(),
        _ => {
            let stage = kernels.build::<f32>("active_tiles").unwrap();
            mark(&device, &stage, (&photo, rows), size).unwrap()
        }
    };
    let pair = ImagePair {
        image: &Array::from_slice(&device, "image", &image).unwrap(),
        photo: &photo,
        background: BACKGROUND,
        size,
        band: band.clone(),
        blank: Some(Blank {
            active_tiles: &tiles,
            tile_start: &Array::from_slice(&device, "tile_start", &tile_start).unwrap(),
        }),
    };
    let loss = Loss::<f64>::new(&kernels, size, true).unwrap();
    let dimage = Array::from_slice(&device, "dimage", &vec![7.0; 3 * plane]).unwrap();
    loss.gradient(&pair, 0.2, &dimage, Beside::NOTHING).unwrap();
    let strips = loss.read_strips(size).unwrap();
    loss.errors(&pair).unwrap();
    let errors = mean_errors(&loss, plane);
    let stride = size.padded()[0];
    let within = |at: &usize| band.contains(&(at % plane / stride / size.tile));
    let rows = |values: &[f64]| -> Vec<u64> {
        let own = (0..values.len()).filter(within);
        own.map(|at| values[at].to_bits()).collect()
    };
    let sums = loss.places(size, band).map(|place| &strips[place]).concat();
    [
        rows(&dimage.to_vec().unwrap()),
        rows(&errors),
        sums.iter().map(|v| v.to_bits()).collect(),
    ]
}

#[test]
fn a_band_needs_no_more_of_a_photo_than_its_rows() {
    const HEIGHT: usize = 203;
    for alpha in [Alpha::None, Alpha::Transparency, Alpha::Mask] {
        for tuning in strips() {
            let size = sized([75, HEIGHT], tuning);
            let (end, tile) = (size.tiles()[1], size.tile);
            let middle = 3..end - 2;
            for band in [0..2, 2..3, middle.clone(), end - 2..end, 4..4, 0..end] {
                let case = format!("{alpha:?}, {tuning:?}, {band:?}");
                let of = |rows| of_band((alpha, tuning), size, &band, &rows);
                let rows = photo_rows(&band, size);
                assert_eq!(rows.len() < HEIGHT, band != (0..end), "{case}");
                let want = of(0..HEIGHT);
                assert!(of(rows) == want, "{case}");
                if band != middle || alpha != Alpha::None {
                    continue;
                }
                // With alpha whole tiles say what is blank; else the two windows see these, and every one of them.
                let [first, end] = [middle.start * tile - HALO, middle.end * tile + HALO];
                assert!(of(first..end) == want, "{case}");
                assert!(of(first + 1..end)[0] != want[0], "{case}");
                assert!(of(first..end - 1)[0] != want[0], "{case}");
            }
        }
    }
}
