//! Runs of other options, caps of other runs, and what a finished run must still hold.

use std::fs;

use super::{Fake, TWO, drive, experiment, record};
use mhsplat::lab::experiment::*;

fn states(e: &Experiment) -> Vec<String> {
    let all = blocks(e).into_iter().flatten();
    all.map(|run| {
        let found = look(e, &run);
        let (word, why) = found.words();
        format!("{word}: {why}")
    })
    .collect()
}

#[test]
fn runs_of_other_options_are_refused_not_counted_and_not_overwritten() {
    let dir = tempfile::tempdir().unwrap();
    let e = experiment(dir.path(), TWO).unwrap();
    drive(&e, &mut Fake::default()).unwrap();
    assert!(states(&e).iter().all(|s| s == "done: complete"));
    let mark = e.output.join("experiment.toml");
    assert_eq!(fs::read_to_string(&mark).unwrap(), TWO);
    let other = experiment(dir.path(), &TWO.replace("1000", "900")).unwrap();
    let all = states(&other);
    let refused = "refused: other options (iterations: 1000 instead of 900)";
    let remedy = "; move it away, or choose another output with -o";
    assert_eq!(all[0], format!("{refused}{remedy}"));
    let mut fake = Fake::default();
    let outcome = drive(&other, &mut fake).unwrap();
    assert!(fake.jobs.is_empty());
    assert_eq!(
        (outcome.done, outcome.failed.len(), outcome.left),
        (0, 8, 0)
    );
    assert_eq!(
        fs::read_to_string(&mark).unwrap(),
        TWO,
        "the text of the runs that are there"
    );
    let summary = write(&other).unwrap();
    assert!(
        summary
            .scenes
            .iter()
            .all(|s| s.comparison.is_none() && s.missing == 4)
    );
    let text = summary.report().to_markdown();
    assert!(
        text.contains("mh, seed 0: refused: other options") && text.contains(remedy),
        "{text}"
    );
    assert!(
        summary
            .report()
            .to_html()
            .contains("refused: other options")
    );
    // What fits renews the text.
    let more = TWO.replace("[0, 1]", "[0, 1, 2]");
    let e = experiment(dir.path(), &more).unwrap();
    let mut fake = Fake::default();
    assert_eq!(drive(&e, &mut fake).unwrap().done, 12);
    assert_eq!(fake.jobs.len(), 4);
    assert_eq!(fs::read_to_string(&mark).unwrap(), more);
}

#[test]
fn a_cap_is_not_taken_from_a_run_of_other_options() {
    let dir = tempfile::tempdir().unwrap();
    let e = experiment(dir.path(), TWO).unwrap();
    drive(&e, &mut Fake::default()).unwrap();
    // The setting that gives the cap changes, the others do not.
    let file = TWO.replace("name = \"mh\"\n", "name = \"mh\"\nmh = { interval = 50 }\n");
    assert_ne!(file, TWO);
    let other = experiment(dir.path(), &file).unwrap();
    let runs = blocks(&other);
    assert_eq!(expected(&other, &runs[0][1]).unwrap(), None);
    let capped = &states(&other)[1];
    let said = ["gives its number of Gaussians", "; mend that one first"];
    assert!(said.iter().all(|s| capped.contains(s)), "{capped}");
    fs::remove_dir_all(e.output.join("b/none/seed-1")).unwrap();
    let mut fake = Fake::default();
    let outcome = drive(&other, &mut fake).unwrap();
    assert!(fake.jobs.is_empty(), "{:?}", fake.jobs);
    assert_eq!(outcome.failed.len(), 8);
    // A capped run whose cap is no longer that of its partner is of other options, too.
    let mut grown = record(&e, "a/mh/seed-0");
    grown.gaussians = 5000;
    grown.write(e.output.join("a/mh/seed-0")).unwrap();
    let all = states(&e);
    assert!(
        all[1].contains("max-gaussians: 1200 instead of 5000"),
        "{all:?}"
    );
}

#[test]
fn record_and_metrics_are_all_that_a_finished_run_needs() {
    let dir = tempfile::tempdir().unwrap();
    let e = experiment(dir.path(), TWO).unwrap();
    drive(&e, &mut Fake::default()).unwrap();
    let lean = e.output.join("a/mh/seed-0");
    fs::remove_file(lean.join("scene.ply")).unwrap();
    assert!(matches!(state(&lean, None), State::Done(_)));
    // A checkpoint that is left is no reason to go on.
    let saved = e.output.join("b/mh/seed-0");
    fs::remove_file(saved.join("scene.ply")).unwrap();
    fs::create_dir(saved.join("checkpoint")).unwrap();
    fs::write(saved.join("checkpoint/state.safetensors"), "").unwrap();
    let mut fake = Fake::default();
    assert_eq!(drive(&e, &mut fake).unwrap().done, 8);
    assert!(fake.jobs.is_empty() && lean.join("run.json").is_file());
    fs::remove_file(lean.join("metrics.csv")).unwrap();
    let outcome = drive(&e, &mut fake).unwrap();
    assert!(fake.jobs.is_empty() && lean.join("run.json").is_file());
    assert!(
        outcome.failed[0].1.contains("without metrics.csv"),
        "{outcome:?}"
    );
}
