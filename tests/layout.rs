//! The shared structs on the device and in Rust, and the rules of the house that a script can check.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use mhsplat::device::tuning::Tuning;
use mhsplat::device::{Array, CameraArg, Defines, Device, Kernels, Projected};
use mhsplat::scene::Edit;

fn probe<R: mhsplat::device::Real>() -> Vec<u32> {
    let device = Device::open(None).unwrap();
    let defines = Defines {
        layout_probe: true,
        ..Defines::new(Tuning::CPU)
    };
    let program = Kernels::new(&device, defines)
        .build::<R>("project")
        .unwrap();
    let out = Array::zeros(&device, "layout", 12).unwrap();
    let launch = program.launch("layout_probe");
    launch.array(&out, 12).run([1, 1], [1, 1]).unwrap();
    out.to_vec().unwrap()
}

macro_rules! layout {
    ($real:ty) => {
        [
            size_of::<Projected<$real>>(),
            std::mem::offset_of!(Projected<$real>, lo),
            std::mem::offset_of!(Projected<$real>, depth),
            std::mem::offset_of!(Projected<$real>, by),
            size_of::<CameraArg<$real>>(),
            std::mem::offset_of!(CameraArg<$real>, intrinsics),
            std::mem::offset_of!(CameraArg<$real>, near),
            std::mem::offset_of!(CameraArg<$real>, across),
            size_of::<Edit>(),
            std::mem::offset_of!(Edit, log_scale),
            std::mem::offset_of!(Edit, opacity_logit),
            std::mem::offset_of!(Edit, color) + size_of::<u32>(),
        ]
        .map(|v| v as u32)
        .to_vec()
    };
}

#[test]
fn structs_have_the_same_layout_on_the_device() {
    assert_eq!(probe::<f32>(), layout!(f32));
    assert_eq!(probe::<f64>(), layout!(f64));
    assert_ne!(
        probe::<f32>(),
        layout!(f64),
        "the comparison must be able to fail"
    );
}

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn files(folder: &str, extension: &str) -> Vec<PathBuf> {
    let mut out = Vec::new();
    let mut folders = vec![root().join(folder)];
    while let Some(f) = folders.pop() {
        for entry in std::fs::read_dir(f).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == extension) {
                out.push(path);
            }
        }
    }
    out.sort();
    out
}

fn stems(folder: &str, extension: &str) -> Vec<String> {
    files(folder, extension)
        .iter()
        .map(|p| p.file_stem().unwrap().to_string_lossy().into_owned())
        .filter(|s| s != "mod")
        .collect()
}

#[test]
fn every_stage_has_its_three_files() {
    let kernels = stems("kernels", "cl");
    assert!(kernels.len() >= 11, "{kernels:?}");
    assert_eq!(kernels, stems("src/pipeline/stage", "rs"));
    for stage in &kernels {
        let file = root().join("tests/stage").join(format!("{stage}.rs"));
        assert!(file.is_file(), "{} is missing", file.display());
    }
}

fn text(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap()
}

#[test]
fn only_device_names_opencl_and_is_unsafe() {
    for file in files("src", "rs") {
        let inside = file.components().any(|c| c.as_os_str() == "device");
        let source = text(&file);
        let speaks = source.contains("ocl_core") || source.contains("unsafe {");
        assert!(inside || !speaks, "{}", file.display());
    }
}

/// Files and folders below src that may use the f64 reference: what runs must not wait for code that is slow and obvious.
const OF_THE_REFERENCE: [&str; 2] = ["pipeline", "lab"];

#[test]
fn only_checks_use_the_reference() {
    let src = root().join("src");
    let uses = |source: &str| {
        let mut lines = source.lines();
        lines.any(|l| l.contains("pipeline::reference") || l.contains("pipeline::reference_pass"))
    };
    let [mut inside, mut outside] = [0, 0];
    for file in files("src", "rs") {
        let source = text(&file);
        if OF_THE_REFERENCE
            .iter()
            .any(|p| file.starts_with(src.join(p)))
        {
            inside += usize::from(uses(&source));
        } else {
            outside += 1;
            assert!(!uses(&source), "{}", file.display());
        }
    }
    assert!(inside > 3 && outside > 100, "{inside} {outside}");
}

/// One struct is the flags and the keys of configuration files, so the configuration names clap, too. Elsewhere an enum that an
/// option takes derives its names, so that none is mirrored, and nothing else.
#[test]
fn clap_is_named_by_the_command_line_and_the_configuration() {
    let src = root().join("src");
    let mut found = 0;
    for file in files("src", "rs") {
        let names_clap = text(&file).replace("clap::ValueEnum", "").contains("clap");
        let inside = ["cli", "config"].map(|room| file.starts_with(src.join(room)));
        found += usize::from(names_clap);
        assert!(inside.contains(&true) || !names_clap, "{}", file.display());
    }
    assert!(found > 5, "{found}");
}

/// Names of kernel files that a text speaks of, `kernels/{a,b}.cl` for two.
fn kernels_named(text: &str) -> Vec<String> {
    let parts = text.split("kernels/").skip(1);
    let names = parts.filter_map(|part| part.split_once(".cl")).map(|p| p.0);
    let plain = |c: char| c.is_alphanumeric() || "_{},".contains(c);
    names
        .filter(|n| n.chars().all(plain))
        .flat_map(|n| n.trim_matches(['{', '}']).split(','))
        .map(str::to_owned)
        .collect()
}

#[test]
fn the_table_of_stages_names_every_kernel_and_no_other() {
    let named = kernels_named(&text(&root().join("src/lib.rs")));
    for file in files("kernels", "cl") {
        let stem = file.file_stem().unwrap().to_str().unwrap().to_owned();
        assert!(named.contains(&stem), "src/lib.rs lacks {stem}.cl");
    }
    for name in &named {
        let file = root().join(format!("kernels/{name}.cl"));
        assert!(file.exists(), "src/lib.rs speaks of {name}.cl");
    }
    assert_eq!(
        kernels_named("`kernels/{a,b}.cl`, `kernels/c.cl`"),
        ["a", "b", "c"]
    );
}

#[test]
fn files_are_small() {
    let all = [
        files("src", "rs"),
        files("kernels", "cl"),
        files("kernels", "clh"),
        files("tests", "rs"),
        files("benches", "rs"),
    ]
    .concat();
    for file in all {
        let n = text(&file).lines().count();
        assert!(n <= 600, "{} has {n} lines", file.display());
    }
}

#[test]
fn few_packages_are_locked() {
    let lock: toml::Table = text(&root().join("Cargo.lock")).parse().unwrap();
    let name = |p: &toml::Value| p["name"].as_str().unwrap().to_owned();
    let packages = lock["package"].as_array().unwrap();
    // Those of the default build: what a feature adds hangs on one package.
    let (mut known, mut left) = (BTreeSet::new(), vec!["mhsplat".to_owned()]);
    while let Some(at) = left.pop() {
        if at == "mpi" || !known.insert(at.clone()) {
            continue;
        }
        let these = packages.iter().filter(|p| name(p) == at);
        let needed = these.filter_map(|p| p.get("dependencies")?.as_array());
        let words = |d: &toml::Value| d.as_str().unwrap().split(' ').next().map(str::to_owned);
        left.extend(needed.flatten().filter_map(words));
    }
    // Some are there in two versions.
    let n = packages.iter().filter(|p| known.contains(&name(p))).count();
    assert!((100..160).contains(&n), "{n} packages");
    assert!(n < packages.len(), "the feature's packages are left out");
}

/// The one build script sets the revision that a run records: OpenCL has its own preprocessor, and kernels are embedded as text.
#[test]
fn the_build_script_sets_the_revision_and_nothing_else() {
    let script = text(&root().join("build.rs"));
    let sets: Vec<&str> = script.split("cargo:").skip(1).collect();
    let revision =
        |s: &&str| s.starts_with("rerun-if") || s.starts_with("rustc-env=MHSPLAT_COMMIT=");
    assert!(sets.len() == 3 && sets.iter().all(revision), "{sets:?}");
    let n = script.lines().count();
    assert!(n < 50, "{n} lines");
}

/// Names and lengths of the functions of a formatted source: from the line with `fn` to the bracket below it.
fn functions(source: &str) -> Vec<(String, usize)> {
    let lines: Vec<&str> = source.lines().collect();
    let starts = lines.iter().enumerate().filter(|(_, l)| {
        let words = l.trim_start();
        ["fn ", "pub fn ", "pub(super) fn ", "pub(crate) fn "]
            .iter()
            .any(|w| words.starts_with(w))
    });
    starts
        .map(|(at, line)| {
            let indent = line.len() - line.trim_start().len();
            let end = format!("{}}}", " ".repeat(indent));
            let length = lines[at..].iter().position(|l| **l == end).unwrap_or(0);
            (line.trim().to_owned(), length + 1)
        })
        .collect()
}

#[test]
fn functions_are_short() {
    let all = [files("src", "rs"), files("benches", "rs")].concat();
    let mut seen = 0;
    for file in all {
        for (name, length) in functions(&text(&file)) {
            seen += 1;
            assert!(length <= 100, "{}: {name}: {length} lines", file.display());
        }
    }
    assert!(seen > 300, "only {seen} functions were found");
    let long = format!("fn f() {{\n{}}}\n", "    x();\n".repeat(110));
    assert_eq!(functions(&long), [("fn f() {".to_owned(), 112)]);
}

/// Masks of a kernel that it negates, by name.
fn negated(source: &str) -> Vec<String> {
    let name = |rest: &str| -> String {
        let end = |c: char| !c.is_alphanumeric() && c != '_';
        rest.split(end).next().unwrap_or_default().to_owned()
    };
    let declared = source.split("maskV ").skip(1);
    let names = declared.flat_map(|d| {
        let line = d.split([';', '{']).next().unwrap_or_default();
        line.split(',')
            .map(|part| name(part.trim()))
            .collect::<Vec<_>>()
    });
    let found = |n: &String| {
        let negation = format!("!{n}");
        let mut after = source.split(negation.as_str()).skip(1);
        !n.is_empty() && after.any(|rest| name(rest).is_empty())
    };
    names.filter(found).collect()
}

/// No kernel negates a mask: oclgrind makes a negated vector 1 where all bits are due.
#[test]
fn kernels_negate_no_mask() {
    let kernels = [files("kernels", "cl"), files("kernels", "clh")].concat();
    assert!(kernels.len() > 20);
    for file in kernels {
        let source = text(&file);
        assert_eq!(negated(&source), Vec::<String>::new(), "{}", file.display());
        for wrong in ["any_lane(!", "all_lanes(!", "choose(!", "!isfinite("] {
            assert!(!source.contains(wrong), "{}: {wrong}", file.display());
        }
    }
    let wrong = "const maskV near = z > 0, far = z < 9; if (!any_lane(near & !far)) return;";
    assert_eq!(negated(wrong), ["far"]);
}

/// A fresh machine has neither a loader nor a driver: what installs them was once committed empty, and nobody noticed where
/// both were there already.
#[test]
fn continuous_integration_installs_what_a_machine_lacks() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let install = text(&root.join(".ci/install"));
    for word in ["pocl-opencl-icd", "ocl-icd-opencl-dev", "apt-get"] {
        assert!(install.contains(word), ".ci/install lacks {word}");
    }
    assert!(text(&root.join(".ci/run")).contains(".ci/install"));
}
