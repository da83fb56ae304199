//! Devices that fail on the way: an error that names the stage and what to do, the last checkpoint kept, and a run that goes on
//! from it as if nothing had happened. The failures are real return values of OpenCL, by a library loaded before the loader's
//! (`tests/faults/faults.c`); where there is no C compiler the tests skip.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use mhsplat::run::{RunRecord, checkpoint};

/// CL_DEVICE_NOT_AVAILABLE.
const LOST: i32 = -2;
/// CL_OUT_OF_RESOURCES.
const RESOURCES: i32 = -5;
/// CL_OUT_OF_HOST_MEMORY.
const MEMORY: i32 = -6;
/// CL_BUILD_PROGRAM_FAILURE.
const BUILD: i32 = -11;

/// The library that fails, built; none where that cannot be.
pub fn shim(dir: &Path) -> Option<PathBuf> {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/faults/faults.c");
    let library = dir.join("libfaults.so");
    let built = Command::new("cc")
        .args(["-shared", "-fPIC", "-O1", "-Wall", "-Werror", "-o"])
        .arg(&library)
        .arg(source)
        .arg("-ldl")
        .output();
    match built {
        Ok(out) => {
            let log = String::from_utf8_lossy(&out.stderr);
            assert!(out.status.success(), "{log}");
            Some(library)
        }
        Err(e) => {
            println!("skipped: no C compiler ({e})");
            None
        }
    }
}

fn train(run: &Path, resume: bool) -> Command {
    let room = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny");
    let mut command = crate::cli::program();
    command.arg("train").arg(room);
    if resume {
        command.arg("--resume").arg(run);
    } else {
        command.arg("-o").arg(run);
        command.args(["--iterations", "200", "--max-size", "64"]);
        command.args(["--checkpoint-every", "25", "--eval-every", "50"]);
        // The set grows: buffers are made and copied on the way.
        command.args(["--max-gaussians", "1000000"]);
    }
    command
}

/// A run in which OpenCL's call `name` fails from number `number` on.
fn failing(library: &Path, run: &Path, name: &str, number: u32, error: i32) -> Output {
    let mut command = train(run, false);
    command.env("LD_PRELOAD", library);
    command.env("MHSPLAT_FAULT", format!("{name}:{number}:{error}"));
    command.output().unwrap()
}

pub fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

pub fn refuses(output: &Output, words: &[&str]) {
    let text = said(output);
    assert_eq!(output.status.code(), Some(2), "{text}");
    for word in words {
        assert!(text.contains(word), "{word:?} is not in: {text}");
    }
    assert!(!text.contains("panicked"), "{text}");
}

#[test]
fn a_device_lost_on_the_way_costs_what_came_after_the_checkpoint() {
    let dir = tempfile::tempdir().unwrap();
    let Some(library) = shim(dir.path()) else {
        return;
    };
    let whole = dir.path().join("whole");
    // Preloaded but asked for nothing, it changes nothing; and the device has passed its self-test, which launches, too.
    let straight = failing(&library, &whole, "none", 1, 0);
    assert!(straight.status.success(), "{}", said(&straight));
    for (name, number) in [
        ("clEnqueueNDRangeKernel", 6000),
        ("clEnqueueReadBuffer", 400),
        ("clEnqueueCopyBuffer", 300),
        ("clEnqueueFillBuffer", 150),
        ("clFlush", 100),
        ("clWaitForEvents", 500),
    ] {
        let run = dir.path().join(name);
        let lost = failing(&library, &run, name, number, LOST);
        refuses(
            &lost,
            &[
                "CL_DEVICE_NOT_AVAILABLE",
                "lost",
                "iterations is saved",
                "--resume",
            ],
        );
        let saved = checkpoint::read(&run).unwrap().state.iteration;
        assert!((25..200).contains(&saved), "{name}: {saved}");
        let record = RunRecord::read(&run).unwrap();
        assert!(record.iterations < 200, "the record of a run that ended");
        let on = train(&run, true).output().unwrap();
        assert!(on.status.success(), "{name}: {}", said(&on));
        let [a, b] = [&whole, &run].map(|r| fs::read(r.join("scene.ply")).unwrap());
        assert!(a == b, "{name}: the scene differs");
    }
}

#[test]
fn what_cannot_be_allocated_or_built_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let Some(library) = shim(dir.path()) else {
        return;
    };
    let straight = failing(&library, &dir.path().join("whole"), "none", 1, 0);
    assert!(straight.status.success(), "{}", said(&straight));
    // At the start nothing is begun, and the folder is free again.
    let run = dir.path().join("run");
    for (number, error, name) in [
        (1, MEMORY, "CL_OUT_OF_HOST_MEMORY"),
        (20, MEMORY, "CL_OUT_OF_HOST_MEMORY"),
        (40, RESOURCES, "CL_OUT_OF_RESOURCES"),
    ] {
        let full = failing(&library, &run, "clCreateBuffer", number, error);
        refuses(&full, &[name, "allocate", "bytes", "lower"]);
        assert!(!run.exists(), "{number}: {}", said(&full));
    }
    let broken = failing(&library, &run, "clBuildProgram", 3, BUILD);
    refuses(
        &broken,
        &["build ", ".cl", "memory may have run out", "driver"],
    );
    assert!(!run.exists());
    // In the middle, where a density step asks for larger arrays, what was saved stays.
    let late = failing(&library, &run, "clCreateBuffer", 173, MEMORY);
    refuses(&late, &["allocate", "lower", "iterations is saved"]);
    assert!(checkpoint::read(&run).is_ok());
}

/// A disk that does not read an archive is told as that, wherever in the archive it fails.
#[test]
fn a_disk_that_fails_is_no_damaged_archive() {
    let dir = tempfile::tempdir().unwrap();
    let Some(library) = shim(dir.path()) else {
        return;
    };
    let archive = crate::inputs::small_archive(&dir);
    for number in 1.. {
        let mut command = crate::cli::program();
        command.arg("info").arg(&archive).env("TMPDIR", dir.path());
        command.env("LD_PRELOAD", &library);
        // EIO.
        command.env("MHSPLAT_FAULT", format!("pread64:{number}:5"));
        let output = command.output().unwrap();
        if output.status.success() {
            assert!(number > 3, "{number} reads of an archive");
            break;
        }
        refuses(&output, &["photos.zip", "Input/output error"]);
        assert!(!said(&output).contains("damaged"), "{}", said(&output));
    }
}

/// A machine without a driver: told at once, with what to install.
#[test]
fn no_driver_is_told_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let began = std::time::Instant::now();
    let output = Command::new(env!("CARGO_BIN_EXE_mhsplat"))
        .arg("devices")
        .env("OCL_ICD_VENDORS", dir.path())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(
        said.contains("no driver found") && said.contains("install"),
        "{said}"
    );
    // The loader's crate would have asked for ten seconds.
    assert!(began.elapsed().as_secs() < 5);
}
