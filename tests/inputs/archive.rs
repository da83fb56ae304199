//! Datasets in zip archives: as their folders are, and hostile archives.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use glam::DVec3;
use tempfile::TempDir;

use crate::cli::{done, mhsplat, program, stderr, text};
use crate::dataset::{assert_refused, colmap_scene, load_every};
use mhsplat::capture::{LoadOptions, PhotoSource, load};

/// An entry of an archive, and what its headers say of it.
#[derive(Clone)]
pub struct Entry {
    name: String,
    content: Vec<u8>,
    method: u16,
    flags: u16,
    /// Unix mode in the directory.
    mode: u32,
    /// Size in the directory, if it is not that of the content.
    size: Option<u64>,
    /// True if sizes and the offset are in a Zip64 field.
    long: bool,
}

pub fn entry(name: &str, content: &[u8]) -> Entry {
    Entry {
        name: name.into(),
        content: content.into(),
        method: 8,
        flags: 0,
        mode: 0o100_644,
        size: None,
        long: false,
    }
}

fn words(out: &mut Vec<u8>, values: &[u16]) {
    values.iter().for_each(|v| out.extend(v.to_le_bytes()));
}

fn longs(out: &mut Vec<u8>, values: &[u32]) {
    values.iter().for_each(|v| out.extend(v.to_le_bytes()));
}

/// The archive of entries, in their order.
pub fn archive(entries: &[Entry]) -> Vec<u8> {
    let (mut out, mut directory) = (Vec::new(), Vec::new());
    for e in entries {
        let packed = match e.method {
            8 => {
                let level = flate2::Compression::fast();
                let mut encoder = flate2::write::DeflateEncoder::new(Vec::new(), level);
                encoder.write_all(&e.content).unwrap();
                encoder.finish().unwrap()
            }
            _ => e.content.clone(),
        };
        let (offset, sum) = (out.len() as u64, crc32fast::hash(&e.content));
        let size = e.size.unwrap_or(e.content.len() as u64);
        let name = e.name.as_bytes();
        out.extend(b"PK\x03\x04");
        words(&mut out, &[20, e.flags, e.method, 0, 0]);
        longs(&mut out, &[sum, packed.len() as u32, size as u32]);
        words(&mut out, &[name.len() as u16, 0]);
        out.extend(name);
        out.extend(&packed);
        let d = &mut directory;
        d.extend(b"PK\x01\x02");
        words(d, &[(3 << 8) | 20, 20, e.flags, e.method, 0, 0]);
        let mut extra = Vec::new();
        let sizes = match e.long {
            true => {
                words(&mut extra, &[1, 24]);
                let values = [size, packed.len() as u64, offset];
                values.iter().for_each(|v| extra.extend(v.to_le_bytes()));
                [u32::MAX; 3]
            }
            false => [size as u32, packed.len() as u32, offset as u32],
        };
        longs(d, &[sum, sizes[1], sizes[0]]);
        words(d, &[name.len() as u16, extra.len() as u16, 0, 0, 0]);
        longs(d, &[e.mode << 16, sizes[2]]);
        d.extend(name);
        d.extend(&extra);
    }
    let (start, length, n) = (
        out.len() as u32,
        directory.len() as u32,
        entries.len() as u16,
    );
    out.extend(directory);
    out.extend(b"PK\x05\x06");
    words(&mut out, &[0, 0, n, n]);
    longs(&mut out, &[length, start]);
    words(&mut out, &[0]);
    out
}

/// Files below a folder as entries below `top`, and the folders themselves.
fn of_folder(folder: &Path, top: &str) -> Vec<Entry> {
    let mut all = Vec::new();
    for item in fs::read_dir(folder).unwrap() {
        let path = item.unwrap().path();
        let name = format!("{top}{}", path.file_name().unwrap().to_str().unwrap());
        if path.is_dir() {
            all.push(Entry {
                method: 0,
                mode: 0o040_755,
                ..entry(&format!("{name}/"), b"")
            });
            all.extend(of_folder(&path, &format!("{name}/")));
        } else {
            all.push(entry(&name, &fs::read(&path).unwrap()));
        }
    }
    all
}

fn written(dir: &TempDir, entries: &[Entry]) -> PathBuf {
    let path = dir.path().join("photos.zip");
    fs::write(&path, archive(entries)).unwrap();
    path
}

/// An archive of six photos.
pub fn small_archive(dir: &TempDir) -> PathBuf {
    let scene = colmap_scene(6, DVec3::ZERO, true);
    written(dir, &of_folder(scene.path(), ""))
}

#[test]
fn an_archive_is_read_as_its_folder() {
    let (scene, dir) = (
        colmap_scene(9, DVec3::ZERO, true),
        tempfile::tempdir().unwrap(),
    );
    let expected = load_every(scene.path(), 4).unwrap();
    let mac = entry("__MACOSX/._x", b"x");
    for (top, method, long) in [("", 8, false), ("kitchen/", 0, true), ("a b\\", 8, true)] {
        let mut entries = of_folder(scene.path(), top);
        entries.push(mac.clone());
        for e in &mut entries {
            (e.method, e.long) = (method, long);
            if top.ends_with('\\') {
                e.name = e.name.replace('/', "\\");
            }
        }
        let path = written(&dir, &entries);
        let data = load_every(&path, 4).unwrap();
        assert_eq!(data.fingerprint(), expected.fingerprint(), "{top}");
        assert_eq!(data.capture_fingerprint(), expected.capture_fingerprint());
        assert_eq!((&data.path, &data.place), (&path, &expected.place));
        assert_eq!(data.points.positions.len(), 3);
        for (a, b) in data.views().zip(expected.views()) {
            assert_eq!(a.photo.load().unwrap(), b.photo.load().unwrap());
        }
    }
}

/// Folders of unpacked archives below one for temporary files.
fn left(folder: &Path) -> usize {
    let names = fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().file_name());
    names
        .filter(|n| n.to_str().unwrap().starts_with("mhsplat-"))
        .count()
}

#[test]
fn photos_on_demand_keep_the_folder_and_its_end_removes_it() {
    let (scene, dir) = (
        colmap_scene(6, DVec3::ZERO, true),
        tempfile::tempdir().unwrap(),
    );
    let path = written(&dir, &of_folder(scene.path(), ""));
    let options = LoadOptions {
        image_budget: Some(2 * 16 * 12 * 3),
        ..LoadOptions::default()
    };
    let data = load(&path, &options).unwrap();
    assert!(data.photos_on_demand());
    let photos: Vec<PhotoSource> = data.views().map(|v| v.photo.clone()).collect();
    drop(data);
    assert!(photos.iter().all(|photo| photo.load().is_ok()));
    // Nothing of a program that has ended is left, whether it succeeded or not.
    let temporary = dir.path().join("tmp");
    fs::create_dir(&temporary).unwrap();
    let info = |path: &Path| {
        let mut command = program();
        command.env("TMPDIR", &temporary).args(["info", text(path)]);
        command.output().unwrap()
    };
    let output = info(&path);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(String::from_utf8_lossy(&output.stdout).contains("photos.zip: colmap-bin"));
    assert_eq!(left(&temporary), 0);
    let mut command = program();
    let run = dir.path().join("run");
    command
        .env("TMPDIR", &temporary)
        .args(["train", text(&path), "-o", text(&run)]);
    let output = command
        .args(["--iterations", "2", "--image-budget", "1200", "-q"])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(left(&temporary), 0);
    let mut entries = of_folder(scene.path(), "");
    entries.retain(|e| !e.name.ends_with("cameras.bin"));
    let output = info(&written(&dir, &entries));
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(
        stderr(&output).contains("photos.zip"),
        "{}",
        stderr(&output)
    );
    assert_eq!(left(&temporary), 0);
}

/// Nothing is left of a program that is interrupted while it unpacks.
#[test]
#[cfg(unix)]
fn an_interrupted_program_removes_what_it_unpacked() {
    let (scene, dir) = (
        colmap_scene(6, DVec3::ZERO, true),
        tempfile::tempdir().unwrap(),
    );
    let mut entries = of_folder(scene.path(), "");
    entries.insert(0, entry("large", &vec![0; 60 << 20]));
    let path = written(&dir, &entries);
    let temporary = dir.path().join("tmp");
    fs::create_dir(&temporary).unwrap();
    // On a busy machine the program may have come to its end before the signal.
    let mut codes = (0..10).map(|_| interrupted(&path, &temporary));
    assert!(codes.any(|code| code == Some(130)));
}

/// Exit code of a program that is sent SIGINT while it unpacks an archive; whatever it is, nothing is left.
#[cfg(unix)]
fn interrupted(archive: &Path, temporary: &Path) -> Option<i32> {
    let mut command = program();
    command.env("TMPDIR", temporary);
    command.args(["info", text(archive)]);
    let [out, err] = [std::process::Stdio::null(), std::process::Stdio::null()];
    let mut child = command.stdout(out).stderr(err).spawn().unwrap();
    while left(temporary) == 0 {
        std::thread::sleep(std::time::Duration::from_millis(1));
        if let Some(ended) = child.try_wait().unwrap() {
            assert_eq!(left(temporary), 0);
            return ended.code();
        }
    }
    let id = child.id().to_string();
    let sent = Command::new("kill").args(["-INT", &id]).status().unwrap();
    assert!(sent.success());
    let code = child.wait().unwrap().code();
    assert_eq!(left(temporary), 0);
    code
}

/// A run of the archive is scored and resumed with the archive or with the folder.
#[test]
fn a_run_takes_the_archive_for_the_folder() {
    let (scene, dir) = (
        colmap_scene(6, DVec3::ZERO, true),
        tempfile::tempdir().unwrap(),
    );
    let path = written(&dir, &of_folder(scene.path(), "top/"));
    let run = dir.path().join("run");
    done(&["train", text(&path), "-o", text(&run), "--iterations", "2"]);
    let record = fs::read_to_string(run.join("run.json")).unwrap();
    let record: serde_json::Value = serde_json::from_str(&record).unwrap();
    assert_eq!(record["dataset"]["path"], text(&path));
    done(&["eval", text(&run)]);
    done(&["eval", text(&run), text(scene.path())]);
    let longer = ["--resume", text(&run), "--extend", "1s"];
    done(&[&["train"][..], &longer].concat());
    for dataset in [scene.path(), &path] {
        done(&[&["train", text(dataset)][..], &longer].concat());
    }
    fs::remove_file(&path).unwrap();
    let output = mhsplat(&["eval", text(&run)]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("not there any more"));
}

/// Names that begin with a dot and a slash, as `bsdtar` writes them, and smaller photos in the archive.
#[test]
fn an_archive_may_name_the_present_folder_and_has_the_folder_of_images() {
    let (scene, dir) = (
        colmap_scene(6, DVec3::ZERO, true),
        tempfile::tempdir().unwrap(),
    );
    let mut entries = of_folder(scene.path(), "./");
    entries.push(Entry {
        method: 0,
        mode: 0o040_755,
        ..entry("./", b"")
    });
    for e in &mut entries {
        e.name = e.name.replace("./images/", "./images_2/");
    }
    let path = written(&dir, &entries);
    assert_eq!(load_every(&path, 0).unwrap().train.len(), 6);
    let run = dir.path().join("run");
    let begin = [
        "train",
        text(&path),
        "-o",
        text(&run),
        "--images",
        "images_2",
    ];
    done(&[&begin[..], &["--iterations", "2", "-q"]].concat());
    let record = mhsplat::RunRecord::read(&run).unwrap();
    assert_eq!(record.config.images, Some("images_2".into()));
    done(&["eval", text(&run)]);
    done(&["train", "--resume", text(&run), "--extend", "1s", "-q"]);
    let two: Vec<Entry> = ["a/", "b/"]
        .iter()
        .flat_map(|top| of_folder(scene.path(), top))
        .collect();
    let words = ["photos.zip", "2 folders", "unpack it"];
    assert_refused(load_every(&written(&dir, &two), 0), &words);
}

#[test]
fn hostile_archives_are_refused_by_the_entry() {
    let dir = tempfile::tempdir().unwrap();
    let outside = dir.path().join("evil.txt");
    let absolute = text(&outside).to_owned();
    let plain = entry("a.txt", b"content");
    let with = |change: &dyn Fn(&mut Entry)| {
        let mut e = plain.clone();
        change(&mut e);
        vec![entry("first.txt", b"1"), e]
    };
    let cases: Vec<(Vec<Entry>, &[&str])> = vec![
        (
            with(&|e| e.name = "../evil.txt".into()),
            &["../evil.txt", "leads out"],
        ),
        (
            with(&|e| e.name = "a/..\\../evil.txt".into()),
            &["evil.txt", "leads out"],
        ),
        (
            with(&|e| e.name = absolute.clone()),
            &["evil.txt", "leads out"],
        ),
        (with(&|e| e.name = "a\0b".into()), &["leads out"]),
        (with(&|e| e.name = String::new()), &["no name of a file"]),
        (with(&|e| e.mode = 0o120_777), &["a.txt", "symbolic link"]),
        (with(&|e| e.mode = 0o020_666), &["a.txt", "device"]),
        (with(&|e| e.flags = 1), &["a.txt", "encrypted"]),
        (with(&|e| e.method = 14), &["a.txt", "method 14"]),
        (
            with(&|e| e.name = "first.txt".into()),
            &["first.txt", "given twice"],
        ),
        (
            with(&|e| e.name = "first.txt/b".into()),
            &["first.txt/b", "below a file"],
        ),
        (with(&|e| e.size = Some(3)), &["a.txt", "damaged"]),
        (with(&|e| e.size = Some(30)), &["a.txt", "damaged"]),
        (
            with(&|e| (e.size, e.long) = (Some(1 << 50), true)),
            &["more than 100 times its size"],
        ),
        (
            with(&|e| (e.size, e.long) = (Some(u64::MAX), true)),
            &["more than 100 times its size"],
        ),
    ];
    for (entries, said) in cases {
        let path = written(&dir, &entries);
        assert_refused(load_every(&path, 0), &[&["photos.zip"], said].concat());
        assert!(!outside.exists());
    }
}

#[test]
fn damaged_archives_are_refused_or_read() {
    let (scene, dir) = (
        colmap_scene(3, DVec3::ZERO, true),
        tempfile::tempdir().unwrap(),
    );
    let whole = archive(&of_folder(scene.path(), ""));
    let path = dir.path().join("photos.zip");
    let read = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        load_every(&path, 0)
    };
    assert_eq!(read(&whole).unwrap().train.len(), 3);
    // A comment at the end is allowed.
    let mut longer = whole.clone();
    let n = longer.len();
    longer[n - 2] = 5;
    longer.extend(b"hello");
    assert_eq!(read(&longer).unwrap().train.len(), 3);
    assert_refused(read(b""), &["photos.zip", "no zip archive"]);
    assert_refused(read(b"PK"), &["photos.zip", "no zip archive"]);
    for n in (0..whole.len()).step_by(7) {
        assert_refused(read(&whole[..n]), &["photos.zip"]);
    }
    // Any byte of the directory and its end may be wrong: nothing panics, and a refusal names the archive.
    let directory = whole.len() - 22 - number(&whole, whole.len() - 10) as usize;
    for at in directory..whole.len() {
        for value in [0, 0xff] {
            let mut bytes = whole.clone();
            bytes[at] = value;
            if let Err(error) = read(&bytes) {
                assert!(error.to_string().contains("photos.zip"), "{error}");
            }
        }
    }
    // A byte of a file's content: the checksum tells.
    let mut entries = of_folder(scene.path(), "");
    entries.push(Entry {
        method: 0,
        ..entry("note.txt", b"some words that are known")
    });
    let mut bytes = archive(&entries);
    let at = bytes.windows(10).position(|w| w == b"some words").unwrap();
    bytes[at] ^= 1;
    assert_refused(read(&bytes), &["photos.zip", "note.txt", "damaged"]);
}

fn number(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
}

#[test]
fn other_archives_and_files_are_told_the_way_on() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["a.7z", "a.tar", "a.tar.gz", "a.rar"] {
        let path = dir.path().join(name);
        fs::write(&path, "x").unwrap();
        let words = [name, "an archive of a kind that is not read", "zip"];
        assert_refused(load_every(&path, 0), &words);
    }
    let path = dir.path().join("a.zip");
    fs::create_dir(&path).unwrap();
    assert_refused(load_every(&path, 0), &["a.zip", "cameras.bin"]);
}

/// An archive that Python made, where there is Python.
#[test]
fn archives_of_another_program_are_read() {
    let (scene, dir) = (
        colmap_scene(3, DVec3::ZERO, false),
        tempfile::tempdir().unwrap(),
    );
    let path = dir.path().join("PHOTOS.ZIP");
    let made = Command::new("python3")
        .args(["-m", "zipfile", "-c", text(&path)])
        .args(["images", "sparse"].map(|part| scene.path().join(part)))
        .output();
    if !made.is_ok_and(|output| output.status.success()) {
        println!("skipped: no python3");
        return;
    }
    let data = load_every(&path, 0).unwrap();
    let folder = load_every(scene.path(), 0).unwrap();
    assert_eq!(data.fingerprint(), folder.fingerprint());
}
