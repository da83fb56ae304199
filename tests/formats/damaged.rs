//! Files that are cut off, damaged or made to harm.

use std::fs;
use std::io::Write;
use std::path::Path;

use super::{LOSSY, scene};
use crate::dataset::assert_refused;
use mhsplat::base::error::{Error, Result};
use mhsplat::capture::Frame;
use mhsplat::config::SceneFormat;
use mhsplat::scene::formats::{self, SceneFile};

/// Reads bytes as a file of a name.
fn read(dir: &Path, name: &str, bytes: &[u8]) -> Result<SceneFile> {
    let file = dir.join(name);
    fs::write(&file, bytes).unwrap();
    formats::read(&file, &Frame::IDENTITY)
}

/// The bytes of a small scene in a format, and its name.
fn file(dir: &Path, format: SceneFormat) -> (String, Vec<u8>) {
    let name = format!("a{}", formats::ending(format));
    let path = dir.join(&name);
    formats::write(&path, format, &scene(5, 1), &Frame::IDENTITY).unwrap();
    (name, fs::read(path).unwrap())
}

/// SPZ of version 4 with raw Zstandard blocks.
pub fn spz4() -> Vec<u8> {
    let streams = [
        vec![0; 18],
        vec![200; 2],
        vec![128; 6],
        vec![90; 6],
        vec![0; 8],
    ];
    let frame = |bytes: &Vec<u8>| {
        let n = bytes.len() as u8;
        // Magic; a single segment whose size is a byte; one last raw block.
        let head = [0x28, 0xb5, 0x2f, 0xfd, 0x20, n, 1 | n << 3, 0, 0];
        [&head[..], bytes].concat()
    };
    let mut file = b"NGSP\x04\0\0\0\x02\0\0\0\0\x0c\x01\x05\x20\0\0\0".to_vec();
    file.resize(32, 0);
    let frames = streams.each_ref().map(frame);
    for (packed, whole) in frames.iter().zip(&streams) {
        file.extend((packed.len() as u64).to_le_bytes());
        file.extend((whole.len() as u64).to_le_bytes());
    }
    file.extend(frames.concat());
    file
}

#[test]
fn version_4_of_spz_is_read() {
    let dir = tempfile::tempdir().unwrap();
    let scene = read(dir.path(), "a.spz", &spz4()).unwrap();
    assert_eq!((scene.splats.len(), scene.anti_aliased), (2, true));
    assert!(formats::is_anti_aliased(&dir.path().join("a.spz")));
    let whole = spz4();
    for length in 0..whole.len() {
        assert_refused(read(dir.path(), "a.spz", &whole[..length]), &["a.spz"]);
    }
    // Axes of its own, in an extension record.
    let mut turned = whole;
    turned[14] |= 2;
    turned[16] += 12;
    let record = [
        0xADBE_0003_u32.to_le_bytes(),
        4_u32.to_le_bytes(),
        [3, 0, 0, 0],
    ]
    .concat();
    turned.splice(32..32, record);
    assert_refused(read(dir.path(), "a.spz", &turned), &["axes"]);
}

#[test]
fn truncated_files_are_errors_at_every_length() {
    let dir = tempfile::tempdir().unwrap();
    for format in LOSSY {
        let (name, whole) = file(dir.path(), format);
        for length in 0..whole.len() {
            let found = read(dir.path(), &name, &whole[..length]);
            // Whole Gaussians of a format without a header are a scene.
            if format == SceneFormat::Splat && length % 32 == 0 {
                assert_eq!(found.unwrap().splats.len(), length / 32);
                continue;
            }
            assert_refused(found, &[&name]);
        }
    }
}

#[test]
fn corrupt_bytes_never_panic() {
    let dir = tempfile::tempdir().unwrap();
    let mut files = LOSSY.map(|format| file(dir.path(), format)).to_vec();
    files.push(("b.spz".to_owned(), spz4()));
    for (name, whole) in files {
        for at in 0..whole.len() {
            for flip in [0xff, 0x80, 0x01, 0x12] {
                let mut bytes = whole.clone();
                bytes[at] ^= flip;
                match read(dir.path(), &name, &bytes) {
                    Ok(scene) => {
                        let planes = scene.splats.planes().iter();
                        assert!(planes.flatten().all(|v| v.is_finite()), "{name}");
                    }
                    Err(Error::Input { .. }) => {}
                    Err(other) => panic!("{name}: {other:?}"),
                }
            }
        }
    }
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    packed.write_all(bytes).unwrap();
    packed.finish().unwrap()
}

/// Small files that announce, or hold, more than any memory.
#[test]
fn hostile_sizes_are_refused_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let header = |version: u8, count: u32, degree: u8, bits: u8| {
        let mut bytes = b"NGSP".to_vec();
        bytes.extend([version, 0, 0, 0]);
        bytes.extend(count.to_le_bytes());
        bytes.extend([degree, bits, 0, 0]);
        bytes
    };
    let announced = header(3, u32::MAX, 3, 12);
    assert_refused(
        read(dir.path(), "a.spz", &announced),
        &["4294967295", "fewer"],
    );
    assert_refused(
        read(dir.path(), "a.spz", &gzip(&announced)),
        &["4294967295", "fewer"],
    );
    // 100 MB of zeros in 100 kB.
    let mut bomb = header(3, 5_000_000, 0, 12);
    bomb.resize(100_000_000, 0);
    let bomb = gzip(&bomb);
    assert!(bomb.len() < 200_000);
    assert_refused(read(dir.path(), "a.spz", &bomb), &["5000000", "fewer"]);
    assert_refused(
        read(dir.path(), "a.spz", &header(1, 0, 0, 0)),
        &["version 1"],
    );
    assert_refused(
        read(dir.path(), "a.spz", &header(3, 0, 5, 0)),
        &["degree 5"],
    );
    assert_refused(read(dir.path(), "a.spz", &header(3, 0, 0, 60)), &["60"]);
    let mut long = spz4();
    long[8..12].copy_from_slice(&3_000_000_000_u32.to_le_bytes());
    assert_refused(read(dir.path(), "a.spz", &long), &["3000000000"]);
    let (name, compressed) = file(dir.path(), SceneFormat::CompressedPly);
    let text = String::from_utf8_lossy(&compressed).into_owned();
    let at = text.find("vertex 5").unwrap();
    for (number, word) in [(*b"vertex 9", "bytes"), (*b"vertex 0", "0 Gaussians")] {
        let mut wrong = compressed.clone();
        wrong[at..at + 8].copy_from_slice(&number);
        assert_refused(read(dir.path(), &name, &wrong), &[word]);
    }
    assert_refused(read(dir.path(), "a.splat", &[0; 33]), &["33 bytes", "32"]);
    let mut nan = vec![0; 32];
    nan[..4].copy_from_slice(&f32::NAN.to_le_bytes());
    assert_refused(read(dir.path(), "a.splat", &nan), &["NaN", "Gaussian 0"]);
}

#[test]
fn files_that_are_no_scenes_are_told() {
    let dir = tempfile::tempdir().unwrap();
    for (name, bytes, word) in [
        ("a.sog", &b"PK\x03\x04"[..], "archive"),
        ("b.sog", b"hello", "zip archive"),
        ("a.ksplat", b"\0\x01", ".ksplat"),
        ("a.glb", b"glTF", ".glb"),
        ("a.spz", b"hello", "SPZ"),
        ("a.txt", b"", "'ply'"),
    ] {
        assert_refused(read(dir.path(), name, bytes), &[name, word]);
    }
}
