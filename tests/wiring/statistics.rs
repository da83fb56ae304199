//! Error statistics that a density step gets: those of the last renders before it, and of no other.

use mhsplat::Plan;
use mhsplat::config::ViewSubset;
use mhsplat::device::Device;
use mhsplat::train::{Trainer, TrainerState};

use super::definitions::{Definitions, Wrong};
use super::steps::{config, next, start, trainer, views};

/// True if gathered statistics \[3\]\[N\] are these sums, to 1e-4 of a view's error; numbers of views exactly.
fn same(state: &TrainerState, sums: &[Vec<f64>; 3]) -> bool {
    let close = |k: usize, bound: f64| {
        let pairs = state.rows.statistics[k].iter().zip(&sums[k]);
        pairs
            .into_iter()
            .all(|(g, w)| (f64::from(*g) - w).abs() <= bound)
    };
    let lengths = state.rows.statistics.iter().zip(sums);
    let whole = lengths.into_iter().all(|(g, w)| g.len() == w.len());
    state.rows.statistics.len() == 3 && whole && close(0, 1e-4) && close(1, 1e-4) && close(2, 0.0)
}

/// The windows before the first two density steps, after 3 and 6 iterations, hold the views asked for, as many as there are since
/// the last step: from the first of them to the last.
#[test]
fn error_statistics_are_of_the_last_renders_before_a_step() {
    let data = views();
    // Progress is 2/19 and 5/19: of 4 views 3 and 2 are left.
    for (view_subset, counts) in [
        (ViewSubset::Fixed(1), [1, 1]),
        (ViewSubset::Fixed(2), [2, 2]),
        (ViewSubset::All, [3, 3]),
        (ViewSubset::Shrinking, [3, 2]),
    ] {
        let mut config = config(false);
        config.mh.view_subset = view_subset;
        let first = start(&data);
        let mut defined = Definitions::new(&data, &config, &first, false, Wrong::default());
        let mut trainer = trainer(&data, &config);
        for count in counts {
            let mut state = next(&mut trainer);
            defined.iterate();
            for _ in 0..2 {
                state = next(&mut trainer);
                defined.iterate();
            }
            let all = &defined.errors;
            assert_eq!((all.len(), defined.window().len()), (3, count));
            for views in 1..=3 {
                let sums = Definitions::sums(&all[3 - views..]);
                let what = format!("{view_subset:?}: {views} of {count} views");
                assert_eq!(same(&state, &sums), views == count, "{what}");
            }
            // Nor are they those of the iterations before.
            let early = Definitions::sums(&all[..count]);
            assert_eq!(same(&state, &early), count == 3);
            next(&mut trainer);
            defined.density_step();
        }
    }
}

/// Sums start anew with the first view of a window, whatever was in them, and go on with every later one.
#[test]
fn error_statistics_start_with_the_first_view_of_a_window() {
    let data = views();
    let mut config = config(false);
    config.mh.view_subset = ViewSubset::Fixed(2);
    let mut straight = trainer(&data, &config);
    let states: Vec<_> = (0..3).map(|_| next(&mut straight)).collect();
    let (device, plan) = (
        Device::open(None).unwrap(),
        Plan::new(&data, &config).unwrap(),
    );
    // After iteration k, with 7 in every statistic, to the end of iteration 3.
    let resumed = |k: usize| {
        let mut dirty = states[k - 1].clone();
        for row in &mut dirty.rows.statistics {
            row.fill(7.0);
        }
        let mut trainer = Trainer::new(&device, &data, &plan, &dirty.splats).unwrap();
        trainer.restore(&dirty).unwrap();
        let mut state = dirty;
        while state.iteration < 3 {
            state = next(&mut trainer);
        }
        state.rows.statistics
    };
    let clean = &states[2].rows.statistics;
    assert!(clean[2].contains(&2.0));
    assert!(resumed(1) == *clean, "the window begins with the second");
    let added = resumed(2);
    let last = |k: usize, i: usize| clean[k][i] - states[1].rows.statistics[k][i];
    for (k, row) in added.iter().enumerate() {
        let expected = |i: usize| 7.0 + last(k, i);
        assert!((0..row.len()).all(|i| (row[i] - expected(i)).abs() < 1e-5));
    }
}
