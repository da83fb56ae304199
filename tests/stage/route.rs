//! route: Gaussians to the bands that they touch, and the sums of their pairs back.

use std::sync::Arc;
use std::thread;

use super::*;
use mhsplat::base::constants::SUMS;
use mhsplat::device::tuning::KEY_CULLED;
use mhsplat::device::{Array, CameraArg, Projected, Real};
use mhsplat::lab::verify::definition::inputs;
use mhsplat::pipeline::buffers::{GaussianBuffers, Shard, ViewBuffers};
use mhsplat::pipeline::forward::RenderOptions;
use mhsplat::pipeline::pass::{Pipeline, Target};
use mhsplat::pipeline::photo_array::PhotoArray;
use mhsplat::pipeline::share::Share;
use mhsplat::pipeline::stage::loss::{Beside, photo_rows};
use mhsplat::pipeline::stage::project::{project, write_records};
use mhsplat::pipeline::stage::route::{Route, route};
use mhsplat::ranks::{Exchange, threads};
use mhsplat::scene::Gaussians;

/// Words of a key and a record.
fn words<R: Real>() -> usize {
    1 + size_of::<Projected<R>>() / 4
}

#[test]
fn bands_get_the_gaussians_that_touch_them_cut_to_their_rows() {
    let (device, case) = (device(), cases::mild("routed", 900, [90, 75], 1, 41));
    let (scene, camera, options) = inputs(&case);
    let projected: Vec<_> = (0..scene.len())
        .map(|i| project(&scene, i, &camera, &options))
        .collect();
    for tuning in TUNINGS {
        // 5 or 3 rows of tiles; the second rank has none of them.
        let end = 75_u32.div_ceil(tuning.tile);
        let bands = [0, end / 2, end / 2, end];
        let kernels = Kernels::new(&device, Defines::new(tuning)).of_degree(1);
        let stage = kernels.build::<f64>("project").unwrap();
        let buffers = GaussianBuffers::<f64>::upload(&device, &case.splats, 0).unwrap();
        let mut view = ViewBuffers::<f64>::new(&device, &tuning, false).unwrap();
        view.fit_gaussians(&device, buffers.stride).unwrap();
        (view.camera, view.count) = (CameraArg::new(&case.camera, tuning.tile), buffers.count);
        write_records(&stage, &buffers, &view, 0..view.count).unwrap();
        let records = view.records.read(0, view.count).unwrap();
        let keys = view.keys.read(0, view.count).unwrap();
        // The last rank's own; as the first rank takes them, the others have nothing for it.
        let mut stage = Route::<f64>::new(&kernels, [2, 3], 2).unwrap();
        let mut first = Route::<f64>::new(&kernels, [0, 3], 2).unwrap();
        stage.set_bands(&bands).unwrap();
        stage.divide(&device, view.count).unwrap();
        let halves = [0, 1].map(|part| stage.send(&device, &view, part).unwrap());
        assert!(!stage.rows(0).is_empty() && !stage.rows(1).is_empty());
        assert_eq!(stage.rows(0).end, stage.rows(1).start);
        let mut shared = 0;
        for rank in 0..3 {
            let want = route(
                &projected,
                tuning.tile as i32,
                [bands[rank], bands[rank + 1]],
            );
            shared += want.len();
            let parts = halves.each_ref().map(|half| half[rank].clone());
            let sent: usize = parts.iter().map(Vec::len).sum();
            let expected = |k: usize, rows: [i32; 2]| {
                let by = rows[0] as u32 | (rows[1] as u32) << 16;
                (Projected { by, ..records[k] }, keys[k])
            };
            if rank == 2 {
                assert_eq!(sent, 0, "they stay");
                // What it sent to the first comes back, as if of that and of the one in the middle: it stands behind, and comes first.
                let sent = &halves[0][0];
                let messages = vec![vec![sent.clone(), sent.clone(), Vec::new()]; 2];
                stage.receive(&device, messages, &mut view).unwrap();
                let n = sent.len() / words::<f64>();
                let end = 900 + 4 * n;
                assert!(n > 0 && view.count == end && view.early == (900..end));
                let got = [0, 1, 2].map(|from| stage.got(from));
                assert_eq!(got, [900..900 + 2 * n, 900 + 2 * n..end, 0..900]);
                let got = view.records.read(0, end).unwrap();
                let got_keys = view.keys.read(0, end).unwrap();
                assert_eq!(got[900..900 + n], got[end - n..]);
                let spans = view.isect_counts.read(0, 900).unwrap();
                let mut here = want.into_iter().peekable();
                for i in 0..900 {
                    match here.next_if(|(k, _)| *k == i) {
                        Some((_, rows)) => {
                            assert_eq!((got[i], got_keys[i]), expected(i, rows), "{i}");
                        }
                        None => {
                            assert_eq!(
                                (got_keys[i], spans[i]),
                                (KEY_CULLED, 0),
                                "{i} is elsewhere"
                            );
                        }
                    }
                }
                continue;
            }
            assert_eq!(sent, want.len() * words::<f64>(), "rank {rank}");
            let messages = parts.map(|part| vec![Vec::new(), Vec::new(), part]);
            let mut taken = ViewBuffers::<f64>::new(&device, &tuning, false).unwrap();
            first
                .receive(&device, messages.to_vec(), &mut taken)
                .unwrap();
            let got = [0, 1, 2].map(|from| first.got(from));
            assert_eq!(got, [0..0, 0..0, 0..want.len()]);
            let got = taken.records.read(0, want.len()).unwrap();
            let got_keys = taken.keys.read(0, want.len()).unwrap();
            for (k, (i, rows)) in want.into_iter().enumerate() {
                assert_eq!((got[k], got_keys[k]), expected(i, rows), "rank {rank}, {i}");
            }
        }
        assert!(shared > projected.iter().flatten().count() + 20, "{shared}");
    }
}

#[test]
fn records_of_no_gaussian_are_packed_so_that_warming_up_compiles_it() {
    // Its own: other tests have launches, too.
    let device = Device::open(None).unwrap();
    for tuning in TUNINGS {
        let kernels = Kernels::new(&device, Defines::new(tuning)).of_degree(1);
        let mut view = ViewBuffers::<f64>::new(&device, &tuning, false).unwrap();
        let mut stage = Route::<f64>::new(&kernels, [1, 3], 1).unwrap();
        stage.set_bands(&[0, 2, 2, 5]).unwrap();
        stage.divide(&device, 0).unwrap();
        let round = || {
            let sent = stage.send(&device, &view, 0)?;
            stage.receive(&device, vec![sent], &mut view)
        };
        device.timed(round).unwrap();
        let enqueued = device.enqueued();
        let packed = enqueued.iter().filter(|(name, _)| *name == "route_pack");
        assert_eq!(
            packed.count(),
            2,
            "for ranks before and after: {enqueued:?}"
        );
        assert_eq!(view.count, 0);
    }
}

/// A scene's rows from `first` to before `end`.
fn rows(splats: &Gaussians, first: usize, end: usize) -> Gaussians {
    let planes = splats.planes().iter().map(|p| p[first..end].to_vec());
    Gaussians::new(splats.sh_degree(), planes.collect()).unwrap()
}

/// A rank's end of the exchange, its first row and the one after its last, the bands of all, and the parts in which rows travel.
type Part = (Arc<dyn Exchange>, [usize; 2], Vec<u32>, usize);

/// Number of pairs of each Gaussian, and their sums, added up in their order.
type Sums = Vec<(usize, Vec<f32>)>;

/// Lets the other ranks of a test go on to their end when one panics.
struct Ended(Arc<dyn Exchange>);

impl Drop for Ended {
    fn drop(&mut self) {
        if thread::panicking() {
            self.0.fail("has panicked");
        }
    }
}

/// Sums of each Gaussian's pairs, the loss in the place of one more, and the image gradient, of a pass over some rows: of all, or as one of
/// some ranks.
fn pass(case: &Case, tuning: Tuning, part: Option<Part>) -> (Sums, Vec<f32>) {
    let device = device();
    let defines = Defines {
        alpha: case.photo.alpha,
        ..Defines::new(tuning)
    };
    let camera = CameraArg::<f32>::new(&case.camera, tuning.tile);
    let mut pipeline =
        Pipeline::<f32>::new(&device, defines, case.sh_degree, camera.image()).unwrap();
    let all = case.splats.len();
    let [first, end] = part.as_ref().map_or([0, all], |(_, rows, ..)| *rows);
    let own = rows(&case.splats, first, end);
    let mut scene = GaussianBuffers::<f32>::upload(&device, &own, 0).unwrap();
    pipeline.forward.fit(&scene, &camera).unwrap();
    let mut photo = PhotoArray::upload(&device, &case.photo).unwrap();
    let _ended = part.as_ref().map(|(exchange, ..)| Ended(exchange.clone()));
    if let Some((exchange, _, bands, parts)) = part {
        scene.shard = Some(Shard { first, all });
        let mut share = Share::in_parts(&device, defines, exchange, parts).unwrap();
        share.set_bands(bands);
        // Of the photo there is what the band needs.
        let (planes, [width, _]) = (case.photo.alpha.planes(), camera.image().pixels);
        let rows = photo_rows(&share.own_band(), camera.image());
        photo = photo.part(&device, [planes, width], &rows).unwrap();
        pipeline.share = Some(share);
    }
    let options = RenderOptions {
        sh_degree: case.sh_degree,
        background: case.background,
        ..RenderOptions::default()
    };
    if pipeline.share.is_none() {
        // Makes room for all pairs.
        pipeline.forward.render(&scene, &camera, &options).unwrap();
    }
    pipeline.enqueue(&scene, &camera, &photo, &options).unwrap();
    let pair = pipeline
        .pair(Target {
            view: 0,
            photo: &photo,
            background: case.background,
            skip_blank: true,
        })
        .unwrap();
    let losses = Array::<f32>::zeros(&device, "losses", 2).unwrap();
    let beside = Beside {
        losses: Some((&losses, 0)),
        errors: false,
    };
    let [lambda, ..] = case.lambdas;
    pipeline.loss_gradient(0, &pair, lambda, beside).unwrap();
    pipeline.splat_gradient().unwrap();
    let mut taken = 0;
    for part in 0..pipeline.parts() {
        let rows = pipeline.take_sums(part, scene.count).unwrap();
        if !rows.is_empty() {
            assert_eq!(rows.start, taken);
            taken = rows.end;
        }
    }
    assert_eq!(taken, scene.count);
    let frame = pipeline.frame();
    let starts = frame.isect_start.read(0, scene.count).unwrap();
    let counts = frame.isect_counts.read(0, scene.count).unwrap();
    let sums = frame.sums.to_vec().unwrap();
    let of = |(start, count): (u32, u32)| {
        let [from, n] = [start, count].map(|v| v as usize * SUMS);
        let mut total = vec![0.0f32; SUMS];
        for pair in sums[from..from + n].chunks(SUMS) {
            total.iter_mut().zip(pair).for_each(|(t, v)| *t += v);
        }
        (count as usize, total)
    };
    let mut all: Sums = starts.into_iter().zip(counts).map(of).collect();
    // Whoever is not the leader has none.
    all.push((0, losses.to_vec().unwrap()));
    (all, pipeline.image_gradient().to_vec().unwrap())
}

/// Bands that cut Gaussians, one of a row of tiles, and one of none.
#[test]
fn ranks_have_the_sums_of_one_that_has_all() {
    let mut case = cases::mild("shared", 400, [100, 170], 2, 43);
    // Some cover many tiles.
    for i in (0..400).step_by(37) {
        let wider = case.splats.gather::<3>(3, i).map(|v| v + 2.0);
        case.splats.scatter(3, i, wider);
    }
    // Some have the depths of others at other ranks: they are composited in the order of all rows.
    for i in (0..400).step_by(3) {
        let at = case.splats.gather::<3>(0, i);
        case.splats.scatter(0, (7 * i + 153) % 400, at);
    }
    for (tuning, case) in [
        (Tuning::CPU, case.clone()),
        (Tuning::GPU, case.clone()),
        (Tuning::CPU, case.clone().with_mask()),
        (Tuning::GPU, case.with_mask()),
    ] {
        let (want, gradient) = pass(&case, tuning, None);
        let pairs: usize = want.iter().map(|s| s.0).sum();
        assert!(pairs > 800, "{pairs}");
        let tile = tuning.tile as usize;
        let end = 170_u32.div_ceil(tuning.tile);
        let at = end / 2 - 1;
        let cuts = [vec![0, at + 1, end], vec![0, at, at, at + 1, end]];
        for (bands, parts) in cuts.iter().zip([1, 2]).chain(cuts.iter().zip([2, 1])) {
            let ranks = bands.len() - 1;
            let ends = [0, 150, 151, 400, 400];
            let shares = thread::scope(|scope| {
                let begin = |(rank, exchange): (usize, Arc<dyn Exchange>)| {
                    let end = if rank + 1 == ranks {
                        400
                    } else {
                        ends[rank + 1]
                    };
                    let part = Some((exchange, [ends[rank], end], bands.clone(), parts));
                    let case = &case;
                    scope.spawn(move || pass(case, tuning, part))
                };
                let begun: Vec<_> = threads(ranks).into_iter().enumerate().map(begin).collect();
                let ended = begun.into_iter().map(|thread| thread.join().unwrap());
                ended.collect::<Vec<_>>()
            });
            let losses = shares[0].0.last().unwrap();
            assert_eq!(losses, want.last().unwrap(), "the leader's loss");
            let mut got = Vec::new();
            for (rank, (mut sums, own)) in shares.into_iter().enumerate() {
                sums.pop();
                got.extend(sums);
                let rows = bands[rank] as usize * tile..bands[rank + 1] as usize * tile;
                let [stride, height] = [100, 170_usize].map(|side| side.next_multiple_of(tile));
                for c in 0..3 {
                    let at = (c * height + rows.start) * stride..(c * height + rows.end) * stride;
                    assert!(own[at.clone()] == gradient[at], "gradient of rank {rank}");
                }
            }
            for (i, (pairs, sums)) in got.iter().enumerate() {
                let (all, total) = &want[i];
                assert!(sums == total, "Gaussian {i}, {ranks} ranks, {tuning:?}");
                assert!(pairs <= all && (*pairs > 0) == (*all > 0));
            }
            let came: usize = got.iter().map(|s| s.0).sum();
            assert!(got.len() == 400 && came < pairs, "{came} of {pairs}");
        }
    }
}

/// A band of more pairs than there is room for is composited again once there is.
#[test]
fn a_rank_without_room_for_its_pairs_makes_some() {
    let mut case = cases::mild("crowded", 600, [64, 160], 0, 47);
    for i in 0..600 {
        let wider = case.splats.gather::<3>(3, i).map(|v| v + 3.0);
        case.splats.scatter(3, i, wider);
    }
    let pairs = |sums: &Sums| sums.iter().map(|s| s.0).sum::<usize>();
    let (want, _) = pass(&case, Tuning::CPU, None);
    // The first room, see `Renderer::fit`.
    assert!(pairs(&want) > 4096, "{}", pairs(&want));
    let exchange = threads(1).remove(0);
    let (got, _) = pass(
        &case,
        Tuning::CPU,
        Some((exchange, [0, 600], vec![0, 160 / Tuning::CPU.tile], 1)),
    );
    let totals = |sums: Sums| sums.into_iter().map(|s| s.1).collect::<Vec<_>>();
    assert!(totals(got) == totals(want));
}
