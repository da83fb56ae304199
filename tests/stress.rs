//! The stress suite: every family within its bound, none forgotten, and a bound that can be missed.

use crate::device;
use mhsplat::lab::verify::Verification;
use mhsplat::lab::verify::check::Row;
use mhsplat::lab::verify::page::report;
use mhsplat::lab::verify::stress::{FAMILIES, Family, beside_scenes, verify_family};

const SHAPES: [&str; 5] = [
    "needles",
    "pancakes",
    "end-on",
    "quaternion norm",
    "broken values",
];
const PLACES: [&str; 5] = ["scale variance", "depth", "near plane", "inside", "aside"];
const COUNTS: [&str; 6] = [
    "opacity",
    "alpha cut",
    "layers",
    "sizes",
    "crowds and ties",
    "constant images",
];

fn family(name: &str) -> Family {
    FAMILIES.into_iter().find(|f| f.name == name).unwrap()
}

fn assert_good(rows: &[Row]) {
    let failed: Vec<&Row> = rows.iter().filter(|r| !r.pass).collect();
    assert!(failed.is_empty(), "{failed:#?}");
    assert!(
        rows.iter()
            .all(|r| r.non_finite == 0 && r.stiffness.is_some())
    );
}

fn check(names: &[&str]) {
    let device = device();
    for name in names {
        let family = family(name);
        let rows = verify_family(&device, &family).unwrap();
        let precisions = if device.info().fp64 { 3 } else { 2 };
        assert_eq!(rows.len() % (precisions * family.stiffness.len()), 0);
        assert!(!rows.is_empty());
        assert_good(&rows);
    }
}

#[test]
fn shapes() {
    check(&SHAPES);
}

#[test]
fn places() {
    check(&PLACES);
}

#[test]
fn counts_and_values() {
    check(&COUNTS);
}

#[test]
fn beside_the_scenes() {
    let rows = beside_scenes(&device()).unwrap();
    assert_good(&rows);
    for family in ["optimiser", "crowds and ties"] {
        assert!(rows.iter().any(|r| r.family == family), "{family}");
    }
}

#[test]
fn no_family_is_forgotten() {
    let mut here: Vec<&str> = [&SHAPES[..], &PLACES, &COUNTS].concat();
    let mut there: Vec<&str> = FAMILIES.iter().map(|f| f.name).collect();
    here.sort_unstable();
    there.sort_unstable();
    assert_eq!(here, there);
}

#[test]
fn a_bound_can_be_missed_and_the_page_says_so() {
    let device = device();
    let mut narrow = family("sizes");
    narrow.bound = 1e-9;
    narrow.stiffness = &narrow.stiffness[..4];
    let cases = verify_family(&device, &narrow).unwrap();
    let failed = cases.iter().filter(|r| !r.pass).count();
    assert!(failed > 0, "f32 is not that exact");
    let double = cases.iter().filter(|r| r.quantity.ends_with("(f64)"));
    assert!(double.clone().count() > 0 || !device.info().fp64);
    assert!(double.into_iter().all(|r| r.pass));
    let v = Verification {
        device: "a device <1>".into(),
        tuning: device.tuning(),
        suite: "stress",
        passed: cases.len() - failed,
        failed,
        families: vec![narrow.note()],
        cases,
    };
    let page = report(std::slice::from_ref(&v)).to_html();
    assert!(page.contains("a device &lt;1&gt;") && page.contains("FAILED"));
    assert!(page.contains("<svg") && page.contains("Failed comparisons"));
    let other = Verification {
        device: "another".into(),
        ..v.clone()
    };
    let text = report(&[v, other]).to_markdown();
    assert!(text.contains("FAILED") && text.contains(&format!("{failed} failed")));
    assert!(
        text.contains("| family | a device <1> | another |"),
        "{text}"
    );
}

#[test]
fn a_device_that_computes_wrong_results_is_refused() {
    use mhsplat::Error;
    use mhsplat::lab::selftest::{judge, rows};
    let good = rows(&device()).unwrap();
    judge(&good).unwrap();
    let mut bad = good;
    let at = bad.iter().position(|r| r.stage == "splat").unwrap();
    bad[at].pass = false;
    bad[at].non_finite = 3;
    let error = judge(&bad).unwrap_err();
    assert!(matches!(error, Error::Device { .. }));
    let said = error.to_string();
    for part in ["splat", "3 not finite", "--device"] {
        assert!(said.contains(part), "{said}");
    }
}
