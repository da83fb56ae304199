//! project_grad: gradients of the raw parameters.

use std::ops::Range;

use super::*;
use mhsplat::base::constants::{LARGE_PAIRS, SUMS};
use mhsplat::base::rng::{Philox, Stream};
use mhsplat::device::tuning::status::{NON_FINITE, OVERFLOW, SLOTS};
use mhsplat::device::{Array, CameraArg, Real};
use mhsplat::lab::error::{Tolerance, compare};
use mhsplat::lab::verify::cases::ADAM;
use mhsplat::pipeline::buffers::{GaussianBuffers, GradientBlock, ViewBuffers};
use mhsplat::pipeline::forward::RenderOptions;
use mhsplat::pipeline::pass::{Pipeline, Target};
use mhsplat::pipeline::photo_array::PhotoArray;
use mhsplat::pipeline::stage::adam::{self, Step};
use mhsplat::pipeline::stage::loss::Beside;
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

/// Errors of a precision.
const BOUNDS: [f64; 2] = [EXACT, 1e-5];

/// First moments after a step with the gradients of some views of one scene, as a batch of so many, over 1 − β₁: their mean. The
/// views come one after the other; after the last of them one that overflows changes nothing.
fn mean_of<R: Real>(tuning: Tuning, cases: &[Case]) -> Vec<f64> {
    let (device, case) = (device(), &cases[0]);
    let defines = Defines {
        sh_degree: case.sh_degree,
        ..Defines::new(tuning)
    };
    let scene = GaussianBuffers::<R>::upload(&device, &case.splats, 0).unwrap();
    let size = CameraArg::<R>::new(&case.camera, tuning.tile).image();
    let mut pipeline = Pipeline::<R>::new(&device, defines, case.sh_degree, size).unwrap();
    let zeros = |name| Array::<R>::zeros(&device, name, scene.params.len()).unwrap();
    let (values, m, v) = (zeros("grads"), zeros("m"), zeros("v"));
    // Rows come in parts where they come over a network.
    let parts = [0..32, 32..scene.count];
    let block = |views: usize, rows: &Range<usize>| GradientBlock {
        values: &values,
        planes: scene.planes(),
        stride: scene.stride,
        first: 0,
        rows: rows.clone(),
        views,
    };
    let [lambda, opacity, scale] = case.lambdas;
    for (k, case) in cases.iter().enumerate() {
        let options = RenderOptions {
            sh_degree: case.sh_degree,
            background: case.background,
            ..RenderOptions::default()
        };
        let camera = CameraArg::new(&case.camera, tuning.tile);
        pipeline.forward.render(&scene, &camera, &options).unwrap();
        let photo = PhotoArray::upload(&device, &case.photo).unwrap();
        let target = Target {
            view: 0,
            photo: &photo,
            background: case.background,
            skip_blank: true,
        };
        let pair = pipeline.pair(target).unwrap();
        pipeline
            .loss_gradient(0, &pair, lambda, Beside::NOTHING)
            .unwrap();
        pipeline.splat_gradient().unwrap();
        let of = |views| {
            let (backward, forward) = (&pipeline.backward, &pipeline.forward);
            let lambdas = [opacity, scale];
            let of = |rows: &Range<usize>| {
                let block = block(views, rows);
                backward.parameters(forward, &scene, case.sh_degree, lambdas, &block)
            };
            parts.iter().try_for_each(of)
        };
        of(k).unwrap();
        let status = &pipeline.frame().status;
        status.write(OVERFLOW as usize, &[1]).unwrap();
        of(0).and_then(|()| of(1)).unwrap();
        status.write(OVERFLOW as usize, &[0]).unwrap();
    }
    let step = Step {
        rate: case.rates,
        constants: ADAM,
        t: 1,
    };
    let adam = Kernels::new(&device, defines).build::<R>("adam").unwrap();
    let frame = pipeline.frame();
    for rows in &parts {
        let grads = block(cases.len(), rows);
        adam::update(&adam, &scene, [&m, &v], &grads, &step, frame).unwrap();
    }
    let plane = |p: usize| m.read(p * scene.stride, scene.count).unwrap();
    let moments = (0..scene.planes()).flat_map(plane);
    moments.map(|m| m.into() / (1.0 - ADAM[0])).collect()
}

/// The gradient of a batch is the mean of those of its views by the definitions, the regularisers counted once.
#[test]
fn a_batch_has_the_mean_gradient_of_its_views() {
    let first = cases::mild("first view", 90, [60, 44], 2, 36);
    let mut second = cases::mild("second view", 90, [60, 44], 2, 37);
    second.splats = first.splats.clone();
    second.camera.translation += glam::DVec3::new(-0.4, 0.2, 0.3);
    let cases = [first, second];
    let of_each = cases.each_ref().map(|case| {
        let planes = Reference::new(case).pass.grads.planes;
        planes.into_iter().flatten().collect::<Vec<f64>>()
    });
    let [a, b] = &of_each;
    let mean: Vec<f64> = a.iter().zip(b).map(|(a, b)| 0.5 * (a + b)).collect();
    let sum: Vec<f64> = mean.iter().map(|g| 2.0 * g).collect();
    for tuning in widths() {
        let got = [
            mean_of::<f64>(tuning, &cases),
            mean_of::<f32>(tuning, &cases),
        ];
        for (got, bound) in got.iter().zip(BOUNDS) {
            let against = |want: &[f64]| compare(got, want, Tolerance::all(bound));
            assert!(against(&mean).is_ok(), "{:?}", against(&mean));
            for wrong in [a, b, &sum] {
                assert!(against(wrong).is_err(), "the comparator must fail");
            }
        }
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
    frame.camera = CameraArg::new(&case.camera, tuning.tile);
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
    let take = |rows: Range<usize>| {
        let of = (&frame, rows);
        update(&stage, &scene, of, [0.0; 2], [&m, &v], &step).unwrap();
    };
    // In two parts, as where sums come over a network.
    let half = tuning.update_run().min(n);
    take(0..half);
    take(half..n);
    let rows = [&scene.params, &m, &v].map(|array| {
        let planes = 0..scene.planes();
        let of = |p| array.read(p * scene.stride, n).unwrap();
        planes.flat_map(of).collect::<Vec<f32>>()
    });
    let (status, sums) = (frame.status.to_vec(), frame.sums.to_vec().unwrap());
    // Gradients are computed block by block of the same sums.
    take(0..n);
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
