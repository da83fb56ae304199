//! Binary glTF: files of other programs, with all that the extension allows.

use std::fs;

use super::scene;
use crate::dataset::assert_refused;
use mhsplat::base::error::Result;
use mhsplat::capture::Frame;
use mhsplat::config::SceneFormat;
use mhsplat::scene::formats::{self, SceneFile};
use mhsplat::scene::{Plane, sh};
use serde_json::{Value, json};

const GAUSSIANS: usize = 2;

/// A document of two Gaussians, and its bytes: positions and scales (f32) interleaved; rotations, opacities and colours after them.
fn document() -> (Value, Vec<u8>) {
    let mut data = Vec::new();
    for i in 0..GAUSSIANS {
        let row = [1.0 + i as f32, 2.0, 3.0, 0.5, 1.0, 0.25];
        data.extend(row.iter().flat_map(|v| v.to_le_bytes()));
    }
    // Half a turn about z, and a third of a turn about the diagonal: x, y, z, w.
    for q in [[0, 0, 32767, 0], [16384, 16384, 16384, 16384_i16]] {
        data.extend(q.iter().flat_map(|v| v.to_le_bytes()));
    }
    data.extend([51, 204, 0, 0]);
    for k in 0..4 {
        for i in 0..GAUSSIANS {
            let row = [0.1, 0.2, 0.3].map(|v: f32| v + k as f32 + 10.0 * i as f32);
            data.extend(row.iter().flat_map(|v| v.to_le_bytes()));
        }
    }
    let name = |of: &str| format!("KHR_gaussian_splatting:{of}");
    let mut accessors = vec![
        json!({ "bufferView": 0, "componentType": 5126, "count": 2, "type": "VEC3" }),
        json!({ "bufferView": 0, "byteOffset": 12, "componentType": 5126, "count": 2, "type": "VEC3" }),
        json!({ "bufferView": 1, "componentType": 5122, "normalized": true, "count": 2, "type": "VEC4" }),
        json!({ "bufferView": 1, "byteOffset": 16, "componentType": 5121, "normalized": true, "count": 2, "type": "SCALAR" }),
    ];
    let mut attributes = json!({ "POSITION": 0 });
    for (k, of) in ["SCALE", "ROTATION", "OPACITY"].into_iter().enumerate() {
        attributes[name(of)] = json!(k + 1);
    }
    for k in 0..4 {
        let of = ["0_COEF_0", "1_COEF_0", "1_COEF_1", "1_COEF_2"][k];
        attributes[name(&format!("SH_DEGREE_{of}"))] = json!(accessors.len());
        accessors.push(json!({ "bufferView": 2, "byteOffset": 24 * k, "componentType": 5126, "count": 2, "type": "VEC3" }));
    }
    let document = json!({
        "asset": { "version": "2.0" },
        "nodes": [{ "name": "other" }, { "mesh": 0 }],
        "meshes": [{ "primitives": [{
            "mode": 0, "attributes": attributes,
            "extensions": { "KHR_gaussian_splatting": { "kernel": "ellipse", "colorSpace": "srgb_rec709_display" } },
        }] }],
        "accessors": accessors,
        "bufferViews": [
            { "buffer": 0, "byteLength": 48, "byteStride": 24 },
            { "buffer": 0, "byteOffset": 48, "byteLength": 20 },
            { "buffer": 0, "byteOffset": 68, "byteLength": 96 },
        ],
        "buffers": [{ "byteLength": data.len() }],
    });
    (document, data)
}

fn read(document: &Value, data: &[u8]) -> Result<SceneFile> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let word = |n: usize| (n as u32).to_le_bytes();
    let file = [
        b"glTF",
        &word(2)[..],
        &word(28 + text.len() + data.len()),
        &word(text.len()),
        b"JSON",
        &text,
        &word(data.len()),
        b"BIN\0",
        data,
    ]
    .concat();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.glb");
    fs::write(&path, file).unwrap();
    formats::read(&path, &Frame::IDENTITY)
}

#[test]
fn attributes_of_every_layout_are_read_in_the_usual_axes() {
    let (document, data) = document();
    let file = read(&document, &data).unwrap();
    let splats = &file.splats;
    assert_eq!((splats.len(), splats.sh_degree()), (2, 1));
    assert_eq!(splats.gather(Plane::POSITION, 1), [-2.0, -2.0, 3.0]);
    let scales = splats.gather::<3>(Plane::LOG_SCALE, 0).map(f32::exp);
    assert!(
        scales
            .iter()
            .zip([0.5, 1.0, 0.25])
            .all(|(a, b)| (a - b).abs() < 1e-6)
    );
    assert_eq!(splats.gather(Plane::ROTATION, 0), [0.0, 0.0, 0.0, 1.0]);
    let [w, x, y, z] = splats.gather(Plane::ROTATION, 1);
    assert!(w > 0.49 && x == -w && y == -w && z == w);
    let opacity = |i: usize| 1.0 / (1.0 + (-splats.planes()[Plane::OPACITY][i]).exp());
    assert!((opacity(0) - 0.2).abs() < 1e-6 && (opacity(1) - 0.8).abs() < 1e-6);
    assert_eq!(splats.gather(Plane::SH, 1), [10.1, 10.2, 10.3]);
    // Of the bands along y, z and x, those along y and x change sign.
    assert_eq!(splats.gather(Plane::SH + 3, 0), [-1.1, -1.2, -1.3]);
    assert_eq!(splats.gather(Plane::SH + 6, 0), [2.1, 2.2, 2.3]);
    assert_eq!(splats.gather(Plane::SH + 9, 0), [-3.1, -3.2, -3.3]);
    assert_eq!(file.up, Some([0.0, -1.0, 0.0]));
    assert!(!file.anti_aliased && file.changes().is_empty());
}

#[test]
fn the_node_says_what_is_up_and_what_else_it_says_is_told() {
    let (mut document, data) = document();
    // A quarter of a turn about x takes z to -y: what is up in the scene is -z, in glTF's axes.
    let half = 0.5_f64.sqrt();
    document["nodes"][1]["rotation"] = json!([half, 0.0, 0.0, half]);
    document["nodes"][1]["scale"] = json!([2.0, 2.0, 2.0]);
    document["meshes"][0]["primitives"][0]["extras"] = json!({ "antialiased": true });
    let file = read(&document, &data).unwrap();
    let up = file.up.unwrap();
    assert!((up[2] + 1.0).abs() < 1e-6, "{up:?}");
    assert!(file.anti_aliased);
    assert!(file.changes()[0].contains("scale"));
}

#[test]
fn what_is_not_read_is_refused_or_told() {
    let (document, data) = document();
    let with = |key: &str, value: &str| {
        let mut document = document.clone();
        let primitive = &mut document["meshes"][0]["primitives"][0];
        primitive["extensions"]["KHR_gaussian_splatting"][key] = json!(value);
        read(&document, &data)
    };
    for (key, known, unknown) in [
        ("kernel", "ellipse", "box"),
        ("colorSpace", "srgb_rec709_display", "lin_rec709_display"),
    ] {
        assert!(with(key, known).unwrap().changes().is_empty());
        let error = with(key, unknown).unwrap_err().to_string();
        assert!(error.contains(key) && error.contains(unknown), "{error}");
    }
    let mut twice = document;
    let primitives = twice["meshes"][0]["primitives"].as_array_mut().unwrap();
    primitives.push(primitives[0].clone());
    let remarks = read(&twice, &data).unwrap().changes();
    assert!(remarks[0].contains("first of 2"), "{remarks:?}");
}

/// The colour of a direction, as a viewer that follows the extension computes it from the file, is that of the scene.
#[test]
fn what_is_written_has_the_extensions_basis() {
    let given = scene(1, 3);
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.glb");
    formats::write(&path, SceneFormat::Glb, &given, &Frame::IDENTITY).unwrap();
    let bytes = fs::read(&path).unwrap();
    assert_eq!(
        bytes.len() as u32,
        u32::from_le_bytes(bytes[8..12].try_into().unwrap())
    );
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let document: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    let attributes = &document["meshes"][0]["primitives"][0]["attributes"];
    let stored = |name: &str| -> f64 {
        let accessor = &document["accessors"][attributes[name].as_u64().unwrap() as usize];
        let view = &document["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let at = 28 + length + view["byteOffset"].as_u64().unwrap() as usize;
        f64::from(f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()))
    };
    let c = |degree: u32, k: u32| {
        stored(&format!(
            "KHR_gaussian_splatting:SH_DEGREE_{degree}_COEF_{k}"
        ))
    };
    // The extension's own table (its section on lighting), of some of the functions.
    let direction = [0.36, 0.48, -0.8];
    let [x, y, z] = [-direction[0], -direction[1], direction[2]];
    let written = 0.282_094_791_773_878 * c(0, 0)
        + 0.488_602_511_902_92 * (-y * c(1, 0) + z * c(1, 1) - x * c(1, 2))
        + 1.092_548_430_592_079 * (x * y * c(2, 0) - y * z * c(2, 1) - x * z * c(2, 3))
        + 0.315_391_565_252_52 * (2.0 * z * z - x * x - y * y) * c(2, 2)
        + 0.546_274_215_296_04 * (x * x - y * y) * c(2, 4)
        - 0.590_043_589_926_644
            * (y * (3.0 * x * x - y * y) * c(3, 0) + x * (x * x - 3.0 * y * y) * c(3, 6))
        + 2.890_611_442_640_554 * x * y * z * c(3, 1)
        - 0.457_045_799_464_466 * (4.0 * z * z - x * x - y * y) * (y * c(3, 2) + x * c(3, 4))
        + 0.373_176_332_590_115 * z * (2.0 * z * z - 3.0 * x * x - 3.0 * y * y) * c(3, 3)
        + 1.445_305_721_320_277 * z * (x * x - y * y) * c(3, 5);
    let basis = sh::basis(direction);
    let own = |k: usize| f64::from(given.splats.planes()[Plane::SH + 3 * k][0]);
    let meant: f64 = (0..16).map(|k| own(k) * basis[k]).sum();
    assert!((written - meant).abs() < 1e-5, "{written} {meant}");
}

#[test]
fn documents_that_do_not_fit_their_bytes_are_refused() {
    let (good, data) = document();
    let refused = |change: &dyn Fn(&mut Value), words: &[&str]| {
        let mut document = good.clone();
        change(&mut document);
        assert_refused(read(&document, &data), words);
    };
    refused(
        &|d| d["accessors"][0]["count"] = json!(4_000_000_000_u64),
        &["POSITION", "fewer bytes"],
    );
    refused(
        &|d| d["accessors"][0]["count"] = json!(0),
        &["ROTATION", "2 values"],
    );
    refused(
        &|d| d["accessors"][3]["count"] = json!(1),
        &["OPACITY", "1 values"],
    );
    refused(
        &|d| d["accessors"][3]["type"] = json!("VEC3"),
        &["OPACITY", "SCALAR"],
    );
    refused(
        &|d| d["accessors"][1]["componentType"] = json!(5125),
        &["SCALE", "5125"],
    );
    refused(&|d| d["accessors"][1]["bufferView"] = json!(17), &["SCALE"]);
    refused(
        &|d| d["bufferViews"][0]["byteStride"] = json!(4),
        &["POSITION"],
    );
    refused(
        &|d| d["bufferViews"][2]["byteLength"] = json!(90),
        &["COEF_2"],
    );
    refused(&|d| d["bufferViews"][0]["buffer"] = json!(1), &["buffer"]);
    refused(&|d| d["meshes"] = json!([]), &["without Gaussians"]);
    let extension = |d: &mut Value| {
        d["meshes"][0]["primitives"][0]["extensions"]["KHR_gaussian_splatting"]["extensions"] =
            json!({ "KHR_gaussian_splatting_compression_spz_2": {} });
    };
    refused(&extension, &["compression_spz_2", "without compression"]);
    let mut opaque = data.clone();
    opaque[12..16].copy_from_slice(&(-1.0_f32).to_le_bytes());
    assert_refused(read(&good, &opaque), &["no negative scale", "Gaussian 0"]);
    opaque[12..16].copy_from_slice(&f32::NAN.to_le_bytes());
    assert_refused(read(&good, &opaque), &["SCALE", "Gaussian 0"]);
}
