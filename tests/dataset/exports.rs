//! Exports of RealityScan, Metashape and Bundler, made by their published formulas and projected by these.

use std::f64::consts::PI;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use glam::{DMat3, DVec3};
use tempfile::TempDir;

use super::{assert_refused, load_every};
use mhsplat::capture::{Dataset, Layout, LoadOptions, View, load};

/// Size of the photos, pixels.
pub(super) const SIZE: [u32; 2] = [40, 30];
/// Views of an export.
pub(super) const VIEWS: usize = 6;
/// Photos of them are called IMG_0.png and so on.
pub(super) fn name(i: usize) -> String {
    format!("IMG_{i}.png")
}

/// Centres of the cameras: a ring of radius 4 around the origin, at heights of their own.
pub(super) fn center(i: usize) -> DVec3 {
    let angle = 2.0 * PI * i as f64 / VIEWS as f64;
    DVec3::new(4.0 * angle.cos(), 4.0 * angle.sin(), 0.5 + 0.1 * i as f64)
}

/// Directions right, down and forward of a camera that looks at the origin, tilted a little; z is up.
pub(super) fn axes(i: usize) -> [DVec3; 3] {
    let forward = -center(i).normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let down = forward.cross(right);
    let tilt = 0.1 * i as f64;
    [
        right * tilt.cos() + down * tilt.sin(),
        down * tilt.cos() - right * tilt.sin(),
        forward,
    ]
}

/// Points that all cameras see.
pub(super) fn points() -> Vec<DVec3> {
    let at = |i: i32| DVec3::new(f64::from(i % 3) - 1.0, f64::from(i / 3 % 3) - 1.0, 0.2);
    (0..9).map(|i| 0.6 * at(i)).collect()
}

/// A folder with photos.
pub(super) fn photos(folder: &str) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    let images = dir.path().join(folder);
    fs::create_dir_all(&images).unwrap();
    for i in 0..VIEWS {
        let ramp = |x: u32, y: u32| image::Rgb([(5 * x) as u8, (7 * y) as u8, 90]);
        let photo = image::RgbImage::from_fn(SIZE[0], SIZE[1], ramp);
        photo.save(images.join(name(i))).unwrap();
    }
    dir
}

/// The points in the file `points.ply`, moved.
fn cloud(dir: &Path, shift: DVec3) {
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nend_header\n",
        points().len()
    );
    for p in points() {
        let p = p + shift;
        let _ = writeln!(text, "{} {} {}", p.x, p.y, p.z);
    }
    fs::write(dir.join("points.ply"), text).unwrap();
}

/// Point of the photo as it lies on the disk, pixels, by the camera and lens that were read.
fn read_pixel(data: &Dataset, view: &View, point: DVec3) -> [f64; 2] {
    let c = &view.camera;
    let t = c.rotation * data.frame.to_local(point) + c.translation;
    assert!(t.z > 0.0);
    let [x, y] = view.lens.distort([t.x / t.z, t.y / t.z]);
    // The undistorted image has the photo's focal length and, in proportion, its principal point.
    let share = |center: f64, size: u32, whole: u32| center * f64::from(whole) / f64::from(size);
    [
        c.fx * x + share(c.cx, c.width, SIZE[0]),
        c.fy * y + share(c.cy, c.height, SIZE[1]),
    ]
}

/// Compares all views with the format's own projection of a point in the file's view of this number.
#[track_caller]
pub(super) fn assert_projects(data: &Dataset, project: impl Fn(usize, DVec3) -> [f64; 2]) {
    assert_eq!(data.train.len(), VIEWS);
    for view in &data.train {
        let i = view.name.strip_suffix(".png").unwrap_or(&view.name);
        let i = i.rsplit_once('_').unwrap().1.parse().unwrap();
        for point in points() {
            let [found, expected] = [read_pixel(data, view, point), project(i, point)];
            let off = (found[0] - expected[0]).hypot(found[1] - expected[1]);
            assert!(off < 1e-6, "{} {point}: {found:?} {expected:?}", view.name);
            let inside = expected[0] > 0.0 && expected[0] < f64::from(SIZE[0]);
            assert!(inside, "{expected:?}");
        }
    }
}

/// Brown's lens as both vendors write it: the first tangential term along x.
fn brown(k: [f64; 4], [t1, t2]: [f64; 2], [x, y]: [f64; 2]) -> [f64; 2] {
    let r = x.hypot(y);
    let radial = 1.0 + k[0] * r.powi(2) + k[1] * r.powi(4) + k[2] * r.powi(6) + k[3] * r.powi(8);
    [
        x * radial + t1 * (r * r + 2.0 * x * x) + t2 * 2.0 * x * y,
        y * radial + t2 * (r * r + 2.0 * y * y) + t1 * 2.0 * x * y,
    ]
}

pub(super) const RADIAL: [f64; 4] = [-0.12, 0.05, -0.02, 0.01];
pub(super) const TANGENTIAL: [f64; 2] = [4e-3, -7e-3];

/// Heading, pitch and roll of a camera, radians, by the vendor's definition: Euler angles in the order ZYX of the body (nose, right wing,
/// nadir) in the frame north, east, down, the camera's top towards the nose.
fn heading_pitch_roll(i: usize) -> [f64; 3] {
    let [right, down, forward] = axes(i);
    let ned = |v: DVec3| DVec3::new(v.y, v.x, -v.z);
    let (nose, wing, nadir) = (ned(-down), ned(right), ned(forward));
    // Columns of Rz(heading) Ry(pitch) Rx(roll).
    [nose.y.atan2(nose.x), -nose.z.asin(), wing.z.atan2(nadir.z)]
}

/// The projection by the vendor's document: angles → body → camera → Brown → normalised lengths → pixels.
fn reality_scan_pixel(i: usize, point: DVec3, focal: f64, center_of: [f64; 2]) -> [f64; 2] {
    let [heading, pitch, roll] = heading_pitch_roll(i);
    let d = point - center(i);
    let ned = DVec3::new(d.y, d.x, -d.z);
    let rotation = DMat3::from_rotation_z(heading)
        * DMat3::from_rotation_y(pitch)
        * DMat3::from_rotation_x(roll);
    let body = rotation.transpose() * ned;
    // Right wing, tail, nadir.
    let [x, y, z] = [body.y, -body.x, body.z];
    let [x, y] = brown(RADIAL, TANGENTIAL, [x / z, y / z]);
    let side = 40.0;
    [
        side * (focal / 36.0 * x + center_of[0]) + 20.0,
        side * (focal / 36.0 * y + center_of[1]) + 15.0,
    ]
}

/// A row for each view.
pub fn reality_scan(focal: f64, center_of: [f64; 2]) -> String {
    let mut text = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2\n".to_owned();
    for i in 0..VIEWS {
        let c = center(i);
        let [h, p, r] = heading_pitch_roll(i).map(f64::to_degrees);
        let [k1, k2, k3, k4] = RADIAL;
        let ([px, py], [t1, t2]) = (center_of, TANGENTIAL);
        let _ = writeln!(
            text,
            "{},{},{},{},{h},{p},{r},{focal},{px},{py},{k1},{k2},{k3},{k4},{t1},{t2}",
            name(i),
            c.x,
            c.y,
            c.z
        );
    }
    text
}

#[test]
fn reality_scan_projects_as_its_document_says() {
    let dir = photos("images");
    let (focal, middle) = (31.0, [0.012, -0.02]);
    let file = dir.path().join("cameras.csv");
    let text = reality_scan(focal, middle);
    let newer = text.replace("f,px,py", "f_35mm,px_norm,py_norm");
    for text in [text.clone(), format!("#cameras 6\n{text}"), newer] {
        fs::write(&file, text).unwrap();
        let data = load_every(dir.path(), 0).unwrap();
        assert_eq!(data.layout, Layout::RealityScan);
        assert_eq!(data.place, "cameras.csv, photos in images");
        assert_projects(&data, |i, p| reality_scan_pixel(i, p, focal, middle));
        // No points in the export.
        assert!(data.points.positions.is_empty());
    }
    // The comparison notices another principal point.
    let data = load_every(dir.path(), 0).unwrap();
    let found = read_pixel(&data, &data.train[0], points()[0]);
    let other = reality_scan_pixel(0, points()[0], focal, [0.0; 2]);
    assert!((found[0] - other[0]).abs() > 0.4);
    // Points beside it; a camera whose photo is missing.
    cloud(dir.path(), DVec3::ZERO);
    fs::remove_file(dir.path().join("images/IMG_4.png")).unwrap();
    let data = load_every(dir.path(), 0).unwrap();
    assert_eq!(data.missing, ["IMG_4.png"]);
    let place = "cameras.csv, photos in images, points in points.ply";
    assert_eq!((data.points.positions.len(), &*data.place), (9, place));
    let back = data.points.positions[0].map(f64::from);
    let off = data.frame.to_dataset(DVec3::from_array(back)) - points()[0];
    assert!(off.length() < 1e-5, "{off}");
    // Points in another coordinate system are of no use.
    cloud(dir.path(), DVec3::new(5e5, 4e6, 0.0));
    let data = load_every(dir.path(), 0).unwrap();
    assert!(data.points.positions.is_empty());
    assert!(data.remarks[0].starts_with("warning: the points of points.ply"));
    fs::write(&file, text.replace("31,", "x,")).unwrap();
    assert_refused(
        load_every(dir.path(), 0),
        &["cameras.csv", "f or f_35mm", "'x'"],
    );
    fs::write(&file, text.replace("31,", "0,")).unwrap();
    assert_refused(load_every(dir.path(), 0), &["IMG_0.png", "focal length 0"]);
    fs::write(&file, text.lines().next().unwrap()).unwrap();
    assert_refused(load_every(dir.path(), 0), &["no camera"]);
}

/// A camera over the origin that looks straight down, its top to the north, sees north at the top and east at the right.
#[test]
fn reality_scan_looks_down_where_all_angles_are_zero() {
    let dir = photos("");
    let mut text = "#name,x,y,alt,heading,pitch,roll,f\n".to_owned();
    for (i, heading) in [(0, 0), (1, 90)] {
        let _ = writeln!(text, "{},{i},0,10,{heading},0,0,36", name(i));
    }
    fs::write(dir.path().join("a.csv"), text).unwrap();
    let data = load_every(dir.path(), 0).unwrap();
    let [north, east] = [DVec3::Y, DVec3::X].map(|p| read_pixel(&data, &data.train[0], p));
    assert!((north[0] - 20.0).abs() < 1e-6 && (north[1] - 11.0).abs() < 1e-6);
    assert!((east[0] - 24.0).abs() < 1e-6 && (east[1] - 15.0).abs() < 1e-6);
    // Heading is clockwise: with 90° the top is in the east.
    let east = read_pixel(&data, &data.train[1], DVec3::new(2.0, 0.0, 0.0));
    assert!((east[0] - 20.0).abs() < 1e-6 && (east[1] - 11.0).abs() < 1e-6);
}

/// Scale and rotation of the chunk, and its shift.
fn chunk() -> (f64, DMat3, DVec3) {
    let turned = DMat3::from_rotation_x(0.4) * DMat3::from_rotation_z(1.1);
    (2.5, turned, DVec3::new(100.0, -30.0, 7.0))
}

/// Affinity and skew, pixels.
const AFFINE: [f64; 2] = [0.8, -0.5];

/// The document of a project: a sensor of a type; the transform of the component, or of the chunk.
pub fn metashape(kind: &str, in_component: bool) -> String {
    let (scale, turned, shift) = chunk();
    let row = |m: DMat3| {
        let m = m.transpose().to_cols_array();
        m.map(|v| v.to_string()).join(" ")
    };
    let transform = format!(
        "<transform><rotation locked=\"true\">{}</rotation><translation>{} {} {}</translation><scale>{scale}</scale></transform>",
        row(turned),
        shift.x,
        shift.y,
        shift.z
    );
    let (component, whole) = match in_component {
        true => (transform, String::new()),
        false => (String::new(), transform),
    };
    let mut cameras = String::new();
    for i in 0..VIEWS {
        let [x, y, z] = axes(i);
        let c = center(i);
        // World → chunk.
        let [x, y, z] = [x, y, z].map(|axis| turned.transpose() * axis);
        let c = turned.transpose() * (c - shift) / scale;
        let label = name(i).replace(".png", "");
        let camera = format!(
            "<camera id=\"{i}\" sensor_id=\"0\" component_id=\"0\" label=\"{label}\"><transform>{} {} {} {} {} {} {} {} {} {} {} {} 0 0 0 1</transform></camera>",
            x.x, y.x, z.x, c.x, x.y, y.y, z.y, c.y, x.z, y.z, z.z, c.z
        );
        cameras += &match i {
            2 => format!("<group id=\"0\" label=\"g\">{camera}</group>"),
            _ => camera,
        };
    }
    let [k1, k2, k3, k4] = RADIAL;
    let ([p1, p2], [b1, b2]) = (TANGENTIAL, AFFINE);
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<document version=\"2.0.0\"><chunk label=\"Chunk 1\" enabled=\"true\"><sensors next_id=\"1\">\
         <sensor id=\"0\" label=\"s\" type=\"{kind}\"><resolution width=\"40\" height=\"30\"/>\
         <calibration type=\"{kind}\" class=\"initial\"><resolution width=\"40\" height=\"30\"/><f>99</f></calibration>\
         <calibration type=\"{kind}\" class=\"adjusted\"><resolution width=\"40\" height=\"30\"/><f>33</f><cx>0.7</cx><cy>-0.4</cy>\
         <b1>{b1}</b1><b2>{b2}</b2><k1>{k1}</k1><k2>{k2}</k2><k3>{k3}</k3><k4>{k4}</k4><p1>{p1}</p1><p2>{p2}</p2></calibration></sensor></sensors>\
         <components next_id=\"1\" active_id=\"0\"><component id=\"0\" label=\"Component 1\">{component}</component></components>\
         <cameras next_id=\"9\" next_group_id=\"1\">{cameras}<camera id=\"7\" sensor_id=\"0\" label=\"not aligned\"/>\
         <camera id=\"8\" sensor_id=\"0\" label=\"IMG_0\" enabled=\"false\"><transform>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</transform></camera>\
         </cameras>{whole}</chunk></document>\n"
    )
}

/// The projection of the manual's appendix on camera models, frame and fisheye.
fn metashape_pixel(fisheye: bool, i: usize, point: DVec3) -> [f64; 2] {
    let [right, down, forward] = axes(i);
    let d = point - center(i);
    let [x, y] = [right.dot(d) / forward.dot(d), down.dot(d) / forward.dot(d)];
    let r = x.hypot(y);
    let bent = if fisheye { r.atan() / r } else { 1.0 };
    let [x, y] = brown(RADIAL, TANGENTIAL, [x * bent, y * bent]);
    let [b1, b2] = AFFINE;
    [
        0.5 * 40.0 + 0.7 + x * 33.0 + x * b1 + y * b2,
        0.5 * 30.0 - 0.4 + y * 33.0,
    ]
}

#[test]
fn metashape_projects_as_its_manual_says() {
    // Photos beside the file, or in a folder of any name.
    for (folder, place) in [
        ("", "photos in this folder"),
        ("raw", "photos by file name in raw"),
    ] {
        let dir = photos(folder);
        cloud(dir.path(), DVec3::ZERO);
        for (kind, in_component) in [("frame", true), ("frame", false), ("fisheye", true)] {
            fs::write(
                dir.path().join("cameras.xml"),
                metashape(kind, in_component),
            )
            .unwrap();
            let data = load_every(dir.path(), 0).unwrap();
            assert_eq!(data.layout, Layout::Metashape);
            let place = format!("cameras.xml, {place}, points in points.ply");
            assert_eq!(data.place, place);
            assert_projects(&data, |i, p| metashape_pixel(kind == "fisheye", i, p));
            assert_eq!(data.points.positions.len(), 9);
        }
    }
}

#[test]
fn metashape_files_that_do_not_tell_the_cameras_are_refused() {
    let dir = photos("images");
    let file = dir.path().join("cameras.xml");
    let whole = metashape("frame", true);
    for (from, to, words) in [
        ("frame", "cylindrical", &["cylindrical", "undistorted"][..]),
        (
            "type=\"frame\"",
            "type=\"spherical\"",
            &["spherical", "not read"],
        ),
        ("<f>33</f>", "<f>nan</f>", &["f of sensor 0", "1 numbers"]),
        ("<f>33</f>", "", &["focal length 0"]),
        ("<k1>", "<p3>0.1</p3><k1>", &["p3"]),
        (
            "<sensor id=\"0\"",
            "<sensor id=\"1\"",
            &["without calibration"],
        ),
        (
            "<transform>",
            "<transform>1 ",
            &["transform of IMG_0", "16 numbers"],
        ),
        ("</chunk>", "", &["not XML"]),
        ("<camera ", "<camara ", &["not XML"]),
    ] {
        let changed = match from {
            "<transform>" => {
                let (before, after) = whole.split_once("label=\"IMG_0\">").unwrap();
                format!("{before}label=\"IMG_0\">{}", after.replacen(from, to, 1))
            }
            _ => whole.replace(from, to),
        };
        assert_ne!(changed, whole);
        fs::write(&file, changed).unwrap();
        assert_refused(load_every(dir.path(), 0), words);
    }
    // Entities that grow without bounds are no XML of a camera file.
    let bomb = "<?xml version=\"1.0\"?><!DOCTYPE d [<!ENTITY a \"aaaa\"><!ENTITY b \"&a;&a;\">]><document><chunk>&b;</chunk></document>";
    fs::write(&file, bomb).unwrap();
    assert_refused(load_every(dir.path(), 0), &["not XML"]);
    let two = whole.replace(
        "id=\"5\" sensor_id=\"0\" component_id=\"0\"",
        "id=\"5\" sensor_id=\"0\" component_id=\"1\"",
    );
    assert_ne!(two, whole);
    fs::write(&file, two).unwrap();
    let data = load_every(dir.path(), 0).unwrap();
    assert_eq!(data.train.len(), VIEWS - 1);
    assert!(data.remarks[0].contains("only the 5 cameras of component 0"));
    // A sensor that no camera has may be of any kind.
    let unused = "<sensors next_id=\"1\"><sensor id=\"9\" type=\"spherical\"><calibration type=\"spherical\"/></sensor>";
    let more = whole.replace("<sensors next_id=\"1\">", unused);
    assert_ne!(more, whole);
    fs::write(&file, more).unwrap();
    assert_eq!(load_every(dir.path(), 0).unwrap().train.len(), VIEWS);
}

/// A bundle of all views and points, and its list.
pub fn bundler() -> (String, String) {
    let (mut text, mut list) = (
        format!("# Bundle file v0.3\n{} 2\n", VIEWS + 1),
        String::new(),
    );
    for i in 0..VIEWS {
        let [x, y, z] = axes(i);
        // x right, y up, z back.
        let rows = [x, -y, -z];
        let t = rows.map(|axis| -axis.dot(center(i)));
        let _ = writeln!(text, "35.5 -0.1 0.03");
        for row in rows {
            let _ = writeln!(text, "{} {} {}", row.x, row.y, row.z);
        }
        let _ = writeln!(text, "{} {} {}", t[0], t[1], t[2]);
        let _ = writeln!(list, "C:\\photos\\{}{}", name(i), ["", " 0 35.5"][i % 2]);
    }
    // One that could not be registered.
    text += "0 0 0\n0 0 0\n0 0 0\n0 0 0\n0 0 0\n";
    list += "lost.png\n";
    text += "0.6 0.1 -0.2\n10 20 30\n2 0 17 1.5 -2.5 3 4 0.5 0.25\n-0.6 0.4 0.2\n40 50 60\n0\n";
    (text, list)
}

#[test]
fn bundler_projects_as_its_manual_says() {
    let dir = photos("images");
    let (bundle, list) = bundler();
    let (file, names) = (dir.path().join("bundle.out"), dir.path().join("list.txt"));
    fs::write(&file, &bundle).unwrap();
    fs::write(&names, &list).unwrap();
    let data = load_every(dir.path(), 0).unwrap();
    assert_eq!(data.layout, Layout::Bundler);
    assert_projects(&data, |i, point| {
        let [x, y, z] = axes(i);
        let p = [x, -y, -z].map(|axis| axis.dot(point - center(i)));
        let [a, b] = [-p[0] / p[2], -p[1] / p[2]];
        let r = a.hypot(b);
        let scale = 35.5 * (1.0 - 0.1 * r * r + 0.03 * r.powi(4));
        // From the centre, y up.
        [20.0 + scale * a, 15.0 - scale * b]
    });
    assert_eq!(data.points.colors, [[10, 20, 30], [40, 50, 60]]);
    let first = data.points.positions[0].map(f64::from);
    let off = data.frame.to_dataset(DVec3::from_array(first)) - DVec3::new(0.6, 0.1, -0.2);
    assert!(off.length() < 1e-6);
    assert!(!data.remarks.iter().any(|r| r.contains("--images")));
    // Nobody knows which size a focal length is of.
    let options = LoadOptions {
        images: Some("images".into()),
        ..LoadOptions::default()
    };
    let remarks = load(dir.path(), &options).unwrap().remarks;
    assert!(
        remarks
            .iter()
            .any(|r| r.contains("focal lengths") && r.contains("--images"))
    );
    // COLMAP's names of the two files.
    let [out, listed] = ["a.bundle.out", "a.list.txt"].map(|name| dir.path().join(name));
    fs::rename(&file, &out).unwrap();
    fs::rename(&names, &listed).unwrap();
    assert_eq!(load_every(dir.path(), 0).unwrap().train.len(), VIEWS);
    // A byte-order mark before either.
    fs::write(&out, format!("\u{feff}{bundle}")).unwrap();
    fs::write(&listed, format!("\u{feff}{list}")).unwrap();
    assert_eq!(load_every(dir.path(), 0).unwrap().train.len(), VIEWS);
    fs::write(&listed, list.replace("lost.png\n", "")).unwrap();
    let words = ["a.list.txt", "6 photos", "7 cameras"];
    assert_refused(load_every(dir.path(), 0), &words);
    fs::remove_file(&listed).unwrap();
    assert_refused(load_every(dir.path(), 0), &["list.txt"]);
    fs::write(&listed, &list).unwrap();
    fs::write(&out, &bundle[..bundle.len() / 2]).unwrap();
    assert_refused(load_every(dir.path(), 0), &["ends within"]);
    // A count of cameras that the file does not hold.
    fs::write(&out, bundle.replace("\n7 2\n", "\n900000000 2\n")).unwrap();
    assert_refused(load_every(dir.path(), 0), &["camera"]);
    fs::write(&out, bundle.replace("\n7 2\n", "\n7.5 2\n")).unwrap();
    assert_refused(load_every(dir.path(), 0), &["whole number"]);
}

#[test]
fn several_exports_are_refused_and_other_datasets_come_first() {
    let dir = photos("images");
    let (bundle, list) = bundler();
    fs::write(dir.path().join("bundle.out"), bundle).unwrap();
    fs::write(dir.path().join("list.txt"), list).unwrap();
    fs::write(dir.path().join("metrics.csv"), "iteration,loss\n1,2\n").unwrap();
    assert!(load_every(dir.path(), 0).is_ok());
    fs::write(dir.path().join("b.csv"), reality_scan(31.0, [0.0; 2])).unwrap();
    let words = ["b.csv, bundle.out", "keep the one"];
    assert_refused(load_every(dir.path(), 0), &words);
    assert_refused(
        load_every(&dir.path().join("images"), 0),
        &["a part of a dataset"],
    );
}
