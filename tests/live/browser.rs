//! The page in headless Chromium, where there is one.

use mhsplat::Device;
use mhsplat::Result;
use mhsplat::capture::Camera;
use mhsplat::capture::photo::Photo;
use mhsplat::device::Defines;
use mhsplat::pipeline::buffers::GaussianBuffers;
use mhsplat::pipeline::forward::{Quantity, RenderOptions, Rendered, Renderer};
use mhsplat::run::live::Scenery;

use super::server::{page, serve};
use crate::viewer::browser::{alike, browser, rendered, visit};
use crate::viewer::pages::{scene, views};

/// PSNR that the page's picture has against the kernels' at least, dB: what JPEG costs.
const ALIKE: f64 = 30.0;

/// A scene on the device.
struct Drawn(GaussianBuffers, Renderer);

impl Scenery for Drawn {
    fn render(&mut self, camera: &Camera, quantity: Quantity) -> Result<Rendered> {
        let options = RenderOptions {
            sh_degree: self.0.sh_degree,
            background: self.background(),
            quantity,
            active_only: false,
        };
        self.1.image(&self.0, camera, &options)
    }

    fn photo(&mut self, _: usize) -> Result<Option<(Camera, Photo)>> {
        Ok(None)
    }

    fn background(&self) -> [f32; 3] {
        [0.25, 0.5, 0.75]
    }

    fn reach(&self) -> f64 {
        1.0
    }
}

#[test]
fn the_browser_shows_what_the_kernels_render() {
    let Some(browser) = browser() else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let (splats, all) = (scene(3000, 2), views());
    let expected = rendered(&splats, false, &all);
    let device = Device::open(None).unwrap();
    let defines = Defines::new(device.tuning());
    let renderer = Renderer::new(&device, defines, 2, false).unwrap();
    let buffers = GaussianBuffers::upload(&device, &splats, 0).unwrap();
    let picture = dir.path().join("shot.png");
    let shot = format!("--screenshot={}", picture.display());
    serve(&page(false), &mut Drawn(buffers, renderer), |client| {
        let (port, token) = (client.port, &client.token);
        let url = format!("http://127.0.0.1:{port}/?token={token}#view=4&size=160x120&bare");
        visit(&browser, dir.path(), &url, &[&shot]);
    });
    let found = image::open(&picture).unwrap().to_rgb8();
    let found = image::imageops::crop_imm(&found, 0, 0, 160, 120).to_image();
    let like = alike(&found, &expected[4]);
    println!("{like:.1} dB");
    assert!(like > ALIKE, "{like} dB");
    assert!(alike(&found, &expected[3]) < 25.0);
}
