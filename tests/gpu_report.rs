//! The report of a GPU (`.ci/gpu-report`), by a program that answers in place of the real one.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

use crate::cli::{program, stderr};

/// A program that says that it has a GPU and measures small cases on the CPU; what trains and verifies leaves a page, or fails.
fn answering(dir: &Path, verifies: i32) -> Command {
    let real = program();
    let stub = dir.join("mhsplat");
    let text = format!(
        r#"#!/usr/bin/env bash
real="{}" folder=
for ((k = 1; k <= $#; k++)); do
  case ${{!k}} in -o) next=$((k + 1)); folder=${{!next}} ;; esac
done
case $1 in
  devices) echo "0 [Gpu] one; tuned: ${{MHSPLAT_TUNING:-measured}}" ;;
  verify) mkdir "$folder" && touch "$folder/verify.html" && exit {verifies} ;;
  train | synth) mkdir -p "${{folder:-$3}}" && touch "${{folder:-$3}}/scene.ply" "${{folder:-$3}}/run.json" ;;
  bench)
    # Default sizes in the first bench alone.
    case $folder:${{MHSPLAT_TUNING:-}} in *default:default | *tuned:) ;; *) exit 1 ;; esac
    MHSPLAT_DEVICE=cpu MHSPLAT_TUNING=default exec "$real" bench --brief 100@16 -o "$folder" ;;
  *) echo "mhsplat 0" ;;
esac
"#,
        real.get_program().display(),
    );
    fs::write(&stub, text).unwrap();
    fs::set_permissions(&stub, fs::Permissions::from_mode(0o755)).unwrap();
    let mut command = Command::new("bash");
    command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join(".ci/gpu-report"));
    command.env("MHSPLAT", stub).env("OUT", dir.join("report"));
    for (name, value) in real.get_envs() {
        command.env(name, value.unwrap_or_default());
    }
    command
}

fn reported(verifies: i32) -> (Output, tempfile::TempDir) {
    let dir = tempfile::tempdir().unwrap();
    let output = answering(dir.path(), verifies).output().unwrap();
    (output, dir)
}

#[test]
fn a_report_has_every_step_and_both_sizes_side_by_side() {
    let (output, dir) = reported(0);
    assert!(output.status.success(), "{}", stderr(&output));
    let report = dir.path().join("report");
    let page = fs::read_to_string(report.join("index.html")).unwrap();
    for step in [
        "verify-tiny",
        "verify",
        "train",
        "bench-default",
        "train-large",
        "tune",
        "verify-tuned",
        "bench-tuned",
    ] {
        assert!(page.contains(&format!("<tr><td>{step}<td>done")), "{page}");
    }
    // Times of the two, and the ratio.
    let row = page
        .lines()
        .find(|l| l.contains("100 Gaussians, 16 × 16, splat<"));
    let cells: Vec<f64> = row
        .unwrap()
        .split("<td>")
        .filter_map(|cell| cell.parse().ok())
        .collect();
    assert!(cells.len() == 3 && cells.iter().all(|v| *v > 0.0), "{page}");
    // What is sent has figures and no scenes.
    let list = Command::new("tar")
        .arg("-tzf")
        .arg(report.join("figures.tar.gz"))
        .output()
        .unwrap();
    let list = String::from_utf8(list.stdout).unwrap();
    assert!(list.contains("bench-default/bench.csv") && list.contains("devices.txt"));
    assert!(!list.contains("scene.ply"), "{list}");
}

#[test]
fn a_step_that_fails_is_told_and_the_others_go_on() {
    let (output, dir) = reported(1);
    assert_eq!(output.status.code(), Some(1));
    let page = fs::read_to_string(dir.path().join("report/index.html")).unwrap();
    assert!(
        page.contains("<tr><td>verify-tuned<td>failed (1)"),
        "{page}"
    );
    assert!(page.contains("<tr><td>bench-tuned<td>done"), "{page}");
    // Nothing of an earlier report is written over.
    let again = answering(dir.path(), 0).output().unwrap();
    assert_eq!(again.status.code(), Some(2));
    assert!(stderr(&again).contains("is there already"));
}
