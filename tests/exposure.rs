//! Per-image exposure: photos of different brightness.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use crate::cli::{done, mhsplat, stderr, text};
use crate::determinism::{drive, room, saved};
use mhsplat::Plan;
use mhsplat::capture::{Alpha, Dataset, LoadOptions, load};
use mhsplat::config::ExposureChoice;
use mhsplat::device::{Defines, Device};
use mhsplat::evaluate::Evaluator;
use mhsplat::evaluate::color::{corrected, fit};
use mhsplat::pipeline::buffers::ViewSet;
use mhsplat::pipeline::photos::Photos;
use mhsplat::pipeline::stage::exposure::{exposed, unexposed};
use mhsplat::run::{Clock, Progress, Run, RunRecord, checkpoint, initial_gaussians};
use mhsplat::run::{FinalRecord, PlanRecord};
use mhsplat::train::brightness::{GainSpread, compared, gain, spread};
use mhsplat::train::reasons::Why;
use mhsplat::{TrainConfig, Trainer};

/// Gains of photos: so much as in a set taken with automatic exposure.
const MILD: [f64; 2] = [0.7, 1.3];
/// So much that transforms are worth far more than the seeds' spread.
const STRONG: [f64; 2] = [0.4, 1.2];

/// Gain of the k-th photo, within `range` in no order.
fn true_gain(range: [f64; 2], k: usize) -> f64 {
    range[0] + (range[1] - range[0]) * ((k * 7) % 13) as f64 / 12.0
}

fn copy_folder(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy_folder(&path, &target);
        } else {
            std::fs::copy(&path, &target).unwrap();
        }
    }
}

/// The bundled scene in `folder`, its photos brightened and darkened; their names in the order of their gains.
fn alter(folder: &Path, range: [f64; 2]) -> Vec<PathBuf> {
    copy_folder(
        &Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny"),
        folder,
    );
    let files = std::fs::read_dir(folder.join("images")).unwrap();
    let mut files: Vec<_> = files.map(|f| f.unwrap().path()).collect();
    files.sort();
    for (k, file) in files.iter().enumerate() {
        let mut photo = image::open(file).unwrap().to_rgb8();
        for v in photo.iter_mut() {
            *v = (f64::from(*v) * true_gain(range, k)).round().min(255.0) as u8;
        }
        photo.save(file).unwrap();
    }
    files
}

/// What [`alter`] makes, at `max_size`; with the gain of each training view.
fn altered(max_size: u32, range: [f64; 2]) -> (Dataset, Vec<f64>) {
    let folder = tempfile::tempdir().unwrap();
    let files = alter(folder.path(), range);
    let options = LoadOptions {
        max_size,
        ..LoadOptions::default()
    };
    let data = load(folder.path(), &options).unwrap();
    let at = |name: &str| {
        let is = |f: &std::path::PathBuf| f.ends_with(name);
        files.iter().position(is).unwrap()
    };
    let gains = data.train.iter().map(|v| true_gain(range, at(&v.name)));
    let gains = gains.collect();
    (data, gains)
}

fn config(iterations: u32, exposure: ExposureChoice) -> TrainConfig {
    TrainConfig {
        iterations,
        max_size: 96,
        sh_degree: 1,
        seed: 5,
        exposure,
        ..TrainConfig::default()
    }
}

fn trainer(data: &Dataset, config: &TrainConfig) -> Trainer {
    let device = Device::open(None).unwrap();
    let splats = initial_gaussians(data, &Plan::new(data, config).unwrap()).unwrap();
    Trainer::new(&device, data, &Plan::new(data, config).unwrap(), &splats).unwrap()
}

fn trained(data: &Dataset, config: &TrainConfig, until: u32) -> Trainer {
    let mut trainer = trainer(data, config);
    drive(&mut trainer, until).unwrap();
    trainer
}

/// Colour-corrected PSNR of the held-out views.
fn corrected_psnr(data: &Dataset, trainer: &mut Trainer) -> f64 {
    let device = Device::open(None).unwrap();
    let views = ViewSet::new(&Photos::new(&device, data.image_budget), data.test.clone()).unwrap();
    let evaluator = Evaluator::new(&device, Defines::new(device.tuning()), views).unwrap();
    let background = trainer.schedule().fixed_background();
    let mut scores = evaluator.score_all(trainer, background, false).unwrap();
    evaluator
        .add_color_corrected(&mut scores, trainer, background)
        .unwrap();
    for s in scores.iter().map(|v| &v.scores) {
        assert!(s.cc_psnr.unwrap() > s.psnr - 0.05, "{s:?}");
    }
    FinalRecord::of(scores).unwrap().mean.cc_psnr.unwrap()
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (ma, mb) = (mean(a), mean(b));
    let sum = |f: &dyn Fn(f64, f64) -> f64| -> f64 {
        a.iter().zip(b).map(|(a, b)| f(a - ma, b - mb)).sum()
    };
    sum(&|a, b| a * b) / (sum(&|a, _| a * a) * sum(&|_, b| b * b)).sqrt()
}

#[test]
fn altered_photos_are_learned_better_and_their_gains_found() {
    let (data, gains) = altered(96, STRONG);
    let [mut with, mut without] = [ExposureChoice::On, ExposureChoice::Off]
        .map(|choice| trained(&data, &config(600, choice), 600));
    // What a transform makes of grey.
    let exposures = with.exposures().unwrap();
    let found: Vec<f64> = exposures[0]
        .chunks_exact(12)
        .map(|e| exposed(e, [0.5; 3]).iter().map(|v| f64::from(*v)).sum())
        .collect();
    let alike = correlation(&found, &gains);
    let [on, off] = [&mut with, &mut without].map(|t| corrected_psnr(&data, t));
    println!(
        "colour-corrected PSNR {on:.2} dB with, {off:.2} dB without; gains correlate by {alike:.4}"
    );
    assert!(alike > 0.95, "{alike}");
    // 1.6 to 1.9 dB with three seeds.
    assert!(on >= off + 1.0, "{on} {off}");
}

/// The record of a run of 500 iterations with everything left open, and the seconds that the training clock stood: in iteration 301, and in
/// the others (median).
fn decided(data: Dataset) -> (RunRecord, [f64; 2]) {
    let folder = tempfile::tempdir().unwrap();
    let device = Device::open(None).unwrap();
    let mut config = config(500, ExposureChoice::Auto);
    config.eval_every = Some(0);
    let clock = Clock::start();
    let mut run = Run::start(folder.path(), data, config, &device, clock).unwrap();
    let (mut before, mut deciding, mut others) = ((Instant::now(), 0.0), 0.0, Vec::new());
    let clocks = |p: &Progress| {
        let now = (Instant::now(), p.train_seconds);
        let stood = (now.0 - before.0).as_secs_f64() - (now.1 - before.1);
        match p.iteration {
            301 => deciding = stood,
            _ => others.push(stood),
        }
        before = now;
    };
    run.drive(&AtomicBool::new(false), clocks).unwrap();
    let read = RunRecord::read(folder.path()).unwrap();
    assert_eq!(read.plan, run.record().plan);
    others.sort_by(f64::total_cmp);
    (read, [deciding, others[others.len() / 2]])
}

#[test]
fn it_is_switched_on_where_brightness_varies_and_nowhere_else() {
    let (record, [stood, other]) = decided(altered(96, MILD).0);
    // Its kernels are built before that iteration: half a millisecond where another test has built them on this device.
    println!("the training clock stood for {stood:.6} s, else {other:.6} s");
    assert!(stood > f64::max(1e-5, 5.0 * other), "{stood} {other}");
    let find = |list: &[mhsplat::run::Item]| {
        let mut items = list.iter().filter(|i| i.what == "per-image exposure");
        (items.next().map(|i| i.why.clone()), items.count())
    };
    let kept = find(&record.plan.kept);
    println!("{kept:?}");
    assert!(kept.0.unwrap().contains("after 300 iterations") && kept.1 == 0);
    assert!(find(&record.plan.left_out).0.is_none());
    let scores = record.final_scores.unwrap().mean;
    assert!(scores.cc_psnr.unwrap() > scores.psnr && scores.cc_ssim.is_some());
    assert!(record.stages.iter().any(|s| s.name == "exposure"));
    let (record, _) = decided(room(96));
    let left = find(&record.plan.left_out);
    println!("{left:?}");
    assert!(left.0.unwrap().contains("spread") && find(&record.plan.kept).0.is_none());
    assert!(record.final_scores.unwrap().mean.cc_psnr.is_none());
    assert!(record.stages.iter().all(|s| s.name != "exposure"));
}

#[test]
fn where_it_is_off_nothing_of_it_runs_and_no_bit_changes() {
    let data = room(64);
    let run = |choice| {
        let mut trainer = trainer(&data, &config(360, choice));
        trainer.time_every_iteration();
        drive(&mut trainer, 320).unwrap();
        let stages: Vec<&str> = trainer.stage_times().iter().map(|s| s.0).collect();
        (
            trainer.state().unwrap().splats,
            stages.contains(&"exposure"),
            trainer.learned().gains,
        )
    };
    let off = run(ExposureChoice::Off);
    assert!(!off.1 && off.2.is_none());
    let auto = run(ExposureChoice::Auto);
    assert!(!auto.1 && !auto.2.unwrap().varies(), "{:?}", auto.2);
    assert!(auto.0 == off.0, "looking must change nothing");
    let on = run(ExposureChoice::On);
    assert!(on.1 && on.0 != off.0);
}

/// The altered scene with the left eighth of its photos transparent.
fn cut_out(folder: &Path) {
    for file in alter(folder, MILD) {
        let mut photo = image::open(&file).unwrap().to_rgba8();
        let edge = photo.width() / 8;
        for (x, _, pixel) in photo.enumerate_pixels_mut() {
            pixel[3] = if x < edge { 0 } else { 255 };
        }
        photo.save(&file).unwrap();
    }
}

#[test]
fn transparent_photos_get_no_transforms_and_masked_ones_do() {
    let folder = tempfile::tempdir().unwrap();
    cut_out(folder.path());
    let read = |alpha_is_mask| {
        let options = LoadOptions {
            max_size: 64,
            alpha_is_mask,
            ..LoadOptions::default()
        };
        load(folder.path(), &options).unwrap()
    };
    let [transparent, masked] = [false, true].map(read);
    assert_eq!(
        (transparent.alpha(), masked.alpha()),
        (Alpha::Transparency, Alpha::Mask)
    );
    let auto = config(360, ExposureChoice::Auto);
    let looked = trained(&masked, &auto, 301);
    assert!(looked.learned().gains.unwrap().varies() && looked.compensates_exposure());
    let left = trained(&transparent, &auto, 301);
    assert!(left.learned().gains.is_none() && !left.compensates_exposure());
    let why = |data: &Dataset| {
        let items = PlanRecord::of(&Plan::new(data, &auto).unwrap()).left_out;
        let mut items = items.iter().filter(|i| i.what == "per-image exposure");
        items.next().unwrap().why.clone()
    };
    assert!(why(&transparent).contains("transparent photos"));
    assert!(why(&masked).contains("compared with their renders"));
}

#[test]
fn exposure_of_transparent_photos_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, run) = (folder.path().join("photos"), folder.path().join("run"));
    cut_out(&photos);
    let base = ["train", text(&photos), "-o", text(&run), "--exposure", "on"];
    let base = [&base[..], &["--iterations", "3", "--max-size", "64"]].concat();
    let refused = mhsplat(&base);
    let said = stderr(&refused);
    assert_eq!(refused.status.code(), Some(2), "{said}");
    for word in ["--exposure", "transparent", "--alpha-is-mask"] {
        assert!(said.contains(word), "{word}: {said}");
    }
    assert!(!run.exists(), "a refused run left its folder");
    done(&[&base[..], &["--alpha-is-mask"]].concat());
}

#[test]
fn a_resumed_run_with_exposures_ends_with_the_same_bits() {
    let (data, _) = altered(64, MILD);
    let device = Device::open(None).unwrap();
    // Before it begins, when that is due next, and after.
    for (choice, iterations, stops) in [
        (ExposureChoice::On, 200, [33, 40, 73]),
        (ExposureChoice::Auto, 1500, [290, 300, 310]),
    ] {
        let config = config(iterations, choice);
        let until = stops[2] + 30;
        let mut whole = trained(&data, &config, until);
        assert!(whole.compensates_exposure());
        let (splats, rows) = (whole.state().unwrap().splats, whole.exposures().unwrap());
        assert!(rows.iter().all(|r| r.iter().any(|v| *v != 0.0)));
        for stop in stops {
            let mut part = trained(&data, &config, stop);
            let folder = tempfile::tempdir().unwrap();
            checkpoint::write(folder.path(), &saved(&mut part, &config, &data)).unwrap();
            drop(part);
            let state = checkpoint::read(folder.path()).unwrap().state;
            let mut resumed = Trainer::new(
                &device,
                &data,
                &Plan::new(&data, &config).unwrap(),
                &state.splats,
            )
            .unwrap();
            resumed.restore(&state).unwrap();
            drive(&mut resumed, until).unwrap();
            assert!(
                splats == resumed.state().unwrap().splats,
                "{choice:?} {stop}"
            );
            assert!(rows == resumed.exposures().unwrap(), "{choice:?} {stop}");
            assert_eq!(whole.learned(), resumed.learned());
        }
    }
}

#[test]
fn pairs_that_do_not_fit_step_no_exposure_twice() {
    let (data, _) = altered(64, MILD);
    let config = config(60, ExposureChoice::On);
    let mut roomy = trained(&data, &config, 40);
    let mut tight = trainer(&data, &config);
    tight.shrink_intersections(1024).unwrap();
    drive(&mut tight, 40).unwrap();
    assert!(tight.overflows() > 0);
    assert!(roomy.exposures().unwrap() == tight.exposures().unwrap());
    assert!(roomy.state().unwrap().splats == tight.state().unwrap().splats);
}

#[test]
fn exposures_of_another_shape_are_refused() {
    let data = room(64);
    let mut with = trained(&data, &config(60, ExposureChoice::On), 20);
    let state = with.state().unwrap();
    let off = config(60, ExposureChoice::Off);
    let device = Device::open(None).unwrap();
    let mut without = Trainer::new(
        &device,
        &data,
        &Plan::new(&data, &off).unwrap(),
        &state.splats,
    )
    .unwrap();
    let said = without.restore(&state).unwrap_err().to_string();
    assert!(said.contains("exposures of another shape"), "{said}");
}

/// Gains found in a render of 100 pixels and its photo, a tenth of which is far off.
fn seen(gains: [f32; 3]) -> [f64; 3] {
    let render: Vec<f32> = (0..300).map(|i| 0.1 + 0.005 * (i % 100) as f32).collect();
    let of = |c: usize, i: usize| {
        if i % 10 == 3 {
            0.9
        } else {
            gains[c] * render[c * 100 + i]
        }
    };
    let photo = [0, 1, 2].map(|c| (0..100).map(|i| of(c, i)).collect());
    gain(&render, &[0.0; 100], &photo).unwrap()
}

#[test]
fn gains_are_found_under_outliers_and_their_spread_decides() {
    let got = seen([0.8, 1.0, 1.25]);
    for (got, want) in got.iter().zip([0.8, 1.0, 1.25]) {
        assert!((got - want).abs() < 0.01, "{got} {want}");
    }
    let grey = [0, 1, 2].map(|_| vec![0.5; 100]);
    assert!(
        gain(&[0.5; 300], &[1.0; 100], &grey).is_none(),
        "background alone"
    );
    let at = |k: i32| (0.1 * f64::from(k)).exp();
    let gains: Vec<[f64; 3]> = (-2..=2).map(|k| [at(k), 1.0, at(k)]).collect();
    let got = spread(&gains).unwrap();
    assert!((got - 0.148_26 * 2.0 / 3.0).abs() < 1e-9, "{got}");
    assert!(spread(&gains[..3]).is_none());
    let varied = GainSpread::new(7, &gains);
    assert!(varied.varies(), "{varied:?}");
    assert!(Why::Gains(varied).to_string().contains("9.9 %"));
    assert!(!GainSpread::new(7, &[[1.0; 3]; 8]).varies());
    assert_eq!(compared(10, 250), [0, 2, 4, 6, 8]);
    assert_eq!(compared(1000, 30_000).len(), 64);
}

#[test]
fn transforms_are_fitted_applied_and_undone() {
    let e = [
        0.8, 0.1, 0.0, 0.05, 0.0, 1.1, -0.1, 0.02, 0.05, 0.0, 0.9, -0.03,
    ];
    let render: Vec<f32> = (0..300)
        .map(|i| ((i * 7919) % 101) as f32 / 101.0)
        .collect();
    let got = fit(&render, &corrected(&render, &e), &[]);
    for (got, want) in got.iter().zip(e) {
        assert!((got - want).abs() < 1e-3, "{got} {want}");
    }
    let flat = fit(&[0.0; 30], &[0.5; 30], &[]);
    assert!(flat.iter().all(|v| v.is_finite()) && (flat[3] - 0.5).abs() < 1e-3);
    let (e, x) = (e.map(|v| v as f32), [0.2, 0.5, 0.7]);
    let back = unexposed(&e, exposed(&e, x));
    assert!(back.iter().zip(x).all(|(b, x)| (b - x).abs() < 1e-5));
    assert_eq!(unexposed(&[0.0; 12], x), x);
}
