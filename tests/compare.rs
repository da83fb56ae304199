//! Comparing runs: figures, groups, refusals.

mod cli;
mod curve;
pub mod made;
mod paired;
mod remarks;

use made::{Made, compared, run};

use mhsplat::RunRecord;
use mhsplat::base::error::Error;
use mhsplat::config::Length;
use mhsplat::device::tuning::Tuning;
use mhsplat::lab::compare::{Clock, Options, Source, compare, finished, report};

fn message(error: &Error) -> String {
    error.to_string()
}

/// Folders of `made`, compared.
fn fails(made: &[Made], options: &Options) -> String {
    message(&compared(made, options).unwrap_err())
}

#[test]
fn seeds_are_samples_of_one_group_and_everything_else_sets_apart() {
    let labels = |made: &[Made]| -> Vec<(String, usize)> {
        let c = compared(made, &Options::default()).unwrap();
        c.groups
            .iter()
            .map(|g| (g.label.clone(), g.runs.len()))
            .collect()
    };
    let seeds = |f: &dyn Fn(Made) -> Made| [0, 1, 2].map(|s| f(run("r", s))).to_vec();
    let two = [seeds(&|m| m), seeds(&|m| m.sampler_none())].concat();
    assert_eq!(labels(&two), [("mh".into(), 3), ("none".into(), 3)]);
    let option = [seeds(&|m| m), seeds(&|m| m.iterations(500))].concat();
    assert_eq!(
        labels(&option),
        [
            ("mh, iterations 1000".into(), 3),
            ("mh, iterations 500".into(), 3)
        ]
    );
    // Only what tells groups of one sampler apart is in their names.
    let capped = |m: Made| m.with(|r| r.config.max_gaussians = Some(900));
    let three = [
        run("a", 0),
        run("b", 0).sampler_none(),
        run("c", 0).iterations(500),
    ];
    let names: Vec<String> = labels(&three).into_iter().map(|l| l.0).collect();
    assert_eq!(names, ["mh, iterations 1000", "none", "mh, iterations 500"]);
    let caps = labels(&[run("a", 0), capped(run("b", 0))]);
    assert_eq!(caps[1].0, "mh, max-gaussians 900");
    // An option that the first run does not list is a difference, too.
    let longer = run("b", 0).with(|r| r.config.lengths = vec![Length::new(5, 2000)]);
    for runs in [[run("a", 0), longer.clone()], [longer, run("a", 0)]] {
        let c = compared(&runs, &Options::default()).unwrap();
        let names: Vec<&str> = c.differences.iter().map(|d| d.what.as_str()).collect();
        assert!(names.contains(&"lengths"), "{names:?}");
    }
    // How often a run was evaluated changes nothing in it.
    let beside = [
        run("a", 0),
        run("b", 1).with(|r| r.config.eval_every = Some(7)),
    ];
    assert_eq!(labels(&beside), [("mh".into(), 2)]);
    let device = [
        run("a", 0),
        run("b", 0).with(|r| r.device.name = "other".into()),
    ];
    assert_eq!(labels(&device).len(), 2);
    let named = [
        run("a", 0).named("x"),
        run("b", 0).sampler_none().named("x"),
    ];
    let c = compared(&named, &Options::default()).unwrap();
    assert_eq!(c.groups[0].label, "x");
    let mixed = "x: its runs differ in more than the seed: sampler";
    assert!(c.warnings.iter().any(|w| w == mixed), "{:?}", c.warnings);
}

#[test]
fn unequal_numbers_of_gaussians_are_named() {
    let more = |extra: u64| {
        let mut other = run("b", 0).named("other");
        other.rows[19].gaussians += extra;
        let c = compared(&[run("a", 0), other], &Options::default()).unwrap();
        assert!(
            c.warnings
                .iter()
                .all(|w| report(&c).to_markdown().contains(w))
        );
        c.warnings
    };
    assert!(more(20).is_empty(), "equal to 2 %");
    // Those that were removed at the end count, in tables and curves.
    let removed = run("b", 0).named("other").with(|r| r.removed = 30);
    let c = compared(&[run("a", 0), removed], &Options::default()).unwrap();
    let ends = c.groups.iter().map(|g| {
        let run = &g.runs[0];
        (run.last.gaussians, run.rows[run.rows.len() - 1].gaussians)
    });
    assert_eq!(ends.collect::<Vec<_>>(), [(1200, 1200), (1230, 1230)]);
    let warnings = more(200);
    let named = "not at equal numbers of Gaussians: 1200 (mh) to 1400 (other)";
    assert!(warnings[0].starts_with(named), "{warnings:?}");
}

#[test]
fn some_runs_arriving_is_not_all() {
    let made = [run("a", 0), run("b", 1), run("c", 2).below(3.0)];
    let options = Options {
        thresholds: vec![10.0, 24.0, 99.0],
        clock: Some(Clock::Iterations),
        ..Options::default()
    };
    let c = compared(&made, &options).unwrap();
    let text = report(&c).to_markdown();
    assert!(text.contains("| 2 of 3: "), "{text}");
    assert!(text.contains("| not reached |"), "{text}");
    assert!(text.contains("| ≤ 50"), "at the first evaluation: {text}");
    let reach = c.groups[0].reach(1, Clock::Iterations).unwrap();
    assert_eq!((reach.reached(), reach.spread), (2, None));
}

#[test]
fn what_is_not_comparable_is_refused_by_name() {
    type Change = fn(&mut mhsplat::RunRecord);
    let cases: [(Change, &str); 5] = [
        (
            |r| r.dataset.width = 320,
            "another resolution, 320 × 72 instead of 96 × 72",
        ),
        (|r| r.dataset.test_views = 4, "another split"),
        (
            |r| r.final_scores.as_mut().unwrap().per_view[0].view = "other".into(),
            "other held-out views",
        ),
        (
            |r| r.dataset.fingerprint = Some("f".into()),
            "another dataset",
        ),
        (
            |r| (r.dataset.path, r.dataset.fingerprint) = ("x/other".into(), None),
            "another dataset",
        ),
    ];
    for (change, word) in cases {
        let made = [run("a", 0), run("b", 1).with(change)];
        let refusal = fails(&made, &Options::default());
        assert!(
            refusal.contains(word) && refusal.contains("--allow-different"),
            "{refusal}"
        );
        let allowed = Options {
            allow_different: true,
            ..Options::default()
        };
        let c = compared(&made, &allowed).unwrap();
        assert!(
            c.warnings.iter().any(|w| w.contains(word)),
            "{:?}",
            c.warnings
        );
        assert!(report(&c).to_html().contains("not comparable: "));
    }
    // A dataset that was moved is the same one.
    let moved = [
        run("a", 0),
        run("b", 1).with(|r| r.dataset.path = "/elsewhere/room".into()),
    ];
    assert!(
        compared(&moved, &Options::default())
            .unwrap()
            .warnings
            .is_empty()
    );
    let white = |r: &mut mhsplat::RunRecord| {
        r.config.background = mhsplat::config::Background::White;
    };
    let c = compared(&[run("a", 0), run("b", 1).with(white)], &Options::default()).unwrap();
    assert!(
        c.warnings[0].contains("another background"),
        "{:?}",
        c.warnings
    );
}

#[test]
fn unfinished_runs_count_with_a_warning() {
    let cut = run("cut", 1).with(|r| r.iterations = 600).rows(12);
    let c = compared(&[run("a", 0), cut], &Options::default()).unwrap();
    let unfinished =
        |w: &String| w.contains("unfinished, 600 of 1000 iterations") && w.contains("after 600");
    assert!(c.warnings.iter().any(unfinished), "{:?}", c.warnings);
    let run_of_it = &c.groups[0].runs[1];
    assert!(!run_of_it.finished && run_of_it.flip.is_none() && run_of_it.last.iteration == 600);
    assert!(
        !c.groups[0].end.contains_key("flip"),
        "no FLIP of a group without that of every run"
    );
    // A time budget ends a run as well as its iterations do.
    let mut record = run("a", 0).record;
    record.iterations = 600;
    assert!(!finished(&record));
    record.out_of_time = true;
    assert!(finished(&record));
}

#[test]
fn runs_that_cannot_be_read_say_what_is_wrong() {
    let dir = tempfile::tempdir().unwrap();
    run("good", 0).write(dir.path());
    let refused = |name: &str, words: &[&str]| {
        let sources = ["good", name].map(|n| Source::parse(dir.path().join(n).to_str().unwrap()));
        let text = message(&compare(&sources, &Options::default()).unwrap_err());
        for word in words {
            assert!(text.contains(word), "{word}: {text}");
        }
    };
    refused("nowhere", &["nowhere: no such folder"]);
    std::fs::create_dir(dir.path().join("empty")).unwrap();
    refused("empty", &["empty: holds no run.json", "mhsplat train"]);
    let bad = run("bad", 1).write(dir.path());
    std::fs::remove_file(bad.join("metrics.csv")).unwrap();
    refused("bad", &["bad: holds no metrics.csv"]);
    std::fs::write(bad.join("metrics.csv"), "iteration,psnr\n1,2\n").unwrap();
    refused("bad", &["metrics.csv", "header"]);
    let good = std::fs::read_to_string(dir.path().join("good/metrics.csv")).unwrap();
    std::fs::write(bad.join("metrics.csv"), good.replacen("1.", "x.", 1)).unwrap();
    refused("bad", &["metrics.csv: line "]);
    std::fs::write(bad.join("metrics.csv"), good).unwrap();
    std::fs::write(bad.join("run.json"), "{\"version\":").unwrap();
    refused("bad", &["run.json", "not a run record"]);
    let record = std::fs::read_to_string(dir.path().join("good/run.json")).unwrap();
    let chance = record.replacen("\"sampler\": \"mh\"", "\"sampler\": \"chance\"", 1);
    std::fs::write(bad.join("run.json"), &chance).unwrap();
    refused(
        "bad",
        &["run.json", "config.sampler: unknown variant `chance`"],
    );
    std::fs::write(bad.join("run.json"), record + "}").unwrap();
    refused("bad", &["run.json", "trailing characters"]);
    // Not evaluated yet: left out with a word; nothing but such runs: refused.
    let young = run("young", 1).rows(0);
    let c = compared(&[run("a", 0), young.clone()], &Options::default()).unwrap();
    assert!(
        c.warnings.iter().any(|w| w.contains("not evaluated yet")),
        "{:?}",
        c.warnings
    );
    assert!(fails(&[young], &Options::default()).contains("no run with an evaluation"));
}

#[test]
fn without_cpu_seconds_training_seconds_are_the_clock() {
    let without = run("b", 1).slower(0.0);
    let c = compared(&[run("a", 0), without.clone()], &Options::default()).unwrap();
    assert_eq!(c.clock, Clock::Train);
    assert!(c.warnings.iter().any(|w| w.contains("no CPU seconds")));
    let asked = Options {
        clock: Some(Clock::Cpu),
        ..Options::default()
    };
    assert!(fails(&[run("a", 0), without], &asked).contains("--clock"));
    assert_eq!(
        compared(&[run("a", 0)], &Options::default()).unwrap().clock,
        Clock::Cpu
    );
}

#[test]
fn default_thresholds_lie_where_runs_can_be_told_apart() {
    let c = compared(&[run("a", 0), run("b", 1).below(2.0)], &Options::default()).unwrap();
    assert!((3..=12).contains(&c.thresholds.len()), "{:?}", c.thresholds);
    let best = c.groups[0].end["psnr"].max;
    assert!(
        c.thresholds.iter().all(|t| *t <= best && *t > 12.0),
        "{:?}",
        c.thresholds
    );
    for reach in c
        .groups
        .iter()
        .flat_map(|g| g.to_psnr.iter().flat_map(|t| &t.reach))
    {
        assert!(!reach.at_most(), "a threshold below the first evaluation");
    }
    for bad in [f64::NAN, f64::INFINITY, 200.5, -1e300] {
        let options = Options {
            thresholds: vec![20.0, bad],
            ..Options::default()
        };
        assert!(fails(&[run("a", 0)], &options).contains("--threshold"));
    }
    let nobody = Options {
        reference: Some("adc".into()),
        ..Options::default()
    };
    assert!(fails(&[run("a", 0)], &nobody).contains("there are: mh"));
}

/// Results stay readable when a setting is gone; a name that no version knew is still refused.
#[test]
fn records_of_earlier_versions_are_read() {
    let dir = tempfile::tempdir().unwrap();
    let folder = run("old", 1).write(dir.path());
    let file = folder.join("run.json");
    let now = RunRecord::read(&folder).unwrap();
    let mut old = serde_json::to_value(&now).unwrap();
    old["config"]["work"]["resolution-interval"] = 1500.into();
    old["device"]["tuning"] = serde_json::to_value(Tuning::CPU).unwrap();
    old["device"]["tuning"]["update-block"] = 8192.into();
    std::fs::write(&file, old.to_string()).unwrap();
    let read = RunRecord::read(&folder).unwrap();
    assert_eq!(read.config, now.config);
    assert_eq!(read.device.tuning, Some(Tuning::CPU));
    old["config"]["work"]["unheard-of"] = 1.into();
    std::fs::write(&file, old.to_string()).unwrap();
    let error = RunRecord::read(&folder).unwrap_err().to_string();
    assert!(error.contains("not a run record"), "{error}");
}
