//! Thresholds, and caveats of groups that differ.

use super::made::{Made, compared, run};
use mhsplat::lab::compare::thresholds::between;
use mhsplat::lab::compare::{Clock, Comparison, Options, report};

#[test]
fn default_thresholds_are_whole_decibels_from_the_first_evaluation_to_the_best() {
    let all = between(&[(12.3, 18.2), (14.0, 19.0), (11.0, 17.0)]);
    assert_eq!(all, [15.0, 16.0, 17.0, 18.0, 19.0]);
    // Fewer than four: halves.
    let ends = [(22.7, 24.6), (22.0, 23.9)];
    assert_eq!(between(&ends), [23.0, 23.5, 24.0, 24.5]);
    assert_eq!(between(&[(20.1, 20.4)]), [0.0; 0]);
    assert_eq!(between(&[(20.0, 20.0)]), [0.0; 0]);
    let wide = between(&[(0.5, 60.0)]);
    assert!((18..=24).contains(&wide.len()), "{wide:?}");
    for bad in [f64::NAN, f64::NEG_INFINITY, 1e300] {
        assert!(between(&[(bad, 30.0)]).len() < 25);
        assert!(between(&[(10.0, bad)]).len() < 25);
    }
    assert!(between(&[]).is_empty());
}

#[test]
fn the_early_thresholds_are_shown_and_those_that_only_one_reaches() {
    let made = [run("a", 0), run("b", 0).sampler_none().below(3.0)];
    let c = compared(&made, &Options::default()).unwrap();
    let own: Vec<f64> = (15..=25).map(f64::from).collect();
    assert_eq!(c.thresholds, own);
    let text = report(&c).to_markdown();
    let row = text
        .lines()
        .find(|l| l.starts_with("| none | ") && l.contains("not reached"));
    assert_eq!(row.unwrap().matches("not reached").count(), 3, "{text}");
    assert!(text.contains("every whole dB above the highest first evaluation"));
    assert!(report(&c).to_html().contains("every whole dB above"));
}

fn against(made: &[Made], reference: &str, thresholds: &[f64]) -> Comparison {
    let options = Options {
        thresholds: thresholds.to_vec(),
        reference: Some(reference.into()),
        ..Options::default()
    };
    compared(made, &options).unwrap()
}

#[test]
fn every_group_is_held_against_the_numbers_of_the_reference() {
    let sized = |name: &str, gaussians: u64| {
        let mut made = run(name, 0).named(name);
        made.rows[19].gaussians = gaussians;
        made
    };
    let made = [
        sized("a", 1200),
        sized("b", 1190),
        sized("c", 1224),
        sized("d", 1500),
        sized("e", 1100),
    ];
    let of = |reference: &str| {
        let warnings = against(&made, reference, &[20.0]).warnings;
        warnings
            .into_iter()
            .find(|w| w.contains("equal numbers"))
            .unwrap()
    };
    assert!(
        of("a").starts_with("not at equal numbers of Gaussians: 1200 (a) to 1500 (d), 1100 (e);"),
        "{}",
        of("a")
    );
    assert!(
        of("b").contains("1190 (b) to 1224 (c), 1500 (d), 1100 (e);"),
        "{}",
        of("b")
    );
}

#[test]
fn other_machines_are_named() {
    let warnings = |other: Made, clock: Clock| {
        let options = Options {
            clock: Some(clock),
            ..Options::default()
        };
        let made = [run("a", 0).named("a"), other.named("b")];
        compared(&made, &options).unwrap().warnings
    };
    let device = || run("b", 0).with(|r| (r.device.name, r.version) = ("gpu".into(), "9".into()));
    let named = warnings(device(), Clock::Cpu);
    assert!(
        named[0].starts_with("b: device gpu instead of ") && named[0].contains("version 9"),
        "{named:?}"
    );
    assert!(
        warnings(device(), Clock::Iterations).is_empty(),
        "iterations are the same everywhere"
    );
    assert!(warnings(run("b", 0).slower(2.0), Clock::Cpu).is_empty());
}
