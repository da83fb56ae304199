//! One pass of a case through every stage, in order, on one device and in one precision.
//!
//! A quantity is named here and nowhere else: with what the device computed, what the reference did, and the floor of its errors.

use std::ops::Range;

use crate::base::constants::{FILTER_CHUNKS, SUMS};
use crate::base::error::Result;
use crate::device::tuning::{KEY_CULLED, Tuning, status};
use crate::device::{Array, CameraArg, Defines, Device, Kernels, Real};
use crate::lab::verify::cases::{ADAM, Case};
use crate::lab::verify::definition::{
    EXPOSURE_RATE, EXPOSURES, NOISE, NOISE_KEYS, ProjectedRow, Reference, UP, VIEW, edited,
    largest_sum, lists, ordered, removed, seen_before,
};
use crate::lab::verify::optimise::optimise;
pub use crate::lab::verify::outcome::{Outcome, Quantity};
use crate::pipeline::buffers::{GaussianBuffers, GradientBlock, ViewBuffers};
use crate::pipeline::exposure::ExposureModel;
use crate::pipeline::forward::RenderOptions;
use crate::pipeline::pass::{Pipeline, Target};
use crate::pipeline::photo_array::PhotoArray;
use crate::pipeline::stage::adam::Step;
use crate::pipeline::stage::exposure::{apply, backward};
use crate::pipeline::stage::flip::Flip;
use crate::pipeline::stage::loss::{Beside, ImagePair};
use crate::pipeline::stage::morton::{Morton, Order};
use crate::pipeline::stage::photo_error::{PhotoErrors, photo_error};
use crate::pipeline::stage::{edit, filter, metrics, noise, project_grad, screen_grad, seen};
use crate::scene::Plane;

/// Runs every stage in precision `R` on a case, and its definition if there is a reference.
pub fn run<R: Real>(
    device: &Device,
    tuning: Tuning,
    case: &Case,
    reference: Option<&Reference>,
) -> Result<Outcome> {
    device.timed(|| {
        let mut pass = Pass::<R>::new(device, tuning, case, reference)?;
        pass.render()?;
        pass.forward()?;
        let error_sums = pass.loss()?;
        let grads = pass.gradients()?;
        let (scene, moments) = pass.optimiser(&grads)?;
        pass.noise()?;
        pass.screen_gradients()?;
        pass.seen()?;
        let got = pass.planes(&error_sums, 3)?;
        pass.add("importance", "cues", got, |r, out| {
            r.error_sums(out.got("loss", "error maps"))
        });
        pass.edit(&scene, &moments)?;
        pass.metrics()?;
        if pass.kernels.defines().anti_alias {
            let got = widen(pass.scene.filter.read(0, pass.scene.count)?);
            let want = |r: &Reference, _: &Outcome| r.scene.filter.clone().unwrap_or_default();
            pass.add("filter", "standard deviation", got, want);
        }
        pass.exposure()?;
        pass.photo_errors()?;
        pass.order()?;
        let times = device.take_times(usize::MAX)?.into_iter();
        pass.out.seconds = times.map(|(stage, t)| (stage, t.seconds)).collect();
        Ok(pass.out)
    })
}

/// Numbers in f64.
pub(super) fn widen<R: Real>(values: Vec<R>) -> Vec<f64> {
    values.into_iter().map(Into::into).collect()
}

/// A pass under way.
struct Pass<'a, R: Real> {
    device: &'a Device,
    kernels: Kernels,
    pipeline: Pipeline<R>,
    scene: GaussianBuffers<R>,
    photo: PhotoArray,
    camera: CameraArg<R>,
    case: &'a Case,
    reference: Option<&'a Reference>,
    out: Outcome,
}

impl<'a, R: Real> Pass<'a, R> {
    fn new(
        device: &'a Device,
        tuning: Tuning,
        case: &'a Case,
        reference: Option<&'a Reference>,
    ) -> Result<Self> {
        let defines = Defines {
            alpha_min: case.alpha_min,
            sh_degree: case.sh_degree,
            alpha: case.photo.alpha,
            anti_alias: !case.filter_views.is_empty(),
            ..Defines::new(tuning)
        };
        let mut scene = GaussianBuffers::<R>::upload(device, &case.splats, 0)?;
        if defines.anti_alias {
            scene = scene.with_filter(device)?;
        }
        let camera = CameraArg::<R>::new(&case.camera, tuning.tile);
        Ok(Self {
            pipeline: Pipeline::new(device, defines, case.sh_degree, camera.image())?,
            kernels: Kernels::new(device, defines),
            photo: PhotoArray::upload(device, &case.photo)?,
            device,
            scene,
            camera,
            case,
            reference,
            out: Outcome::default(),
        })
    }

    /// Value of the reference, which may begin with the device's numbers so far; the default without a reference.
    fn want<T: Default>(&self, of: impl FnOnce(&Reference, &Outcome) -> T) -> T {
        self.reference.map(|r| of(r, &self.out)).unwrap_or_default()
    }

    /// Adds a quantity and returns the floor of its errors, which is 0 until it is set.
    fn add(
        &mut self,
        stage: &'static str,
        name: &'static str,
        got: Vec<f64>,
        want: impl FnOnce(&Reference, &Outcome) -> Vec<f64>,
    ) -> &mut f64 {
        let (at, want) = (self.out.quantities.len(), self.want(want));
        self.out.quantities.push(Quantity {
            stage,
            name,
            got,
            want,
            floor: 0.0,
        });
        &mut self.out.quantities[at].floor
    }

    fn frame(&self) -> &ViewBuffers<R> {
        &self.pipeline.forward.frame
    }

    /// Planes of a padded image, without the padding.
    fn image(&self, image: &Array<R>, planes: Range<usize>) -> Result<Vec<f64>> {
        let padded = widen(image.to_vec()?);
        let [w, h] = self.camera.size.map(|s| s as usize);
        let [stride, rows] = self.camera.image().padded();
        let starts = planes.flat_map(|c| (0..h).map(move |y| (c * rows + y) * stride));
        let row = |from: usize| padded[from..from + w].iter().copied();
        Ok(starts.flat_map(row).collect())
    }

    /// The first planes of an array of the scene's stride, one after the other.
    fn planes(&self, array: &Array<R>, planes: usize) -> Result<Vec<f64>> {
        let plane = |p| Ok(widen(array.read(p * self.scene.stride, self.scene.count)?));
        Ok((0..planes).map(plane).collect::<Result<Vec<_>>>()?.concat())
    }

    fn copy(&self, array: &Array<R>) -> Result<Array<R>> {
        let copy = Array::zeros(self.device, array.name(), array.len())?;
        copy.copy_from(0, array, 0, array.len())?;
        Ok(copy)
    }

    /// The scene again, so that its parameters can be changed.
    fn copy_of_scene(&self) -> Result<GaussianBuffers<R>> {
        Ok(GaussianBuffers {
            params: self.copy(&self.scene.params)?,
            filter: self.copy(&self.scene.filter)?,
            ..self.scene
        })
    }

    /// Renders twice: the first pass may be repeated with more room for pairs; times are of one that is not.
    fn render(&mut self) -> Result<()> {
        let (device, forward) = (self.device, &mut self.pipeline.forward);
        if self.kernels.defines().anti_alias {
            let views = self.case.filter_views.iter();
            let camera = |c| CameraArg::<R>::new(c, self.camera.tile as u32);
            let cameras: Vec<_> = views.map(camera).collect();
            let cameras = Array::from_slice(device, "cameras", &cameras)?;
            let largest = Array::zeros(device, "largest", FILTER_CHUNKS as usize)?;
            let stage = self.kernels.build::<R>("filter")?;
            filter::compute(&stage, &self.scene, &forward.frame, &cameras, &largest)?;
        }
        let options = RenderOptions {
            sh_degree: self.case.sh_degree,
            background: self.case.background,
            ..RenderOptions::default()
        };
        forward.render(&self.scene, &self.camera, &options)?;
        device.forget_launches(0);
        forward.render(&self.scene, &self.camera, &options)
    }

    fn forward(&mut self) -> Result<()> {
        let projected = self.projected()?;
        for (name, numbers) in [
            ("mean", 0..2),
            ("quadratic form", 2..5),
            ("opacity, depth, colour", 5..10),
            ("pixel bounds", 10..14),
        ] {
            let part = |r: &ProjectedRow| r[numbers.clone()].to_vec();
            let got = projected.iter().flat_map(part).collect();
            let want = |r: &Reference, _: &Outcome| r.projected().iter().flat_map(part).collect();
            self.add("project", name, got, want);
        }
        let (tile, tiles) = (self.camera.tile, self.tiles()?);
        let count = |tiles: &[Vec<u32>]| tiles.iter().map(Vec::len).sum::<usize>() as f64;
        let pairs = |r: &Reference, _: &Outcome| vec![count(&r.tiles(tile))];
        let counts = self.frame().isect_counts.read(0, self.scene.count)?;
        let counted = counts.into_iter().map(f64::from).sum();
        self.add("scan", "pairs counted", vec![counted], pairs);
        self.add("bin", "pairs emitted", vec![count(&tiles)], pairs);
        let want = |r: &Reference, _: &Outcome| lists(&r.tiles(tile));
        self.add("sort", "tile lists", lists(&tiles), want);
        let got = self.image(&self.frame().image, 0..3)?;
        self.add("splat", "image", got, |r, _| r.pass.image.clone());
        let got = self.image(&self.frame().image, 3..4)?;
        self.add("splat", "transmittance", got, |r, _| {
            r.pass.transmittance.clone()
        });
        Ok(())
    }

    /// Projected Gaussians; zeros when culled.
    fn projected(&self) -> Result<Vec<ProjectedRow>> {
        let (frame, count) = (self.frame(), self.scene.count);
        let keys = frame.keys.read(0, count)?;
        let projected = frame.records.read(0, count)?;
        let bounds = |b: u32| [f64::from(b & 0xffff), f64::from(b >> 16)];
        let of = |(key, r): (&u32, &crate::device::Projected<R>)| {
            if *key == KEY_CULLED {
                return ProjectedRow::default();
            }
            let ([x0, x1], [y0, y1]) = (bounds(r.bx), bounds(r.by));
            let [red, green, blue] = r.rgb.map(Into::into);
            let [x, y, a, rho, c, lo, depth] =
                [r.x, r.y, r.a, r.r, r.c, r.lo, r.depth].map(Into::into);
            [x, y, a, rho, c, lo, depth, red, green, blue, x0, x1, y0, y1]
        };
        Ok(keys.iter().zip(&projected).map(of).collect())
    }

    /// Gaussians of each tile from front to back.
    fn tiles(&self) -> Result<Vec<Vec<u32>>> {
        let frame = self.frame();
        let pairs = frame.status.read(status::INTERSECTIONS as usize, 1)?[0] as usize;
        let order = frame.order().read(0, pairs)?;
        let owner = frame.isect_owner.read(0, pairs)?;
        let start = frame
            .tile_start
            .read(0, self.camera.image().tile_count() + 1)?;
        let tile = |w: &[u32]| {
            let slots = &order[w[0] as usize..w[1] as usize];
            slots.iter().map(|slot| owner[*slot as usize]).collect()
        };
        Ok(start.windows(2).map(tile).collect())
    }

    fn pair(&self) -> Result<ImagePair<'_, R>> {
        let target = Target {
            view: 0,
            photo: &self.photo,
            background: self.case.background,
            skip_blank: true,
        };
        self.pipeline.pair(target)
    }

    /// Loss, its gradient and the error maps; returns the error statistics of the Gaussians after the same view twice.
    fn loss(&mut self) -> Result<Array<R>> {
        self.pipeline.mark_tiles(&self.photo, &self.camera)?;
        let pipeline = &self.pipeline;
        let pair = self.pair()?;
        let losses = Array::zeros(self.device, "losses", 2)?;
        // What is blank is skipped in most iterations; where density control gathers errors there is everything at once.
        let [lambda, ..] = self.case.lambdas;
        let mut beside = Beside {
            losses: Some((&losses, 0)),
            errors: false,
        };
        pipeline.loss_gradient(0, &pair, lambda, beside)?;
        let gradient = self.image(pipeline.image_gradient(), 0..3)?;
        beside.errors = true;
        pipeline.loss_gradient(0, &pair, lambda, beside)?;
        let stage = self.kernels.build::<R>("importance")?;
        let sums = Array::zeros(self.device, "cues", 3 * self.scene.stride)?;
        for first_view in [true, false] {
            pipeline.add_errors(&stage, &self.scene, first_view, &sums)?;
        }
        let (maps, planes) = pipeline.error_maps()?;
        let set = |first| self.image(maps, first..first + 2);
        let mut errors = set(0)?;
        for first in (2..planes).step_by(2) {
            let more = set(first)?;
            errors.iter_mut().zip(more).for_each(|(sum, v)| *sum += v);
        }
        self.add("loss", "L1, SSIM", widen(losses.to_vec()?), |r, _| {
            vec![r.pass.loss.l1, r.pass.loss.ssim]
        });
        // Where render and photo agree it is nothing, of terms of this size: the sign of L1 over all values.
        let floor = 1.0 / gradient.len() as f64;
        let want = |r: &Reference, _: &Outcome| r.pass.loss.gradient.clone();
        *self.add("loss", "gradient", gradient, want) = floor;
        self.add("loss", "error maps", errors, |r, _| {
            let loss = &r.pass.loss;
            [loss.ssim_error.as_slice(), &loss.l1_error].concat()
        });
        Ok(sums)
    }

    /// Sums of the Gaussians and the gradients of their parameters, which are returned.
    fn gradients(&mut self) -> Result<Array<R>> {
        // Sums that are not written must not go unnoticed.
        let sums = &self.frame().sums;
        sums.write(0, &vec![R::of(f64::NAN); sums.len()])?;
        self.pipeline.splat_gradient()?;
        let got = self.sums()?;
        self.add("splat_grad", "sums", got, |r, _| r.sums());

        let values = Array::zeros(self.device, "grads", self.scene.params.len())?;
        let [_, opacity, scale] = self.case.lambdas;
        let (pipeline, block) = (&self.pipeline, self.block(&values, 0));
        let (backward, lambdas) = (&pipeline.backward, [opacity, scale]);
        let degree = self.case.sh_degree;
        backward.parameters(&pipeline.forward, &self.scene, degree, lambdas, &block)?;
        let (n, planes) = (self.scene.count, self.scene.planes());
        let all = self.planes(&values, planes)?;
        // A saturated opacity has no gradient; the regulariser's alone is up to λ_o/4N.
        let saturated = 0.25 * opacity / n.max(1) as f64;
        let turn = self.want(|r, _| r.turn_floor());
        for (name, of, floor) in [
            ("position", Plane::POSITION..Plane::LOG_SCALE, 0.0),
            ("log-scale", Plane::LOG_SCALE..Plane::ROTATION, 0.0),
            ("rotation", Plane::ROTATION..Plane::OPACITY, turn),
            ("opacity", Plane::OPACITY..Plane::SH, saturated),
            ("SH", Plane::SH..planes, 0.0),
        ] {
            let got = all[of.start * n..of.end * n].to_vec();
            let want = |r: &Reference, _: &Outcome| r.pass.grads.planes[of].concat();
            *self.add("project_grad", name, got, want) = floor;
        }
        Ok(values)
    }

    /// Nine sums of each Gaussian over its tile intersections \[N, 9\].
    fn sums(&self) -> Result<Vec<f64>> {
        let (frame, count) = (self.frame(), self.scene.count);
        let counts = frame.isect_counts.read(0, count)?;
        let starts = frame.isect_start.read(0, count)?;
        let all = widen(frame.sums.to_vec()?);
        let of = |(n, first): (&u32, &u32)| {
            let mut total = [0.0; SUMS];
            for p in 0..*n as usize {
                for (k, t) in total.iter_mut().enumerate() {
                    *t += all[(*first as usize + p) * SUMS + k];
                }
            }
            total
        };
        Ok(counts.iter().zip(&starts).flat_map(of).collect())
    }

    fn block<'b>(&self, values: &'b Array<R>, views: usize) -> GradientBlock<'b, R> {
        GradientBlock {
            values,
            planes: Plane::count(self.case.sh_degree),
            stride: self.scene.stride,
            first: 0,
            rows: 0..self.scene.count,
            views,
        }
    }

    /// Two steps with the same gradients; returns the copy of the scene that they changed, and its moments.
    fn optimiser(&mut self, grads: &Array<R>) -> Result<(GaussianBuffers<R>, [Array<R>; 2])> {
        let scene = self.copy_of_scene()?;
        let (block, steps) = (self.block(grads, 1), (self.case.rates, 2));
        let moments = optimise(&self.kernels, &scene, &block, steps, self.frame())?;
        let names = ["parameters", "first moments", "second moments"];
        self.add_steps(names, &scene, &moments, 2)?;
        self.out.non_finite = self.frame().status.read(status::NON_FINITE as usize, 1)?[0];
        self.step()?;
        Ok((scene, moments))
    }

    /// One step from the sums, as training takes it, of a copy of the scene.
    fn step(&mut self) -> Result<()> {
        let scene = self.copy_of_scene()?;
        let zeros = |name| Array::zeros(self.device, name, scene.params.len());
        let moments = [zeros("moment1")?, zeros("moment2")?];
        let [_, opacity, scale] = self.case.lambdas;
        let step = Step {
            rate: self.case.rates,
            constants: ADAM,
            t: 1,
        };
        let stage = self.kernels.taking_steps().build::<R>("project_grad")?;
        let (of, lambdas) = ((self.frame(), 0..scene.count), [opacity, scale]);
        project_grad::update(&stage, &scene, of, lambdas, moments.each_ref(), &step)?;
        let names = [
            "parameters, one step",
            "first moments, one step",
            "second moments, one step",
        ];
        self.add_steps(names, &scene, &moments, 1)
    }

    /// Adds parameters and moments after so many steps.
    fn add_steps(
        &mut self,
        names: [&'static str; 3],
        scene: &GaussianBuffers<R>,
        moments: &[Array<R>; 2],
        steps: u32,
    ) -> Result<()> {
        let want = self.want(|r, out| r.optimised(self.case, &out.gradients(), steps));
        let arrays = [&scene.params, &moments[0], &moments[1]];
        for ((name, array), want) in names.into_iter().zip(arrays).zip(want) {
            let got = self.planes(array, scene.planes())?;
            self.add("adam", name, got, |_, _| want.concat());
        }
        Ok(())
    }

    /// Displacements by the noise, on a copy of the scene.
    fn noise(&mut self) -> Result<()> {
        let moved = self.copy_of_scene()?;
        let stage = self.kernels.build::<R>("noise")?;
        noise::perturb(&stage, &moved, self.frame(), &NOISE, NOISE_KEYS)?;
        let before = self.planes(&self.scene.params, Plane::LOG_SCALE)?;
        let after = self.planes(&moved.params, Plane::LOG_SCALE)?;
        let got = after.iter().zip(&before).map(|(a, b)| a - b).collect();
        self.add("noise", "displacement", got, |r, _| r.displacements());
        Ok(())
    }

    fn screen_gradients(&mut self) -> Result<()> {
        let stage = self.kernels.build::<R>("screen_grad")?;
        let sums = Array::zeros(self.device, "cues", 2 * self.scene.stride)?;
        for _ in 0..2 {
            screen_grad::add_norms(&stage, &self.scene, self.frame(), &sums)?;
        }
        let mut norms = self.planes(&sums, 2)?;
        let iterations = norms.split_off(self.scene.count);
        let want = self.want(|r, out| {
            r.screen_gradients(out.got("splat_grad", "sums"), out.got("sort", "tile lists"))
        });
        let [norms_want, iterations_want] = want;
        self.add("screen_grad", "norms", norms, |_, _| norms_want);
        self.add("screen_grad", "iterations", iterations, |_, _| {
            iterations_want
        });
        Ok(())
    }

    /// Flags of the Gaussians that the view shows, if some were seen before.
    fn seen(&mut self) -> Result<()> {
        let frame = self.frame();
        let before: Vec<u32> = seen_before(self.scene.count).collect();
        let seen = Array::from_slice(self.device, "seen", &before)?;
        let shown = Array::zeros(self.device, "shown", frame.capacity)?;
        let stage = self.kernels.build::<R>("seen")?;
        seen::mark(&stage, frame, &shown, &seen)?;
        let got = seen.to_vec()?.into_iter().map(f64::from).collect();
        self.add("seen", "Gaussians", got, |r, _| r.seen());
        Ok(())
    }

    /// Edits of the rows after the optimiser's steps.
    fn edit(&mut self, scene: &GaussianBuffers<R>, [m, v]: &[Array<R>; 2]) -> Result<()> {
        let edits = Array::from_slice(self.device, "edits", &self.case.edits)?;
        let stage = self.kernels.build::<R>("edit")?;
        edit::write_rows(&stage, scene, [m, v], &edits)?;
        let planes = |a: &Array<R>| self.planes(a, scene.planes());
        let got = [planes(&scene.params)?, planes(m)?, planes(v)?].concat();
        let case = self.case;
        self.add("edit", "rows", got, |r, out| {
            edited(case, r.optimised(case, &out.gradients(), 2))
        });
        Ok(())
    }

    /// Rows in Morton order without some that are removed; takes arrays of the view for scratch.
    fn order(&mut self) -> Result<()> {
        let stage = Morton::new::<R>(&self.kernels)?;
        let removed: Vec<u32> = removed(self.scene.count).collect();
        let (forward, scene) = (&mut self.pipeline.forward, &self.scene);
        let rows = forward.sort_rows(&stage, scene, &removed, Order::Morton { up: UP })?;
        let rows = rows.read(0, scene.count - removed.len())?;
        let got = rows.into_iter().map(f64::from).collect();
        let splats = &self.case.splats;
        self.add("morton", "order", got, |_, _| ordered(splats, &removed));
        Ok(())
    }

    /// Scores of the render; 1 − SSIM is the sum of the device's own error map.
    fn metrics(&mut self) -> Result<()> {
        let stage = self.kernels.build::<R>("metrics")?;
        // The stage clamps the render in place.
        let image = self.copy(&self.frame().image)?;
        let pair = ImagePair {
            image: &image,
            ..self.pair()?
        };
        let [w, h] = pair.size.pixels;
        let rows = Array::zeros(self.device, "score", 3 * h)?;
        let maps = self.pipeline.error_maps()?;
        metrics::sum_dissimilarity(&stage, &pair, maps, &rows)?;
        metrics::score(&stage, &pair, &rows)?;
        let flips = widen(Flip::new(&self.kernels, pair.size)?.rows(&pair)?);
        let sum = |k: usize| Ok(vec![widen(rows.read(k * h, h)?).iter().sum::<f64>()]);
        self.add("metrics", "squared error", sum(0)?, |r, _| {
            let mask = r.mask.as_deref();
            vec![metrics::squared_error(&r.pass.image, &r.photo, mask)]
        });
        let floor = self.add("metrics", "1 - SSIM", sum(2)?, |r, out| {
            let map = &out.got("loss", "error maps")[..r.camera.pixels()];
            vec![metrics::sum_counted(map, r.mask.as_deref())]
        });
        // It is nothing but rounding where pictures agree.
        *floor = 1e-3 * (w * h) as f64;
        let want = |r: &Reference, out: &Outcome| r.flip(out.got("splat", "image"));
        // Errors are judged beside the largest possible.
        *self.add("flip", "errors of the rows", flips, want) = w as f64;
        Ok(())
    }

    /// Errors of the pixels of the render, under the transform of the case's view.
    fn photo_errors(&mut self) -> Result<()> {
        let stage = PhotoErrors::<R>::new(&self.kernels)?;
        let transforms: Vec<R> = EXPOSURES.as_flattened().iter().map(|v| R::of(*v)).collect();
        let transforms = Array::from_slice(self.device, "exposures", &transforms)?;
        // The stage writes to the render.
        let image = self.copy(&self.frame().image)?;
        let pair = ImagePair {
            image: &image,
            ..self.pair()?
        };
        stage.write(&pair, Some((&transforms, VIEW)))?;
        let plane = PhotoErrors::<R>::PLANE;
        let got = self.image(&image, plane..plane + 1)?;
        let alpha = self.case.photo.alpha;
        self.add("photo_error", "errors", got, |r, out| {
            let (image, opacity) = (out.got("splat", "image"), (alpha, &r.opacity[..]));
            photo_error(image, &EXPOSURES[VIEW], &r.photo, opacity)
        });
        Ok(())
    }

    /// Exposure of the render and of the loss gradient, as the stages before gave them.
    fn exposure(&mut self) -> Result<()> {
        let (frame, plane) = (self.frame(), self.camera.image().plane());
        let model = ExposureModel::<R>::new(&self.kernels, EXPOSURES.len(), plane, 0)?;
        let start: Vec<R> = EXPOSURES.as_flattened().iter().map(|v| R::of(*v)).collect();
        let zeros = vec![R::of(0.0); start.len()];
        model.restore(&[start, zeros.clone(), zeros])?;
        let gradient = self.copy(self.pipeline.image_gradient())?;
        model.stage.apply(frame, VIEW)?;
        model.stage.backward(frame, VIEW, &gradient)?;
        for iteration in 0..2 {
            let step = Step {
                rate: EXPOSURE_RATE,
                constants: ADAM,
                t: iteration,
            };
            model.step(VIEW, step, &frame.status)?;
        }
        let exposed = self.image(&model.stage.corrected, 0..3)?;
        self.add("exposure", "image", exposed, |_, out| {
            apply(out.got("splat", "image"), &EXPOSURES[VIEW])
        });
        let (by_render, by_transform, floor) = self.want(|_, out| {
            let (image, dimage) = (out.got("splat", "image"), out.got("loss", "gradient"));
            let (by_render, by_transform) = backward(image, &EXPOSURES[VIEW], dimage);
            let floor = largest_sum(image, dimage);
            (by_render, by_transform.to_vec(), floor)
        });
        let got = self.image(&gradient, 0..3)?;
        let name = "gradient with respect to the render";
        self.add("exposure", name, got, |_, _| by_render);
        let (got, name) = (
            widen(model.gradient()?),
            "gradient with respect to the transform",
        );
        let steps = self.want(|r, _| r.transforms(&got));
        *self.add("exposure", name, got, |_, _| by_transform) = floor;
        let names = ["transforms", "first moments", "second moments"];
        for ((name, got), want) in names.into_iter().zip(model.rows()?).zip(steps) {
            self.add("exposure", name, widen(got), |_, _| want);
        }
        Ok(())
    }
}
