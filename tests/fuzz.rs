//! Untrusted files: whatever is in them, a reader answers or refuses, and does neither panic, hang nor ask for more memory than
//! the file is worth. A few hundred mutated inputs per reader; MHSPLAT_FUZZ=1000000 for more (with `--test-threads 1`, so that the
//! peak of memory is each reader's own).

mod mutate;

use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use mhsplat::dataset::colmap::{read_bin, read_txt, write_txt};
use mhsplat::dataset::synthetic::{SynthLayout, SynthOptions, generate};
use mhsplat::dataset::{Frame, LoadOptions, load, point_cloud};
use mhsplat::export::{checkpoint, ply};
use mhsplat::report::{clock, read_rows};
use mhsplat::{RunRecord, TrainConfig};
use mutate::{Dice, mutated};

/// Inputs per reader in a plain test run.
const INPUTS: u64 = 400;
/// No input takes longer, on a busy machine either.
const LONGEST: Duration = Duration::from_secs(20);
/// The peak of the process may grow by this over a reader's inputs.
const MOST_MEMORY: u64 = 1 << 30;

fn inputs() -> u64 {
    std::env::var("MHSPLAT_FUZZ").map_or(INPUTS, |n| n.parse().unwrap())
}

/// Feeds a reader; it says whether it took the input.
fn feed(name: &str, seeds: &[Vec<u8>], mut read: impl FnMut(&[u8]) -> bool) {
    let before = clock::peak_rss_bytes();
    let (mut taken, mut slowest) = (0u64, Duration::ZERO);
    assert!(
        seeds.iter().all(|s| read(s)),
        "{name}: the seeds themselves are good"
    );
    let count = inputs();
    for k in 0..count {
        let input = mutated(seeds, &mut Dice::new(k));
        let began = Instant::now();
        match catch_unwind(AssertUnwindSafe(|| read(&input))) {
            Ok(good) => taken += u64::from(good),
            Err(_) => {
                let kept = std::env::temp_dir().join(format!("mhsplat-fuzz-{name}-{k}"));
                fs::write(&kept, &input).unwrap();
                panic!(
                    "{name}: input {k} makes the reader panic; it is kept as {}",
                    kept.display()
                );
            }
        }
        slowest = slowest.max(began.elapsed());
    }
    let grown = clock::peak_rss_bytes().saturating_sub(before);
    println!(
        "{name}: {count} inputs of {} seeds, {taken} taken, slowest {slowest:?}, peak grew by {} MiB",
        seeds.len(),
        grown >> 20
    );
    assert!(slowest < LONGEST, "{name}: {slowest:?}");
    // Beside other tests the peak is anybody's.
    let alone = std::env::var_os("MHSPLAT_FUZZ").is_some();
    assert!(!alone || grown < MOST_MEMORY, "{name}: {grown} bytes");
    assert!(
        taken < count,
        "{name}: a reader that takes everything checks nothing"
    );
}

/// A tiny dataset in a layout.
fn dataset(dir: &Path, layout: SynthLayout) {
    let options = SynthOptions {
        layout,
        views: 3,
        width: 24,
        height: 16,
        points: 20,
        samples: 1,
        ..SynthOptions::default()
    };
    generate("room", dir, &options).unwrap();
}

/// A reader of a folder of which one file is mutated.
fn feed_file(name: &str, file: &Path, read: impl Fn() -> bool) {
    let good = fs::read(file).unwrap();
    feed(name, std::slice::from_ref(&good), |bytes| {
        fs::write(file, bytes).unwrap();
        read()
    });
    fs::write(file, good).unwrap();
}

#[test]
fn colmap_models() {
    let dir = tempfile::tempdir().unwrap();
    dataset(dir.path(), SynthLayout::Colmap);
    let model = dir.path().join("sparse/0");
    let text = dir.path().join("text");
    fs::create_dir(&text).unwrap();
    write_txt(&text, &read_bin(&model).unwrap()).unwrap();
    for stem in ["cameras", "images", "points3D"] {
        let file = model.join(format!("{stem}.bin"));
        feed_file(&format!("{stem}.bin"), &file, || read_bin(&model).is_ok());
        let file = text.join(format!("{stem}.txt"));
        feed_file(&format!("{stem}.txt"), &file, || read_txt(&text).is_ok());
    }
}

#[test]
fn transforms_and_photos() {
    let dir = tempfile::tempdir().unwrap();
    dataset(dir.path(), SynthLayout::Transforms);
    let reads = || load(dir.path(), &LoadOptions::default()).is_ok();
    feed_file(
        "transforms",
        &dir.path().join("transforms_train.json"),
        reads,
    );
    let photo = mhsplat::dataset::load(dir.path(), &LoadOptions::default()).unwrap();
    let file = first_image(dir.path());
    assert!(!photo.train.is_empty());
    feed_file("png", &file, reads);
    let jpeg = file.clone();
    let pixels = image::open(&file).unwrap().into_rgb8();
    // The reader goes by content, not by the name.
    pixels
        .save_with_format(&jpeg, image::ImageFormat::Jpeg)
        .unwrap();
    feed_file("jpeg", &jpeg, reads);
}

fn first_image(dir: &Path) -> PathBuf {
    let data = load(dir, &LoadOptions::default()).unwrap();
    let name = &data.train[0].name;
    let candidates = [dir.join(name), dir.join(format!("{name}.png"))];
    candidates.into_iter().find(|p| p.is_file()).unwrap()
}

#[test]
fn point_clouds_and_scenes() {
    let dir = tempfile::tempdir().unwrap();
    let room = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny");
    let mut data = load(&room, &LoadOptions::default()).unwrap();
    data.points.positions.truncate(9);
    data.points.colors.truncate(9);
    let points = dir.path().join("points.ply");
    point_cloud::write(&points, &data.points, &Frame::IDENTITY).unwrap();
    let ascii = dir.path().join("ascii.ply");
    let text = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 1 2\n3 4 5\n";
    fs::write(&ascii, text).unwrap();
    for (name, file) in [("points.ply", points), ("ascii.ply", ascii)] {
        feed_file(name, &file, || {
            point_cloud::read(&file, &Frame::IDENTITY).is_ok()
        });
    }
    let splats = mhsplat::model::init::from_points(&data.points, 1).unwrap();
    let scene = dir.path().join("scene.ply");
    ply::write(&scene, &splats, &Frame::IDENTITY).unwrap();
    feed_file("scene.ply", &scene, || {
        ply::read(&scene, &Frame::IDENTITY).is_ok()
    });
}

#[test]
fn configurations_and_records() {
    let toml = toml::to_string(&TrainConfig {
        time_budget: Some(60.0),
        ..TrainConfig::default()
    });
    let seeds = [
        toml.unwrap_or_default().into_bytes(),
        b"iterations = 9\ntime-budget = \"10m\"\nimage-budget = \"2G\"\n[mh]\nview-subset = 7\n"
            .to_vec(),
    ];
    feed("config.toml", &seeds, |bytes| {
        let text = String::from_utf8_lossy(bytes);
        toml::from_str::<TrainConfig>(&text).is_ok_and(|c| c.validate().is_ok())
    });
    let json = serde_json::to_vec(&TrainConfig::default()).unwrap();
    feed("config.json", &[json], |bytes| {
        serde_json::from_slice::<TrainConfig>(bytes).is_ok_and(|c| c.validate().is_ok())
    });
    let dir = tempfile::tempdir().unwrap();
    let metrics = dir.path().join("metrics.csv");
    let text = "iteration,train_seconds,wall_seconds,cpu_seconds,loss,psnr,ssim,gaussians,proposed,accepted,relocated,pruned,non_finite\n1,0.5,0.6,1,0.1,20,0.5,9,0,0,0,0,0\n";
    fs::write(&metrics, text).unwrap();
    feed_file("metrics.csv", &metrics, || read_rows(&metrics).is_ok());
}

#[test]
fn checkpoints_and_run_records() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let room = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny");
    let mut command = crate::cli::program();
    command.arg("train").arg(room).arg("-o").arg(&run);
    command.args([
        "--iterations",
        "3",
        "--max-size",
        "32",
        "--max-gaussians",
        "40",
        "--sh-degree",
        "0",
    ]);
    assert!(command.output().unwrap().status.success());
    let file = checkpoint::path(&run);
    feed_file("checkpoint", &file, || checkpoint::read(&run).is_ok());
    // The same with a checksum that fits: whoever means harm can compute one.
    let good = fs::read(&file).unwrap();
    feed("signed checkpoint", std::slice::from_ref(&good), |bytes| {
        fs::write(&file, signed(bytes)).unwrap();
        checkpoint::read(&run).is_ok()
    });
    feed_file("run.json", &run.join("run.json"), || {
        RunRecord::read(&run).is_ok()
    });
}

/// A checkpoint's bytes with the checksum of what they hold, as far as that can be told.
fn signed(bytes: &[u8]) -> Vec<u8> {
    let sum = || -> Option<(String, String)> {
        let (_, metadata) = safetensors::SafeTensors::read_metadata(bytes).ok()?;
        let entries = metadata.metadata().as_ref()?;
        let tensors = safetensors::SafeTensors::deserialize(bytes).ok()?;
        let mut sum = crc32fast::Hasher::new();
        sum.update(entries.get("mhsplat")?.as_bytes());
        for name in ["params", "moment1", "moment2", "losses", "cues"] {
            if let Ok(tensor) = tensors.tensor(name) {
                sum.update(tensor.data());
            }
        }
        Some((
            entries.get("crc32")?.clone(),
            format!("{:08x}", sum.finalize()),
        ))
    };
    let Some((old, new)) = sum() else {
        return bytes.to_vec();
    };
    let mut out = bytes.to_vec();
    if old.len() == new.len()
        && let Some(at) = out.windows(old.len()).position(|w| w == old.as_bytes())
    {
        out[at..at + new.len()].copy_from_slice(new.as_bytes());
    }
    out
}
