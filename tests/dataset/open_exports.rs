//! Exports of OpenSfM and OpenMVG, made by their documents and projected by these.

use std::fs;

use glam::{DMat3, DQuat, DVec3};
use serde_json::{Value, json};

use super::exports::{
    RADIAL, SIZE, TANGENTIAL, VIEWS, assert_projects, axes, center, name, photos, points,
};
use super::{assert_refused, load_every};
use mhsplat::capture::Layout;

/// Focal lengths of the two cameras, which views have by turns: of OpenSfM's over the larger side, of OpenMVG's in pixels.
const FOCAL: [f64; 2] = [0.8, 0.9];
/// Principal point from the middle of the photo, over the larger side.
const MIDDLE: [f64; 2] = [0.012, -0.02];

/// A point on the plane at depth 1 before a camera.
fn seen(i: usize, point: DVec3) -> [f64; 2] {
    let [right, down, forward] = axes(i);
    let d = point - center(i);
    [right.dot(d) / forward.dot(d), down.dot(d) / forward.dot(d)]
}

/// Brown's lens with OpenCV's order of the tangential terms, k3 being the last.
fn brown([x, y]: [f64; 2]) -> [f64; 2] {
    let r2 = x * x + y * y;
    let ([k1, k2, k3, _], [p1, p2]) = (RADIAL, TANGENTIAL);
    let radial = 1.0 + k1 * r2 + k2 * r2 * r2 + k3 * r2 * r2 * r2;
    [
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    ]
}

/// A fisheye: the angle to the axis, bent by k1 and k2.
fn fisheye([x, y]: [f64; 2]) -> [f64; 2] {
    let r = x.hypot(y);
    let angle = r.atan();
    let [k1, k2, ..] = RADIAL;
    let bent = angle * (1.0 + k1 * angle.powi(2) + k2 * angle.powi(4)) / r;
    [x * bent, y * bent]
}

fn pose(i: usize) -> (DMat3, DVec3) {
    let [x, y, z] = axes(i);
    let rotation = DMat3::from_cols(x, y, z).transpose();
    (rotation, -(rotation * center(i)))
}

/// A reconstruction with cameras of a kind, after a smaller one.
fn reconstruction(kind: &str) -> Value {
    let ([k1, k2, k3, _], [p1, p2], [c_x, c_y]) = (RADIAL, TANGENTIAL, MIDDLE);
    let camera = |focal: f64| match kind {
        "fisheye" => {
            json!({"projection_type": kind, "width": 4000, "height": 3000, "focal": focal, "k1": k1, "k2": k2})
        }
        _ => json!({
            "projection_type": kind, "width": 4000, "height": 3000, "focal_x": focal, "focal_y": focal,
            "c_x": c_x, "c_y": c_y, "k1": k1, "k2": k2, "k3": k3, "p1": p1, "p2": p2
        }),
    };
    let cameras = json!({"a": camera(FOCAL[0]), "b": camera(FOCAL[1])});
    let shot = |i: usize| {
        let (rotation, translation) = pose(i);
        let turn = DQuat::from_mat3(&rotation).to_scaled_axis();
        let camera = ["a", "b"][i % 2];
        json!({"rotation": turn.to_array(), "translation": translation.to_array(), "camera": camera})
    };
    let shots: serde_json::Map<String, Value> = (0..VIEWS).map(|i| (name(i), shot(i))).collect();
    let cloud = points().into_iter().enumerate();
    let cloud: serde_json::Map<String, Value> = cloud
        .map(|(i, p)| {
            let point = json!({"color": [200.0, 100.0, 7.0], "coordinates": p.to_array()});
            (i.to_string(), point)
        })
        .collect();
    let small = json!({"cameras": cameras, "shots": {"x.png": shot(0)}, "points": {}});
    json!([small, {"cameras": cameras, "shots": shots, "points": cloud}])
}

#[test]
fn open_sfm_projects_as_its_document_says() {
    let dir = photos("images");
    let file = dir.path().join("reconstruction.json");
    for kind in ["brown", "fisheye"] {
        fs::write(&file, reconstruction(kind).to_string()).unwrap();
        let data = load_every(dir.path(), 0).unwrap();
        assert_eq!(data.layout, Layout::OpenSfm);
        assert_eq!(data.place, "reconstruction.json, photos in images");
        assert!(data.remarks.iter().any(|r| r.contains("largest of 2")));
        assert_projects(&data, |i, p| {
            let (bent, middle) = match kind {
                "fisheye" => (fisheye(seen(i, p)), [0.0; 2]),
                _ => (brown(seen(i, p)), MIDDLE),
            };
            // The larger side, and the middle of the photo.
            let of = |k: usize, half: f64| 40.0 * (FOCAL[i % 2] * bent[k] + middle[k]) + half;
            [of(0, 20.0), of(1, 15.0)]
        });
        assert_eq!(data.points.positions.len(), 9);
        assert_eq!(data.points.colors[0], [200, 100, 7]);
    }
    for (from, to, words) in [
        ("fisheye", "dual", ["dual", "not read"]),
        ("focal", "vocal", ["IMG_0.png", "focal length"]),
        ("\"b\":", "\"c\":", ["IMG_1.png", "not there"]),
        ("\"shots\"", "\"shot\"", ["reconstruction.json", "shots"]),
    ] {
        fs::write(
            &file,
            reconstruction("fisheye").to_string().replace(from, to),
        )
        .unwrap();
        assert_refused(load_every(dir.path(), 0), &words);
    }
}

/// A scene whose second camera is of the class of the first, which alone is named; with the base class in a value of its own, or not.
fn sfm_data(class: &str, nested: bool) -> Value {
    let [width, height] = SIZE;
    let ([k1, k2, k3, k4], [t1, t2]) = (RADIAL, TANGENTIAL);
    let middle = [20.0 + 40.0 * MIDDLE[0], 15.0 + 40.0 * MIDDLE[1]];
    let intrinsics: Vec<Value> = (0..2)
        .map(|key| {
            let focal = 40.0 * FOCAL[key];
            let base = json!({"width": width, "height": height, "focal_length": focal, "principal_point": middle});
            let mut data = match nested {
                true => json!({"value0": base}),
                false => base,
            };
            match class {
                "fisheye" => data["fisheye"] = json!([k1, k2, k3, k4]),
                _ => data["disto_t2"] = json!([k1, k2, k3, t1, t2]),
            }
            let wrapped = json!({"id": 2_147_483_660_u64, "data": data});
            let value = match key {
                0 => json!({"polymorphic_id": 2_147_483_651_u64, "polymorphic_name": class, "ptr_wrapper": wrapped}),
                _ => json!({"polymorphic_id": 3, "ptr_wrapper": wrapped}),
            };
            json!({"key": key, "value": value})
        })
        .collect();
    let view = |i: usize, name: String, pose: u64| {
        let data = json!({
            "local_path": "/", "filename": name, "width": width, "height": height, "id_view": i, "id_intrinsic": i % 2, "id_pose": pose
        });
        json!({"key": i, "value": {"polymorphic_id": 1_073_741_824, "ptr_wrapper": {"id": i, "data": data}}})
    };
    let mut views: Vec<Value> = (0..VIEWS)
        .map(|i| view(i, name(i), 10 + i as u64))
        .collect();
    views.push(view(VIEWS, "without-a-pose.png".into(), 4_294_967_295));
    let extrinsics: Vec<Value> = (0..VIEWS)
        .map(|i| {
            let rows = pose(i).0.transpose();
            let rows = [rows.x_axis, rows.y_axis, rows.z_axis].map(|row| row.to_array());
            json!({"key": 10 + i, "value": {"rotation": rows, "center": center(i).to_array()}})
        })
        .collect();
    let structure: Vec<Value> = points()
        .into_iter()
        .enumerate()
        .map(|(i, p)| json!({"key": i, "value": {"X": p.to_array(), "observations": []}}))
        .collect();
    json!({
        "sfm_data_version": "0.3", "root_path": "/elsewhere/images", "views": views, "intrinsics": intrinsics,
        "extrinsics": extrinsics, "structure": structure, "control_points": []
    })
}

#[test]
fn open_mvg_projects_as_its_document_says() {
    let dir = photos("images");
    let file = dir.path().join("sfm_data.json");
    for (class, nested) in [
        ("pinhole_brown_t2", true),
        ("pinhole_brown_t2", false),
        ("fisheye", true),
    ] {
        fs::write(&file, sfm_data(class, nested).to_string()).unwrap();
        let data = load_every(dir.path(), 0).unwrap();
        assert_eq!(data.layout, Layout::OpenMvg);
        assert_eq!(data.place, "sfm_data.json, photos in images");
        assert_projects(&data, |i, p| {
            let [x, y] = seen(i, p);
            let bent = match class {
                "fisheye" => {
                    let r = x.hypot(y);
                    let a = r.atan();
                    let [k1, k2, k3, k4] = RADIAL;
                    let a = a
                        * (1.0 + k1 * a.powi(2) + k2 * a.powi(4) + k3 * a.powi(6) + k4 * a.powi(8));
                    [x * a / r, y * a / r]
                }
                _ => brown([x, y]),
            };
            let of = |k: usize, half: f64| 40.0 * (FOCAL[i % 2] * bent[k] + MIDDLE[k]) + half;
            [of(0, 20.0), of(1, 15.0)]
        });
        assert_eq!(data.points.positions.len(), 9);
    }
    let text = sfm_data("fisheye", true).to_string();
    for (from, to, words) in [
        (
            "\"fisheye\",",
            "\"pinhole_odd\",",
            ["pinhole_odd", "not read"],
        ),
        (
            "focal_length",
            "vocal_length",
            ["IMG_0.png", "focal length"],
        ),
        (
            "id_pose",
            "id_prose",
            ["sfm_data.json", "no view with a pose"],
        ),
        (
            "\"intrinsics\"",
            "\"intrinsic\"",
            ["sfm_data.json", "intrinsics"],
        ),
    ] {
        assert_ne!(text.replace(from, to), text, "{from}");
        fs::write(&file, text.replace(from, to)).unwrap();
        assert_refused(load_every(dir.path(), 0), &words);
    }
}
