//! Real datasets, where they are at hand.

use std::path::PathBuf;

use super::load_every;
use mhsplat::capture::{Alpha, Dataset, Layout, LoadOptions, load};

/// A folder of the optional test data: `$MHSPLAT_DATA`, or `shared/data` next to the checkout.
pub fn data(name: &str) -> Option<PathBuf> {
    let root = std::env::var_os("MHSPLAT_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    let path = root.join(name);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {name} is not at hand");
    None
}

/// Share of the points that project into a view, mean over the training views; points behind count as outside.
fn visible(d: &Dataset) -> f64 {
    let mut inside = 0;
    for view in &d.train {
        let c = &view.camera;
        inside += d
            .points
            .positions
            .iter()
            .map(|p| c.rotation * glam::DVec3::from_array(p.map(f64::from)) + c.translation)
            .filter(|t| t.z > 0.0)
            .map(|t| (c.fx * t.x / t.z + c.cx, c.fy * t.y / t.z + c.cy))
            .filter(|(x, y)| {
                (0.0..f64::from(c.width)).contains(x) && (0.0..f64::from(c.height)).contains(y)
            })
            .count();
    }
    inside as f64 / (d.train.len() * d.points.positions.len()) as f64
}

#[test]
fn colmap_points_lie_where_the_cameras_look() {
    for (name, layout, views) in [
        ("plush-tiny", Layout::ColmapTxt, (14, 3)),
        ("fox-colmap", Layout::ColmapBin, (43, 7)),
        ("synth-outdoor", Layout::ColmapTxt, (35, 5)),
    ] {
        let Some(path) = data(name) else { continue };
        let options = LoadOptions {
            max_size: 100,
            ..LoadOptions::default()
        };
        let mut d = load(&path, &options).unwrap();
        assert_eq!(d.layout, layout);
        assert_eq!((d.train.len(), d.test.len()), views, "{name}");
        assert_eq!(d.train[0].camera.width.max(d.train[0].camera.height), 100);
        let share = visible(&d);
        assert!(share > 0.25, "{name}: {share} of the points are in view");
        for view in &mut d.train {
            view.camera.rotation = view.camera.rotation.transpose();
        }
        assert!(visible(&d) < share, "{name}: turned cameras see as much");
    }
}

#[test]
fn blender_scenes_load_with_alpha() {
    let Some(path) = data("lego-tiny") else {
        return;
    };
    let d = load_every(&path, 8).unwrap();
    assert_eq!((d.train.len(), d.test.len()), (21, 4));
    assert_eq!(d.alpha(), Alpha::Transparency);
    assert!((d.train[0].camera.fx - 138.888).abs() < 0.01);
    // Every camera looks at the middle of the scene.
    for view in &d.train {
        let t =
            view.camera.rotation * d.frame.to_local(glam::DVec3::ZERO) + view.camera.translation;
        assert!(
            t.z > 0.0 && t.x.hypot(t.y) < 0.05 * t.z,
            "{}: {t}",
            view.name
        );
    }
}

#[test]
fn distorted_datasets_are_undistorted() {
    for name in ["fox", "south-opencv"] {
        if let Some(path) = data(name) {
            let d = load_every(&path, 8).unwrap();
            assert_eq!(d.undistorted, d.train.len() + d.test.len());
        }
    }
}
