//! Anti-aliasing as a whole: what it is for, and that files and checkpoints keep it.

use glam::{DMat3, DVec3};

use crate::cli::{done, room as room_folder, text};
use crate::determinism::{drive, room, saved, trained};
use mhsplat::Plan;
use mhsplat::TrainConfig;
use mhsplat::base::constants::blur;
use mhsplat::capture::{Alpha, Camera, Frame, Photo};
use mhsplat::config::{AntiAliasing, Init, Sampler};
use mhsplat::device::{CameraArg, Defines, Device};
use mhsplat::lab::verify::{cases, definition::Reference, pass};
use mhsplat::pipeline::buffers::GaussianBuffers;
use mhsplat::pipeline::forward::{RenderOptions, Rendered, Renderer};
use mhsplat::run::{checkpoint, initial_gaussians};
use mhsplat::scene::{Gaussians, Plane, formats, ply};
use mhsplat::train::Trainer;

/// True if the plan has the filters.
fn filters(data: &mhsplat::Dataset, config: &TrainConfig) -> bool {
    Plan::new(data, config).unwrap().anti_aliasing.value
}

fn config(anti_aliasing: AntiAliasing, sampler: Sampler) -> TrainConfig {
    TrainConfig {
        anti_aliasing,
        sampler,
        iterations: 130,
        max_size: 64,
        sh_degree: 1,
        seed: 5,
        ..TrainConfig::default()
    }
}

/// Mean brightness of a bright Gaussian of a standard deviation of 1.5 pixels in 256 × 256 of them, and at `1/zoom` of that
/// size; trained, as far as the filter is concerned, at the full size.
fn brightness_at(middle: f64, zoom: u32, anti_aliased: bool) -> f64 {
    let mut case = cases::mild("zoom", 1, [256, 256], 0, 40);
    let full = Camera {
        rotation: DMat3::IDENTITY,
        translation: DVec3::new(0.0, 0.0, 2.0),
        fx: 300.0,
        fy: 300.0,
        cx: middle,
        cy: middle,
        width: 256,
        height: 256,
    };
    case.camera = full.scaled_to(256 / zoom, 256 / zoom);
    case.photo = Photo {
        width: 256 / zoom,
        height: 256 / zoom,
        alpha: Alpha::None,
        data: vec![0; (3 * (256 / zoom) * (256 / zoom)) as usize],
    };
    case.background = [0.0; 3];
    case.splats = Gaussians::zeros(0, 1);
    let scale = (1.5 * 2.0 / 300.0f32).ln();
    case.splats.scatter(Plane::LOG_SCALE, 0, [scale; 3]);
    case.splats.scatter(Plane::OPACITY, 0, [4.0]);
    case.splats.scatter(Plane::SH, 0, [1.7; 3]);
    if anti_aliased {
        case.filter_views = vec![full];
    }
    let device = Device::open(None).unwrap();
    let out = pass::run::<f32>(&device, device.tuning(), &case, None).unwrap();
    let (image, want) = (out.got("splat", "image"), Reference::new(&case).pass.image);
    let mean = |image: &[f64]| image.iter().sum::<f64>() / image.len() as f64;
    assert!((mean(image) - mean(&want)).abs() < 1e-4 * mean(&want));
    mean(image)
}

/// The mean over a Gaussian that projects, at a quarter of the size, to a corner of four pixels and to the centre of one: what
/// sampling at pixel centres takes from the one it adds to the other, so that the filter is left.
fn brightness(zoom: u32, anti_aliased: bool) -> f64 {
    let at = |middle| brightness_at(middle, zoom, anti_aliased);
    0.5 * (at(128.0) + at(130.0))
}

#[test]
fn zooming_out_keeps_the_brightness_with_the_filters_and_not_without() {
    let ratio = |on: bool| brightness(4, on) / brightness(1, on);
    let (with, without) = (ratio(true), ratio(false));
    println!("mean brightness at a quarter of the size: x{with:.3} with, x{without:.3} without");
    assert!((with - 1.0).abs() < 0.05, "{with}");
    assert!(without > 2.0, "{without}");
}

#[test]
fn a_resumed_run_ends_with_the_same_bits() {
    let data = room(64);
    // The filter is that of iteration 100 or of the last density step; the checkpoint comes after both, or before the filter of
    // its own iteration where no density step falls on it.
    for (sampler, at) in [
        (Sampler::Mh, 113),
        (Sampler::Mcmc, 113),
        (Sampler::Adc, 113),
        (Sampler::None, 100),
    ] {
        let config = config(AntiAliasing::On, sampler);
        let (_, whole) = trained(&data, &config, 130);
        let plain = TrainConfig {
            anti_aliasing: AntiAliasing::Off,
            ..config.clone()
        };
        assert!(
            whole != trained(&data, &plain, 130).1,
            "the filters do nothing"
        );
        let (mut part, _) = trained(&data, &config, at);
        let folder = tempfile::tempdir().unwrap();
        checkpoint::write(folder.path(), &saved(&mut part, &config, &data)).unwrap();
        let state = checkpoint::read(folder.path()).unwrap().state;
        assert_eq!(state.rows.filter.len(), state.splats.len());
        assert!(state.rows.filter.iter().all(|s| *s > 0.0));
        let device = Device::open(None).unwrap();
        let mut resumed = Trainer::new(
            &device,
            &data,
            &Plan::new(&data, &config).unwrap(),
            &state.splats,
        )
        .unwrap();
        resumed.restore(&state).unwrap();
        drive(&mut resumed, 130).unwrap();
        assert!(resumed.state().unwrap().splats == whole, "{sampler:?}");
        // Its renders would lack the filters.
        let options = mhsplat::lab::surrogate::Options {
            candidates: 200,
            views: 8,
            seed: 0,
        };
        let refused = mhsplat::lab::surrogate::check(
            folder.path(),
            data.clone(),
            &device,
            &options,
            &mut |_, _| (),
        );
        assert!(refused.unwrap_err().to_string().contains("anti-aliasing"));
        let mut other = Trainer::new(
            &device,
            &data,
            &Plan::new(&data, &plain).unwrap(),
            &state.splats,
        )
        .unwrap();
        assert!(other.restore(&state).is_err(), "a filter nobody asked for");
    }
}

#[test]
fn too_little_room_for_pairs_changes_nothing() {
    let data = room(64);
    let config = config(AntiAliasing::On, Sampler::Mh);
    let (_, whole) = trained(&data, &config, 130);
    let device = Device::open(None).unwrap();
    let splats = initial_gaussians(&data, &Plan::new(&data, &config).unwrap()).unwrap();
    let mut tight =
        Trainer::new(&device, &data, &Plan::new(&data, &config).unwrap(), &splats).unwrap();
    for until in [99, 104, 130] {
        tight.shrink_intersections(256).unwrap();
        drive(&mut tight, until).unwrap();
    }
    assert!(tight.overflows() > 0);
    assert!(tight.state().unwrap().splats == whole);
}

fn shown(splats: &Gaussians, camera: &Camera, anti_alias: bool) -> Rendered {
    let device = Device::open(None).unwrap();
    let defines = Defines {
        anti_alias,
        ..Defines::new(device.tuning())
    };
    let degree = splats.sh_degree();
    let mut renderer = Renderer::<f32>::new(&device, defines, degree, false).unwrap();
    let mut scene = GaussianBuffers::upload(&device, splats, 0).unwrap();
    if anti_alias {
        scene = scene.with_filter(&device).unwrap();
    }
    let options = RenderOptions {
        sh_degree: degree,
        ..RenderOptions::default()
    };
    renderer.image(&scene, camera, &options).unwrap()
}

fn apart(a: &Rendered, b: &Rendered) -> f32 {
    let pairs = a.rgb.iter().zip(&b.rgb);
    pairs.fold(0.0, |most, (a, b)| most.max((a - b).abs()))
}

#[test]
fn the_exported_scene_has_the_3d_filter_in_it_and_says_so() {
    let data = room(64);
    let config = config(AntiAliasing::On, Sampler::Mh);
    let (mut trainer, _) = trained(&data, &config, 130);
    let state = trainer.state().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let [marked, plain] = ["marked.ply", "plain.ply"].map(|name| folder.path().join(name));
    ply::write_filtered(&marked, &state.splats, &state.rows.filter, &data.frame).unwrap();
    ply::write_filtered(&plain, &state.splats, &[], &data.frame).unwrap();
    assert!(formats::is_anti_aliased(&marked) && !formats::is_anti_aliased(&plain));
    assert!(ply::ANTI_ALIASED.contains(&format!("2D filter of {},", blur(true))));
    // Of other filters (those of an earlier version): refused, not shown with these.
    let other = folder.path().join("other.ply");
    let part = b" 2D filter of 0.1,";
    let mut bytes = std::fs::read(&marked).unwrap();
    let at = bytes.windows(part.len()).position(|w| w == part).unwrap();
    bytes.drain(at..at + part.len());
    std::fs::write(&other, bytes).unwrap();
    let refused = formats::read(&other, &data.frame).unwrap_err().to_string();
    assert!(
        refused.contains("other.ply")
            && refused.contains("`mhsplat anti-aliasing: mip-splatting, 3D filter applied`"),
        "{refused}"
    );
    assert!(!formats::is_anti_aliased(&folder.path().join("none.ply")));
    assert!(ply::write_filtered(&plain, &state.splats, &[1.0], &Frame::IDENTITY).is_err());

    let camera = data.train[0].camera;
    let arg = CameraArg::<f32>::new(&camera, trainer.tuning().tile);
    let options = RenderOptions {
        sh_degree: 1,
        ..RenderOptions::default()
    };
    let (scene, renderer) = trainer.scene_and_renderer().unwrap();
    renderer.render(scene, &arg, &options).unwrap();
    let trained = renderer.read_image().unwrap();
    let baked = formats::read(&marked, &data.frame).unwrap().splats;
    let raw = formats::read(&plain, &data.frame).unwrap().splats;
    // Rounding, and pixels at the cut.
    let same = apart(&trained, &shown(&baked, &camera, true));
    assert!(same < 0.01, "{same}");
    assert!(apart(&trained, &shown(&baked, &camera, false)) > 5.0 * same);
    assert!(apart(&trained, &shown(&raw, &camera, true)) > 5.0 * same);

    // Training on from it takes the mark for an answer, unless it is told otherwise.
    let on_from = |path: &std::path::Path, anti_aliasing| TrainConfig {
        init: Init::File(path.to_path_buf()),
        anti_aliasing,
        ..TrainConfig::default()
    };
    assert!(filters(&data, &on_from(&marked, AntiAliasing::Auto)));
    assert!(!filters(&data, &on_from(&marked, AntiAliasing::Off)));
    assert!(!filters(&data, &on_from(&plain, AntiAliasing::Auto)));
    // It starts from what was trained, not from what the filter made of it. The filter that was written is up to 30
    // iterations old.
    let start = on_from(&marked, AntiAliasing::Auto);
    let start = TrainConfig {
        sh_degree: 1,
        ..start
    };
    let splats = initial_gaussians(&data, &Plan::new(&data, &start).unwrap()).unwrap();
    let device = Device::open(None).unwrap();
    let mut again =
        Trainer::new(&device, &data, &Plan::new(&data, &start).unwrap(), &splats).unwrap();
    let (scene, renderer) = again.scene_and_renderer().unwrap();
    renderer.render(scene, &arg, &options).unwrap();
    let begun = apart(&trained, &renderer.read_image().unwrap());
    assert!(begun < 3.0 * same.max(0.01), "{begun}");
}

#[test]
fn a_filter_of_nothing_changes_no_bit_and_a_wide_one_dims_and_widens() {
    let mut splats = Gaussians::zeros(0, 2);
    for i in 0..2 {
        splats.scatter(Plane::LOG_SCALE, i, [-3.0, -4.0, -5.0f32]);
        splats.scatter(Plane::OPACITY, i, [1.25f32]);
    }
    let sigma = (-4.0f64).exp();
    let out = splats.filtered(&[0.0, sigma as f32]).unwrap();
    assert_eq!(out.gather::<11>(0, 0), splats.gather::<11>(0, 0));
    let wide = [-3.0f64, -4.0, -5.0].map(|l| (2.0 * l).exp() + sigma * sigma);
    let mut left = 1.0;
    for (k, wide) in wide.iter().enumerate() {
        let got = f64::from(out.planes()[Plane::LOG_SCALE + k][1]);
        assert!((got - 0.5 * wide.ln()).abs() < 1e-6, "{got}");
        left *= ([-6.0f64, -8.0, -10.0][k].exp() / wide).sqrt();
    }
    let opacity = |logit: f64| 1.0 / (1.0 + (-logit).exp());
    let got = opacity(f64::from(out.planes()[Plane::OPACITY][1]));
    assert!((got - left * opacity(1.25)).abs() < 1e-6, "{got}");
}

#[test]
fn what_is_filtered_can_be_taken_back() {
    let data = room(64);
    let splats =
        initial_gaussians(&data, &Plan::new(&data, &TrainConfig::default()).unwrap()).unwrap();
    let sigma: Vec<f32> = splats.planes()[Plane::LOG_SCALE]
        .iter()
        .enumerate()
        .map(|(i, l)| l.exp() * 0.05 * (i % 60) as f32)
        .collect();
    let there = splats.filtered(&sigma).unwrap();
    assert_ne!(there, splats);
    let back = there.unfiltered(&sigma).unwrap();
    for p in 0..Plane::SH {
        for (a, b) in splats.planes()[p].iter().zip(&back.planes()[p]) {
            assert!((a - b).abs() < 1e-4, "plane {p}: {a} {b}");
        }
    }
    assert!(splats.filtered(&sigma[1..]).is_err());
}

/// The command line end to end: a run with the option, its scene rendered from the folder as it was evaluated, and gone on with.
#[test]
fn a_run_is_evaluated_again_with_its_own_filters() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let train = |more: &[&str]| {
        let base = [
            "train",
            &room_folder(),
            "--iterations",
            "60",
            "--max-size",
            "64",
            "--json",
        ];
        done(&[&base, more].concat())
    };
    let record = train(&["-o", text(&run), "--anti-aliasing", "on"]);
    let record: serde_json::Value = serde_json::from_str(&record).unwrap();
    assert_eq!(record["config"]["anti-aliasing"], "on");
    let kept = record["plan"]["kept"].as_array().unwrap();
    assert!(kept.iter().any(|i| i["what"] == "anti-aliasing"));
    let score = |scene: &std::path::Path, size| -> f64 {
        let of = ["eval", text(scene), &room_folder(), "--max-size", size];
        let out = done(&[&of[..], &["--json"]].concat());
        serde_json::from_str::<serde_json::Value>(&out).unwrap()["psnr"]
            .as_f64()
            .unwrap()
    };
    let of_run = record["final"]["psnr"].as_f64().unwrap();
    let again = score(&run, "64");
    assert!((again - of_run).abs() < 0.01, "{again} {of_run}");
    // The same scene without its mark is another picture: at half the size, where the 2D filter has more to do, worse.
    let bytes = std::fs::read(run.join("scene.ply")).unwrap();
    let comment = format!(
        "comment {}\ncomment SplatRenderMode: mip\n",
        ply::ANTI_ALIASED
    )
    .into_bytes();
    let at = bytes
        .windows(comment.len())
        .position(|w| w == comment)
        .unwrap();
    let bare = [&bytes[..at], &bytes[at + comment.len()..]].concat();
    let unmarked = folder.path().join("unmarked.ply");
    std::fs::write(&unmarked, bare).unwrap();
    let [with, without] = [&run, &unmarked].map(|scene| score(scene, "32"));
    println!("at half the size {with:.2} dB with the mark, {without:.2} dB without");
    assert!(with - without >= 0.05, "{with} {without}");
}
