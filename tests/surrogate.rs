//! The check of the surrogate: rank statistics by hand, estimates against differences of the loss, and the command.

use std::fs;
use std::path::PathBuf;

use crate::cli::{done, mhsplat, room, stderr, text};
use crate::determinism;
use mhsplat::Plan;
use mhsplat::base::rng::{Philox, Stream};
use mhsplat::config::TrainConfig;
use mhsplat::device::Device;
use mhsplat::lab::stats::quantile;
use mhsplat::lab::surrogate::rank::{kendall, ranks, spearman, with_interval};
use mhsplat::lab::surrogate::{Base, Birth, Instrument, Setting, Shape};
use mhsplat::pipeline::buffers::ViewSet;
use mhsplat::pipeline::forward::{Quantity, RenderOptions};
use mhsplat::pipeline::photos::Photos;
use mhsplat::run::initial_gaussians;
use mhsplat::scene::Plane;
use mhsplat::{Gaussians, Trainer};

fn close(a: Option<f64>, b: f64) -> bool {
    a.is_some_and(|a| (a - b).abs() < 1e-12)
}

#[test]
fn rank_correlations_by_hand_with_ties() {
    let (x, y) = ([1.0, 2.0, 2.0, 3.0, 4.0], [1.0, 3.0, 2.0, 2.0, 5.0]);
    assert_eq!(ranks(&x), [1.0, 2.5, 2.5, 4.0, 5.0]);
    assert_eq!(ranks(&y), [1.0, 4.0, 2.5, 2.5, 5.0]);
    // Deviations of the ranks: Σxy = 7.25, Σxx = Σyy = 9.5.
    assert!(close(spearman(&x, &y), 7.25 / 9.5));
    // Of 10 pairs 7 agree, 1 disagrees, 1 is tied in x, 1 in y.
    assert!(close(kendall(&x, &y), 6.0 / 9.0));
    let back = y.map(|v| -v);
    assert!(close(kendall(&x, &back), -6.0 / 9.0));
    // Another order is another figure: the comparison can fail.
    let other = [3.0, 1.0, 2.0, 2.0, 5.0];
    assert!(!close(spearman(&x, &other), 7.25 / 9.5));
    assert!(!close(kendall(&x, &other), 6.0 / 9.0));
}

#[test]
fn rank_correlations_without_an_answer_have_none() {
    for f in [spearman, kendall] {
        assert_eq!(f(&[], &[]), None);
        assert_eq!(f(&[1.0], &[2.0]), None);
        assert_eq!(f(&[1.0, 1.0, 1.0], &[1.0, 2.0, 3.0]), None);
        assert_eq!(f(&[1.0, 2.0], &[1.0]), None);
        assert_eq!(f(&[1.0, 2.0], &[0.0, -0.0]), None);
    }
    assert_eq!(quantile(&[], 0.5), None);
    assert_eq!(quantile(&[1.0, 2.0, 4.0], 0.75), Some(3.0));
}

/// τ_b from its definition, pair by pair.
fn kendall_by_pairs(x: &[f64], y: &[f64]) -> f64 {
    let (mut score, mut in_x, mut in_y) = (0.0, 0.0, 0.0);
    let sign = |a: f64, b: f64| f64::from(i8::from(a > b) - i8::from(a < b));
    for i in 0..x.len() {
        for j in 0..i {
            let (dx, dy) = (sign(x[i], x[j]), sign(y[i], y[j]));
            score += dx * dy;
            in_x += dx * dx;
            in_y += dy * dy;
        }
    }
    score / (in_x * in_y).sqrt()
}

#[test]
fn kendall_counts_as_its_definition_does() {
    let values = |stream: u32, levels: f64| -> Vec<f64> {
        let stream = Stream::Synthetic.stream(stream);
        let draw = |i: u64| (levels * Philox::uniform(5, stream, i)[0]).floor();
        (0..97).map(draw).collect()
    };
    for levels in [3.0, 20.0, 1e6] {
        let (x, y) = (values(40, levels), values(41, levels));
        let mixed: Vec<f64> = x.iter().zip(&y).map(|(a, b)| a + 0.5 * b).collect();
        assert!(close(kendall(&x, &y), kendall_by_pairs(&x, &y)));
        assert!(close(kendall(&x, &mixed), kendall_by_pairs(&x, &mixed)));
    }
}

#[test]
fn an_interval_holds_its_value_and_repeats() {
    let stream = Stream::Synthetic.stream(42);
    let draw = |i: u64| Philox::normal(3, stream, i);
    let (x, y): (Vec<f64>, Vec<f64>) = (0..200).map(draw).map(|v| (v[0], v[0] + v[1])).unzip();
    let e = with_interval(spearman, &x, &y, 1, 2).unwrap();
    assert!(e.low < e.value && e.value < e.high);
    // ρ of two such normals is 0.69; the interval of 200 pairs is about 0.16 wide.
    assert!((0.55..0.8).contains(&e.value));
    assert!((0.08..0.25).contains(&(e.high - e.low)));
    assert_eq!(with_interval(spearman, &x, &y, 1, 2), Some(e));
    assert_ne!(with_interval(spearman, &x, &y, 2, 2), Some(e));
}

/// A room half-way learned, and an instrument over three of its views with a cut so low that the loss is smooth.
fn instrument() -> (Instrument<f64>, Base, Gaussians) {
    let data = determinism::room(64);
    let config = TrainConfig {
        iterations: 300,
        max_size: 64,
        ..TrainConfig::default()
    };
    let device = Device::open(None).unwrap();
    let first = initial_gaussians(&data, &Plan::new(&data, &config).unwrap()).unwrap();
    let mut trainer =
        Trainer::new(&device, &data, &Plan::new(&data, &config).unwrap(), &first).unwrap();
    trainer.advance_to(config.iterations).unwrap();
    let splats = trainer.state().unwrap().splats;
    let photos = Photos::new(&device, data.image_budget);
    let views = ViewSet::<f64>::new(&photos, data.train.iter().take(3).cloned()).unwrap();
    let setting = Setting {
        render: RenderOptions {
            sh_degree: 1,
            background: [0.1, 0.2, 0.3],
            quantity: Quantity::Color,
            active_only: false,
        },
        lambda_ssim: 0.2,
        alpha_min: 1e-9,
        epsilon: 1e-6,
    };
    let mut instrument = Instrument::new(&device, views, splats.clone(), setting, 100).unwrap();
    let base = instrument.base().unwrap();
    (instrument, base, splats)
}

fn own(splats: &Gaussians, source: u32) -> Shape {
    Shape {
        log_scale: splats.gather(Plane::LOG_SCALE, source as usize),
        opacity_logit: splats.planes()[Plane::OPACITY][source as usize],
    }
}

/// Largest difference over the largest value, and the median of the relative differences.
fn differences(got: &[f64], want: &[f64]) -> [f64; 2] {
    let most = want.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let gaps: Vec<f64> = got.iter().zip(want).map(|(a, b)| (a - b).abs()).collect();
    let mut relative: Vec<f64> = gaps.iter().zip(want).map(|(g, w)| g / w.abs()).collect();
    relative.sort_by(f64::total_cmp);
    let largest = gaps.iter().fold(0.0f64, |m, g| m.max(*g)) / most;
    [largest, quantile(&relative, 0.5).unwrap()]
}

/// Share of its opacity at which a birth is taken to be small. What is left of second order is about as large.
const SMALL: f64 = 1e-4;

#[test]
fn an_estimate_is_the_derivative_of_the_true_change() {
    let (mut instrument, base, splats) = instrument();
    let stride = splats.len() as u32 / 24;
    let births: Vec<Birth> = (0..24)
        .map(|k| {
            let source = k * stride;
            let at: [f32; 3] = splats.gather(Plane::POSITION, source as usize);
            Birth {
                source,
                position: at.map(|v| v + 0.01),
                shape: own(&splats, source),
            }
        })
        .collect();
    let estimates = instrument.estimate(&births).unwrap();
    let all = [true; 3];
    let (mut slopes, mut estimated) = (Vec::new(), Vec::new());
    for (birth, estimate) in births.iter().zip(&estimates) {
        if !estimate.touched.contains(&true) {
            assert_eq!(instrument.change(&base, birth, &all).unwrap(), 0.0);
            continue;
        }
        let mut small = *birth;
        let logit = f64::from(birth.shape.opacity_logit);
        let o = SMALL / (1.0 + (-logit).exp());
        small.shape.opacity_logit = (o / (1.0 - o)).ln() as f32;
        slopes.push(instrument.change(&base, &small, &all).unwrap() / SMALL);
        estimated.push(estimate.change);
    }
    assert!(slopes.len() > 10, "{} births are seen", slopes.len());
    let [largest, median] = differences(&estimated, &slopes);
    println!("estimate against differences: {largest:.1e} of the largest, median {median:.1e}");
    assert!(largest < 5e-3 && median < 2e-3, "{estimated:?} {slopes:?}");
    // Another birth's estimate is no match.
    estimated.rotate_left(1);
    assert!(differences(&estimated, &slopes)[0] > 0.1);
    // The scene is as it was.
    assert_eq!(instrument.base().unwrap().losses, base.losses);
}

/// A short run on the bundled scene.
fn short_run(dir: &std::path::Path) -> PathBuf {
    let run = dir.join("run");
    let room = room();
    let folder = ["train", &room, "-o", text(&run)];
    let small = ["--max-size", "64", "--iterations", "120"];
    let few = ["--max-gaussians", "3000"];
    done(&[&folder[..], &small, &few].concat());
    run
}

#[test]
fn the_command_writes_a_page_and_json() {
    let dir = tempfile::tempdir().unwrap();
    let run = short_run(dir.path());
    let few = ["--candidates", "24", "--views", "2", "--seed", "3"];
    let all = [&["surrogate", text(&run)][..], &few].concat();
    let tables = done(&all);
    for word in ["## Birth copy", "## Birth faint", "| probe |", "τ_b"] {
        assert!(tables.contains(word), "{word}: {tables}");
    }
    let folder = run.join("surrogate");
    let html = fs::read_to_string(folder.join("surrogate.html")).unwrap();
    for word in ["<svg", "gain by tenths of I", "class=\"band s1\""] {
        assert!(html.contains(word), "{word}");
    }
    assert!(!html.contains("http://") && html.matches("<script").count() == 1);
    let saved = fs::read_to_string(folder.join("surrogate.json")).unwrap();
    let first: serde_json::Value = serde_json::from_str(&saved).unwrap();
    let rows = first["candidates"].as_array().unwrap().len();
    assert_eq!(rows + first["unseen"].as_u64().unwrap() as usize, 24);
    assert_eq!(first["views"].as_array().unwrap().len(), 2);
    assert!(first["forms"][1]["correlations"][5]["spearman"]["value"].is_f64());
    assert!(first["candidates"][0]["gain"][0].is_f64());
    // The shares are those of the candidates in the file.
    let seen = first["candidates"].as_array().unwrap();
    let good = seen.iter().filter(|c| c["gain"][1].as_f64() > Some(0.0));
    let share = good.count() as f64 / rows as f64;
    assert!(close(first["forms"][1]["lowering"].as_f64(), share));
    // Over its own pages again, to the same figures; on stdout the same document.
    let again: serde_json::Value =
        serde_json::from_str(&done(&[&all[..], &["--json"]].concat())).unwrap();
    assert_eq!(again, first);
    fs::write(folder.join("surrogate.html"), "mine").unwrap();
    assert_eq!(mhsplat(&all).status.code(), Some(2));
}

#[test]
fn what_cannot_be_checked_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let refused = |args: &[&str], why: &str| {
        let output = mhsplat(&[&["surrogate"][..], args].concat());
        assert_eq!(output.status.code(), Some(2), "{args:?}");
        assert!(stderr(&output).contains(why), "{}", stderr(&output));
    };
    refused(&[text(&dir.path().join("nowhere"))], "holds no run.json");
    for option in ["--anti-aliasing", "--exposure"] {
        let run = dir.path().join(option);
        let room = room();
        let folder = ["train", &room, "-o", text(&run), option, "on"];
        done(&[&folder[..], &["--max-size", "64", "--iterations", "10"]].concat());
        refused(&[text(&run)], &format!("{option} off"));
    }
    let run = short_run(dir.path());
    refused(&[text(&run), "--views", "0"], "--views");
    refused(&[text(&run), "--candidates", "0"], "--candidates");
    refused(&[text(&run), text(&dir.path().join("nowhere"))], "nowhere");
    let other =
        crate::cli::scratch_dataset(dir.path(), mhsplat::lab::synth::SynthLayout::Transforms);
    refused(&[text(&run), text(&other)], "its views are not those of");
    fs::remove_dir_all(run.join("checkpoint")).unwrap();
    refused(&[text(&run)], "no checkpoint");
}
