//! Datasets far from their origin or in extreme units: the local frame is that of the recentred scene.

use glam::DVec3;

use crate::base::rng::{Philox, Stream};
use crate::capture::Frame;
use crate::lab::verify::check::{FamilyNote, Row};

/// Name, axis and bound of the family.
pub const NOTE: FamilyNote = FamilyNote {
    name: "world frames",
    axis: "offset or unit",
    bound: 1e-6,
    reason: "f64 coordinates at 1e7 units resolve 2e-9 of them, and local ones are rounded to f32",
};
/// Cameras and points in a cube of edge 6.
fn scene() -> [Vec<DVec3>; 2] {
    let place = |k: u64, n: u64| -> Vec<DVec3> {
        (0..n)
            .map(|i| {
                let [x, y, z, _] = Philox::uniform(k, Stream::Synthetic.stream(3), i);
                6.0 * (DVec3::new(x, y, z) - 0.5)
            })
            .collect()
    };
    [place(1, 40), place(2, 1000)]
}

fn local(cameras: &[DVec3], points: &[DVec3]) -> Vec<f64> {
    let frame = Frame::fit(cameras, points);
    let all = cameras.iter().chain(points);
    all.flat_map(|p| frame.to_local(*p).as_vec3().to_array())
        .map(f64::from)
        .collect()
}

/// Rows of all offsets and units.
pub fn rows() -> Vec<Row> {
    let [cameras, points] = scene();
    let want = local(&cameras, &points);
    let largest = want.iter().fold(0.0f64, |l, w| l.max(w.abs()));
    let row = |case: &str, stiffness: f64, change: &dyn Fn(DVec3) -> DVec3| {
        let moved = |all: &[DVec3]| all.iter().map(|p| change(*p)).collect::<Vec<_>>();
        let got = local(&moved(&cameras), &moved(&points));
        let errors: Vec<f64> = got
            .iter()
            .zip(&want)
            .map(|(g, w)| (g - w).abs() / largest)
            .collect();
        let (of, names) = ([NOTE.name, "dataset"], [case, "local positions"]);
        Row::of_errors(of, names, stiffness, &errors, NOTE.bound)
    };
    let offset = |e: i32| {
        let by = 10f64.powi(e);
        let to = DVec3::new(by, -0.7 * by, 0.4 * by);
        row(&format!("offset {by:.0e}"), by, &|p| p + to)
    };
    let unit = |e: i32| {
        let by = 10f64.powi(e);
        row(&format!("unit {by:.0e}"), by, &|p| p * by)
    };
    let offsets = (3..=7).map(offset);
    offsets.chain((-6..=6).step_by(3).map(unit)).collect()
}
