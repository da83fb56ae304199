//! Thresholds, bounds of what is not reached, and what sets groups apart.

use super::made::{Made, compared, run};
use mhsplat::lab::compare::thresholds::between;
use mhsplat::lab::compare::{Bound, Bounded, Clock, Comparison, Limit, Options, bounded};

fn sorted(ends: &[(f64, f64)], reference: usize) -> Vec<f64> {
    let mut all = between(ends, reference);
    all.sort_by(f64::total_cmp);
    all.dedup();
    all
}

#[test]
fn default_thresholds_are_whole_decibels_from_the_first_evaluation_to_the_best() {
    let all = sorted(&[(12.3, 18.2), (14.0, 19.0), (11.0, 17.0)], 0);
    assert_eq!(all, [15.0, 16.0, 17.0, 18.0, 19.0]);
    // Fewer than four: halves within the last 1 dB of the reference (24.6) and of the others (23.9).
    let ends = [(22.7, 24.6), (22.0, 23.9)];
    assert_eq!(sorted(&ends, 0), [23.0, 23.5, 24.0, 24.5]);
    assert_eq!(sorted(&[(20.1, 20.4)], 0), [0.0; 0]);
    assert_eq!(sorted(&[(20.0, 20.0)], 0), [0.0; 0]);
    let wide = sorted(&[(0.5, 60.0)], 0);
    assert!((18..=24).contains(&wide.len()), "{wide:?}");
    for bad in [f64::NAN, f64::NEG_INFINITY, 1e300] {
        assert!(sorted(&[(bad, 30.0)], 0).len() < 25);
        assert!(sorted(&[(10.0, bad)], 0).len() < 25);
    }
    assert!(between(&[], 0).is_empty());
}

#[test]
fn the_early_thresholds_are_shown_and_those_that_only_one_reaches() {
    let made = [run("a", 0), run("b", 0).sampler_none().below(3.0)];
    let c = compared(&made, &Options::default()).unwrap();
    let own: Vec<f64> = (15..=25).map(f64::from).collect();
    assert_eq!(c.thresholds, own);
    let text = mhsplat::lab::compare::markdown(&c);
    let row = text
        .lines()
        .find(|l| l.starts_with("| none | ") && l.contains("not reached"));
    assert_eq!(row.unwrap().matches("not reached").count(), 3, "{text}");
    assert!(text.contains("every whole dB above the highest first evaluation"));
    assert!(mhsplat::lab::compare::page(&c).contains("every whole dB above"));
}

/// `fast`, twice as slow, and 3 dB lower, of these seeds.
fn three(seeds: &[u64]) -> Vec<Made> {
    let of = |s: &u64| {
        [
            run("fast", *s).named("fast"),
            run("slow", *s).slower(2.0).named("slow"),
            run("low", *s).below(3.0).named("low"),
        ]
    };
    seeds.iter().flat_map(of).collect()
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
fn what_is_not_reached_is_counted_and_a_bound() {
    let made = three(&[0, 1, 2]);
    let at = [20.0, 24.0, 40.0];
    let c = against(&made, "fast", &at);
    let low = c.relative.iter().find(|r| r.label == "low").unwrap();
    let counts = (
        low.counts.both,
        low.counts.only_reference,
        low.counts.only_group,
        low.counts.neither,
    );
    assert_eq!(counts, (1, 1, 0, 1));
    let fast = c.groups[0]
        .reach(1, Clock::Cpu)
        .unwrap()
        .spread
        .unwrap()
        .median;
    // Seed 1 is the middle one; its clock ends at 50.5.
    let limit = low.to_psnr[1].limit.unwrap();
    assert!((limit.value - 50.5 / fast).abs() < 1e-9 && limit.bound == Bound::AtLeast);
    let exact = low.to_psnr[0].ratio.unwrap().median;
    let bounded = low.bounded.unwrap();
    assert_eq!((bounded.of, bounded.at_least, bounded.at_most), (2, 1, 0));
    assert!((bounded.ratio - (exact * limit.value).sqrt()).abs() < 1e-9);
    assert_eq!(low.mean_of, 1, "the mean alone hides what is missing");
    assert!(low.to_psnr[2].limit.is_none(), "neither reaches 40 dB");
    let text = mhsplat::lab::compare::markdown(&c);
    let cell = format!(
        "| both 1, only fast 1, only low 0, neither 1 | ≥ {:.2}, of 2 |",
        bounded.ratio
    );
    assert!(text.contains(&cell), "{cell}: {text}");
    assert!(
        text.contains(&format!("≥ {:.2}: not reached", limit.value)),
        "{text}"
    );

    let c = against(&made, "low", &at);
    let fast = c.relative.iter().find(|r| r.label == "fast").unwrap();
    assert_eq!((fast.counts.only_group, fast.counts.only_reference), (1, 0));
    let other = fast.bounded.unwrap();
    assert!((other.ratio * bounded.ratio - 1.0).abs() < 1e-9);
    assert_eq!(other.limit().bound, Bound::AtMost);
    assert!(mhsplat::lab::compare::markdown(&c).contains(&format!("≤ {:.2}, of 2 |", other.ratio)));
}

#[test]
fn fewer_than_three_seeds_give_counts_but_no_bound() {
    let c = against(&three(&[0, 1]), "fast", &[20.0, 24.0]);
    let low = &c.relative[1];
    assert_eq!((low.counts.both, low.counts.only_reference), (1, 1));
    assert!(low.bounded.is_none() && low.to_psnr.iter().all(|t| t.limit.is_none()));
}

#[test]
fn a_ratio_is_of_the_seeds_that_both_have() {
    let fast = |s| run("fast", s).named("fast");
    let slow = |s| run("slow", s).slower(2.0).named("slow");
    let made = [
        fast(0),
        fast(1),
        fast(2),
        fast(9),
        slow(1),
        slow(2),
        slow(9),
    ];
    let c = against(&made, "fast", &[20.0]);
    let ratio = c.relative[0].to_psnr[0].ratio.unwrap();
    assert!((ratio.median - 2.0).abs() < 1e-9, "{ratio:?}");
    let named =
        "slow: seeds 1, 2, 9, but 0, 1, 2, 9 of fast; their medians are not of the same seeds";
    assert!(c.warnings.iter().any(|w| w == named), "{:?}", c.warnings);
    // Three and three others are compared as they are.
    let apart = [fast(0), fast(1), fast(2), slow(2), slow(3), slow(4)];
    assert!(
        against(&apart, "fast", &[20.0]).relative[0].to_psnr[0]
            .ratio
            .is_some()
    );
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
fn other_machines_and_other_spacing_of_evaluations_are_named() {
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
    assert!(warnings(run("b", 0).slower(1.4), Clock::Cpu).is_empty());
    let named = warnings(run("b", 0).slower(2.0), Clock::Cpu);
    assert_eq!(
        named,
        [
            "b: evaluations are 5.0 CPU seconds apart, those of a 2.5: times may be late by up to as much"
        ]
    );
    assert!(warnings(run("b", 0).slower(2.0), Clock::Iterations).is_empty());
}

#[test]
fn a_mean_of_bounds_of_both_sides_is_none() {
    let limit = |value, bound| Limit { value, bound };
    let (exact, low) = (limit(2.0, Bound::Exact), limit(0.5, Bound::AtLeast));
    let (high, either) = (limit(1.0, Bound::AtMost), limit(1.0, Bound::Unknown));
    let text = |all: &[Limit]| bounded(&Bounded::of(all).unwrap());
    assert_eq!(text(&[exact, exact]), "2.00, of 2");
    assert_eq!(text(&[exact, low]), "≥ 1.00, of 2");
    assert_eq!(text(&[exact, high]), "≤ 1.41, of 2");
    assert_eq!(text(&[low, high]), "≈ 0.71, of 2, no bound: 1 ≥, 1 ≤");
    assert_eq!(text(&[exact, either]), "≈ 1.41, of 2, no bound: 1 ≥, 1 ≤");
    assert!(Bounded::of(&[]).is_none());
    // Over scenes: none of them is left out for having no bound.
    let scenes = [[exact, low], [low, high]].map(|l| Bounded::of(&l).unwrap());
    let mean = Bounded::mean(&scenes).unwrap();
    assert_eq!((mean.of, mean.at_least, mean.at_most), (2, 2, 1));
}
