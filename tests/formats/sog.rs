//! SOG archives, written here by their specification.

use std::fs;
use std::path::Path;

use image::ExtendedColorType;
use image::codecs::webp::WebPEncoder;
use serde_json::{Value, json};

use super::scene;
use crate::dataset::assert_refused;
use crate::inputs::archive::{archive, entry};
use mhsplat::base::error::{Error, Result};
use mhsplat::base::math::sigmoid;
use mhsplat::capture::Frame;
use mhsplat::scene::formats::{self, SceneFile};
use mhsplat::scene::{Gaussians, Plane};

/// Gaussians of the archive of the tests; images are rounded up to 4 × 4 pixels.
const COUNT: usize = 13;

fn webp(width: u32, height: u32, pixels: &[[u8; 4]]) -> Vec<u8> {
    let mut all = pixels.concat();
    all.resize(4 * (width * height) as usize, 0);
    let mut file = Vec::new();
    let encoder = WebPEncoder::new_lossless(&mut file);
    let color = ExtendedColorType::Rgba8;
    encoder.encode(&all, width, height, color).unwrap();
    file
}

/// Files of an archive by their names, and the Gaussians that they hold.
struct Sog {
    meta: Value,
    images: Vec<(&'static str, Vec<u8>)>,
    splats: Gaussians,
}

/// Thirteen Gaussians of SH degree 2: the values are those that the bytes stand for.
fn sog() -> Sog {
    let mut splats = scene(COUNT, 2).splats;
    let byte = |i: usize, k: usize| (37 * i + 91 * k) as u8;
    let rows = |of: &dyn Fn(usize) -> [u8; 4]| (0..COUNT).map(of).collect::<Vec<_>>();
    let book = |least: f64, most: f64| -> Vec<f64> {
        let of = |k: u32| least + (most - least) * f64::from(k) / 255.0;
        (0..256).map(of).collect()
    };
    let (mins, maxs) = ([-2.0, -1.0, 0.5], [1.5, 2.5, 3.0]);
    let [scales, colors, bands] = [book(-9.0, 0.0), book(-1.5, 1.5), book(-0.4, 0.4)];
    for i in 0..COUNT {
        for k in 0..3 {
            let word = f64::from(u16::from_le_bytes([byte(i, k), byte(i, k + 5)]));
            let v: f64 = mins[k] + (maxs[k] - mins[k]) * word / 65_535.0;
            let position = v.signum() * (v.abs().exp() - 1.0);
            splats.plane_mut(Plane::POSITION + k)[i] = position as f32;
            splats.plane_mut(Plane::LOG_SCALE + k)[i] = scales[usize::from(byte(i, k))] as f32;
            splats.plane_mut(Plane::SH + k)[i] = colors[usize::from(byte(i, k + 7))] as f32;
        }
        // The largest component is each in turn: 1 − 3·0.16 is more than 0.16.
        let small = [0.4, -0.2, 0.3].map(|v| ((v / 0.5_f64.sqrt() + 1.0) * 127.5).round());
        let parts = small.map(|b| (b / 127.5 - 1.0) * 0.5_f64.sqrt());
        let rest = (1.0 - parts.iter().map(|v| v * v).sum::<f64>()).sqrt();
        let mut q = parts.to_vec();
        q.insert(i % 4, rest);
        for (k, v) in q.into_iter().enumerate() {
            splats.plane_mut(Plane::ROTATION + k)[i] = v as f32;
        }
        // Palette entry 64 + i is in the second row of the palette.
        for k in 0..24 {
            let value = bands[usize::from(byte(i, k))] as f32;
            splats.plane_mut(Plane::SH + 3 + k)[i] = value;
        }
    }
    let mut palette = vec![[9_u8, 9, 9, 255]; 2 * 64 * 8];
    for i in 0..COUNT {
        for k in 0..8 {
            let [r, g, b] = [0, 1, 2].map(|c| byte(i, 3 * k + c));
            palette[64 * 8 + 8 * i + k] = [r, g, b, 255];
        }
    }
    let turned = |i: usize| {
        let [a, b, c] =
            [0.4, -0.2, 0.3].map(|v| ((v / 0.5_f64.sqrt() + 1.0) * 127.5_f64).round() as u8);
        [a, b, c, 252 + (i % 4) as u8]
    };
    let three = |i: usize, from: usize| [byte(i, from), byte(i, from + 1), byte(i, from + 2)];
    let with = |rgb: [u8; 3], a: u8| [rgb[0], rgb[1], rgb[2], a];
    let images = vec![
        ("l.webp", webp(4, 4, &rows(&|i| with(three(i, 0), 255)))),
        ("u.webp", webp(4, 4, &rows(&|i| with(three(i, 5), 255)))),
        ("s.webp", webp(4, 4, &rows(&|i| with(three(i, 0), 255)))),
        ("q.webp", webp(4, 4, &rows(&turned))),
        (
            "c.webp",
            webp(4, 4, &rows(&|i| with(three(i, 7), 20 * i as u8))),
        ),
        ("p.webp", webp(512, 2, &palette)),
        ("n.webp", webp(4, 4, &rows(&|i| [64 + i as u8, 0, 0, 255]))),
    ];
    let meta = json!({
        "version": 2, "count": COUNT, "antialias": true, "asset": {"generator": "a test"},
        "means": {"mins": mins, "maxs": maxs, "files": ["l.webp", "u.webp"]},
        "scales": {"codebook": scales, "files": ["s.webp"]},
        "quats": {"files": ["q.webp"]},
        "sh0": {"codebook": colors, "files": ["c.webp"]},
        "shN": {"count": 77, "bands": 2, "codebook": bands, "files": ["p.webp", "n.webp"]},
    });
    Sog {
        meta,
        images,
        splats,
    }
}

impl Sog {
    fn bytes(&self) -> Vec<u8> {
        let meta = serde_json::to_vec(&self.meta).unwrap();
        let mut entries = vec![entry("meta.json", &meta)];
        entries.extend(self.images.iter().map(|(name, file)| entry(name, file)));
        archive(&entries)
    }

    fn read(&self, dir: &Path) -> Result<SceneFile> {
        let file = dir.join("a.sog");
        fs::write(&file, self.bytes()).unwrap();
        formats::read(&file, &Frame::IDENTITY)
    }
}

#[test]
fn bytes_are_what_the_specification_says() {
    let dir = tempfile::tempdir().unwrap();
    let mut sog = sog();
    let read = sog.read(dir.path()).unwrap();
    assert!(read.anti_aliased && formats::is_anti_aliased(&dir.path().join("a.sog")));
    assert_eq!((read.splats.len(), read.splats.sh_degree()), (COUNT, 2));
    for plane in (0..Plane::count(2)).filter(|p| *p != Plane::OPACITY) {
        let pairs = read.splats.planes()[plane]
            .iter()
            .zip(&sog.splats.planes()[plane]);
        for (i, (found, right)) in pairs.enumerate() {
            let off = (found - right).abs();
            assert!(
                off < 2e-6 * right.abs().max(1.0),
                "{plane} {i}: {found} {right}"
            );
        }
    }
    for (i, logit) in read.splats.planes()[Plane::OPACITY].iter().enumerate() {
        let opacity = sigmoid(f64::from(*logit));
        assert!(
            (opacity - 20.0 * i as f64 / 255.0).abs() < 1e-6,
            "{opacity}"
        );
    }
    sog.meta["antialias"] = json!(false);
    sog.meta.as_object_mut().unwrap().remove("shN");
    let read = sog.read(dir.path()).unwrap();
    assert_eq!((read.splats.sh_degree(), read.anti_aliased), (0, false));
    assert!(!formats::is_anti_aliased(&dir.path().join("a.sog")));
}

#[test]
fn damaged_archives_are_told() {
    let dir = tempfile::tempdir().unwrap();
    type Change = fn(&mut Sog);
    let changes: [(Change, &str); 9] = [
        (|s| s.meta["version"] = json!(3), "version 3"),
        (|s| s.meta["count"] = json!(17), "l.webp has 4 × 4 pixels"),
        (
            |s| s.meta["count"] = json!(s.bytes().len() / 8 + 1),
            "announces",
        ),
        (|s| s.meta["scales"]["codebook"] = json!([1.0]), "codebook"),
        (
            |s| s.meta["means"]["files"][0] = json!("../l.webp"),
            "no ../l.webp",
        ),
        (|s| s.meta["shN"]["bands"] = json!(4), "4 bands"),
        (|s| s.images[5].1 = webp(500, 3, &[]), "500 pixels in a row"),
        (
            |s| s.images[3].1 = webp(4, 4, &[]),
            "no rotation of Gaussian 0",
        ),
        (|s| s.images[2].1.truncate(20), "s.webp"),
    ];
    for (change, word) in changes {
        let mut sog = sog();
        change(&mut sog);
        assert_refused(sog.read(dir.path()), &["a.sog", word]);
    }
    let file = dir.path().join("b.sog");
    fs::write(&file, archive(&[entry("photo.jpg", b"mine")])).unwrap();
    let read = formats::read(&file, &Frame::IDENTITY);
    assert_refused(read, &["b.sog", "without meta.json"]);
}

#[test]
fn corrupt_archives_never_panic() {
    let dir = tempfile::tempdir().unwrap();
    let (whole, file) = (sog().bytes(), dir.path().join("a.sog"));
    for at in (0..whole.len()).step_by(3) {
        for flip in [0xff, 0x01] {
            let mut bytes = whole.clone();
            bytes[at] ^= flip;
            fs::write(&file, &bytes).unwrap();
            match formats::read(&file, &Frame::IDENTITY) {
                Ok(scene) => {
                    let planes = scene.splats.planes().iter();
                    assert!(planes.flatten().all(|v| v.is_finite()), "{at}");
                }
                Err(Error::Input { .. }) => {}
                Err(other) => panic!("{at}: {other:?}"),
            }
        }
        fs::write(&file, &whole[..at]).unwrap();
        assert!(formats::read(&file, &Frame::IDENTITY).is_err());
    }
}
