//! First crossings and bands.

use mhsplat::lab::compare::curve::{Crossing, Curve, band};

fn at(at: f64) -> Option<Crossing> {
    Some(Crossing { at, at_most: false })
}

#[test]
fn crossings_are_interpolated() {
    let c = Curve::new([(10.0, 20.0), (20.0, 24.0), (40.0, 25.0)]);
    assert_eq!(c.first_reaches(21.0), at(12.5));
    assert_eq!(c.first_reaches(24.0), at(20.0));
    assert_eq!(c.first_reaches(24.5), at(30.0));
    assert_eq!(c.first_reaches(25.0), at(40.0));
    assert_eq!(
        c.first_reaches(25.000_001),
        None,
        "not reached is no number"
    );
    assert_eq!(c.first_reaches(f64::NAN), None);
    let first = Crossing {
        at: 10.0,
        at_most: true,
    };
    assert_eq!(c.first_reaches(20.0), Some(first));
    assert_eq!(c.first_reaches(5.0), Some(first));
    assert_eq!(Curve::default().first_reaches(5.0), None);
    assert_ne!(
        c.first_reaches(21.0),
        at(20.0),
        "the next evaluation is too late"
    );
    assert_ne!(
        c.first_reaches(21.0),
        at(10.0),
        "the one before is too early"
    );
}

#[test]
fn the_first_crossing_of_a_curve_that_falls_again_counts() {
    // Up to 24, down to 18, up to 26: 22 is crossed three times.
    let c = Curve::new([
        (0.0, 10.0),
        (10.0, 20.0),
        (20.0, 24.0),
        (30.0, 18.0),
        (40.0, 26.0),
    ]);
    assert_eq!(c.first_reaches(22.0), at(15.0));
    assert_ne!(c.first_reaches(22.0), at(35.0), "the last crossing");
    assert_eq!(c.first_reaches(25.0), at(38.75));
    // A peak that is lost in the end was reached all the same; one between two evaluations is not known of.
    let peak = Curve::new([(0.0, 10.0), (1.0, 30.0), (2.0, 20.0)]);
    assert_eq!(peak.first_reaches(25.0), at(0.75));
    assert_eq!(peak.first_reaches(30.5), None);
    assert_eq!(peak.last(), Some(20.0));
}

#[test]
fn plateaus_jumps_and_disorder() {
    let flat = Curve::new([(0.0, 1.0), (1.0, 2.0), (2.0, 2.0), (3.0, 3.0)]);
    assert_eq!(flat.first_reaches(2.0), at(1.0));
    let jump = Curve::new([(1.0, 1.0), (1.0, 2.0)]);
    assert_eq!(jump.first_reaches(1.5), at(1.0));
    let mixed = Curve::new([
        (2.0, 30.0),
        (f64::NAN, 40.0),
        (1.0, f64::INFINITY),
        (0.0, 10.0),
    ]);
    assert_eq!(mixed.points(), [(0.0, 10.0), (2.0, 30.0)]);
    assert_eq!(mixed.first_reaches(20.0), at(1.0));
}

#[test]
fn values_between_points_and_none_outside() {
    let c = Curve::new([(1.0, 10.0), (3.0, 20.0)]);
    assert_eq!(c.value(1.0), Some(10.0));
    assert_eq!(c.value(2.0), Some(15.0));
    assert_eq!(c.value(3.0), Some(20.0));
    assert_eq!(c.value(0.99), None);
    assert_eq!(c.value(3.01), None);
}

#[test]
fn a_band_is_the_median_and_range_where_all_curves_are() {
    let line =
        |from: f64, to: f64, height: f64| Curve::new([(from, from + height), (to, to + height)]);
    let all = band(&[
        line(0.0, 10.0, 0.0),
        line(1.0, 8.0, 5.0),
        line(0.0, 12.0, 1.0),
    ]);
    let (first, last) = (all[0], all[all.len() - 1]);
    assert_eq!((first.0, last.0), (1.0, 8.0));
    for (x, s) in &all {
        assert!((s.median - (x + 1.0)).abs() < 1e-12 && s.samples == 3);
        assert!((s.min - x).abs() < 1e-12 && (s.max - (x + 5.0)).abs() < 1e-12);
    }
    assert!(all.windows(2).all(|w| w[0].0 < w[1].0));
    assert!(
        band(&[line(0.0, 1.0, 0.0), line(2.0, 3.0, 0.0)]).is_empty(),
        "no common span"
    );
    assert!(band(&[line(0.0, 1.0, 0.0), Curve::default()]).is_empty());
    assert!(band(&[]).is_empty());
    let one = band(&[Curve::new([(0.0, 1.0), (1.0, 3.0), (5.0, 2.0)])]);
    assert_eq!(
        one.iter().map(|p| (p.0, p.1.median)).collect::<Vec<_>>(),
        [(0.0, 1.0), (1.0, 3.0), (5.0, 2.0)]
    );
}
