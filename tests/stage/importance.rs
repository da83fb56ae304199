//! importance: error cues.

use super::*;

#[test]
fn agrees_with_the_reference() {
    agrees("importance");
}

#[test]
fn wrong_cues_are_rejected() {
    rejects("importance", "cues", |cues| {
        cues[2 * 60..].iter_mut().for_each(|v| *v += 1.0)
    });
}

#[test]
fn a_centre_outside_of_the_image_is_seen_by_no_view() {
    let mut case = cases::mild("outside", 3, [20, 20], 0, 35);
    case.splats.scatter(0, 0, [0.0, 0.0, 0.0]);
    case.splats.scatter(0, 1, [50.0, 0.0, 0.0]);
    case.splats.scatter(0, 2, [0.0, 0.0, -100.0]);
    let out = run(Tuning::CPU, &case);
    let cues = planes(&out, "importance", "cues", 3);
    assert_eq!(cues[2], [2.0, 0.0, 0.0], "the same view twice");
    assert!(cues[..2].iter().all(|sums| sums[1..] == [0.0; 2]));
}
