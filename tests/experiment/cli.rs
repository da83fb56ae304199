//! `mhsplat experiment` as a command.

use std::fs;
use std::process::Stdio;
use std::time::{Duration, Instant};

use crate::cli::{done, mhsplat, program, room, stderr, stdout, text};
use mhsplat::lab::experiment::{State, last_error, state};

#[test]
fn ctrl_c_stops_and_the_same_command_ends_it() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("tiny.toml");
    let scene = format!(
        "seeds = [0]\n[train]\niterations = 1500\nmax-size = 64\ncheckpoint-every = 0\n[[scene]]\npath = {:?}\n",
        room()
    );
    fs::write(
        &file,
        scene + "[[setting]]\nname = \"none\"\nsampler = \"none\"\n",
    )
    .unwrap();
    let out = dir.path().join("out");
    let args = ["experiment", text(&file), "-o", text(&out)];
    let mut child = program()
        .args(args)
        .stderr(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let run = out.join("room-tiny/none/seed-0");
    let started = Instant::now();
    while fs::read_to_string(run.join("metrics.csv")).map_or(0, |t| t.lines().count()) < 2 {
        assert!(started.elapsed() < Duration::from_secs(120));
        assert!(child.try_wait().unwrap().is_none(), "ended too early");
        std::thread::sleep(Duration::from_millis(10));
    }
    // To the parent alone: it has to tell its child.
    let id = child.id().to_string();
    let killed = std::process::Command::new("kill")
        .args(["-INT", &id])
        .status()
        .unwrap();
    assert!(killed.success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert_eq!(state(&run, None), State::Begun);
    assert!(done(&[&args[..], &["--dry-run"]].concat()).contains("resumes from its checkpoint"));
    let summary: serde_json::Value =
        serde_json::from_str(&done(&[&args[..], &["--json"]].concat())).unwrap();
    assert_eq!(
        summary["scenes"][0]["comparison"]["groups"][0]["label"],
        "none"
    );
    assert!(matches!(state(&run, None), State::Done(_)));
    assert!(out.join("summary.html").is_file());
    fs::write(&file, "seeds = 3").unwrap();
    let refused = mhsplat(&args);
    assert_eq!(refused.status.code(), Some(2));
    assert!(stderr(&refused).contains("tiny.toml"));
}

#[test]
fn a_dry_run_as_json_and_every_failure_on_stderr() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("two.toml");
    // Folders that are no datasets: training fails at once.
    for scene in ["a", "b"] {
        fs::create_dir(dir.path().join(scene)).unwrap();
    }
    let toml = "seeds = [0]\n[[scene]]\npath = \"a\"\n[[scene]]\npath = \"b\"\n[[setting]]\nname = \"mh\"\n";
    fs::write(&file, toml).unwrap();
    let out = dir.path().join("out");
    let args = ["experiment", text(&file), "-o", text(&out)];
    let listed = done(&[&args[..], &["--dry-run", "--json"]].concat());
    let v: serde_json::Value = serde_json::from_str(&listed).unwrap();
    assert_eq!(v.as_array().unwrap().len(), 2);
    assert_eq!(v[1]["state"], "new");
    assert!(v[1]["run"].as_str().unwrap().ends_with("b/mh/seed-0"));
    assert!(v[1]["why"].is_string());
    assert!(!out.exists(), "nothing is written");
    let failed = mhsplat(&[&args[..], &["--json"]].concat());
    assert_eq!(failed.status.code(), Some(2));
    let said = stderr(&failed);
    for scene in ["a", "b"] {
        let line = |l: &str| l.starts_with("failed: ") && l.contains(&format!("out/{scene}/mh"));
        assert!(said.lines().any(line), "{scene}: {said}");
    }
    let summary: serde_json::Value = serde_json::from_str(&stdout(&failed)).unwrap();
    assert_eq!(summary["scenes"][0]["missing"], 1);
}

#[test]
fn what_a_process_says_need_not_be_text() {
    let said = b"\xff\xfe driver\nerror: first\n\xc3\x28\nerror: no \xff such file\r\nbye\xff";
    let last = last_error(&said[..]).unwrap();
    assert_eq!(last, "error: no \u{fffd} such file");
    assert_eq!(last_error(&b"all well\n"[..]), None);
}
