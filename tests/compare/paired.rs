//! Groups seed by seed.

use super::made::{Made, compared, run};
use mhsplat::lab::compare::{Bound, Options, Paired, Verdict, few, paired};

fn pairs(made: &[Made], reference: &str) -> Vec<Paired> {
    let options = Options {
        thresholds: vec![20.0, 24.0],
        reference: Some(reference.into()),
        ..Options::default()
    };
    paired(&compared(made, &options).unwrap())
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

#[test]
fn ratios_and_differences_are_of_each_seed() {
    let made = [0, 1, 2].map(|s| [fast(s), slow(s), low(s)]).concat();
    let found = pairs(&made, "fast");
    let [slower, lower] = [&found[0], &found[1]];
    // Seeds differ in speed by 2 %, their ratios in nothing.
    let mean = slower.mean.unwrap();
    assert_eq!(mean.samples, 3);
    assert!((mean.min - 2.0).abs() < 1e-9 && (mean.max - 2.0).abs() < 1e-9);
    assert_eq!(few(&mean, |v| format!("{v:.1}")), "2.0 (2.0–2.0)");
    assert!((slower.worst.unwrap().1.value - 2.0).abs() < 1e-9);
    assert_eq!(slower.no_later, Verdict { holds: 2, of: 2 });
    assert!(slower.psnr.unwrap().median.abs() < 1e-9 && slower.final_holds == Some(true));
    assert!((lower.psnr.unwrap().min - 3.0).abs() < 1e-9);
    assert_eq!((lower.counts.both, lower.counts.only_reference), (1, 1));
    assert_eq!(lower.to_psnr[1].bound, Bound::AtLeast);
    assert_eq!(lower.no_later.text(), "yes, 2 of 2");

    let turned = pairs(&made, "slow");
    assert_eq!(turned[0].no_later.text(), "no, 0 of 2");
    assert_eq!(turned[0].final_holds, Some(true), "late, but as good");
    let turned = pairs(&made, "low");
    assert_eq!(turned[0].no_later.all(), Some(false));
    assert_eq!(turned[0].final_holds, Some(false));
    let (_, worst) = turned[0].worst.unwrap();
    assert!(
        worst.value < 1.0 && worst.bound == Bound::AtMost,
        "{worst:?}"
    );
}

#[test]
fn of_two_seeds_that_disagree_neither_side_is_favoured() {
    let other = |seed: u64| run("other", seed).slower([0.6, 1.5][seed as usize]);
    let made = [0, 1].map(|s| [fast(s), other(s).named("other")]).concat();
    let of = |reference: &str| pairs(&made, reference).remove(0);
    let (one, two) = (of("fast"), of("other"));
    assert_eq!([one.no_later.holds, two.no_later.holds], [0, 0]);
    let ratio = |p: &Paired| p.to_psnr[0].spread.unwrap().median;
    assert!((ratio(&one) * ratio(&two) - 1.0).abs() < 1e-9);
    assert!(
        (ratio(&one) - 0.9f64.sqrt()).abs() < 1e-2,
        "{}",
        ratio(&one)
    );
}

#[test]
fn only_seeds_of_both_count() {
    let found = pairs(&[fast(0), fast(1), slow(1), slow(2)], "fast");
    assert_eq!(found[0].seeds, [1]);
    let mean = found[0].mean.unwrap();
    assert_eq!(
        few(&mean, |v| format!("{v:.1}")),
        "2.0",
        "one seed has no spread"
    );
    assert!(pairs(&[fast(0), slow(1)], "fast").is_empty());
}

#[test]
fn a_seed_that_misses_is_the_latest_of_all() {
    // Two of three seeds of `other` reach 24 dB sooner, one never does: the median is sooner still.
    let other = |s: u64| match s {
        2 => run("other", s).below(3.0).named("other"),
        _ => run("other", s).slower(0.5).named("other"),
    };
    let made = [0, 1, 2].map(|s| [fast(s), other(s)]).concat();
    let found = &pairs(&made, "fast")[0];
    let at = &found.to_psnr[1];
    assert_eq!(at.no_later, Some(false));
    assert_eq!((at.bound, found.counts.only_reference), (Bound::AtLeast, 1));
    assert_eq!(at.seeds[2].no_later, Some(true));
}

#[test]
fn the_end_may_be_so_much_lower_and_no_more() {
    let holds = |by: f64| {
        let made = [fast(0).below(by), run("b", 0).named("b")];
        pairs(&made, "fast")[0].final_holds
    };
    assert_eq!(holds(0.04), Some(true));
    assert_eq!(holds(0.06), Some(false));
}
