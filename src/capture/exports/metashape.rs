//! Metashape's camera export: an XML document with a chunk of sensors and cameras.
//!
//! Conventions: Agisoft Metashape User Manual, Professional Edition, appendix "Camera models": camera axes x right, y down, z into the
//! scene; `cx` and `cy` from the centre of the image, pixels; a photo's point is f x' + b1 x' + b2 y', f y' from there; Brown's lens with
//! the tangential terms the other way round than OpenCV's. A camera's `transform` is camera-to-chunk, row by row; that of its component,
//! or of the chunk in older files, leads on to the coordinate system of the project (geocentric, where the project is georeferenced).

use std::collections::HashMap;
use std::path::Path;

use glam::{DMat3, DVec3};
use roxmltree::{Document, Node};

use crate::base::error::{Error, Result};
use crate::capture::assemble::RawScene;
use crate::capture::camera::{Camera, camera_axes};
use crate::capture::dataset::Layout;
use crate::capture::exports::shared::{add_cloud, scene};
use crate::capture::lens::Lens;
use crate::capture::panorama::intrinsics;

/// Remedy for a file that cannot be used.
const EXPORT: &str = "export the cameras again (File, Export, Export Cameras, Agisoft XML)";

/// True for a text that begins as the document does.
pub(super) fn is_document(text: &str) -> bool {
    text.contains("<document") && text.contains("<chunk")
}

/// A similarity transform: scale and rotation, and a shift after them.
#[derive(Clone, Copy)]
struct Similarity {
    linear: DMat3,
    shift: DVec3,
}

impl Similarity {
    const IDENTITY: Self = Self {
        linear: DMat3::IDENTITY,
        shift: DVec3::ZERO,
    };
}

/// A camera's sensor: intrinsics at the size of its photos, and the lens.
struct Sensor {
    camera: Camera,
    lens: Lens,
}

/// An aligned camera: its photo, its sensor's and its component's identifiers, axes and centre in the chunk.
struct Aligned<'a> {
    label: &'a str,
    sensor: &'a str,
    component: &'a str,
    axes: DMat3,
    center: DVec3,
}

fn child<'a, 'i>(node: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    node.children().find(|c| c.has_tag_name(name))
}

/// The elements of a name in a list of the chunk, in groups or not.
fn listed<'a, 'i>(
    chunk: Node<'a, 'i>,
    list: &'static str,
    name: &'static str,
) -> impl Iterator<Item = Node<'a, 'i>> {
    let list = child(chunk, list);
    let below = list.into_iter().flat_map(|list| list.descendants());
    below.filter(move |node| node.has_tag_name(name))
}

/// A file, for messages.
struct Reader<'p>(&'p Path);

impl Reader<'_> {
    fn bad(&self, what: impl Into<String>) -> Error {
        Error::input(self.0, what, EXPORT)
    }

    /// The numbers in an element.
    fn numbers<const N: usize>(&self, node: Node<'_, '_>, of: &str) -> Result<[f64; N]> {
        let words = node.text().unwrap_or_default().split_ascii_whitespace();
        let numbers = words.map(|word| word.parse().ok().filter(|v: &f64| v.is_finite()));
        let numbers: Option<Vec<f64>> = numbers.collect();
        numbers.and_then(|n| n.try_into().ok()).ok_or_else(|| {
            let name = node.tag_name().name();
            self.bad(format!("{name} of {of} is not {N} numbers"))
        })
    }

    /// The transform in an element, if it has one.
    fn similarity(&self, node: Node<'_, '_>, of: &str) -> Result<Option<Similarity>> {
        let Some(node) = child(node, "transform") else {
            return Ok(None);
        };
        let mut found = Similarity::IDENTITY;
        if let Some(rotation) = child(node, "rotation") {
            let rotation = self.numbers(rotation, of)?;
            found.linear = DMat3::from_cols_array(&rotation).transpose();
        }
        if let Some(scale) = child(node, "scale") {
            let [scale] = self.numbers(scale, of)?;
            found.linear *= scale;
        }
        if let Some(shift) = child(node, "translation") {
            found.shift = DVec3::from_array(self.numbers(shift, of)?);
        }
        Ok(Some(found))
    }

    /// Width and height of photos, pixels.
    fn resolution(&self, node: Option<Node<'_, '_>>, of: &str) -> Result<[u32; 2]> {
        let side = |name: &str| node?.attribute(name)?.parse().ok().filter(|s| *s > 0);
        match (side("width"), side("height")) {
            (Some(width), Some(height)) => Ok([width, height]),
            _ => Err(self.bad(format!("{of} has no resolution"))),
        }
    }

    /// Intrinsics (fx, fy, cx, cy) and lens of panoramas of a size, which have nothing to calibrate.
    fn sphere(
        &self,
        calibration: Option<Node<'_, '_>>,
        [width, height]: [u32; 2],
        of: &str,
    ) -> Result<([f64; 4], Lens)> {
        let terms = [
            "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4",
        ];
        let parts = calibration.into_iter().flat_map(|c| c.children());
        for part in parts.filter(|n| terms.contains(&n.tag_name().name())) {
            let ([value], name) = (self.numbers(part, of)?, part.tag_name().name());
            if value != 0.0 {
                let what = format!("{of} is spherical and has {name}, which is not read");
                let fix = "align the panoramas without adjusting their sensor, and export again";
                return Err(Error::input(self.0, what, fix));
            }
        }
        Ok((intrinsics(width, height), Lens::Equirectangular))
    }

    /// A sensor with a calibration, or of panoramas of a known size; `None` for another.
    fn sensor(&self, node: Node<'_, '_>) -> Result<Option<Sensor>> {
        let of = format!("sensor {}", node.attribute("id").unwrap_or_default());
        let calibrations = node.children().filter(|c| c.has_tag_name("calibration"));
        let adjusted = |c: &Node<'_, '_>| c.attribute("class") == Some("adjusted");
        // The initial calibration stands before the adjusted one, or alone.
        let found = calibrations.max_by_key(adjusted);
        let kind = found.and_then(|c| c.attribute("type"));
        let kind = kind.or_else(|| node.attribute("type"));
        let own = found.and_then(|c| child(c, "resolution"));
        let size = own.or_else(|| child(node, "resolution"));
        let spherical = kind == Some("spherical");
        let lacks = match spherical {
            true => size.is_none(),
            false => found.is_none(),
        };
        if lacks {
            return Ok(None);
        }
        let [width, height] = self.resolution(size, &of)?;
        let (of_sensor, lens) = match found {
            Some(found) if !spherical => self.calibrated(found, kind, [width, height], &of)?,
            calibration => self.sphere(calibration, [width, height], &of)?,
        };
        let origin = (DMat3::IDENTITY, DVec3::ZERO);
        let camera = Camera::new(of_sensor, [width, height], origin);
        Ok(Some(Sensor { camera, lens }))
    }

    /// Intrinsics (fx, fy, cx, cy) and lens of a calibration of a kind.
    fn calibrated(
        &self,
        found: Node<'_, '_>,
        kind: Option<&str>,
        [width, height]: [u32; 2],
        of: &str,
    ) -> Result<([f64; 4], Lens)> {
        let value = |name: &str| match child(found, name) {
            Some(node) => self.numbers(node, of).map(|[v]| v),
            None => Ok(0.0),
        };
        let fisheye = match kind.unwrap_or("frame") {
            "frame" => false,
            "fisheye" | "equidistant_fisheye" => true,
            other => {
                let what =
                    format!("{of} is of the type {other}; frame, fisheye or spherical expected");
                let fix = "export undistorted photos with their cameras";
                return Err(Error::input(self.0, what, fix));
            }
        };
        for name in ["p3", "p4"] {
            if value(name)? != 0.0 {
                let what = format!("{of} has {name}, which is not read");
                let fix = "export undistorted photos with their cameras";
                return Err(Error::input(self.0, what, fix));
            }
        }
        let (focal, b1) = (value("f")?, value("b1")?);
        if !(focal > 0.0 && focal + b1 > 0.0) {
            return Err(self.bad(format!("{of} has the focal length {focal}")));
        }
        let radial = [value("k1")?, value("k2")?, value("k3")?, value("k4")?];
        let tangential = [value("p2")?, value("p1")?];
        let skew = value("b2")? / (focal + b1);
        let plain = radial == [0.0; 4] && tangential == [0.0; 2] && skew == 0.0 && !fisheye;
        let lens = match plain {
            true => Lens::Pinhole,
            false => Lens::Brown {
                fisheye,
                radial,
                tangential,
                skew,
            },
        };
        let center = [f64::from(width) / 2.0, f64::from(height) / 2.0];
        let [cx, cy] = [center[0] + value("cx")?, center[1] + value("cy")?];
        Ok(([focal + b1, focal, cx, cy], lens))
    }

    /// The cameras of a chunk that are aligned and not disabled.
    fn aligned<'a>(&self, chunk: Node<'a, '_>) -> Result<Vec<Aligned<'a>>> {
        let mut all = Vec::new();
        for node in listed(chunk, "cameras", "camera") {
            let label = node.attribute("label").unwrap_or_default();
            let enabled = node.attribute("enabled");
            let Some(transform) = child(node, "transform") else {
                continue;
            };
            if matches!(enabled, Some("false" | "0")) {
                continue;
            }
            let m: [f64; 16] = self.numbers(transform, label)?;
            let column = |k: usize| DVec3::new(m[k], m[4 + k], m[8 + k]);
            all.push(Aligned {
                label,
                sensor: node.attribute("sensor_id").unwrap_or_default(),
                component: node.attribute("component_id").unwrap_or_default(),
                axes: DMat3::from_cols(column(0), column(1), column(2)),
                center: column(3),
            });
        }
        Ok(all)
    }
}

/// The cameras of the component that has most of them, and a remark on the others: each is aligned for itself.
fn largest(mut cameras: Vec<Aligned<'_>>) -> (Vec<Aligned<'_>>, Option<String>) {
    let mut counts: HashMap<&str, usize> = HashMap::new();
    for camera in &cameras {
        *counts.entry(camera.component).or_default() += 1;
    }
    let best = counts
        .iter()
        .max_by_key(|(id, n)| (**n, std::cmp::Reverse(**id)));
    let Some((&best, &most)) = best else {
        return (cameras, None);
    };
    let all = cameras.len();
    cameras.retain(|camera| camera.component == best);
    let left = (most < all).then(|| {
        format!(
            "warning: only the {most} cameras of component {best} are used; {} others are aligned apart from them",
            all - most
        )
    });
    (cameras, left)
}

/// The views of the cameras of a file in `root`, and the points beside it.
///
/// # Errors
/// XML that is none, no aligned camera, a sensor that is not read; what [`scene`] and [`add_cloud`] refuse.
pub(super) fn load(root: &Path, file: &Path, asked: Option<&Path>) -> Result<RawScene> {
    let reader = Reader(file);
    let bytes = crate::base::files::read_text(file)?;
    let text = String::from_utf8_lossy(&bytes);
    let document = Document::parse(&text).map_err(|e| reader.bad(format!("not XML: {e}")))?;
    let chunks = document.root_element().children();
    let chunks = chunks.filter(|node| node.has_tag_name("chunk"));
    let chunks = chunks.map(|chunk| Ok((chunk, reader.aligned(chunk)?)));
    let chunks: Vec<_> = chunks.collect::<Result<_>>()?;
    let several = chunks
        .iter()
        .filter(|(_, cameras)| !cameras.is_empty())
        .count()
        > 1;
    let first_most = chunks
        .into_iter()
        .rev()
        .max_by_key(|(_, cameras)| cameras.len());
    let Some((chunk, cameras)) = first_most.filter(|(_, cameras)| !cameras.is_empty()) else {
        return Err(reader.bad("no aligned camera"));
    };
    let (cameras, left) = largest(cameras);
    let mut sensors = HashMap::new();
    for node in listed(chunk, "sensors", "sensor") {
        let id = node.attribute("id").unwrap_or_default();
        let used = cameras.iter().any(|camera| camera.sensor == id);
        if used && let Some(sensor) = reader.sensor(node)? {
            sensors.insert(id, sensor);
        }
    }
    let mut transform = reader.similarity(chunk, "the chunk")?;
    for node in listed(chunk, "components", "component") {
        let id = node.attribute("id").unwrap_or_default();
        if cameras[0].component == id {
            transform = reader.similarity(node, "the component")?.or(transform);
        }
    }
    let world = transform.unwrap_or(Similarity::IDENTITY);
    let names: Vec<&str> = cameras.iter().map(|camera| camera.label).collect();
    let place = (root, file, Layout::Metashape);
    let mut scene = scene(place, asked, &names, |i, _| {
        let found = &cameras[i];
        let Some(sensor) = sensors.get(found.sensor) else {
            let what = format!(
                "{} has a sensor without calibration, or without resolution",
                found.label
            );
            return Err(reader.bad(what));
        };
        let axes = world.linear * found.axes;
        let Some(rotation) = camera_axes([axes.x_axis, axes.y_axis, axes.z_axis]) else {
            return Err(reader.bad(format!("the transform of {} is no pose", found.label)));
        };
        let center = world.linear * found.center + world.shift;
        let camera = Camera {
            rotation,
            translation: -(rotation * center),
            ..sensor.camera
        };
        Ok((camera, sensor.lens))
    })?;
    scene.remarks.extend(left);
    if several {
        let label = chunk.attribute("label").unwrap_or("without a name");
        scene.remarks.push(format!(
            "the chunk {label} is used, which has most of the cameras"
        ));
    }
    add_cloud(&mut scene, root, file)?;
    Ok(scene)
}
