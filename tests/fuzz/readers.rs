//! The readers of untrusted files, fed from memory: what the tests mutate, and what a fuzzer is let loose on.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use tempfile::TempDir;

use mhsplat::capture::colmap::ColmapModel;
use mhsplat::capture::{Frame, LoadOptions, load, point_cloud};
use mhsplat::config::ExposureChoice;
use mhsplat::lab::experiment::Experiment;
use mhsplat::lab::synth::{SynthLayout, SynthOptions, generate};
use mhsplat::run::{Clock, METRICS_FILE, MetricsRow, RECORD_FILE, Run, checkpoint, read_rows};
use mhsplat::scene::formats::{self, SceneFile};
use mhsplat::{Device, RunRecord, TrainConfig};

/// Whether a reader takes what is fed to it.
type Read = Box<dyn FnMut(&[u8]) -> bool + Send>;

/// A reader and files that it takes.
pub struct Reader {
    pub seeds: Vec<Vec<u8>>,
    pub read: Read,
}

// All readers, by what they read.
pub const COLMAP: [&str; 6] = [
    "cameras_bin",
    "images_bin",
    "points3d_bin",
    "cameras_txt",
    "images_txt",
    "points3d_txt",
];
pub const PHOTOS: [&str; 9] = [
    "transforms",
    "lenses",
    "png",
    "jpeg",
    "webp",
    "exr",
    "hdr",
    "bmp",
    "mask",
];
pub const EXPORTS: [&str; 5] = [
    "reality_scan_csv",
    "metashape_xml",
    "bundle_out",
    "open_sfm_json",
    "open_mvg_json",
];
pub const CLOUDS: [&str; 7] = [
    "points_ply",
    "scene_ply",
    "scene_compressed_ply",
    "scene_spz",
    "scene_spz4",
    "scene_splat",
    "scene_glb",
];
pub const SETTINGS: [&str; 3] = ["config_toml", "config_json", "experiment_toml"];
pub const RUNS: [&str; 4] = ["checkpoint", "signed_checkpoint", "run_json", "metrics_csv"];

/// The reader of a name.
pub fn reader(name: &str) -> Reader {
    match name {
        n if COLMAP.contains(&n) => colmap(n),
        n if PHOTOS.contains(&n) => photos(n),
        n if EXPORTS.contains(&n) => export(n),
        n if CLOUDS.contains(&n) => cloud(n),
        n if SETTINGS.contains(&n) => settings(n),
        n if RUNS.contains(&n) => run(n),
        other => panic!("no reader is named {other}"),
    }
}

/// A reader of a file in a folder, which is kept as long as the reader.
fn of_file(dir: TempDir, file: PathBuf, read: impl Fn(&Path) -> bool + Send + 'static) -> Reader {
    Reader {
        seeds: vec![fs::read(&file).unwrap()],
        read: Box::new(move |bytes| {
            fs::write(&file, bytes).unwrap();
            read(dir.path())
        }),
    }
}

/// A tiny dataset in a layout.
fn dataset(layout: SynthLayout) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    let options = SynthOptions {
        layout,
        views: 3,
        width: 24,
        height: 16,
        points: 20,
        samples: 1,
        ..SynthOptions::for_scene("room")
    };
    generate("room", dir.path(), &options).unwrap();
    dir
}

fn colmap(name: &str) -> Reader {
    let dir = dataset(SynthLayout::Colmap);
    let (stem, form) = name.split_once('_').unwrap();
    let stem = stem.replace("3d", "3D");
    let model = dir.path().join("sparse/0");
    if form == "bin" {
        let file = model.join(format!("{stem}.bin"));
        return of_file(dir, file, move |_| ColmapModel::read(&model, true).is_ok());
    }
    let text = dir.path().join("text");
    fs::create_dir(&text).unwrap();
    let read = ColmapModel::read(&model, true).unwrap();
    read.write(&text, false).unwrap();
    let file = text.join(format!("{stem}.txt"));
    of_file(dir, file, move |_| ColmapModel::read(&text, false).is_ok())
}

/// Cameras of a whole dataset, of every lens that photos are undistorted from.
fn lenses() -> Reader {
    let dir = dataset(SynthLayout::Colmap);
    let model = dir.path().join("sparse/0");
    let text = ColmapModel::read(&model, true).unwrap();
    for stem in ["cameras", "images", "points3D"] {
        fs::remove_file(model.join(format!("{stem}.bin"))).unwrap();
    }
    text.write(&model, false).unwrap();
    let file = model.join("cameras.txt");
    let mut reader = of_file(dir, file, |dir| load(dir, &LoadOptions::default()).is_ok());
    let cameras = [
        "SIMPLE_RADIAL 24 16 20 12 8 0.1",
        "RADIAL 24 16 20 12 8 0.1 -0.02",
        "OPENCV 24 16 20 21 12 8 0.1 -0.02 0.01 0.02",
        "FULL_OPENCV 24 16 20 21 12 8 0.1 0.02 0.01 0.02 0.03 0.04 0.05 0.06",
        "OPENCV_FISHEYE 24 16 20 21 12 8 0.1 0.02 0.03 0.04",
        "SIMPLE_RADIAL_FISHEYE 24 16 20 12 8 0.1",
        "RADIAL_FISHEYE 24 16 20 12 8 0.1 0.02",
        "FOV 24 16 20 21 12 8 0.9",
        "THIN_PRISM_FISHEYE 24 16 20 21 12 8 0.1 0.02 0.01 0.02 0.03 0.04 0.01 0.02",
        "RAD_TAN_THIN_PRISM_FISHEYE 24 16 20 21 12 8 0.1 0.02 0.03 0.04 0.01 0.02 0.01 0.02 0.01 0.02 0.03 0.04",
        "DIVISION 24 16 20 21 12 8 -0.1",
        "FISHEYE 24 16 20 21 12 8",
        "EUCM 24 16 20 21 12 8 0.6 1.1",
    ];
    let line = |c: &str| format!("1 {c}\n").into_bytes();
    reader.seeds.extend(cameras.into_iter().map(line));
    reader
}

/// A transforms file whose photos have lenses and masks.
fn transforms(dir: TempDir) -> Reader {
    let file = dir.path().join("transforms_train.json");
    let mut with_more: serde_json::Value =
        serde_json::from_slice(&fs::read(&file).unwrap()).unwrap();
    let top = with_more.as_object_mut().unwrap();
    for (key, value) in [("k1", 0.1), ("k2", -0.02), ("p1", 0.01), ("p2", 0.02)] {
        top.insert(key.into(), value.into());
    }
    top.insert("camera_model".into(), "OPENCV".into());
    image::GrayImage::from_pixel(24, 16, image::Luma([255]))
        .save(dir.path().join("mask.png"))
        .unwrap();
    for frame in top["frames"].as_array_mut().unwrap() {
        frame["mask_path"] = "mask.png".into();
    }
    let mut reader = of_file(dir, file, |dir| load(dir, &LoadOptions::default()).is_ok());
    reader.seeds.push(serde_json::to_vec(&with_more).unwrap());
    reader
}

/// The mask of a photo.
fn mask() -> Reader {
    let dir = dataset(SynthLayout::Colmap);
    let name = &load(dir.path(), &LoadOptions::default()).unwrap().train[0].name;
    let file = dir.path().join("masks").join(format!("{name}.png"));
    fs::create_dir(dir.path().join("masks")).unwrap();
    let white = image::GrayImage::from_pixel(24, 16, image::Luma([255]));
    white.save(&file).unwrap();
    of_file(dir, file, |dir| load(dir, &LoadOptions::default()).is_ok())
}

fn photos(name: &str) -> Reader {
    if name == "lenses" {
        return lenses();
    }
    let dir = dataset(SynthLayout::Transforms);
    let reads = |dir: &Path| load(dir, &LoadOptions::default()).is_ok();
    if name == "transforms" {
        return transforms(dir);
    }
    if name == "mask" {
        return mask();
    }
    let data = load(dir.path(), &LoadOptions::default()).unwrap();
    let stem = &data.train[0].name;
    let candidates = [
        dir.path().join(stem),
        dir.path().join(format!("{stem}.png")),
    ];
    let file = candidates.into_iter().find(|p| p.is_file()).unwrap();
    // The reader goes by content, not by the name.
    let format = match name {
        "jpeg" => image::ImageFormat::Jpeg,
        "webp" => image::ImageFormat::WebP,
        "exr" => image::ImageFormat::OpenExr,
        "hdr" => image::ImageFormat::Hdr,
        "bmp" => image::ImageFormat::Bmp,
        _ => image::ImageFormat::Png,
    };
    let pixels = image::open(&file).unwrap();
    let pixels = match name {
        "exr" | "hdr" => image::DynamicImage::from(pixels.into_rgb32f()),
        _ => pixels.into_rgb8().into(),
    };
    pixels.save_with_format(&file, format).unwrap();
    of_file(dir, file, reads)
}

/// A camera export of another program, of one photo.
fn export(name: &str) -> Reader {
    let dir = tempfile::tempdir().unwrap();
    image::RgbImage::new(24, 16)
        .save(dir.path().join("a.png"))
        .unwrap();
    fs::write(dir.path().join("list.txt"), "a.png\n").unwrap();
    let (file, seed) = match name {
        "reality_scan_csv" => (
            "a.csv",
            "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2\n\
             a.png,1,2,3,10,80,-5,28,0.01,-0.02,0.1,0.02,0.03,0.04,0.001,0.002\n",
        ),
        "metashape_xml" => (
            "a.xml",
            "<document version=\"2.0.0\"><chunk><sensors><sensor id=\"0\" type=\"frame\"><calibration class=\"adjusted\">\
             <resolution width=\"24\" height=\"16\"/><f>22</f><cx>0.5</cx><cy>-0.5</cy><b1>0.1</b1><b2>0.2</b2><k1>0.1</k1>\
             <p1>0.01</p1></calibration></sensor></sensors><components><component id=\"0\"><transform>\
             <rotation>1 0 0 0 1 0 0 0 1</rotation><translation>1 2 3</translation><scale>2</scale></transform></component></components>\
             <cameras><camera id=\"0\" sensor_id=\"0\" component_id=\"0\" label=\"a\">\
             <transform>1 0 0 4 0 1 0 5 0 0 1 6 0 0 0 1</transform></camera></cameras></chunk></document>\n",
        ),
        "open_sfm_json" => (
            "reconstruction.json",
            include_str!("corpus/open_sfm_json/minimal"),
        ),
        "open_mvg_json" => (
            "sfm_data.json",
            include_str!("corpus/open_mvg_json/minimal"),
        ),
        _ => (
            "bundle.out",
            "# Bundle file v0.3\n1 1\n20 0.1 0.02\n1 0 0\n0 1 0\n0 0 1\n1 2 3\n4 5 6\n10 20 30\n1 0 7 0.5 0.25\n",
        ),
    };
    let file = dir.path().join(file);
    fs::write(&file, seed).unwrap();
    let options = LoadOptions {
        test_every: 0,
        ..LoadOptions::default()
    };
    of_file(dir, file, move |dir| load(dir, &options).is_ok())
}

fn cloud(name: &str) -> Reader {
    let source = dataset(SynthLayout::Colmap);
    let mut data = load(source.path(), &LoadOptions::default()).unwrap();
    data.points.positions.truncate(9);
    data.points.colors.truncate(9);
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("points.ply");
    if let Some(kind) = name.strip_prefix("scene_") {
        let splats = mhsplat::scene::init::from_points(&data.points, 1).unwrap();
        let ending = kind.trim_end_matches('4').replace('_', ".");
        let file = dir.path().join(format!("scene.{ending}"));
        let (scene, format) = (SceneFile::new(splats), formats::of_name(&file).unwrap());
        formats::write(&file, format, &scene, &Frame::IDENTITY).unwrap();
        if kind == "spz4" {
            // Not written here.
            fs::write(&file, include_bytes!("corpus/scene_spz4/minimal")).unwrap();
        }
        let path = file.clone();
        return of_file(dir, file, move |_| {
            formats::read(&path, &Frame::IDENTITY).is_ok()
        });
    }
    point_cloud::write(&file, &data.points, &Frame::IDENTITY).unwrap();
    let path = file.clone();
    let mut reader = of_file(dir, file, move |_| {
        formats::read_either(&path, &Frame::IDENTITY).is_ok()
    });
    let ascii = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 1 2\n3 4 5\n";
    reader.seeds.push(ascii.into());
    reader
}

fn settings(name: &str) -> Reader {
    let config = TrainConfig {
        time_budget: Some(60.0),
        ..TrainConfig::default()
    };
    let dir = tempfile::tempdir().unwrap();
    match name {
        "config_toml" => Reader {
            seeds: vec![
                toml::to_string(&config).unwrap().into_bytes(),
                b"iterations = 9\ntime-budget = \"10m\"\nimage-budget = \"2G\"\n[mh]\nview-subset = 7\n"
                    .to_vec(),
            ],
            read: Box::new(|bytes| {
                let text = String::from_utf8_lossy(bytes);
                toml::from_str::<TrainConfig>(&text).is_ok_and(|c| c.validate().is_ok())
            }),
        },
        "config_json" => Reader {
            seeds: vec![serde_json::to_vec(&config).unwrap()],
            read: Box::new(|bytes| {
                serde_json::from_slice::<TrainConfig>(bytes).is_ok_and(|c| c.validate().is_ok())
            }),
        },
        "experiment_toml" => {
            let file = dir.path().join("experiment.toml");
            let text = "output = \"out\"\nbudget = \"3h\"\nseeds = [0, 1]\ncap-from = \"mh\"\n[train]\niterations = 30\n\
                        [[setting]]\nname = \"mh\"\n[[setting]]\nname = \"mcmc\"\nsampler = \"mcmc\"\nmcmc.growth = 1.15\n\
                        [[scene]]\npath = \"a\"\nthresholds = [24, 25]\nbackground = \"white\"\n";
            fs::write(&file, text).unwrap();
            let path = file.clone();
            of_file(dir, file, move |_| Experiment::read(&path, None).is_ok())
        }
        other => panic!("{other}"),
    }
}

/// Three iterations of a tiny dataset, with a checkpoint.
fn trained() -> (TempDir, PathBuf) {
    let data = dataset(SynthLayout::Colmap);
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    fs::create_dir(&run).unwrap();
    let config = TrainConfig {
        iterations: 3,
        max_gaussians: Some(20),
        sh_degree: 0,
        exposure: ExposureChoice::On,
        ..TrainConfig::default()
    };
    let device = Device::open(None).unwrap();
    let data = load(data.path(), &LoadOptions::default()).unwrap();
    let mut started = Run::start(&run, data, config, &device, Clock::start()).unwrap();
    started.drive(&AtomicBool::new(false), |_| {}).unwrap();
    (dir, run)
}

fn run(name: &str) -> Reader {
    let (dir, run) = trained();
    let saved = checkpoint::path(&run);
    match name {
        "checkpoint" => of_file(dir, saved, move |_| checkpoint::read(&run).is_ok()),
        "run_json" => of_file(dir, run.join(RECORD_FILE), move |_| {
            RunRecord::read(&run).is_ok()
        }),
        "metrics_csv" => {
            let file = run.join(METRICS_FILE);
            of_file(dir, file.clone(), move |_| {
                read_rows::<MetricsRow>(&file).is_ok()
            })
        }
        // The same with a checksum that fits: whoever means harm can compute one.
        "signed_checkpoint" => {
            let mut plain = of_file(dir, saved, move |_| checkpoint::read(&run).is_ok());
            Reader {
                seeds: plain.seeds,
                read: Box::new(move |bytes| (plain.read)(&signed(bytes))),
            }
        }
        other => panic!("{other}"),
    }
}

/// A checkpoint's bytes with the checksum of what they hold, as far as that can be told.
fn signed(bytes: &[u8]) -> Vec<u8> {
    let sum = || -> Option<(String, String)> {
        let (_, metadata) = safetensors::SafeTensors::read_metadata(bytes).ok()?;
        let entries = metadata.metadata().as_ref()?;
        let tensors = safetensors::SafeTensors::deserialize(bytes).ok()?;
        let mut sum = crc32fast::Hasher::new();
        sum.update(entries.get("mhsplat")?.as_bytes());
        for name in [
            "params",
            "moment1",
            "moment2",
            "losses",
            "cues",
            "filter",
            "exposures",
        ] {
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
