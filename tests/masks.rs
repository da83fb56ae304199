//! Masks beyond training: scores, births, error pictures, and scenes that are looked at without their run.

mod pictures;

use crate::determinism::{room, trained};
use mhsplat::Plan;
use mhsplat::TrainConfig;
use mhsplat::base::constants::FLIP_PIXELS_PER_DEGREE;
use mhsplat::capture::{Alpha, Dataset, Photo, PhotoSource, View};
use mhsplat::config::{OptimizerConfig, Sampler};
use mhsplat::device::{Defines, Device};
use mhsplat::evaluate::{Evaluator, ViewScore};
use mhsplat::pipeline::buffers::ViewSet;
use mhsplat::pipeline::forward::Renders;
use mhsplat::pipeline::photos::Photos;
use mhsplat::pipeline::stage::flip::error_map;
use mhsplat::pipeline::stage::loss::loss;
use mhsplat::pipeline::stage::metrics::sum_counted;
use mhsplat::scene::Plane;

fn config(iterations: u32) -> TrainConfig {
    TrainConfig {
        sampler: Sampler::None,
        iterations,
        sh_degree: 0,
        seed: 2,
        ..TrainConfig::default()
    }
}

/// A view whose photo counts as far as `mask` says of each pixel.
fn masked(view: &View, mask: impl Fn(u32, u32) -> u8) -> View {
    let photo = view.photo.load().unwrap();
    let rgb = photo.rgb_over([0.0; 3]);
    let pixel = |i: usize| (i as u32 % photo.width, i as u32 / photo.width);
    let bytes = rgb.chunks_exact(3).enumerate().flat_map(|(i, p)| {
        let (x, y) = pixel(i);
        [p[0], p[1], p[2], mask(x, y)]
    });
    let bytes: Vec<u8> = bytes.collect();
    let photo = Photo::from_interleaved(photo.width, photo.height, Alpha::Mask, &bytes).unwrap();
    View {
        photo: PhotoSource::from(photo),
        ..view.clone()
    }
}

fn every_view(data: &Dataset, mask: impl Fn(u32, u32) -> u8) -> Dataset {
    let all = |views: &[View]| views.iter().map(|v| masked(v, &mask)).collect();
    Dataset {
        train: all(&data.train),
        test: all(&data.test),
        ..data.clone()
    }
}

/// Scores of a scene that ten iterations on the bundled room leave, over these views, and its render of the first of them.
fn scores(views: &[View]) -> (Vec<ViewScore>, Vec<f32>) {
    let (mut trainer, _) = trained(&room(96), &config(10), 10);
    let device = Device::open(None).unwrap();
    let photos = Photos::new(&device, u64::MAX);
    let views = ViewSet::new(&photos, views.iter().cloned()).unwrap();
    let evaluator = Evaluator::new(&device, Defines::new(device.tuning()), views).unwrap();
    let scene = &mut trainer;
    let mut scores = evaluator.score_all(scene, [0.0; 3], true).unwrap();
    evaluator
        .add_color_corrected(&mut scores, scene, [0.0; 3])
        .unwrap();
    evaluator.score(0, &[], scene, [0.0; 3]).unwrap();
    (scores, scene.renderer().read_image().unwrap().rgb)
}

/// Photos of which the left is white or black, and a mask that leaves it out.
fn two_paints(data: &Dataset, mask: impl Fn(u32, u32) -> u8) -> [Vec<View>; 2] {
    [0, 255].map(|paint| {
        let painted = data.test.iter().map(|view| {
            let mut photo = (*view.photo.load().unwrap()).clone();
            let n = (photo.width * photo.height) as usize;
            for i in 0..n {
                let (x, y) = (i as u32 % photo.width, i as u32 / photo.width);
                if mask(x, y) == 0 {
                    (0..3).for_each(|c| photo.data[c * n + i] = paint);
                }
            }
            let view = View {
                photo: photo.into(),
                ..view.clone()
            };
            masked(&view, &mask)
        });
        painted.collect()
    })
}

#[test]
fn no_bit_of_a_score_depends_on_what_lies_under_a_mask() {
    let data = room(96);
    let mask = |x: u32, _| if x < 40 { 0 } else { 255 };
    let [black, white] = two_paints(&data, mask).map(|views| scores(&views).0);
    assert_eq!(black, white);
    assert_eq!(black.len(), data.test.len());
    assert!(
        black
            .iter()
            .all(|s| s.scores.flip.is_some() && s.scores.cc_ssim.is_some())
    );
    let whole = scores(&data.test).0;
    assert!(
        whole
            .iter()
            .zip(&black)
            .all(|(w, b)| w.scores.ssim != b.scores.ssim)
    );
}

#[test]
fn scores_are_means_over_what_counts() {
    let data = room(96);
    // All of it, a slope, and a box smaller than a window.
    let masks: [fn(u32, u32) -> u8; 3] = [
        |_, _| 255,
        |x, y| (5 * x).saturating_sub(2 * y).min(255) as u8,
        |x, y| {
            if (50..53).contains(&x) && (30..34).contains(&y) {
                255
            } else {
                0
            }
        },
    ];
    for mask in masks {
        let view = masked(&data.test[0], mask);
        let photo = view.photo.load().unwrap();
        let (w, h) = (photo.width as usize, photo.height as usize);
        let n = w * h;
        let (scores, image) = scores(&[view]);
        let m: Vec<f64> = photo.data[3 * n..]
            .iter()
            .map(|v| f64::from(*v) / 255.0)
            .collect();
        let x: Vec<f64> = (0..3 * n).map(|i| m[i % n] * f64::from(image[i])).collect();
        let y: Vec<f64> = photo.data[..3 * n]
            .iter()
            .map(|v| f64::from(*v) / 255.0)
            .collect();
        let twin = loss(&x, &y, [w, h], 0.2);
        let all: f64 = m.iter().sum();
        let ssim = 1.0 - sum_counted(&twin.ssim_error, Some(&m)) / all;
        let squared: f64 = x.iter().zip(&y).map(|(x, y)| (x - y) * (x - y)).sum();
        let psnr = -10.0 * (squared / (3.0 * all)).log10();
        let score = &scores[0].scores;
        println!(
            "{all:.0} pixels: {:.2} dB, SSIM {:.4}",
            score.psnr, score.ssim
        );
        assert!((score.ssim - ssim).abs() < 1e-5, "{} {ssim}", score.ssim);
        assert!((score.psnr - psnr).abs() < 1e-3, "{} {psnr}", score.psnr);
        assert!((-1.0..1.0).contains(&score.ssim));
        let map = error_map(&y, &x, [w, h], FLIP_PIXELS_PER_DEGREE);
        let flip = sum_counted(&map, Some(&m)) / all;
        let got = score.flip.unwrap();
        assert!((got - flip).abs() < 1e-5, "{got} {flip}");
    }
    let nothing = scores(&[masked(&data.test[0], |_, _| 0)]).0;
    assert!(
        nothing.is_empty(),
        "a view of which nothing counts has no score"
    );
}

#[test]
fn what_a_mask_halves_keeps_its_colour() {
    let bytes = [200, 100, 50, 128, 200, 100, 50, 255, 200, 100, 50, 0];
    let photo = Photo::from_interleaved(3, 1, Alpha::Mask, &bytes).unwrap();
    // Within what eight bits of a half leave.
    let shown = photo.shown([1.0; 3]);
    for (got, wanted) in shown.iter().zip([200, 100, 50, 200, 100, 50, 0, 0, 0]) {
        assert!(got.abs_diff(wanted) <= 1, "{shown:?}");
    }
    assert_eq!(
        photo.rgb_over([1.0; 3]),
        [100, 50, 25, 200, 100, 50, 0, 0, 0]
    );
    assert_eq!(
        photo.counted(vec![200, 100, 50, 10, 20, 30, 7, 8, 9]),
        [100, 50, 25, 10, 20, 30, 0, 0, 0]
    );
    let open = Photo::from_interleaved(1, 1, Alpha::Transparency, &[200, 100, 50, 0]).unwrap();
    assert_eq!(open.shown([1.0, 0.5, 0.0]), [255, 128, 0]);
    assert_eq!(open.counted(vec![1, 2, 3]), [1, 2, 3]);
}

/// Mean of the first band of what is born at pixels in the first density steps; nothing else changes.
fn births(data: &Dataset) -> f64 {
    let mut config = TrainConfig {
        sampler: Sampler::Mh,
        optimizer: OptimizerConfig {
            lr_position: 0.0,
            lr_position_final: 0.0,
            lr_sh0: 0.0,
            lr_sh: 0.0,
            lr_opacity: 0.0,
            lr_scale: 0.0,
            lr_rotation: 0.0,
            ..OptimizerConfig::default()
        },
        ..config(90)
    };
    config.mh.coarse_proposals = 0;
    config.mh.fine_proposals = 0;
    config.mh.births_from_iteration = Some(0);
    config.mh.deaths_until_iteration = 0;
    (config.mh.relocation, config.mh.turnover) = (false, 0.0);
    config.mh.noise_rate = 0.0;
    config.work.morton_order = false;
    config.work.resolution_levels = 0;
    let before = mhsplat::run::initial_gaussians(data, &Plan::new(data, &config).unwrap())
        .unwrap()
        .len();
    let (_, splats) = trained(data, &config, 51);
    let born = splats.len() - before;
    assert!(born > 100, "{born} births");
    let sh: f64 = splats.planes()[Plane::SH..Plane::SH + 3]
        .iter()
        .flat_map(|plane| &plane[before..])
        .map(|v| f64::from(*v))
        .sum();
    sh / (3 * born) as f64
}

#[test]
fn births_take_the_photos_colour_where_a_mask_is_soft() {
    let data = room(64);
    let [whole, half, dark] = [255, 128, 40].map(|m| births(&every_view(&data, |_, _| m)));
    println!(
        "mean of the first band at births: {whole:.3}, half masked {half:.3}, mostly {dark:.3}"
    );
    // A colour multiplied by 1/2 would be lower by about 0.25/0.28.
    assert!((half - whole).abs() < 0.15, "{half} {whole}");
    assert!((dark - whole).abs() < 0.25, "{dark} {whole}");
}
