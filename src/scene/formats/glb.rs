//! Binary glTF with KHR_gaussian_splatting (Khronos, release candidate of 2026): f32 attributes of a primitive of points, in glTF's
//! axes left, up, front. <https://github.com/KhronosGroup/glTF/tree/main/extensions/2.0/Khronos/KHR_gaussian_splatting>

use std::path::Path;

use glam::{DQuat, DVec3};
use serde_json::{Map, Value, json};

use crate::base::constants::LOG_SCALE;
use crate::base::error::{Error, Result};
use crate::base::math::sigmoid;
use crate::capture::Frame;
use crate::scene::formats::scene_file::{HalfTurn, SceneFile, limited_logit, localized, unit};
use crate::scene::gaussians::{Gaussians, Plane, sh_coefficients};

/// First bytes of a file.
pub(super) const MAGIC: [u8; 4] = *b"glTF";

const EXTENSION: &str = "KHR_gaussian_splatting";
/// The kernel and the colour space of this program's Gaussians.
const KERNEL: &str = "ellipse";
const COLOR_SPACE: &str = "srgb_rec709_display";
/// Extra property of the primitive of a scene that is to be rendered with the 2D filter.
const ANTI_ALIASED: &str = "antialiased";
/// Bytes of the header, and of the head of a chunk.
const HEADER: usize = 12;
const CHUNK: usize = 8;
/// Types of accessors, by their number of components.
const KINDS: [&str; 4] = ["SCALAR", "VEC2", "VEC3", "VEC4"];
/// Type of a component: f32.
const FLOAT: u64 = 5126;
const FIX: &str = "export the .glb file again, without compression";

/// The chunks of a file: its JSON document and its bytes, which may be cut off.
fn chunks<'a>(path: &Path, bytes: &'a [u8]) -> Result<(Value, &'a [u8])> {
    let wrong = |what: &str| Error::input(path, format!("{what} in a .glb file"), FIX);
    let word = |at: usize| {
        let four = bytes.get(at..)?.first_chunk()?;
        Some(u32::from_le_bytes(*four) as usize)
    };
    if word(4) != Some(2) {
        return Err(wrong("a version other than 2"));
    }
    let length = word(HEADER).ok_or_else(|| wrong("no chunk"))?;
    let start = HEADER + CHUNK;
    let text = bytes.get(start..start.saturating_add(length));
    let text = text
        .filter(|_| bytes[HEADER + 4..start] == *b"JSON")
        .ok_or_else(|| wrong("no whole JSON chunk"))?;
    let document = serde_json::from_slice(text)
        .map_err(|e| wrong(&format!("JSON that cannot be read ({e})")))?;
    let after = start + length;
    let data = match (word(after), bytes.get(after + 4..after + CHUNK)) {
        (Some(length), Some(b"BIN\0")) => {
            let rest = &bytes[after + CHUNK..];
            &rest[..length.min(rest.len())]
        }
        _ => &[],
    };
    Ok((document, data))
}

/// The primitives that have the extension, each with the number of its mesh.
fn primitives(document: &Value) -> Vec<(usize, &Value)> {
    let meshes = document["meshes"].as_array().into_iter().flatten();
    let all = meshes.enumerate().flat_map(|(k, mesh)| {
        let primitives = mesh["primitives"].as_array().into_iter().flatten();
        primitives.map(move |p| (k, p))
    });
    all.filter(|(_, p)| p["extensions"].get(EXTENSION).is_some())
        .collect()
}

/// Checks that Gaussians are of the kind that is read here.
fn check_kind(path: &Path, extension: &Value) -> Result<()> {
    let further = extension["extensions"].as_object();
    let named = |key: &str, known: &str| {
        let found = extension[key].as_str().filter(|v| *v != known)?;
        Some(format!("the {key} {found:?}"))
    };
    let unknown = further
        .and_then(|m| m.keys().next().cloned())
        .or_else(|| named("kernel", KERNEL))
        .or_else(|| named("colorSpace", COLOR_SPACE));
    unknown.map_or(Ok(()), |what| {
        let what = format!("Gaussians with {what}, which is not read here");
        Err(Error::input(path, what, FIX))
    })
}

/// True if the beginning of a file marks its scene as anti-aliased.
pub(super) fn is_anti_aliased(path: &Path, start: &[u8]) -> bool {
    let document = start.starts_with(&MAGIC).then(|| chunks(path, start).ok());
    document.flatten().is_some_and(|(document, _)| {
        let found = primitives(&document);
        found
            .first()
            .is_some_and(|(_, p)| p["extras"][ANTI_ALIASED] == true)
    })
}

/// Accessors of a primitive's attributes.
struct Accessors<'a> {
    path: &'a Path,
    document: &'a Value,
    data: &'a [u8],
    attributes: &'a Map<String, Value>,
}

impl Accessors<'_> {
    fn wrong(&self, name: &str, what: impl std::fmt::Display) -> Error {
        Error::input(self.path, format!("{name}: {what}"), FIX)
    }

    /// The values of an attribute with so many components, one row per Gaussian: `count` of them, if that is given.
    fn rows<const K: usize>(&self, name: &str, count: Option<usize>) -> Result<Vec<[f64; K]>> {
        let wrong = |what: &str| self.wrong(name, what);
        let index = self.attributes.get(name).and_then(Value::as_u64);
        let index = index.ok_or_else(|| wrong("no such attribute"))? as usize;
        let accessor = &self.document["accessors"][index];
        let number = |object: &Value, key: &str| object[key].as_u64();
        let kind = KINDS[K - 1];
        if accessor["type"] != kind || accessor.get("sparse").is_some() {
            return Err(wrong(&format!("a plain accessor of {kind} expected")));
        }
        let normalized = accessor["normalized"] == true;
        let component = number(accessor, "componentType").unwrap_or(0);
        let (size, convert) = component_of(component, normalized)
            .ok_or_else(|| wrong(&format!("components of type {component}")))?;
        let found = number(accessor, "count").unwrap_or(0) as usize;
        if count.is_some_and(|n| n != found) {
            let what = format!("{found} values; as many as Gaussians expected");
            return Err(wrong(&what));
        }
        let view =
            number(accessor, "bufferView").map(|k| &self.document["bufferViews"][k as usize]);
        let view = view
            .filter(|view| number(view, "buffer") == Some(0))
            .ok_or_else(|| wrong("no view of the file's own buffer"))?;
        let part = |object: &Value, key: &str| number(object, key).unwrap_or(0) as usize;
        let stride = number(view, "byteStride").map_or(K * size, |s| s as usize);
        let within = part(accessor, "byteOffset");
        let start = part(view, "byteOffset").saturating_add(within);
        let before = found.saturating_sub(1).saturating_mul(stride);
        let length = before.saturating_add(if found > 0 { K * size } else { 0 });
        let inside = within.saturating_add(length) <= part(view, "byteLength");
        let bytes = self.data.get(start..start.saturating_add(length));
        let bytes = bytes
            .filter(|_| inside && stride >= K * size)
            .ok_or_else(|| wrong("the file has fewer bytes than it names"))?;
        let value = |row: usize, k: usize| convert(&bytes[row * stride + k * size..][..size]);
        let rows: Vec<[f64; K]> = (0..found)
            .map(|row| std::array::from_fn(|k| value(row, k)))
            .collect();
        match rows
            .iter()
            .position(|row| row.iter().any(|v| !v.is_finite()))
        {
            Some(row) => Err(wrong(&format!("the value of Gaussian {row} is not finite"))),
            None => Ok(rows),
        }
    }
}

/// Bytes of a component, and how its value is read from them.
type Component = (usize, fn(&[u8]) -> f64);

/// The component of a type's number.
fn component_of(component: u64, normalized: bool) -> Option<Component> {
    Some(match (component, normalized) {
        (FLOAT, false) => (4, |b| {
            f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        }),
        (5120, true) => (1, |b| (f64::from(b[0] as i8) / 127.0).max(-1.0)),
        (5121, true) => (1, |b| f64::from(b[0]) / 255.0),
        (5121, false) => (1, |b| f64::from(b[0])),
        (5122, true) => (2, |b| {
            (f64::from(i16::from_le_bytes([b[0], b[1]])) / 32767.0).max(-1.0)
        }),
        (5123, true) => (2, |b| f64::from(u16::from_le_bytes([b[0], b[1]])) / 65535.0),
        (5123, false) => (2, |b| f64::from(u16::from_le_bytes([b[0], b[1]]))),
        _ => return None,
    })
}

/// Name of the attribute of SH coefficient `k` of all, in 3DGS's order.
fn coefficient_name(k: u32) -> String {
    let degree = k.isqrt();
    format!(
        "{EXTENSION}:SH_DEGREE_{degree}_COEF_{}",
        k - degree * degree
    )
}

/// Reads a file.
///
/// # Errors
/// [`Error::Input`] for a file without Gaussians of its own bytes, or values that are none.
pub(super) fn read(path: &Path, bytes: &[u8], frame: &Frame) -> Result<SceneFile> {
    let (document, data) = chunks(path, bytes)?;
    let all = primitives(&document);
    let &(mesh, found) = all.first().ok_or_else(|| {
        let what = format!("a .glb file without Gaussians ({EXTENSION})");
        Error::input(path, what, "give a scene of Gaussians")
    })?;
    check_kind(path, &found["extensions"][EXTENSION])?;
    let none = Map::new();
    let accessors = Accessors {
        path,
        document: &document,
        data,
        attributes: found["attributes"].as_object().unwrap_or(&none),
    };
    let named = |name: &str| format!("{EXTENSION}:{name}");
    let positions = accessors.rows::<3>("POSITION", None)?;
    let n = Some(positions.len());
    let rotations = accessors.rows::<4>(&named("ROTATION"), n)?;
    let scales = accessors.rows::<3>(&named("SCALE"), n)?;
    let opacities = accessors.rows::<1>(&named("OPACITY"), n)?;
    let has = |k: u32| accessors.attributes.contains_key(&coefficient_name(k));
    let degree = (1..=3).take_while(|d| has(d * d)).last().unwrap_or(0);
    let mut planes = vec![Vec::with_capacity(positions.len()); Plane::count(degree)];
    for (i, (scale, [opacity])) in scales.iter().zip(&opacities).enumerate() {
        if scale.iter().any(|s| *s < 0.0) || !(0.0..=1.0).contains(opacity) {
            let what = format!(
                "scale {scale:?}, opacity {opacity} of Gaussian {i}; no negative scale, and an opacity of 0 to 1, expected"
            );
            return Err(Error::input(path, what, FIX));
        }
        for k in 0..3 {
            planes[Plane::POSITION + k].push(positions[i][k] as f32);
            planes[Plane::LOG_SCALE + k].push(scale[k].ln().max(LOG_SCALE[0]) as f32);
        }
        let [x, y, z, w] = rotations[i];
        for (k, v) in [w, x, y, z].into_iter().enumerate() {
            planes[Plane::ROTATION + k].push(v as f32);
        }
        planes[Plane::OPACITY].push(limited_logit(*opacity));
    }
    for k in 0..sh_coefficients(degree) {
        for row in accessors.rows::<3>(&coefficient_name(k as u32), n)? {
            for (c, v) in row.into_iter().enumerate() {
                planes[Plane::SH + 3 * k + c].push(v as f32);
            }
        }
    }
    let mut splats = Gaussians::new(degree, planes)?;
    HalfTurn::Z.turn(&mut splats);
    let planes = splats.planes().to_vec();
    let (up, mut remarks) = placed(&document, mesh);
    if all.len() > 1 {
        remarks.push(format!(
            "the first of {} sets of Gaussians is read, the others are left out",
            all.len()
        ));
    }
    Ok(SceneFile {
        anti_aliased: found["extras"][ANTI_ALIASED] == true,
        up: Some(up),
        remarks,
        ..SceneFile::new(localized(path, degree, planes, frame)?)
    })
}

/// The direction up in the scene's own axes, by the rotation of the node that holds the mesh, and remarks on the rest of it.
fn placed(document: &Value, mesh: usize) -> ([f64; 3], Vec<String>) {
    let nodes = document["nodes"].as_array();
    let node = nodes.and_then(|nodes| {
        nodes
            .iter()
            .find(|n| n["mesh"].as_u64() == Some(mesh as u64))
    });
    let node = node.unwrap_or(&Value::Null);
    let part = |k: usize| node["rotation"][k].as_f64();
    let rotation = match [0, 1, 2, 3].map(part) {
        [Some(x), Some(y), Some(z), Some(w)] if x.hypot(y).hypot(z.hypot(w)) > 0.0 => {
            DQuat::from_xyzw(x, y, z, w).normalize()
        }
        _ => DQuat::IDENTITY,
    };
    let moved = ["matrix", "translation", "scale"].into_iter();
    let remarks = moved
        .filter(|key| node.get(key).is_some())
        .map(|key| format!("the {key} of its node is left out"));
    let [x, y, z] = (rotation.inverse() * DVec3::Y).to_array();
    ([-x, -y, z], remarks.collect())
}

/// The bytes of a file, and remarks on what the format cannot hold. The scene is in the dataset's frame.
///
/// # Errors
/// [`Error::Input`] for more than 4 GiB.
pub(super) fn encode(path: &Path, scene: &SceneFile) -> Result<(Vec<u8>, Vec<String>)> {
    let mut splats = scene.splats.clone();
    HalfTurn::Z.turn(&mut splats);
    let n = splats.len();
    let mut writer = Writer::default();
    let positions: Vec<[f32; 3]> = (0..n).map(|i| splats.gather(Plane::POSITION, i)).collect();
    let edge = |f: fn(f32, f32) -> f32, start: f32| -> [f32; 3] {
        let all = |k: usize| positions.iter().map(move |p| p[k]);
        [0, 1, 2].map(|k| if n > 0 { all(k).fold(start, f) } else { 0.0 })
    };
    let bounds = json!({ "min": edge(f32::min, f32::MAX), "max": edge(f32::max, f32::MIN) });
    writer.attribute("POSITION", &positions);
    writer.bound(&bounds);
    let rotation = |i: usize| {
        let [w, x, y, z] = unit(splats.gather(Plane::ROTATION, i));
        [x, y, z, w].map(|v| v as f32)
    };
    writer.attribute(
        &format!("{EXTENSION}:ROTATION"),
        &(0..n).map(rotation).collect::<Vec<_>>(),
    );
    let mut clamped = 0;
    let mut scale = |i: usize| {
        splats.gather::<3>(Plane::LOG_SCALE, i).map(|log| {
            let kept = f64::from(log).clamp(LOG_SCALE[0], LOG_SCALE[1]);
            clamped += usize::from(kept != f64::from(log));
            kept.exp() as f32
        })
    };
    writer.attribute(
        &format!("{EXTENSION}:SCALE"),
        &(0..n).map(&mut scale).collect::<Vec<_>>(),
    );
    let opacity = |l: &f32| [sigmoid(f64::from(*l)) as f32];
    let opacities: Vec<[f32; 1]> = splats.planes()[Plane::OPACITY]
        .iter()
        .map(opacity)
        .collect();
    writer.attribute(&format!("{EXTENSION}:OPACITY"), &opacities);
    for k in 0..sh_coefficients(splats.sh_degree()) {
        let row = |i: usize| splats.gather::<3>(Plane::SH + 3 * k, i);
        writer.attribute(
            &coefficient_name(k as u32),
            &(0..n).map(row).collect::<Vec<_>>(),
        );
    }
    let [least, most] = LOG_SCALE;
    let remark = format!("{clamped} scales outside of e^{least} to e^{most} were clamped");
    let bytes = writer.file(path, scene)?;
    Ok((bytes, (clamped > 0).then_some(remark).into_iter().collect()))
}

/// A file in the making.
#[derive(Default)]
struct Writer {
    data: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    attributes: Map<String, Value>,
}

impl Writer {
    /// Adds an attribute of f32 with K components.
    fn attribute<const K: usize>(&mut self, name: &str, rows: &[[f32; K]]) {
        let start = self.data.len();
        self.data
            .extend(rows.iter().flatten().flat_map(|v| v.to_le_bytes()));
        let index = self.views.len();
        let length = self.data.len() - start;
        self.views.push(
            json!({ "buffer": 0, "byteOffset": start, "byteLength": length, "target": 34962 }),
        );
        self.accessors.push(json!({
            "bufferView": index, "componentType": FLOAT, "count": rows.len(),
            "type": KINDS[K - 1],
        }));
        self.attributes.insert(name.to_owned(), json!(index));
    }

    /// Adds the least and largest values of the attribute added last.
    fn bound(&mut self, bounds: &Value) {
        if let Some(accessor) = self.accessors.last_mut() {
            accessor["min"] = bounds["min"].clone();
            accessor["max"] = bounds["max"].clone();
        }
    }

    /// The whole file, of a scene in glTF's axes but for the direction up, into which its node turns it.
    fn file(self, path: &Path, scene: &SceneFile) -> Result<Vec<u8>> {
        let up = scene.up.map(|[x, y, z]| DVec3::new(-x, -y, z));
        let rotation = up
            .and_then(DVec3::try_normalize)
            .map_or(DQuat::IDENTITY, |up| DQuat::from_rotation_arc(up, DVec3::Y));
        let mut primitive = json!({
            "mode": 0,
            "attributes": self.attributes,
            "extensions": { EXTENSION: { "kernel": KERNEL, "colorSpace": COLOR_SPACE } },
        });
        if scene.anti_aliased {
            primitive["extras"] = json!({ ANTI_ALIASED: true });
        }
        let document = json!({
            "asset": { "version": "2.0", "generator": "mhsplat" },
            "extensionsUsed": [EXTENSION],
            "scene": 0,
            "scenes": [{ "nodes": [0] }],
            "nodes": [{ "mesh": 0, "rotation": rotation.to_array() }],
            "meshes": [{ "primitives": [primitive] }],
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{ "byteLength": self.data.len() }],
        });
        let mut text = document.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let size = HEADER + 2 * CHUNK + text.len() + self.data.len();
        let size = u32::try_from(size).map_err(|_| {
            let what = format!("{size} bytes; a .glb file holds at most 4 GiB");
            Error::input(
                path,
                what,
                "choose another format, or leave out bands with --sh-degree",
            )
        })?;
        let word = |n: usize| (n as u32).to_le_bytes();
        Ok([
            &MAGIC[..],
            &2_u32.to_le_bytes(),
            &size.to_le_bytes(),
            &word(text.len()),
            b"JSON",
            &text,
            &word(self.data.len()),
            b"BIN\0",
            &self.data,
        ]
        .concat())
    }
}
