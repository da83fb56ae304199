//! project_grad: gradients of the raw parameters.

use super::*;
use mhsplat::base::constants::{LARGE_PAIRS, SUMS};
use mhsplat::base::rng::{Philox, Stream};
use mhsplat::device::tuning::status::{NON_FINITE, OVERFLOW, SLOTS};
use mhsplat::device::{Array, CameraArg};
use mhsplat::pipeline::buffers::{GaussianBuffers, ViewBuffers};
use mhsplat::pipeline::stage::adam::Step;
use mhsplat::pipeline::stage::project_grad::update;
use mhsplat::scene::Plane;

#[test]
fn agrees_with_the_reference() {
    agrees("project_grad");
}

#[test]
fn wrong_gradients_are_rejected() {
    for group in ["position", "log-scale", "rotation", "opacity", "SH"] {
        rejects("project_grad", group, |grads| {
            grads[..60].iter_mut().for_each(|g| *g *= -1.0)
        });
    }
}

/// Planes of the gradients.
fn gradients(out: &Outcome, n: usize) -> Vec<Vec<f64>> {
    let groups = out.quantities.iter().filter(|q| q.stage == "project_grad");
    groups
        .flat_map(|q| q.got.chunks(n).map(<[f64]>::to_vec))
        .collect()
}

#[test]
fn anti_aliasing_has_gradients_of_its_own() {
    let case = anti_aliased();
    let with = run(Tuning::CPU, &case);
    let plain = Case {
        filter_views: Vec::new(),
        ..case
    };
    let without = run(Tuning::CPU, &plain);
    assert_ne!(gradients(&with, 90), gradients(&without, 90));
}

/// Pancakes from 2 % of a turn off edge-on to edge-on exactly, thin ones down to the thinnest there are, with and without a 3D
/// filter worth the name: every gradient is a number.
#[test]
fn anti_aliasing_keeps_gradients_finite_edge_on() {
    for thin in [-6.0f32, -12.0, -30.0, -40.0] {
        let mut case = cases::mild("edge-on", 64, [40, 30], 0, 34).anti_aliased(1);
        case.camera.rotation = glam::DMat3::IDENTITY;
        for i in 0..64 {
            let s = &mut case.splats;
            let tilt = 1e-3 * (i / 2) as f32 / 32.0;
            s.scatter(Plane::POSITION, i, [0.0, 0.0, 0.0]);
            s.scatter(Plane::LOG_SCALE, i, [-1.0, thin, -1.0 - (i % 2) as f32]);
            s.scatter(Plane::ROTATION, i, [1.0, tilt, 0.0, 0.0]);
            s.scatter(Plane::OPACITY, i, [4.0]);
        }
        // Views so near that the filter is nothing, and those of the case.
        for views in [case.filter_views.clone(), vec![fine(&case)]] {
            case.filter_views = views;
            let out = run(Tuning::CPU, &case);
            let grads = gradients(&out, 64).concat();
            assert!(grads.iter().all(|g| g.is_finite()), "{thin}");
            let image = out.got("splat", "image");
            assert!(image.iter().all(|v| v.is_finite()), "{thin}");
        }
    }
}

/// The case's camera with a focal length of a million pixels.
fn fine(case: &Case) -> mhsplat::capture::Camera {
    mhsplat::capture::Camera {
        fx: 1e6,
        fy: 1e6,
        ..case.camera
    }
}

#[test]
fn culled_gaussians_have_the_regularisers_alone() {
    let mut case = cases::mild("behind", 4, [20, 20], 1, 33);
    case.splats.plane_mut(2).fill(-100.0);
    let out = run(Tuning::CPU, &case);
    for (p, plane) in gradients(&out, 4).iter().enumerate() {
        let regularised = p == Plane::OPACITY || (Plane::LOG_SCALE..Plane::ROTATION).contains(&p);
        assert!(
            plane
                .iter()
                .all(|g| if regularised { *g > 0.0 } else { *g == 0.0 }),
            "plane {p}"
        );
    }
}

/// By every vector and every run of them, whatever is left over.
fn widths() -> [Tuning; 4] {
    let narrow = Tuning {
        vector_width: 1,
        block_width: 1,
        ..Tuning::CPU
    };
    let eight = Tuning {
        vector_width: 8,
        ..Tuning::CPU
    };
    [Tuning::CPU, eight, narrow, Tuning::GPU]
}

/// Training never stores gradients: those of its steps are those that are read, to the bit.
#[test]
fn a_step_takes_the_gradients() {
    for case in scenes() {
        let n = case.splats.len();
        for tuning in widths() {
            let out = run(tuning, &case);
            let grads = gradients(&out, n);
            let moments = planes(&out, "adam", "first moments, one step", grads.len());
            for (p, (m, g)) in moments.iter().zip(&grads).enumerate() {
                let want = g.iter().map(|g| (1.0f32 - 0.9) * *g as f32);
                let same = want.zip(m).all(|(w, m)| f64::from(w) == *m);
                assert!(same, "{}: plane {p}", case.name);
            }
        }
    }
}

/// Moments before the steps.
const MOMENTS: [f32; 2] = [0.125, 0.25];

/// Parameters and the moments of the rows in use, and the status after a step of 70 Gaussians, the first of which have a pair with these
/// sums. What lies beyond them is no number.
fn step(sums: &[[f32; SUMS]], overflow: u32, tuning: Tuning) -> ([Vec<f32>; 3], Vec<u32>) {
    let counts: Vec<u32> = (0..70).map(|i| u32::from(i < sums.len())).collect();
    let (rows, status, _) = step_of(&counts, sums, overflow, tuning);
    (rows, status)
}

/// The same for these numbers of pairs, whose sums follow each other, and the sums afterwards.
fn step_of(
    counts: &[u32],
    sums: &[[f32; SUMS]],
    overflow: u32,
    tuning: Tuning,
) -> ([Vec<f32>; 3], Vec<u32>, Vec<f32>) {
    let (device, n) = (device(), counts.len());
    let case = cases::mild("steps", n, [40, 30], 1, 35);
    let scene = GaussianBuffers::<f32>::upload(&device, &case.splats, 0).unwrap();
    for plane in 0..scene.planes() {
        let beyond = vec![f32::NAN; scene.stride - n];
        scene
            .params
            .write(plane * scene.stride + n, &beyond)
            .unwrap();
    }
    let mut frame = ViewBuffers::new(&device, &tuning, true).unwrap();
    let starts = counts.iter().scan(0, |next, count| {
        let start = *next;
        *next += count;
        Some(start)
    });
    let starts: Vec<u32> = starts.collect();
    frame.camera = CameraArg::new(&case.camera);
    frame.isect_counts = Array::from_slice(&device, "counts", counts).unwrap();
    frame.isect_start = Array::from_slice(&device, "starts", &starts).unwrap();
    frame.sums = Array::from_slice(&device, "sums", &sums.concat()).unwrap();
    frame.status = Array::zeros(&device, "status", SLOTS).unwrap();
    frame.status.write(OVERFLOW as usize, &[overflow]).unwrap();
    let all = |v: f32| vec![v; scene.params.len()];
    let [m, v] = MOMENTS.map(|v| Array::from_slice(&device, "moment", &all(v)).unwrap());
    let step = Step {
        rate: case.rates,
        constants: [0.9, 0.999, 1e-15],
        t: 1,
    };
    let kernels = Kernels::new(&device, Defines::new(tuning));
    let stage = kernels.of_degree(1).taking_steps();
    let stage = stage.build::<f32>("project_grad").unwrap();
    update(&stage, &scene, &frame, [0.0; 2], [&m, &v], &step).unwrap();
    let rows = [&scene.params, &m, &v].map(|array| {
        let planes = 0..scene.planes();
        let of = |p| array.read(p * scene.stride, n).unwrap();
        planes.flat_map(of).collect::<Vec<f32>>()
    });
    let (status, sums) = (frame.status.to_vec(), frame.sums.to_vec().unwrap());
    // Gradients are computed block by block of the same sums.
    update(&stage, &scene, &frame, [0.0; 2], [&m, &v], &step).unwrap();
    let bits = |sums: &[f32]| sums.iter().map(|v| v.to_bits()).collect::<Vec<u32>>();
    assert_eq!(bits(&frame.sums.to_vec().unwrap()), bits(&sums));
    (rows, status.unwrap(), sums)
}

/// In the group style a group adds the sums of a Gaussian with many pairs in its first slot.
#[test]
fn sums_of_many_pairs_are_added_up() {
    let mut counts = vec![1; 70];
    (counts[3], counts[5], counts[6], counts[69]) = (1000, LARGE_PAIRS, LARGE_PAIRS + 1, 300);
    let pairs: u32 = counts.iter().sum();
    let value = |k: u64| 1e-3 * (0.1 + Philox::uniform(3, Stream::Synthetic.stream(0), k)[0]);
    let sums: Vec<[f32; SUMS]> = (0..u64::from(pairs))
        .map(|p| std::array::from_fn(|q| value(p * SUMS as u64 + q as u64) as f32))
        .collect();
    let mut rest = sums.as_slice();
    let of_each: Vec<&[[f32; SUMS]]> = counts
        .iter()
        .map(|count| rest.split_off(..*count as usize).unwrap())
        .collect();
    let total = |of: &&[[f32; SUMS]]| -> [f32; SUMS] {
        std::array::from_fn(|q| of.iter().map(|s| f64::from(s[q])).sum::<f64>() as f32)
    };
    let totals: Vec<[f32; SUMS]> = of_each.iter().map(total).collect();
    for tuning in widths() {
        let (rows, _, left) = step_of(&counts, &sums, 0, tuning);
        let ([_, wanted, _], _) = step(&totals, 0, tuning);
        let apart = |wanted: &[f32]| {
            let differ = |(a, b): (&f32, &f32)| (a - b).abs() > 1e-5 * b.abs();
            rows[1].iter().zip(wanted).filter(|p| differ(*p)).count()
        };
        assert_eq!(apart(&wanted), 0);
        // One pair in a thousand left out.
        let mut wrong = totals.clone();
        wrong[3] = total(&&of_each[3][1..]);
        let ([_, wrong, _], _) = step(&wrong, 0, tuning);
        assert!(apart(&wrong) > 0, "the comparator must be able to fail");
        let mut slots = left.as_slice();
        for (i, of) in of_each.iter().enumerate() {
            let slots = slots.split_off(..of.len() * SUMS).unwrap();
            if tuning.group_style && counts[i] > LARGE_PAIRS {
                let near = |(a, b): (&f32, &f32)| (a - b).abs() <= 1e-5 * b.abs();
                assert!(slots.iter().zip(&totals[i]).all(near), "{i}");
                assert!(slots[SUMS..].iter().all(|v| *v == 0.0), "{i}");
            } else {
                assert_eq!(slots, of.concat(), "{i}");
            }
        }
        let changed = step_of(&counts, &sums, 7, tuning).2;
        assert!(
            changed == sums.concat(),
            "after an overflow nothing changes"
        );
    }
}

#[test]
fn a_step_leaves_everything_alone_after_an_overflow() {
    let case = cases::mild("steps", 70, [40, 30], 1, 35);
    let before = case.splats.planes().concat();
    for tuning in widths() {
        let ([after, m, v], _) = step(&[[1e-3; SUMS]; 70], 12345, tuning);
        assert_eq!(after, before);
        assert!(m.iter().all(|m| *m == MOMENTS[0]) && v.iter().all(|v| *v == MOMENTS[1]));
        let ([after, m, v], status) = step(&[[1e-3; SUMS]; 70], 0, tuning);
        assert!(after.iter().zip(&before).filter(|(a, b)| a != b).count() > 70 * 15);
        assert!(m.iter().all(|m| *m != MOMENTS[0]) && v.iter().all(|v| *v != MOMENTS[1]));
        assert_eq!(status[NON_FINITE as usize], 0, "no row beyond counts");
    }
}

#[test]
fn a_step_with_sums_that_are_not_finite_keeps_numbers_and_says_so() {
    let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY].map(|v| [v; SUMS]);
    let case = cases::mild("steps", 70, [40, 30], 1, 35);
    let before = case.splats.planes().concat();
    for tuning in widths() {
        let ([after, m, v], status) = step(&bad, 0, tuning);
        assert!(status[NON_FINITE as usize] > 3, "{status:?}");
        assert!(
            [after.as_slice(), &m, &v]
                .concat()
                .iter()
                .all(|v| v.is_finite())
        );
        // The moments alone move them.
        assert!(after.iter().zip(&before).all(|(a, b)| (a - b).abs() < 0.1));
    }
}
