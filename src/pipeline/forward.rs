//! [`Renderer`]: the forward stages, in order.

use std::ops::Range;
use std::sync::Arc;

use crate::base::error::{Error, Result};
use crate::capture::Camera;
use crate::device::tuning::status;
use crate::device::{Array, CameraArg, Defines, Device, Kernels, Program, Real};
use crate::pipeline::buffers::{GaussianBuffers, ViewBuffers};
use crate::pipeline::stage::morton::{Morton, Order};
use crate::pipeline::stage::sort::{Keys, Sort};
use crate::pipeline::stage::{bin, project, scan, seen, splat};

/// Quantity that is composited.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Quantity {
    /// View-dependent colour.
    #[default]
    Color,
    /// Camera z, local units (opacity-weighted; divide by alpha for the mean depth).
    Depth,
}

/// Options of a render.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RenderOptions {
    /// SH degree in use (at most the scene's).
    pub sh_degree: u32,
    /// Background colour.
    pub background: [f32; 3],
    /// Quantity that is composited.
    pub quantity: Quantity,
    /// Only the active tiles of the photo ([`ViewBuffers::active_tiles`]); no effect unless photos have masks.
    pub active_only: bool,
}

/// A rendered image.
#[derive(Debug, Clone, PartialEq)]
pub struct Rendered {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Planar red, green, blue \[3, height, width\].
    pub rgb: Vec<f32>,
    /// Transmittance that is left \[height, width\].
    pub transmittance: Vec<f32>,
}

impl Rendered {
    /// Interleaved 8-bit RGB, clamped and rounded.
    #[must_use]
    pub fn rgb8(&self) -> Vec<u8> {
        let pixels = self.width * self.height;
        (0..pixels)
            .flat_map(|i| (0..3).map(move |c| to_byte(self.rgb[c * pixels + i])))
            .collect()
    }

    /// Mean depths of a render of [`Quantity::Depth`] in local units where at least half of the light comes from Gaussians, else 0.
    #[must_use]
    pub fn mean_depths(&self) -> Vec<f64> {
        let pixels = self.transmittance.iter().zip(&self.rgb);
        let mean = pixels.map(|(t, d)| match *d > 0.0 && d.is_finite() && *t <= 0.5 {
            true => f64::from(*d) / f64::from(1.0 - t),
            false => 0.0,
        });
        mean.collect()
    }
}

/// A value in [0, 1] as a byte.
#[must_use]
pub fn to_byte(v: f32) -> u8 {
    (v.clamp(0.0, 1.0) * 255.0).round() as u8
}

/// Gaussians that can be rendered, whichever devices have them.
pub trait Renders {
    /// Renders a view over a background and waits; the image is in [`Renders::renderer`] then.
    ///
    /// # Errors
    /// No room, or the driver's.
    fn render_view(&mut self, camera: &CameraArg<f32>, background: [f32; 3]) -> Result<()>;

    /// The renderer that has the image of the view rendered last.
    fn renderer(&self) -> &Renderer;
}

/// Gaussians on one device.
impl Renders for (&GaussianBuffers, &mut Renderer) {
    fn render_view(&mut self, camera: &CameraArg<f32>, background: [f32; 3]) -> Result<()> {
        let (scene, renderer) = self;
        let options = RenderOptions {
            sh_degree: scene.sh_degree,
            background,
            ..RenderOptions::default()
        };
        renderer.render(scene, camera, &options)
    }

    fn renderer(&self) -> &Renderer {
        self.1
    }
}

/// Runs the forward stages for one view at a time.
#[derive(Debug)]
pub struct Renderer<R: Real = f32> {
    device: Device,
    /// One build for every SH degree.
    project: Vec<Program>,
    scan: Program,
    bin: Program,
    sort: Sort,
    splat: Program,
    pub(crate) frame: ViewBuffers<R>,
}

impl<R: Real> Renderer<R> {
    /// Builds the kernels for SH degrees 0 to `sh_degree`; `gradients` also allocates what the backward stages need.
    pub fn new(device: &Device, defines: Defines, sh_degree: u32, gradients: bool) -> Result<Self> {
        let kernels = Kernels::new(device, defines);
        let project = (0..=sh_degree)
            .map(|d| kernels.of_degree(d).build::<R>("project"))
            .collect::<Result<_>>()?;
        Ok(Self {
            device: device.clone(),
            project,
            scan: kernels.build::<R>("scan")?,
            bin: kernels.build::<R>("bin")?,
            sort: Sort::new::<R>(&kernels)?,
            splat: kernels.build::<R>("splat")?,
            frame: ViewBuffers::new(device, &defines.tuning, gradients)?,
        })
    }

    /// The device.
    pub(crate) fn device(&self) -> &Device {
        &self.device
    }

    /// Choices that the kernels are compiled with.
    pub(crate) fn defines(&self) -> Defines {
        *self.splat.defines()
    }

    /// Makes the arrays large enough for a scene and a camera (pairs grow on demand).
    pub fn fit(&mut self, scene: &GaussianBuffers<R>, camera: &CameraArg<R>) -> Result<()> {
        self.frame.fit_gaussians(&self.device, scene.stride)?;
        self.frame
            .fit_intersections(&self.device, 0, 4 * scene.count.max(1024))?;
        self.frame.fit_image(&self.device, camera.image())
    }

    /// Enqueues the forward stages. Does not wait; an overflow of the pairs is told by the status array.
    ///
    /// # Errors
    /// Arrays that were not made to fit, or the driver's.
    pub fn enqueue(
        &mut self,
        scene: &GaussianBuffers<R>,
        camera: &CameraArg<R>,
        options: &RenderOptions,
    ) -> Result<()> {
        self.enqueue_intersections(scene, camera, options)?;
        match options.quantity {
            Quantity::Color => self.composite(options.background),
            Quantity::Depth => self.enqueue_depths(options.background),
        }
    }

    /// Enqueues the compositing of depths in the view enqueued last. Does not wait.
    ///
    /// # Errors
    /// The driver's.
    pub(crate) fn enqueue_depths(&mut self, background: [f32; 3]) -> Result<()> {
        // Of whatever degree: no colour is computed.
        project::depths_for_colors(&self.project[0], &self.frame)?;
        self.composite(background)
    }

    /// Enqueues the forward stages up to the sorted pairs.
    fn enqueue_intersections(
        &mut self,
        scene: &GaussianBuffers<R>,
        camera: &CameraArg<R>,
        options: &RenderOptions,
    ) -> Result<()> {
        let rows = 0..camera.image().tiles()[1];
        (self.frame.camera, self.frame.band) = (*camera, rows);
        (self.frame.count, self.frame.early) = (scene.count, 0..0);
        self.project_rows(scene, options, 0..scene.count)?;
        self.intersect_records(options.active_only)
    }

    /// The build of project for a scene.
    fn projection(&self, scene: &GaussianBuffers<R>, options: &RenderOptions) -> Result<&Program> {
        let degree = options.sh_degree.min(scene.sh_degree);
        let built = self.project.get(degree as usize);
        built.ok_or_else(|| {
            Error::device(
                "project",
                format!("not built for SH degree {degree}"),
                "make the renderer for this degree",
            )
        })
    }

    /// Enqueues the projection of some rows of a scene by the camera of the view.
    pub(crate) fn project_rows(
        &self,
        scene: &GaussianBuffers<R>,
        options: &RenderOptions,
        rows: Range<usize>,
    ) -> Result<()> {
        let stage = self.projection(scene, options)?;
        project::write_records(stage, scene, &self.frame, rows)
    }

    /// Enqueues the stages from the records to the sorted pairs.
    pub(crate) fn intersect_records(&mut self, active_only: bool) -> Result<()> {
        bin::sort_visible(&self.bin, &self.sort, &mut self.frame)?;
        self.intersect_tiles(active_only)
    }

    /// Enqueues the compositing of colours.
    pub(crate) fn composite(&self, background: [f32; 3]) -> Result<()> {
        splat::composite(&self.splat, &self.frame, background)
    }

    /// Sorts the rows of a scene, those of `removed` last; takes the arrays of a view for scratch. Does not wait.
    ///
    /// # Errors
    /// No room, or the driver's.
    pub fn sort_rows(
        &mut self,
        stage: &Morton,
        scene: &GaussianBuffers<R>,
        removed: &[u32],
        order: Order,
    ) -> Result<&Array<u32>> {
        self.frame.fit_gaussians(&self.device, scene.stride)?;
        let removed = Array::from_slice(&self.device, "removed", removed)?;
        stage.sort(&self.sort, scene, &removed, order, &mut self.frame)?;
        Ok(self.frame.visible.sorted_values())
    }

    /// Pairs the visible Gaussians with the tiles they touch, by tile and depth.
    fn intersect_tiles(&mut self, active_only: bool) -> Result<()> {
        let f = &mut self.frame;
        bin::count(&self.bin, f, active_only)?;
        if self.bin.defines().tuning.group_style {
            // bin_count has added up the chunks.
            scan::sum_counted(
                &self.scan,
                &f.totals(),
                f.count,
                [f.depth_counts(), f.depth_start()],
            )?;
            bin::emit(&self.bin, f, active_only)?;
            let keys = Keys::tiles(f.capacity, f.camera.image().tile_count());
            self.sort.run(&mut f.pairs, &keys, &f.status)?;
            return bin::find_tiles(&self.bin, f);
        }
        scan::sum_pairs(
            &self.scan,
            &f.totals(),
            f.count,
            [&f.isect_counts, &f.isect_start],
        )?;
        bin::count_tiles(&self.bin, f, active_only)?;
        let by_tile = [f.tile_chunks(), f.camera.image().tile_count()];
        self.sort
            .first_places(&f.tile_counts, by_tile, &f.tile_start)?;
        bin::emit(&self.bin, f, active_only)
    }

    /// Has the views from now on take these active tiles, of a photo at their size.
    pub fn take_tiles(&mut self, active: Arc<Array<u32>>) {
        self.frame.active_tiles = active;
    }

    /// Pairs of each tile of the view rendered last.
    #[doc(hidden)]
    pub fn intersections_per_tile(&self) -> Result<Vec<u32>> {
        let tiles = self.frame.camera.image().tile_count();
        let start = self.frame.tile_start.read(0, tiles + 1)?;
        Ok(start.windows(2).map(|w| w[1] - w[0]).collect())
    }

    /// Flags of the Gaussians that some cameras show, 1 or 0; waits. `stage` is a build of `kernels/seen.cl`.
    pub fn seen(
        &mut self,
        stage: &Program,
        scene: &GaussianBuffers<R>,
        cameras: &[CameraArg<R>],
    ) -> Result<Vec<u32>> {
        let seen = Array::zeros(&self.device, "seen", scene.count)?;
        let mut shown = Array::zeros(&self.device, "shown", 0)?;
        let options = RenderOptions {
            sh_degree: scene.sh_degree,
            ..RenderOptions::default()
        };
        for camera in cameras {
            self.intersect(scene, camera, &options)?;
            let capacity = self.frame.capacity;
            if shown.len() < capacity {
                shown = Array::zeros(&self.device, "shown", capacity)?;
            }
            seen::mark(stage, &self.frame, &shown, &seen)?;
        }
        seen.to_vec()
    }

    /// Flags of the Gaussians of the view rendered last that its band shows, or that are `known` of the first of them to have been shown before; waits.
    /// `stage` is a build of `kernels/seen.cl`.
    pub fn shown(&self, stage: &Program, known: &[bool]) -> Result<Vec<bool>> {
        if self.frame.count == 0 {
            // A kernel takes no empty array.
            return Ok(Vec::new());
        }
        let mut flags: Vec<u32> = known.iter().map(|known| u32::from(*known)).collect();
        flags.resize(self.frame.count, 0);
        let seen = Array::from_slice(&self.device, "seen", &flags)?;
        let shown = Array::zeros(&self.device, "shown", self.frame.capacity)?;
        seen::mark(stage, &self.frame, &shown, &seen)?;
        Ok(seen.to_vec()?.into_iter().map(|flag| flag != 0).collect())
    }

    /// Flags of the Gaussians from `first` on that intersect any tile of the view rendered last.
    pub fn intersected(&self, first: usize) -> Result<Vec<bool>> {
        let f = &self.frame;
        let counts = f.isect_counts.read(first, f.count - first)?;
        Ok(counts.into_iter().map(|n| n > 0).collect())
    }

    /// Makes room for the pairs that did not fit and clears the flag.
    pub(crate) fn grow_intersections(&mut self, needed: u32) -> Result<()> {
        let needed = needed as usize;
        if needed >= u32::MAX as usize {
            return Err(Error::device(
                "bin",
                "more than 2^32 - 1 (tile, Gaussian) pairs in one view",
                "lower --max-size or --max-gaussians",
            ));
        }
        self.device.finish()?;
        // First: where there is no room, what is enqueued after the error goes by its own needs.
        self.frame.status.write(status::OVERFLOW as usize, &[0])?;
        self.frame
            .fit_intersections(&self.device, needed, needed + needed / 2)
    }

    /// Renders a view and waits; grows the pair arrays as needed.
    pub fn render(
        &mut self,
        scene: &GaussianBuffers<R>,
        camera: &CameraArg<R>,
        options: &RenderOptions,
    ) -> Result<()> {
        self.fitting(scene, camera, usize::MAX, |r| {
            r.enqueue(scene, camera, options)
        })
    }

    /// Renders a view and reads the image back, but refuses one of more than `most` tile intersections if there is no room for
    /// them yet: whoever moves about may stand in the midst of Gaussians.
    ///
    /// # Errors
    /// See [`Renderer::render`]; too many tile intersections.
    pub fn image_within(
        &mut self,
        scene: &GaussianBuffers<R>,
        camera: &Camera,
        options: &RenderOptions,
        most: usize,
    ) -> Result<Rendered> {
        let camera = CameraArg::new(camera, self.frame.tile());
        self.fitting(scene, &camera, most, |r| r.enqueue(scene, &camera, options))?;
        self.read_image()
    }

    /// Runs the stages of [`Renderer::render`] up to the sorted tile intersections; nothing is splatted.
    pub(crate) fn intersect(
        &mut self,
        scene: &GaussianBuffers<R>,
        camera: &CameraArg<R>,
        options: &RenderOptions,
    ) -> Result<()> {
        self.fitting(scene, camera, usize::MAX, |r| {
            r.enqueue_intersections(scene, camera, options)
        })
    }

    /// Enqueues something and waits, until the pairs fit; refuses to make room for more than `most`.
    fn fitting(
        &mut self,
        scene: &GaussianBuffers<R>,
        camera: &CameraArg<R>,
        most: usize,
        enqueue: impl Fn(&mut Self) -> Result<()>,
    ) -> Result<()> {
        self.fit(scene, camera)?;
        loop {
            enqueue(self)?;
            let counters = self.frame.status.to_vec()?;
            match counters.get(status::OVERFLOW as usize) {
                Some(&needed) if needed as usize > most => {
                    self.frame.status.write(status::OVERFLOW as usize, &[0])?;
                    return Err(Error::device(
                        "view",
                        format!("{needed} tile intersections, of {most} that it may have"),
                        "step back, or ask for a smaller image",
                    ));
                }
                Some(&needed) if needed > 0 => self.grow_intersections(needed)?,
                _ => return Ok(()),
            }
        }
    }

    /// Renders a view and reads the image back.
    ///
    /// # Errors
    /// See [`Renderer::render`].
    pub fn image(
        &mut self,
        scene: &GaussianBuffers<R>,
        camera: &Camera,
        options: &RenderOptions,
    ) -> Result<Rendered> {
        self.render(scene, &CameraArg::new(camera, self.frame.tile()), options)?;
        self.read_image()
    }

    /// The image of the view rendered last, without its padding.
    pub fn read_image(&self) -> Result<Rendered> {
        let size = self.frame.camera.image();
        let plane = size.plane();
        let ([width, height], [stride, _]) = (size.pixels, size.padded());
        let padded = self.frame.image.read(0, 4 * plane)?;
        let cut = |c: usize| {
            (0..height).flat_map(move |y| {
                let row = c * plane + y * stride;
                row..row + width
            })
        };
        let take = |c: usize| {
            cut(c)
                .map(|i| padded[i].into() as f32)
                .collect::<Vec<f32>>()
        };
        Ok(Rendered {
            width,
            height,
            rgb: (0..3).flat_map(take).collect(),
            transmittance: take(3),
        })
    }
}
