//! Scenes and cameras made up for pages.

use glam::{DMat3, DVec3};
use serde_json::Value;

use mhsplat::Camera;
use mhsplat::base::rng::Philox;
use mhsplat::run::viewer::{MAX_BYTES, SceneView};
use mhsplat::run::{ScenePage, write_scene_page};
use mhsplat::scene::{Gaussians, Plane};

/// Gaussians of all shapes in a ball of radius 1, one of 50 a hundred times as far away.
pub fn scene(n: usize, degree: u32) -> Gaussians {
    let value = |p: usize, i: usize| {
        let u = Philox::uniform(7, p as u64, i as u64)[0] * 2.0 - 1.0;
        let v = match p {
            0..3 if i.is_multiple_of(50) => 100.0 * u,
            0..3 => u,
            3..6 if i.is_multiple_of(50) => 1.0 + u,
            3..6 => -4.5 + 1.5 * u,
            Plane::OPACITY => 4.0 * u,
            p if p < Plane::SH + 3 => u,
            _ => 0.3 * u,
        };
        v as f32
    };
    let planes = (0..Plane::count(degree)).map(|p| (0..n).map(|i| value(p, i)).collect());
    Gaussians::new(degree, planes.collect()).unwrap()
}

/// A camera of 160 × 120 pixels with unequal focal lengths and its principal point beside the middle.
pub fn looking(eye: DVec3, at: DVec3, up: DVec3) -> Camera {
    let z = (at - eye).normalize();
    let x = z.cross(up).normalize();
    let rotation = DMat3::from_cols(x, z.cross(x), z).transpose();
    Camera {
        rotation,
        translation: -(rotation * eye),
        fx: 130.0,
        fy: 120.0,
        cx: 84.5,
        cy: 57.0,
        width: 160,
        height: 120,
    }
}

/// Two held-out views, one with scores, and four training views on a circle, z up.
pub fn views() -> Vec<SceneView> {
    let view = |k: usize| {
        let a = k as f64 * std::f64::consts::TAU / 6.0;
        let eye = DVec3::new(2.2 * a.cos(), 2.2 * a.sin(), 0.8);
        SceneView {
            name: format!("view_{k}.png"),
            camera: looking(eye, DVec3::ZERO, DVec3::Z),
            held_out: k < 2,
            scores: (k == 0).then_some([31.5, 0.9]),
            photo: None,
        }
    };
    (0..6).map(view).collect()
}

/// The page as text, and its remarks.
pub fn written(page: &ScenePage) -> (String, Vec<String>) {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("scene.html");
    let remarks = write_scene_page(&file, page).unwrap();
    (std::fs::read_to_string(file).unwrap(), remarks)
}

pub fn page(splats: &Gaussians, anti_aliased: bool, views: &[SceneView]) -> String {
    let page = ScenePage {
        title: "made up",
        splats,
        anti_aliased,
        background: [0.25, 0.5, 0.75],
        views,
        remarks: &[],
        max_bytes: MAX_BYTES,
    };
    written(&page).0
}

/// Text of a script element.
pub fn element<'a>(html: &'a str, id: &str) -> &'a str {
    let start = html.find(&format!("<script id=\"{id}\"")).unwrap();
    let text = &html[start..];
    let text = &text[text.find('>').unwrap() + 1..];
    &text[..text.find("</script>").unwrap()]
}

pub fn meta(html: &str) -> Value {
    serde_json::from_str(element(html, "meta")).unwrap()
}
