//! The command line as a contract: run folder, JSON, exit codes, and what a new user gets wrong.

mod convert;
mod init;
mod options;
mod refusals;
mod run_folder;
mod shots;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use mhsplat::lab::synth::{SynthLayout, SynthOptions, generate};

/// The program under test, on the default device.
pub fn program() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mhsplat"));
    // Nothing is measured for a test, or kept outside of its folders.
    command.env("MHSPLAT_TUNING", "default");
    command.env("XDG_CACHE_HOME", env!("CARGO_TARGET_TMPDIR"));
    command.env_remove("MHSPLAT_DEVICE");
    command
}

pub fn mhsplat(args: &[&str]) -> Output {
    program().args(args).output().unwrap()
}

pub fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

pub fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// Runs, asserts success and answers stdout.
pub fn done(args: &[&str]) -> String {
    let output = mhsplat(args);
    assert_eq!(
        output.status.code(),
        Some(0),
        "{args:?}: {}",
        stderr(&output)
    );
    stdout(&output)
}

/// The bundled scene.
pub fn room() -> String {
    format!("{}/data/room-tiny", env!("CARGO_MANIFEST_DIR"))
}

pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A tiny dataset on disk that a test may damage: 9 views of 48 × 36 pixels.
pub fn scratch_dataset(dir: &Path, layout: SynthLayout) -> PathBuf {
    let path = dir.join("dataset");
    let options = SynthOptions {
        layout,
        views: 9,
        width: 48,
        height: 36,
        points: 200,
        seed: 1,
        samples: 1,
    };
    generate("room", &path, &options).unwrap();
    path
}

#[test]
fn devices_lists_the_default_and_says_why() {
    let list: serde_json::Value = serde_json::from_str(&done(&["devices", "--json"])).unwrap();
    assert!(!list["devices"].as_array().unwrap().is_empty());
    assert!(list["default"].is_u64());
    assert!(done(&["devices"]).contains("* is the default"));
}

#[test]
fn the_doctor_finds_what_there_is() {
    let found: serde_json::Value = serde_json::from_str(&done(&["doctor", "--json"])).unwrap();
    assert!(found["devices"][0]["failure"].is_null() && found["no_devices"].is_null());
    assert!(found["devices"][0]["local_memory"].as_u64() > Some(0));
    let text = done(&["doctor"]);
    for part in ["loader:", "devices:", "local, work-groups to", "limits:"] {
        assert!(text.contains(part), "{text}");
    }
}

/// A driver that is named and not there: the file, the library and what to install.
#[cfg(target_os = "linux")]
#[test]
fn the_doctor_says_what_to_install() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("lost.icd"), "liblost-driver.so.3\n").unwrap();
    let ill = || {
        let mut command = program();
        // Whichever of the loaders it is, it looks there.
        for name in ["OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH"] {
            command.env(name, dir.path());
        }
        command.arg("doctor");
        command
    };
    let told = ill().output().unwrap();
    let (out, err) = (stdout(&told), stderr(&told));
    assert_eq!(told.status.code(), Some(2), "{out}{err}");
    for part in [
        "lost.icd",
        "liblost-driver.so.3",
        "install a driver",
        "ocl-icd",
    ] {
        assert!(out.contains(part), "{part:?}: {out}");
    }
    assert!(err.contains("no usable device"), "{err}");
    let json = ill().arg("--json").output().unwrap();
    assert_eq!(json.status.code(), Some(2));
    let found: serde_json::Value = serde_json::from_str(&stdout(&json)).unwrap();
    assert!(found["drivers"][0]["failure"].is_string());
}

#[test]
fn a_device_nobody_has_is_refused_from_flag_and_from_environment() {
    let by_flag = mhsplat(&["verify", "--device", "abacus"]);
    assert_eq!(by_flag.status.code(), Some(2));
    assert!(stderr(&by_flag).contains("abacus"));
    let by_variable = program()
        .arg("verify")
        .env("MHSPLAT_DEVICE", "abacus")
        .output()
        .unwrap();
    assert_eq!(by_variable.status.code(), Some(2));
}

#[test]
fn verify_passes_here_and_speaks_json() {
    let v: serde_json::Value = serde_json::from_str(&done(&["verify", "--json"])).unwrap();
    assert_eq!(v["suite"], "quick");
    assert_eq!(v["failed"], 0);
    assert_eq!(v["passed"], v["cases"].as_array().unwrap().len());
    let keys = [
        "family",
        "case",
        "stage",
        "quantity",
        "max_rel_error",
        "median_rel_error",
        "bound",
        "non_finite",
        "flips",
        "pass",
    ];
    for key in keys {
        assert!(!v["cases"][0][key].is_null(), "{key}");
    }
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("verify");
    let text = done(&["verify", "-o", out.to_str().unwrap()]);
    assert!(text.contains("0 failed"), "{text}");
    for file in ["verify.html", "verify.json", "verify.md"] {
        assert!(out.join(file).is_file(), "{file}");
    }
    // The page begins with a row for each family; what passed is folded away.
    let page = std::fs::read_to_string(out.join("verify.html")).unwrap();
    let at = |text: &str| page.find(text).unwrap_or_else(|| panic!("no {text:?}"));
    let (families, folded) = (at("Worst of each family"), at("All comparisons"));
    assert!(families < folded && page[..folded].matches("<tr>").count() < 10);
    assert!(!page.contains("Failed comparisons"));
    let again = mhsplat(&["verify", "-o", out.to_str().unwrap()]);
    assert_eq!(again.status.code(), Some(2), "nothing is overwritten");
}

#[test]
fn usage_errors_exit_with_2() {
    for args in [
        vec!["train"],
        vec!["train", "x", "--iterations", "many"],
        vec!["frobnicate"],
        vec!["render", "x.ply", "-o", "y"],
    ] {
        assert_eq!(mhsplat(&args).status.code(), Some(2), "{args:?}");
    }
    assert!(done(&["--help"]).contains("Exit codes"));
    assert!(done(&["train", "--help"]).contains("--max-size"));
}

#[test]
fn a_tuning_that_means_nothing_is_refused() {
    let devices = |tuning: &str| {
        let mut command = program();
        command.env("MHSPLAT_TUNING", tuning).arg("devices");
        command.output().unwrap()
    };
    let listed = |tuning| String::from_utf8_lossy(&devices(tuning).stdout).into_owned();
    for (asked, said) in [
        ("vector-width=3", "1, 4, 8 or 16"),
        ("tile=48", "tile is 16 or 32"),
        (
            "tile=0,vector-width=1,block-width=1,group-style=true",
            "tile is",
        ),
        (
            "tile=65536,vector-width=1,block-width=1,group-style=true",
            "tile is",
        ),
        ("widht=8", "name=value"),
        ("fast", "name=value"),
    ] {
        let out = devices(asked);
        let text = String::from_utf8_lossy(&out.stderr).into_owned();
        assert_eq!(out.status.code(), Some(2), "{text}");
        assert!(
            text.contains(said) && text.contains("MHSPLAT_TUNING"),
            "{text}"
        );
    }
    let text = listed("strip=800");
    assert!(
        text.contains("given") && text.contains("strip=800"),
        "{text}"
    );
    // The other style has tiles of its own.
    let text = listed("vector-width=1,block-width=1,group-style=true,radix-bits=8");
    assert!(text.contains("group-style=true,tile=16"), "{text}");
}
