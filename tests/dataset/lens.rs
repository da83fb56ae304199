//! Lenses: forward and back, against OpenCV's formulas written out, and whole photos.

use std::fs;

use serde_json::{Value, json};

use super::data;
use mhsplat::capture::colmap::ColmapModel;
use mhsplat::capture::transforms::write_transforms;
use mhsplat::capture::{Camera, Lens, LoadOptions, PhotoSource, Undistortion, load};

const PERSPECTIVE: Lens = Lens::Perspective {
    radial: [-0.28, 0.09, -0.01, 0.02, -0.003, 0.001],
    tangential: [1.5e-3, -7e-4],
};
const FISHEYE: Lens = Lens::Fisheye {
    radial: [0.03, -0.01, 0.004, -0.0007],
};
/// Lenses beyond OpenCV's, strong enough that wrong terms are seen.
const OTHERS: [Lens; 6] = [
    Lens::Brown {
        fisheye: false,
        radial: [-0.2, 0.05, -0.02, 0.004],
        tangential: [2e-3, -1e-3],
        skew: 3e-3,
    },
    Lens::ThinPrismFisheye {
        radial: [0.03, -0.01, 0.004, -0.0007],
        tangential: [2e-3, -1e-3],
        prism: [3e-3, -4e-3],
    },
    Lens::RadTanThinPrismFisheye {
        radial: [0.03, -0.01, 0.004, -0.0007, 3e-4, -1e-4],
        tangential: [2e-3, -1e-3],
        prism: [3e-3, -2e-3, -4e-3, 1e-3],
    },
    Lens::Fov { omega: 0.9 },
    Lens::Division { radial: -0.18 },
    Lens::Eucm {
        alpha: 0.6,
        beta: 1.1,
    },
];

fn camera() -> Camera {
    Camera {
        rotation: glam::DMat3::IDENTITY,
        translation: glam::DVec3::ZERO,
        fx: 300.0,
        fy: 310.0,
        cx: 205.0,
        cy: 148.0,
        width: 400,
        height: 300,
    }
}

#[test]
fn distortion_is_what_opencv_says() {
    let (u, v) = (0.31_f64, -0.22_f64);
    let r2 = u * u + v * v;
    let (r4, r6) = (r2 * r2, r2 * r2 * r2);
    let radial =
        (1.0 - 0.28 * r2 + 0.09 * r4 - 0.01 * r6) / (1.0 + 0.02 * r2 - 0.003 * r4 + 0.001 * r6);
    let expected = [
        u * radial + 2.0 * 1.5e-3 * u * v - 7e-4 * (r2 + 2.0 * u * u),
        v * radial + 1.5e-3 * (r2 + 2.0 * v * v) - 2.0 * 7e-4 * u * v,
    ];
    let found = PERSPECTIVE.distort([u, v]);
    assert!((found[0] - expected[0]).abs() < 1e-15 && (found[1] - expected[1]).abs() < 1e-15);
    let t = r2.sqrt().atan();
    let t2 = t * t;
    let bent = t * (1.0 + 0.03 * t2 - 0.01 * t2 * t2 + 0.004 * t2.powi(3) - 0.0007 * t2.powi(4));
    let found = FISHEYE.distort([u, v]);
    assert!((found[0] - u * bent / r2.sqrt()).abs() < 1e-15);
    assert!((found[1] - v * bent / r2.sqrt()).abs() < 1e-15);
}

/// COLMAP's formulas (`src/colmap/sensor/models.h`), written as it writes them.
#[test]
fn distortion_is_what_colmap_says() {
    let (u, v) = (0.43_f64, -0.31_f64);
    let r2 = u * u + v * v;
    let r = r2.sqrt();
    let t = r.atan();
    // The equidistant image of fisheyes.
    let (x, y) = (u * t / r, v * t / r);
    let (t2, xy) = (x * x + y * y, x * y);
    let brown = {
        let k = 1.0 - 0.2 * r2 + 0.05 * r2 * r2 - 0.02 * r2.powi(3) + 0.004 * r2.powi(4);
        let a = u * k + 2.0 * 2e-3 * u * v - 1e-3 * (r2 + 2.0 * u * u);
        let b = v * k + 2e-3 * (r2 + 2.0 * v * v) - 2.0 * 1e-3 * u * v;
        [a + 3e-3 * b, b]
    };
    let thin = {
        let k = 0.03 * t2 - 0.01 * t2 * t2 + 0.004 * t2.powi(3) - 0.0007 * t2.powi(4);
        [
            x + x * k + 2.0 * 2e-3 * xy - 1e-3 * (t2 + 2.0 * x * x) + 3e-3 * t2,
            y + y * k - 2.0 * 1e-3 * xy + 2e-3 * (t2 + 2.0 * y * y) - 4e-3 * t2,
        ]
    };
    let aria = {
        let k = 1.0 + 0.03 * t2 - 0.01 * t2 * t2 + 0.004 * t2.powi(3) - 0.0007 * t2.powi(4);
        let k = k + 3e-4 * t2.powi(5) - 1e-4 * t2.powi(6);
        let (x, y) = (x * k, y * k);
        let (r2, xy) = (x * x + y * y, x * y);
        [
            x - 2.0 * 1e-3 * xy + 2e-3 * (r2 + 2.0 * x * x) + 3e-3 * r2 - 2e-3 * r2 * r2,
            y + 2.0 * 2e-3 * xy - 1e-3 * (r2 + 2.0 * y * y) - 4e-3 * r2 + 1e-3 * r2 * r2,
        ]
    };
    let fov = (r * 2.0 * (0.9_f64 / 2.0).tan()).atan() / (r * 0.9);
    let division = 2.0 / (1.0 + (1.0 + 4.0 * 0.18 * r2).sqrt());
    let eucm = 1.0 / (0.6 * (1.1 * r2 + 1.0).sqrt() + 0.4);
    let radial = [fov, division, eucm].map(|k| [u * k, v * k]);
    let expected = [brown, thin, aria].into_iter().chain(radial);
    for (lens, expected) in OTHERS.iter().zip(expected) {
        let found = lens.distort([u, v]);
        let off = (found[0] - expected[0]).hypot(found[1] - expected[1]);
        assert!(off < 4e-15, "{lens:?}: {off:e}");
        assert!((found[0] - u).hypot(found[1] - v) > 1e-3);
        // The slope at the centre is that nearby.
        let [near, nearer] = [1e-7, 1e-11].map(|r| lens.distort([r, 0.0])[0] / r);
        assert!((near - nearer).abs() < 1e-6, "{lens:?}: {near} {nearer}");
        assert_eq!(lens.distort([0.0; 2]), [0.0; 2]);
    }
    // The division model is told the other way round.
    let [x, y] = OTHERS[4].distort([u, v]);
    let back = x / (1.0 - 0.18 * (x * x + y * y));
    assert!((back - u).abs() < 1e-15, "{back}");
}

/// Without their other terms fisheyes are the plain one, and Brown's lens is OpenCV's.
#[test]
fn lenses_agree_where_they_overlap() {
    let radial = [0.03, -0.01, 0.004, -0.0007];
    let none = Lens::ThinPrismFisheye {
        radial,
        tangential: [0.0; 2],
        prism: [0.0; 2],
    };
    let mut more = [0.0; 6];
    more[..4].copy_from_slice(&radial);
    let aria = Lens::RadTanThinPrismFisheye {
        radial: more,
        tangential: [0.0; 2],
        prism: [0.0; 4],
    };
    let brown = Lens::Brown {
        fisheye: false,
        radial: [-0.28, 0.09, -0.01, 0.0],
        tangential: [1.5e-3, -7e-4],
        skew: 0.0,
    };
    let opencv = Lens::Perspective {
        radial: [-0.28, 0.09, -0.01, 0.0, 0.0, 0.0],
        tangential: [1.5e-3, -7e-4],
    };
    for (a, b) in [(none, FISHEYE), (aria, FISHEYE), (brown, opencv)] {
        let [p, q] = [a, b].map(|lens| lens.distort([0.5, -0.4]));
        assert!((p[0] - q[0]).hypot(p[1] - q[1]) < 1e-15, "{a:?}");
    }
}

#[test]
fn there_and_back_again() {
    for lens in [Lens::Pinhole, PERSPECTIVE, FISHEYE]
        .into_iter()
        .chain(OTHERS)
    {
        for i in -10..=10 {
            for j in -10..=10 {
                let ray = [0.08 * f64::from(i), 0.06 * f64::from(j)];
                let back = lens.undistort(lens.distort(ray), lens.fold()).unwrap();
                let off = (back[0] - ray[0]).hypot(back[1] - ray[1]);
                assert!(off < 1e-10, "{lens:?} {ray:?}: {off:e}");
            }
        }
    }
    // A lens that folds the image over has no inverse out there.
    let folded = Lens::Perspective {
        radial: [-0.9, 0.0, 0.0, 0.0, 0.0, 0.0],
        tangential: [0.0; 2],
    };
    let fold = (1.0_f64 / (3.0 * 0.9)).sqrt();
    assert!((folded.fold() - fold).abs() < 0.01, "{}", folded.fold());
    assert_eq!(folded.undistort([0.9, 0.9], folded.fold()), None);
    // One that folds in the middle and not at the border is no better.
    let twice = Lens::Perspective {
        radial: [-3.0, 3.0, 0.0, 0.0, 0.0, 0.0],
        tangential: [0.0; 2],
    };
    assert!(twice.fold() < 0.5);
    assert_eq!(Undistortion::new(twice, &camera()), None);
    // A pole of the denominator is a fold, too.
    let pole = Lens::Perspective {
        radial: [0.0, 0.0, 0.0, -4.0, 0.0, 0.0],
        tangential: [0.0; 2],
    };
    assert!(pole.fold() <= 0.5);
    // The root is found where Newton's method from the image's radius would stand beyond the fold.
    let bulging = Lens::Fisheye {
        radial: [0.5, -0.3, 0.0, 0.0],
    };
    let ray = [1.1_f64.tan(), 0.0];
    let back = bulging
        .undistort(bulging.distort(ray), bulging.fold())
        .unwrap();
    assert!((back[0] - ray[0]).abs() < 1e-9);
    // Nothing but zeros is no lens; an equidistant fisheye without coefficients is one.
    assert_eq!(Lens::of_coefficients(&[0.0; 8], false), Lens::Pinhole);
    assert_ne!(Lens::of_coefficients(&[0.0; 4], true), Lens::Pinhole);
}

/// A photo of a smooth picture on the plane at depth 1, taken through a lens.
fn photo(camera: &Camera, lens: Lens, channels: usize) -> Vec<u8> {
    let fold = lens.fold();
    let pixels = (0..camera.height).flat_map(|y| (0..camera.width).map(move |x| (x, y)));
    pixels
        .flat_map(|(x, y)| {
            let place = [
                (f64::from(x) + 0.5 - camera.cx) / camera.fx,
                (f64::from(y) + 0.5 - camera.cy) / camera.fy,
            ];
            let [u, v] = lens.undistort(place, fold).unwrap();
            let wave = |f: f64, p: f64| {
                (127.5 + 100.0 * (f * u + p).sin() * (f * v - p).cos()).round() as u8
            };
            let mut pixel = vec![wave(9.0, 0.0), wave(7.0, 1.0), wave(5.0, 2.0), 255];
            pixel.truncate(channels);
            pixel
        })
        .collect()
}

#[test]
fn a_photo_without_its_distortion_is_the_pinhole_photo() {
    for lens in [PERSPECTIVE, FISHEYE].into_iter().chain(OTHERS) {
        for channels in [3, 4] {
            let source = camera();
            let undistortion = Undistortion::new(lens, &source).unwrap();
            let target = undistortion.target;
            assert!(target.width > 200 && target.height > 150, "{target:?}");
            let found = undistortion.apply(&photo(&source, lens, channels), channels);
            let expected = photo(&target, Lens::Pinhole, channels);
            let far = found
                .iter()
                .zip(&expected)
                .map(|(a, b)| a.abs_diff(*b))
                .max()
                .unwrap();
            assert!(far <= 2, "{lens:?}: {far} grey levels");
            // The comparison fails for a photo that is left as it is.
            let wrong = Undistortion::new(Lens::Pinhole, &source).unwrap();
            let same = wrong.apply(&photo(&source, lens, channels), channels);
            let whole = photo(&source, Lens::Pinhole, channels);
            assert!(same.iter().zip(&whole).any(|(a, b)| a.abs_diff(*b) > 20));
        }
    }
}

/// The photos of south-opencv against COLMAP's: MHSPLAT_UNDISTORTED names the folder that `colmap image_undistorter` (or
/// pycolmap's `undistort_images`) has made of them.
#[test]
fn as_colmap_undistorts() {
    let theirs = std::env::var_os("MHSPLAT_UNDISTORTED").map(std::path::PathBuf::from);
    let (Some(ours), Some(theirs)) = (data("south-opencv"), theirs) else {
        println!("skipped: MHSPLAT_UNDISTORTED is not set");
        return;
    };
    let options = LoadOptions {
        test_every: 0,
        ..LoadOptions::default()
    };
    let [ours, theirs] = [ours, theirs].map(|path| load(&path, &options).unwrap());
    let mut seen = 0;
    for view in &ours.train {
        let Some(other) = theirs.train.iter().find(|v| v.name == view.name) else {
            continue;
        };
        let [PhotoSource::Memory(a), PhotoSource::Memory(b)] = [&view.photo, &other.photo] else {
            panic!("photos fit in memory");
        };
        assert_eq!((a.width, a.height), (b.width, b.height), "{}", view.name);
        let lens = |c: &Camera| [c.fx, c.fy, c.cx, c.cy];
        assert_eq!(lens(&view.camera), lens(&other.camera));
        let sum: u64 = a
            .data
            .iter()
            .zip(&b.data)
            .map(|(a, b)| u64::from(a.abs_diff(*b)))
            .sum();
        let mean = sum as f64 / a.data.len() as f64;
        println!("{}: {mean:.3}", view.name);
        assert!(mean < 1.0, "{}: {mean} grey levels", view.name);
        seen += 1;
    }
    assert_eq!(seen, ours.train.len());
}

/// The lens of a COLMAP model's only camera.
fn colmap_lens(line: &str) -> ([f64; 4], Lens) {
    let dir = super::colmap_scene(3, glam::DVec3::ZERO, false);
    let sparse = dir.path().join("sparse/0");
    fs::write(sparse.join("cameras.txt"), format!("1 {line}\n")).unwrap();
    let camera = ColmapModel::read(&sparse, false).unwrap().cameras[0];
    (camera.params, camera.lens)
}

#[test]
fn every_parameter_has_its_place() {
    let perspective =
        |radial: [f64; 6], tangential: [f64; 2]| Lens::Perspective { radial, tangential };
    let fisheye = |radial: [f64; 4]| Lens::Fisheye { radial };
    let (one, two) = ([20.0, 20.0, 8.0, 6.0], [20.0, 21.0, 8.0, 6.0]);
    for (line, params, lens) in [
        ("SIMPLE_PINHOLE 16 12 20 8 6", one, Lens::Pinhole),
        ("PINHOLE 16 12 20 21 8 6", two, Lens::Pinhole),
        (
            "SIMPLE_RADIAL 16 12 20 8 6 0.1",
            one,
            perspective([0.1, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0; 2]),
        ),
        (
            "RADIAL 16 12 20 8 6 0.1 0.2",
            one,
            perspective([0.1, 0.2, 0.0, 0.0, 0.0, 0.0], [0.0; 2]),
        ),
        (
            "OPENCV 16 12 20 21 8 6 0.1 0.2 0.01 0.02",
            two,
            perspective([0.1, 0.2, 0.0, 0.0, 0.0, 0.0], [0.01, 0.02]),
        ),
        ("OPENCV 16 12 20 21 8 6 0 0 0 0", two, Lens::Pinhole),
        (
            "FULL_OPENCV 16 12 20 21 8 6 0.1 0.2 0.01 0.02 0.3 0.4 0.5 0.6",
            two,
            perspective([0.1, 0.2, 0.3, 0.4, 0.5, 0.6], [0.01, 0.02]),
        ),
        (
            "OPENCV_FISHEYE 16 12 20 21 8 6 0.1 0.2 0.3 0.4",
            two,
            fisheye([0.1, 0.2, 0.3, 0.4]),
        ),
        (
            "SIMPLE_RADIAL_FISHEYE 16 12 20 8 6 0.1",
            one,
            fisheye([0.1, 0.0, 0.0, 0.0]),
        ),
        (
            "RADIAL_FISHEYE 16 12 20 8 6 0.1 0.2",
            one,
            fisheye([0.1, 0.2, 0.0, 0.0]),
        ),
        ("SIMPLE_FISHEYE 16 12 20 8 6", one, fisheye([0.0; 4])),
        ("FISHEYE 16 12 20 21 8 6", two, fisheye([0.0; 4])),
        ("FOV 16 12 20 21 8 6 0.9", two, Lens::Fov { omega: 0.9 }),
        ("FOV 16 12 20 21 8 6 0", two, Lens::Pinhole),
        (
            "THIN_PRISM_FISHEYE 16 12 20 21 8 6 0.1 0.2 0.01 0.02 0.3 0.4 0.03 0.04",
            two,
            Lens::ThinPrismFisheye {
                radial: [0.1, 0.2, 0.3, 0.4],
                tangential: [0.01, 0.02],
                prism: [0.03, 0.04],
            },
        ),
        (
            "RAD_TAN_THIN_PRISM_FISHEYE 16 12 20 21 8 6 0.1 0.2 0.3 0.4 0.5 0.6 0.01 0.02 0.03 0.04 0.05 0.06",
            two,
            Lens::RadTanThinPrismFisheye {
                radial: [0.1, 0.2, 0.3, 0.4, 0.5, 0.6],
                tangential: [0.01, 0.02],
                prism: [0.03, 0.04, 0.05, 0.06],
            },
        ),
        (
            "SIMPLE_DIVISION 16 12 20 8 6 -0.1",
            one,
            Lens::Division { radial: -0.1 },
        ),
        (
            "DIVISION 16 12 20 21 8 6 -0.1",
            two,
            Lens::Division { radial: -0.1 },
        ),
        (
            "EUCM 16 12 20 21 8 6 0.6 1.1",
            two,
            Lens::Eucm {
                alpha: 0.6,
                beta: 1.1,
            },
        ),
    ] {
        assert_eq!(colmap_lens(line), (params, lens), "{line}");
    }
}

/// Binary models name theirs by number.
#[test]
fn models_have_their_numbers() {
    let dir = super::colmap_scene(3, glam::DVec3::ZERO, true);
    let file = dir.path().join("sparse/0/cameras.bin");
    let (one, two) = (&[21.5, 8.5, 5.75][..], &[21.5, 20.25, 8.5, 5.75][..]);
    for (number, first, more) in [
        (7, two, 1),
        (10, two, 8),
        (11, two, 12),
        (12, one, 1),
        (13, two, 1),
        (14, one, 0),
        (15, two, 0),
        (16, two, 2),
    ] {
        let mut bytes = 1_u64.to_le_bytes().to_vec();
        bytes.extend(1_u32.to_le_bytes());
        bytes.extend(i32::to_le_bytes(number));
        bytes.extend([16_u64, 12].into_iter().flat_map(u64::to_le_bytes));
        let params = first
            .iter()
            .copied()
            .chain([0.02; 12].into_iter().take(more));
        bytes.extend(params.flat_map(f64::to_le_bytes));
        fs::write(&file, &bytes).unwrap();
        let camera = ColmapModel::read(&dir.path().join("sparse/0"), true)
            .unwrap()
            .cameras[0];
        assert_ne!(camera.lens, Lens::Pinhole, "{number}");
        let data = load(dir.path(), &LoadOptions::default()).unwrap();
        assert_eq!(data.undistorted, 3, "{number}");
    }
}

#[test]
fn coefficients_out_of_their_domain_are_refused() {
    for line in [
        "FOV 16 12 20 21 8 6 3.2",
        "EUCM 16 12 20 21 8 6 1.6 1.1",
        "EUCM 16 12 20 21 8 6 0.6 0",
        "DIVISION 16 12 20 21 8 6 nan",
        "THIN_PRISM_FISHEYE 16 12 20 21 8 6 0 0 0 0 0 0 inf 0",
    ] {
        let dir = super::colmap_scene(3, glam::DVec3::ZERO, false);
        let file = dir.path().join("sparse/0/cameras.txt");
        fs::write(&file, format!("1 {line}\n")).unwrap();
        let read = load(dir.path(), &LoadOptions::default());
        super::assert_refused(read, &["cameras.txt", "camera 1", "domain"]);
    }
}

/// The pixels of the first view of a dataset of three cameras, written as COLMAP's or as transforms.
fn pixels(dir: &std::path::Path) -> (Camera, Vec<u8>) {
    let data = load(
        dir,
        &LoadOptions {
            test_every: 0,
            ..LoadOptions::default()
        },
    )
    .unwrap();
    assert_eq!(data.undistorted, 3);
    let view = &data.train[0];
    (view.camera, view.photo.load().unwrap().data.clone())
}

#[test]
fn transforms_say_it_as_colmap_does() {
    let views = super::ring(3, glam::DVec3::ZERO);
    for (line, keys) in [
        (
            "OPENCV 16 12 21.5 20.25 8.5 5.75 0.05 0.01 0.003 0.004",
            json!({"k1": 0.05, "k2": 0.01, "p1": 0.003, "p2": 0.004}),
        ),
        (
            "FULL_OPENCV 16 12 21.5 20.25 8.5 5.75 0.05 0.01 0.003 0.004 0.02 0.03 0.04 0.05",
            json!({"camera_model": "FULL_OPENCV", "k1": 0.05, "k2": 0.01, "p1": 0.003, "p2": 0.004,
                   "k3": 0.02, "k4": 0.03, "k5": 0.04, "k6": 0.05}),
        ),
        (
            "OPENCV_FISHEYE 16 12 21.5 20.25 8.5 5.75 0.05 0.01 0.02 0.03",
            json!({"is_fisheye": true, "k1": 0.05, "k2": 0.01, "k3": 0.02, "k4": 0.03}),
        ),
    ] {
        let colmap = super::colmap_scene(3, glam::DVec3::ZERO, false);
        fs::write(
            colmap.path().join("sparse/0/cameras.txt"),
            format!("1 {line}\n"),
        )
        .unwrap();
        let dir = tempfile::tempdir().unwrap();
        super::write_images(dir.path(), &views);
        let file = dir.path().join("transforms.json");
        write_transforms(&file, &views, None).unwrap();
        let mut text: Value = serde_json::from_str(&fs::read_to_string(&file).unwrap()).unwrap();
        for (key, value) in keys.as_object().unwrap() {
            text[key] = value.clone();
        }
        // A frame's own wins over the file's, and a null is no value.
        text["k1"] = json!(0.4);
        for frame in text["frames"].as_array_mut().unwrap() {
            frame["k1"] = json!(0.05);
            frame["k2"] = Value::Null;
        }
        fs::write(&file, text.to_string()).unwrap();
        let (a, b) = (pixels(colmap.path()), pixels(dir.path()));
        assert_eq!((a.0.width, a.0.height), (b.0.width, b.0.height), "{line}");
        assert_eq!(a.1, b.1, "{line}");
        text["frames"][0]["k1"] = json!(0.3);
        fs::write(&file, text.to_string()).unwrap();
        assert_ne!(pixels(dir.path()).1, a.1, "{line}");
    }
}

#[test]
fn a_fingerprint_tells_lenses_apart() {
    let dir = super::colmap_scene(3, glam::DVec3::ZERO, false);
    let of = |tangential: f64| {
        let line = format!("1 OPENCV 16 12 21.5 20.25 8.5 5.75 0.05 0.01 0 {tangential}\n");
        fs::write(dir.path().join("sparse/0/cameras.txt"), line).unwrap();
        let data = load(dir.path(), &LoadOptions::default()).unwrap();
        assert_ne!(data.train[0].lens, Lens::Pinhole);
        (data.train[0].camera, data.fingerprint())
    };
    // So little that the pinhole camera is the same.
    let [a, again, b] = [1e-9, 1e-9, 2e-9].map(of);
    assert_eq!(a, again);
    assert_eq!(a.0, b.0);
    assert_ne!(a.1, b.1);
}

/// Photos that are written without their distortion and read again are the same to the bit, with their cameras and points.
#[test]
fn undistorted_photos_of_their_own_are_the_same_photos() {
    let dir = super::colmap_scene(3, glam::DVec3::ZERO, false);
    let cameras = dir.path().join("sparse/0/cameras.txt");
    let of = |line: String| {
        fs::write(&cameras, format!("1 {line}\n")).unwrap();
        let options = LoadOptions {
            test_every: 0,
            ..LoadOptions::default()
        };
        load(dir.path(), &options).unwrap()
    };
    let a = of("OPENCV 16 12 21.5 20.25 8.5 5.75 0.05 0.01 0.003 0.004".into());
    let raw = of("PINHOLE 16 12 21.5 20.25 8.5 5.75".into());
    for (view, raw) in a.train.iter().zip(&raw.train) {
        let photo = view.photo.load().unwrap();
        assert_ne!(photo.data, raw.photo.load().unwrap().data);
        let pixels = (photo.width * photo.height) as usize;
        let rgb: Vec<u8> = (0..3 * pixels)
            .map(|k| photo.data[k % 3 * pixels + k / 3])
            .collect();
        let file = dir.path().join("images").join(&view.name);
        image::save_buffer(
            file,
            &rgb,
            photo.width,
            photo.height,
            image::ColorType::Rgb8,
        )
        .unwrap();
    }
    let c = a.train[0].camera;
    let b = of(format!(
        "PINHOLE {} {} {} {} {} {}",
        c.width, c.height, c.fx, c.fy, c.cx, c.cy
    ));
    assert_eq!((a.undistorted, b.undistorted), (3, 0));
    for (a, b) in a.train.iter().zip(&b.train) {
        assert_eq!((&a.name, a.camera), (&b.name, b.camera));
        assert_eq!(b.lens, Lens::Pinhole);
        assert_eq!(a.photo.load().unwrap().data, b.photo.load().unwrap().data);
    }
    assert_eq!(a.points.positions, b.points.positions);
    assert_eq!(a.points.colors, b.points.colors);
    assert_eq!(a.frame, b.frame);
}
