//! Groups run by run: the one notion of "sooner".

use super::made::{Made, compared, run};
use mhsplat::lab::compare::{Clock, Options, Paired, report};
use mhsplat::lab::stats::{Interval, Spread, geometric_mean};
use mhsplat::lab::table::few;

fn options(reference: &str, thresholds: &[f64]) -> Options {
    Options {
        thresholds: thresholds.to_vec(),
        reference: Some(reference.into()),
        ..Options::default()
    }
}

fn pairs(made: &[Made], reference: &str) -> Vec<Paired> {
    let options = options(reference, &[20.0, 24.0]);
    compared(made, &options).unwrap().relative
}

fn fast(seed: u64) -> Made {
    run("fast", seed).named("fast")
}

fn slow(seed: u64) -> Made {
    run("slow", seed).slower(2.0).named("slow")
}

fn low(seed: u64) -> Made {
    run("low", seed).below(3.0).named("low")
}

fn one(v: f64) -> String {
    format!("{v:.1}")
}

#[test]
fn ratios_and_differences_are_of_each_seed() {
    let made = [0, 1, 2].map(|s| [fast(s), slow(s), low(s)]).concat();
    let found = pairs(&made, "fast");
    let [slower, lower] = [&found[0], &found[1]];
    // Seeds differ in speed by 2 %, their ratios in nothing.
    let mean = slower.mean.unwrap();
    assert_eq!((mean.samples, slower.mean_of), (3, 2));
    assert!((mean.min - 2.0).abs() < 1e-9 && (mean.max - 2.0).abs() < 1e-9);
    assert_eq!(few(&mean, one), "2.0 (2.0–2.0)");
    assert!((slower.worst.unwrap().1 - 2.0).abs() < 1e-9);
    assert_eq!((slower.no_later, slower.mean_of), (2, 2));
    assert!(slower.change["psnr"].median.abs() < 1e-9);
    assert!((lower.change["psnr"].min - 3.0).abs() < 1e-9);
    // What only one side reaches has no ratio and enters no mean, but is counted.
    assert_eq!((lower.counts.both, lower.counts.only_reference), (1, 1));
    assert_eq!((lower.to_psnr[1].spread, lower.mean_of), (None, 1));
    assert_eq!(lower.to_psnr[1].reached, [3, 0]);

    let turned = pairs(&made, "slow");
    assert_eq!((turned[0].no_later, turned[0].mean_of), (0, 2));
    assert!(
        turned[0].change["psnr"].median.abs() < 1e-9,
        "late, but as good"
    );
    let turned = pairs(&made, "low");
    assert!((turned[0].change["psnr"].max + 3.0).abs() < 1e-9);
    assert_eq!(turned[0].counts.only_group, 1, "never at 24 dB");
}

#[test]
fn of_two_seeds_that_disagree_neither_side_is_favoured() {
    let other = |seed: u64| run("other", seed).slower([0.6, 1.5][seed as usize]);
    let made = [0, 1].map(|s| [fast(s), other(s).named("other")]).concat();
    let of = |reference: &str| pairs(&made, reference).remove(0);
    let (one, two) = (of("fast"), of("other"));
    assert_eq!([one.no_later, two.no_later], [0, 2]);
    let ratio = |p: &Paired| p.to_psnr[0].spread.unwrap().median;
    assert!((ratio(&one) * ratio(&two) - 1.0).abs() < 1e-9);
    let middle = 0.9f64.sqrt();
    assert!((ratio(&one) - middle).abs() < 1e-2, "{}", ratio(&one));
}

#[test]
fn pairs_are_of_one_seed_and_say_so() {
    let of = |made: &[Made]| pairs(made, "fast").remove(0);
    let found = of(&[fast(0), fast(1), slow(1), slow(2)]);
    assert_eq!(
        (found.seeds.as_slice(), found.pairs_text()),
        (&[1][..], "1 seed".into())
    );
    let mean = found.mean.unwrap();
    assert_eq!(few(&mean, one), "2.0", "one pair has no range");
    // Repeats of one seed are pairs of their own, but one seed.
    let again = of(&[0, 0, 0].map(|s| [fast(s), slow(s)]).concat());
    assert_eq!(again.seeds, [0, 0, 0]);
    assert_eq!(again.pairs_text(), "3 pairs of 1 seed");
    // Without a common seed there is nothing to compare, and the caveat says so.
    let apart = [fast(0), fast(1), slow(2), slow(3), slow(4)];
    let c = compared(&apart, &options("fast", &[20.0])).unwrap();
    assert!(c.relative.is_empty());
    let caveat = "slow: seeds 2, 3, 4, but 0, 1 of fast; only those of both are compared";
    assert!(c.warnings.iter().any(|w| w == caveat), "{:?}", c.warnings);
}

#[test]
fn a_run_that_misses_is_counted_and_has_no_ratio() {
    let other = |s: u64| match s {
        2 => run("other", s).below(3.0).named("other"),
        _ => run("other", s).slower(0.5).named("other"),
    };
    let made = [0, 1, 2].map(|s| [fast(s), other(s)]).concat();
    let found = &pairs(&made, "fast")[0];
    let at = &found.to_psnr[1];
    assert_eq!((at.spread, at.reached), (None, [3, 2]));
    assert_eq!(at.ratios[2], None);
    assert!((at.ratios[0].unwrap() - 0.5).abs() < 1e-9);
    assert_eq!(found.counts.only_reference, 1);
    let c = compared(&made, &options("fast", &[20.0, 24.0])).unwrap();
    let text = report(&c).to_markdown();
    assert!(text.contains("| fast 3, other 2 of 3 |"), "{text}");
}

#[test]
fn a_time_that_is_not_known_has_no_ratio() {
    let at = |made: &[Made], psnr: f64| {
        let c = compared(made, &options("fast", &[psnr])).unwrap();
        let time = &c.relative[0].to_psnr[0];
        (time.ratios[0], time.reached)
    };
    // At 10 dB both are there at their first evaluations, at 40 dB neither ever is.
    assert_eq!(at(&[fast(0), slow(0)], 10.0), (None, [1, 1]));
    assert_eq!(at(&[fast(0), slow(0)], 40.0), (None, [0, 0]));
    // An unfinished run may still come.
    let cut = fast(0).rows(4).with(|r| r.iterations = 600);
    assert_eq!(at(&[cut, slow(0)], 24.0), (None, [0, 1]));
}

#[test]
fn times_are_by_the_clock_that_is_asked_for() {
    let by = |clock: Clock| {
        let options = Options {
            clock: Some(clock),
            ..options("fast", &[20.0])
        };
        let c = compared(&[fast(0), slow(0)], &options).unwrap();
        c.relative[0].mean.unwrap().median
    };
    assert!((by(Clock::Cpu) - 2.0).abs() < 1e-9);
    assert!((by(Clock::Iterations) - 1.0).abs() < 1e-9);
}

#[test]
fn intervals_are_of_the_scatter_within_strata() {
    let found = Interval::of_strata(&[&[1.0, 1.0, 4.0], &[5.0, 5.0, 8.0]]).unwrap();
    // Means 2 and 6, each with a variance of 1 of two degrees of freedom: four together.
    let half = 2.776 * 2f64.sqrt() / 2.0;
    for (value, wanted) in [
        (found.mean, 4.0),
        (found.low, 4.0 - half),
        (found.high, 4.0 + half),
    ] {
        assert!((value - wanted).abs() < 1e-9, "{value} instead of {wanted}");
    }
    assert_eq!(found.samples, 6);
    // Far apart, but each without scatter.
    let sure = Interval::of_strata(&[&[1.0; 3], &[9.0; 3]]).unwrap();
    assert!(sure.low == 5.0 && sure.high == 5.0);
    // One stratum has all the scatter: its two degrees of freedom are all there are.
    let one = Interval::of_strata(&[&[1.0, 1.0, 4.0], &[9.0; 3], &[9.0; 3]]).unwrap();
    assert!((one.high - one.mean - 4.303 / 3.0).abs() < 1e-9);
    let many = vec![0.0; 40];
    assert_eq!(Interval::of_strata(&[&many]).unwrap().samples, 40);
    for bad in [
        &[&[1.0, 2.0, 3.0][..], &[1.0, 2.0]][..],
        &[&[1.0, 2.0, f64::NAN]],
        &[],
    ] {
        assert_eq!(Interval::of_strata(bad), None, "{bad:?}");
    }
}

#[test]
fn means_of_ratios_are_geometric() {
    let spread = Spread::of_ratios(&[0.5, 8.0]).unwrap();
    assert!((spread.median - 2.0).abs() < 1e-12);
    assert!((geometric_mean(&[0.5, 8.0]).unwrap() - 2.0).abs() < 1e-12);
    for bad in [
        &[][..],
        &[1.0, 0.0],
        &[1.0, f64::NAN],
        &[1.0, f64::INFINITY],
    ] {
        assert_eq!(geometric_mean(bad), None, "{bad:?}");
    }
}
