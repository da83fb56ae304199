//! edit: rows written by density control.

use super::*;
use mhsplat::device::Array;
use mhsplat::pipeline::buffers::GaussianBuffers;
use mhsplat::pipeline::stage::edit::{gather_rows, limit_opacity, pack, reorder};
use mhsplat::scene::{Edit, OptionalColor, Plane};

#[test]
fn agrees_with_the_reference() {
    agrees("edit");
}

#[test]
fn a_wrong_row_is_rejected() {
    rejects("edit", "rows", |rows| {
        rows[60 * Plane::SH..][..60]
            .iter_mut()
            .for_each(|v| *v += 1.0)
    });
}

#[test]
fn a_wrong_colour_is_rejected() {
    let row = cases::mild("colours", 60, [40, 48], 2, 10).edits[3];
    assert!(row.color.get().is_some());
    rejects("edit", "rows", |rows| {
        rows[60 * Plane::SH + row.dst as usize] += 1.0;
    });
}

/// Planes of the parameters after the optimiser's steps.
fn stepped(out: &Outcome, sh_degree: u32) -> Vec<Vec<f64>> {
    planes(out, "adam", "parameters", Plane::count(sh_degree))
}

/// Planes of the parameters and of both moments after the edits.
fn edited(out: &Outcome, sh_degree: u32) -> [Vec<Vec<f64>>; 3] {
    let n = Plane::count(sh_degree);
    let all = planes(out, "edit", "rows", 3 * n);
    [0, 1, 2].map(|k| all[k * n..(k + 1) * n].to_vec())
}

#[test]
fn a_copy_takes_everything_but_what_is_replaced() {
    let mut case = cases::mild("copy", 6, [20, 20], 1, 36);
    let row = Edit {
        src: 2,
        dst: 4,
        position: [1.0, 2.0, 3.0],
        log_scale: [-1.0; 3],
        opacity_logit: 0.25,
        color: OptionalColor::NONE,
    };
    case.edits = vec![row];
    let out = run(Tuning::CPU, &case);
    let (before, after) = (stepped(&out, 1), edited(&out, 1));
    for p in 0..Plane::count(1) {
        let want = match p {
            0..3 => f64::from(row.position[p]),
            3..6 => -1.0,
            10 => 0.25,
            _ => before[p][2],
        };
        assert_eq!(after[0][p][4], want, "plane {p}");
        for i in [0, 1, 2, 3, 5] {
            assert_eq!(after[0][p][i], before[p][i], "plane {p}, row {i}");
        }
        assert_eq!([after[1][p][4], after[2][p][4]], [0.0; 2]);
    }
}

#[test]
fn a_coloured_row_has_its_own_colour_and_no_higher_bands() {
    let mut case = cases::mild("coloured", 6, [20, 20], 2, 36);
    case.edits = vec![Edit {
        src: 2,
        dst: 4,
        position: [1.0, 2.0, 3.0],
        log_scale: [-1.0; 3],
        opacity_logit: 0.25,
        color: OptionalColor::some([0.5, -0.25, 1.5]),
    }];
    let out = run(Tuning::CPU, &case);
    let (before, after) = (stepped(&out, 2), edited(&out, 2));
    let sh = after[0][Plane::SH..].iter().map(|plane| plane[4]);
    let mut want = vec![0.0; 27];
    want[..3].copy_from_slice(&[0.5, -0.25, 1.5]);
    assert_eq!(sh.collect::<Vec<f64>>(), want);
    for p in Plane::ROTATION..Plane::OPACITY {
        assert_eq!(after[0][p][4], before[p][2]);
    }
}

#[test]
fn rows_in_another_order_are_the_reference_s() {
    let device = device();
    let stage = kernels(&device).build::<f32>("edit").unwrap();
    let (planes, stride, order) = (3, 256, [4u32, 0, 2, 1, 3]);
    let values: Vec<f32> = (0..planes * stride).map(|v| v as f32).collect();
    let array = |name, v: &[f32]| Array::from_slice(&device, name, v).unwrap();
    let (from, to) = (array("from", &values), array("to", &vec![-1.0; 2 * stride]));
    let rows = Array::from_slice(&device, "order", &order).unwrap();
    gather_rows(&stage, (&rows, 5), [1, 2, stride], [&from, &to]).unwrap();
    let got = to.to_vec().unwrap();
    for (p, plane) in values[stride..].chunks(stride).enumerate() {
        let plane: Vec<f64> = plane.iter().map(|v| f64::from(*v)).collect();
        let want = reorder(&order, &plane);
        for (i, w) in want.iter().enumerate() {
            assert_eq!(f64::from(got[p * stride + i]), *w);
        }
        let beyond = &got[p * stride + 5..][..stride - 5];
        assert!(
            beyond.iter().all(|v| *v == 0.0),
            "rows that are gone are zero"
        );
    }
}

#[test]
fn a_snapshot_is_the_planes_side_by_side() {
    let device = device();
    let stage = kernels(&device).build::<f32>("edit").unwrap();
    let (stride, count, planes) = (256, 5, Plane::count(1));
    let values: Vec<f32> = (0..(planes + 2) * stride).map(|v| v as f32).collect();
    let (params, statistics) = values.split_at(planes * stride);
    let array = |name, v: &[f32]| Array::from_slice(&device, name, v).unwrap();
    let scene = GaussianBuffers {
        params: array("params", params),
        filter: Array::zeros(&device, "filter", 0).unwrap(),
        stride,
        count,
        sh_degree: 1,
        shard: None,
    };
    let packed = array("packed", &[-1.0; 100]);
    let statistics = array("statistics", statistics);
    pack(&stage, &scene, (&statistics, 2), &packed).unwrap();
    let got = packed.to_vec().unwrap();
    let first = (0..Plane::SH).chain(planes..planes + 2);
    let want = first.flat_map(|p| &values[p * stride..][..count]).copied();
    assert_eq!(got[..(Plane::SH + 2) * count], want.collect::<Vec<f32>>());
    assert_eq!(got[(Plane::SH + 2) * count..], [-1.0; 100 - 65]);
}

#[test]
fn an_opacity_reset_lowers_what_is_above_and_forgets_the_moments() {
    let device = device();
    let stage = kernels(&device).build::<f32>("edit").unwrap();
    let (planes, stride, count) = (Plane::count(0), 256, 5);
    let array = |name| Array::from_slice(&device, name, &vec![1.5f32; planes * stride]).unwrap();
    let scene = GaussianBuffers {
        params: array("params"),
        filter: Array::zeros(&device, "filter", 0).unwrap(),
        stride,
        count,
        sh_degree: 0,
        shard: None,
    };
    let moments = [&array("moment1"), &array("moment2")];
    scene
        .params
        .write(Plane::OPACITY * stride, &[-6.0, -4.0, 0.0, f32::NAN])
        .unwrap();
    limit_opacity(&stage, &scene, moments, -4.5).unwrap();
    let opacity = scene.params.read(Plane::OPACITY * stride, 6).unwrap();
    assert_eq!(opacity, [-6.0, -4.5, -4.5, -4.5, -4.5, 1.5]);
    for moment in moments {
        let values = moment.to_vec().unwrap();
        for (at, v) in values.iter().enumerate() {
            let reset = at / stride == Plane::OPACITY && at % stride < count;
            assert_eq!(*v, if reset { 0.0 } else { 1.5 }, "{at}");
        }
    }
}
