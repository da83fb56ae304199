//! Parts of an experiment for job arrays.

use std::fs;

use super::{Fake, TWO, drive, experiment};
use crate::cli::{done, mhsplat, stderr, text};
use mhsplat::lab::experiment::{Experiment, mine};

/// Names of the runs of a part.
fn names(e: &mut Experiment, part: &str) -> Vec<String> {
    e.shard = Some(part.parse().unwrap());
    let runs = mine(e).concat().into_iter();
    runs.map(|run| run.dir.display().to_string()).collect()
}

#[test]
fn a_run_is_in_the_part_of_the_one_that_gives_its_cap() {
    let dir = tempfile::tempdir().unwrap();
    let mut e = experiment(dir.path(), TWO).unwrap();
    let (first, second) = (names(&mut e, "1/2"), names(&mut e, "2/2"));
    assert_eq!([first.len(), second.len()], [4, 4]);
    assert!(first.iter().all(|n| n.contains("out/a/")), "{first:?}");
    assert!(second.iter().all(|n| n.contains("out/b/")), "{second:?}");
    let mut free = experiment(dir.path(), &TWO.replace("cap-from = \"mh\"\n", "")).unwrap();
    let parts = ["1/3", "2/3", "3/3"].map(|part| names(&mut free, part));
    assert_eq!(parts.each_ref().map(Vec::len), [3, 3, 2]);
    free.shard = None;
    let all: Vec<String> = mine(&free)
        .concat()
        .iter()
        .map(|run| run.dir.display().to_string())
        .collect();
    let dealt: Vec<String> = (0..8).map(|k| parts[k % 3][k / 3].clone()).collect();
    assert_eq!(dealt, all);
}

#[test]
fn the_part_that_finds_all_runs_done_compares_them() {
    let dir = tempfile::tempdir().unwrap();
    let mut e = experiment(dir.path(), TWO).unwrap();
    let page = e.output.join("summary.html");
    let mut fake = Fake::default();
    // Another job has just begun to put the experiment's text there.
    fs::create_dir_all(&e.output).unwrap();
    fs::write(e.output.join(".experiment.toml.7.mhsplat-tmp"), "seeds").unwrap();
    for (part, runs) in [("2/2", 4), ("1/2", 8)] {
        assert!(!page.exists(), "{part}");
        e.shard = Some(part.parse().unwrap());
        let ended = drive(&e, &mut fake).unwrap();
        assert_eq!((ended.done, ended.left, fake.jobs.len()), (4, 0, runs));
    }
    assert!(page.exists());
    // Nothing is left for the whole.
    e.shard = None;
    assert_eq!(drive(&e, &mut fake).unwrap().done, 8);
    assert_eq!(fake.jobs.len(), 8);
}

#[test]
fn a_dry_run_lists_the_runs_of_a_part_and_wrong_parts_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    experiment(dir.path(), TWO).unwrap();
    let (file, out) = (dir.path().join("file.toml"), dir.path().join("out"));
    let args = ["experiment", text(&file), "-o", text(&out), "--dry-run"];
    let list = |part: &str| {
        let listed = done(&[&args[..], &["--shard", part]].concat());
        listed.lines().map(str::to_owned).collect::<Vec<_>>()
    };
    let parts = ["1/3", "2/3", "3/3"].map(list);
    assert_eq!(parts.each_ref().map(Vec::len), [4, 2, 2]);
    let mut all = done(&args).lines().map(str::to_owned).collect::<Vec<_>>();
    let mut together = parts.concat();
    all.sort_unstable();
    together.sort_unstable();
    assert_eq!(together, all);
    assert_eq!(list("5/8"), Vec::<String>::new(), "there are four pairs");
    for wrong in ["0/3", "4/3", "x", "1/0"] {
        let refused = mhsplat(&[&args[..], &["--shard", wrong]].concat());
        assert_eq!(refused.status.code(), Some(2));
        let said = stderr(&refused);
        assert!(
            said.contains("--shard") && said.contains(wrong) && said.contains("I/N"),
            "{said}"
        );
    }
}
