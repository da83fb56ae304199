//! OpenCL on a machine, present and missing: loader, drivers, devices, permissions and limits, each as found.

use std::ffi::OsStr;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::base::error::Result;
use crate::device::{Defines, Device, DeviceInfo, Kernels, libraries};

/// Folder of the files that name drivers.
const VENDORS: &str = "/etc/OpenCL/vendors";

/// Variables that name a folder of such files, one file, or a library, in the place of [`VENDORS`].
const VENDOR_VARIABLES: [&str; 2] = ["OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH"];

/// Variable that names libraries of drivers themselves.
const FILENAMES_VARIABLE: &str = "OCL_ICD_FILENAMES";

/// Folder of the limits of containers.
const CGROUPS: &str = "/sys/fs/cgroup";

/// Device files of GPUs, by the beginnings of their names in a folder.
const NODES: [(&str, &[&str]); 2] = [
    ("/dev/dri", &["renderD"]),
    ("/dev", &["nvidia", "kfd", "dxg"]),
];

/// Commands that install a loader and a driver, by system.
pub const INSTALL: [(&str, &str); 5] = [
    (
        "Debian, Ubuntu",
        "apt-get install ocl-icd-libopencl1 pocl-opencl-icd; for GPUs of Intel intel-opencl-icd, of AMD mesa-opencl-icd or ROCm's rocm-opencl, of NVIDIA nvidia-opencl-icd (Ubuntu: part of the driver, libnvidia-compute)",
    ),
    (
        "Fedora",
        "dnf install ocl-icd pocl; for GPUs of Intel intel-compute-runtime, of AMD rocm-opencl or mesa-libOpenCL, of NVIDIA xorg-x11-drv-nvidia-cuda (RPM Fusion)",
    ),
    (
        "Arch",
        "pacman -S ocl-icd pocl; for GPUs of Intel intel-compute-runtime, of AMD rocm-opencl-runtime or opencl-mesa, of NVIDIA opencl-nvidia",
    ),
    (
        "macOS",
        "nothing for GPUs, whose driver is part of the system; for the CPU brew install pocl",
    ),
    (
        "Windows",
        "the driver of the GPU's vendor, which brings OpenCL.dll; for CPUs the Intel CPU Runtime for OpenCL Applications",
    ),
];

/// A driver that a file or a variable names.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Driver {
    /// The file or variable.
    pub named_by: String,
    /// Library, as named; empty if the file cannot be read.
    pub library: String,
    /// The system's reason why it does not load; `None` if it does.
    pub failure: Option<String>,
}

/// A device, and whether it can be used.
#[derive(Debug, Clone, Serialize)]
pub struct Examined {
    /// Properties that the driver reports.
    #[serde(flatten)]
    pub info: DeviceInfo,
    /// Reason for which it cannot be used; `None` if it can: it opens, and compiles a kernel.
    pub failure: Option<String>,
}

/// A device file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Node {
    /// Its path.
    pub path: PathBuf,
    /// Group that owns it; `None` where the system does not tell.
    pub group: Option<String>,
    /// Why it cannot be opened; `None` if it can.
    pub failure: Option<String>,
    /// True if it is the permissions that keep it from being opened.
    pub denied: bool,
}

/// A limit of the process or of its container.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Limit {
    /// Name of the limited resource.
    pub name: String,
    /// Its value as the system spells it.
    pub value: String,
}

/// Everything that was found.
#[derive(Debug, Clone, Serialize)]
pub struct Findings {
    /// Libraries of OpenCL's loader in the process; empty where the system does not tell.
    pub loader: Vec<PathBuf>,
    /// Folders, files or libraries in which drivers are looked for.
    pub vendors: Vec<PathBuf>,
    /// Drivers named there.
    pub drivers: Vec<Driver>,
    /// Devices that the loader lists.
    pub devices: Vec<Examined>,
    /// Why there are none; `None` if there are some.
    pub no_devices: Option<String>,
    /// Device files of GPUs.
    pub nodes: Vec<Node>,
    /// Limits on memory, processes and files.
    pub limits: Vec<Limit>,
    /// Steps to take, the most important first; empty if nothing is wrong.
    pub advice: Vec<String>,
}

impl Findings {
    /// True if a device can be used.
    #[must_use]
    pub fn usable(&self) -> bool {
        self.devices.iter().any(|d| d.failure.is_none())
    }
}

/// Examines the machine. Nothing fails: what cannot be found out is left out.
#[must_use]
pub fn examine() -> Findings {
    let vendors = vendor_places(|name| std::env::var(name).ok());
    let mut drivers: Vec<Driver> = vendors.iter().flat_map(|p| drivers_of(p)).collect();
    let filenames = std::env::var(FILENAMES_VARIABLE).unwrap_or_default();
    let libraries = filenames.split(':').filter(|l| !l.is_empty());
    drivers.extend(libraries.map(|l| driver(FILENAMES_VARIABLE, l)));
    let (devices, no_devices) = match Device::list() {
        Ok(list) => (list.into_iter().map(examined).collect(), None),
        Err(error) => (Vec::new(), Some(error.to_string())),
    };
    let mut findings = Findings {
        loader: loader(),
        vendors,
        drivers,
        devices,
        no_devices,
        nodes: NODES
            .iter()
            .flat_map(|(f, names)| nodes(f, names))
            .collect(),
        limits: limits(),
        advice: Vec::new(),
    };
    findings.advice = advice(&findings);
    findings
}

/// Files and folders that name drivers, by variables.
fn vendor_places(variable: impl Fn(&str) -> Option<String>) -> Vec<PathBuf> {
    let set = VENDOR_VARIABLES.iter().filter_map(|name| variable(name));
    let set = set.filter(|value| !value.is_empty());
    let mut places: Vec<PathBuf> = set.map(PathBuf::from).collect();
    places.dedup();
    match places.is_empty() && cfg!(unix) {
        true => vec![VENDORS.into()],
        false => places,
    }
}

/// Drivers that a place names, as loaders take it: every file of a folder that ends in `.icd`, one such file, which is in [`VENDORS`] if
/// no folder is given, or else a library itself.
fn drivers_of(place: &Path) -> Vec<Driver> {
    let is_icd = |file: &Path| file.extension().is_some_and(|e| e == "icd");
    let mut files: Vec<PathBuf> = match place.is_dir() {
        true => {
            let entries = fs::read_dir(place).into_iter().flatten().flatten();
            let files = entries.map(|entry| entry.path());
            files.filter(|file| is_icd(file)).collect()
        }
        false if is_icd(place) && place.components().count() == 1 => {
            vec![Path::new(VENDORS).join(place)]
        }
        false if is_icd(place) => vec![place.to_path_buf()],
        // Systems without a driver have no such folder.
        false if place == Path::new(VENDORS) => Vec::new(),
        false => {
            let variables = VENDOR_VARIABLES.join(" or ");
            return vec![driver(&variables, &place.to_string_lossy())];
        }
    };
    files.sort();
    let named = |file: &PathBuf| match crate::base::files::read(file) {
        Ok(bytes) => {
            let text = String::from_utf8_lossy(&bytes).into_owned();
            let library = text.lines().next().unwrap_or_default().trim().to_owned();
            driver(&file.display().to_string(), &library)
        }
        Err(error) => Driver {
            named_by: file.display().to_string(),
            library: String::new(),
            failure: Some(error.to_string()),
        },
    };
    files.iter().map(named).collect()
}

fn driver(named_by: &str, library: &str) -> Driver {
    let failure = match library {
        "" => Some("names no library".to_owned()),
        library => libraries::load(OsStr::new(library)).err(),
    };
    Driver {
        named_by: named_by.to_owned(),
        library: library.to_owned(),
        failure,
    }
}

fn examined(info: DeviceInfo) -> Examined {
    let tried = || -> Result<()> {
        let device = Device::open(Some(&info.index.to_string()))?;
        let defines = Defines::new(device.tuning());
        Kernels::new(&device, defines)
            .build::<f32>("scan")
            .map(drop)
    };
    Examined {
        failure: tried().err().map(|error| error.to_string()),
        info,
    }
}

/// Libraries of the loader that the system has mapped into the process.
fn loader() -> Vec<PathBuf> {
    let maps = fs::read_to_string("/proc/self/maps").unwrap_or_default();
    let paths = maps
        .lines()
        .filter_map(|line| line.split_whitespace().nth(5));
    let mut found: Vec<PathBuf> = paths
        .filter(|path| path.contains("libOpenCL"))
        .map(PathBuf::from)
        .collect();
    found.sort();
    found.dedup();
    found
}

fn nodes(folder: &str, names: &[&str]) -> Vec<Node> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let wanted = |path: &PathBuf| {
        let name = path.file_name().and_then(OsStr::to_str).unwrap_or("");
        !path.is_dir() && names.iter().any(|n| name.starts_with(n))
    };
    let mut paths: Vec<PathBuf> = entries.map(|e| e.path()).filter(wanted).collect();
    paths.sort();
    let node = |path: PathBuf| {
        let opened = fs::OpenOptions::new().read(true).write(true).open(&path);
        let failure = opened.err();
        Node {
            group: group_of(&path),
            denied: failure
                .as_ref()
                .is_some_and(|e| e.kind() == ErrorKind::PermissionDenied),
            failure: failure.map(|e| e.to_string()),
            path,
        }
    };
    paths.into_iter().map(node).collect()
}

#[cfg(unix)]
fn group_of(path: &Path) -> Option<String> {
    use std::os::unix::fs::MetadataExt;
    let id = fs::metadata(path).ok()?.gid().to_string();
    let groups = fs::read_to_string("/etc/group").unwrap_or_default();
    let mut fields = groups.lines().map(|l| l.split(':').collect::<Vec<_>>());
    let found = fields.find(|f| f.get(2) == Some(&id.as_str()));
    Some(found.map_or(id.clone(), |f| f[0].to_owned()))
}

#[cfg(not(unix))]
fn group_of(_: &Path) -> Option<String> {
    None
}

/// Limits of the process (`ulimit`), of its container (cgroup), and the memory that is available.
fn limits() -> Vec<Limit> {
    let mut all = Vec::new();
    let mut add = |name: &str, value: &str| {
        all.push(Limit {
            name: name.to_owned(),
            value: value.trim().to_owned(),
        });
    };
    let text = fs::read_to_string("/proc/self/limits").unwrap_or_default();
    for name in ["Max address space", "Max processes", "Max open files"] {
        let rest = text.lines().find_map(|l| l.strip_prefix(name));
        if let Some(soft) = rest.and_then(|r| r.split_whitespace().next()) {
            add(name, soft);
        }
    }
    let own = fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    let own = own.lines().find_map(|l| l.strip_prefix("0::/"));
    let root = Path::new(CGROUPS);
    let group = root.join(own.unwrap_or(""));
    if let Some(bytes) = smallest(root, &group, "memory.max") {
        add("container, memory", &format!("{} MiB", bytes >> 20));
    }
    if let Some(count) = smallest(root, &group, "pids.max") {
        add("container, processes", &count.to_string());
    }
    let memory = fs::read_to_string("/proc/meminfo").unwrap_or_default();
    if let Some(bytes) = crate::capture::source::parse_available(&memory) {
        add("memory available", &format!("{} MiB", bytes >> 20));
    }
    all
}

/// Smallest number in the files of that name from a group of processes up to the root of all, each of which holds for what is below it;
/// `None` if none of them limits anything (`max`).
fn smallest(root: &Path, group: &Path, file: &str) -> Option<u64> {
    let places = group.ancestors().take_while(|p| p.starts_with(root));
    let texts = places.filter_map(|p| fs::read_to_string(p.join(file)).ok());
    texts.filter_map(|text| text.trim().parse().ok()).min()
}

/// What to do about findings.
fn advice(f: &Findings) -> Vec<String> {
    let mut advice = Vec::new();
    for d in f.drivers.iter().filter(|d| d.failure.is_some()) {
        let why = d.failure.clone().unwrap_or_default();
        advice.push(format!(
            "the driver that {} names does not load ({why}): install what it lacks, or do not name it there",
            d.named_by
        ));
    }
    for n in &f.nodes {
        let Some(why) = &n.failure else { continue };
        let path = n.path.display();
        let group = n.group.as_deref().unwrap_or("render");
        advice.push(match n.denied {
            true => format!(
                "{path} may not be opened: become a member of its group (`sudo usermod -aG {group} $USER`, then log in again), or pass the device to the container"
            ),
            false => format!("{path} cannot be opened: {why}"),
        });
    }
    for d in f.devices.iter().filter(|d| d.failure.is_some()) {
        let why = d.failure.clone().unwrap_or_default();
        advice.push(format!("device {} cannot be used: {why}", d.info.index));
    }
    if !f.usable() {
        let system = system();
        let ours = INSTALL
            .iter()
            .filter(|(name, _)| system.is_none_or(|s| s == *name));
        advice.extend(ours.map(|(name, what)| format!("install a driver; {name}: {what}")));
    }
    advice
}

/// Name in [`INSTALL`] of the system that this is; `None` for one that is not there.
fn system() -> Option<&'static str> {
    if cfg!(target_os = "macos") {
        return Some("macOS");
    }
    if cfg!(windows) {
        return Some("Windows");
    }
    let release = fs::read_to_string("/etc/os-release").unwrap_or_default();
    distribution(&release)
}

/// Name in [`INSTALL`] of the distribution that an os-release file describes.
fn distribution(release: &str) -> Option<&'static str> {
    let value = |key: &str| release.lines().find_map(|l| l.strip_prefix(key));
    let names = [value("ID="), value("ID_LIKE=")].into_iter().flatten();
    let mut words = names.flat_map(|v| v.trim_matches('"').split(' '));
    words.find_map(|word| match word {
        "debian" | "ubuntu" => Some("Debian, Ubuntu"),
        "fedora" | "rhel" | "centos" => Some("Fedora"),
        "arch" => Some("Arch"),
        _ => None,
    })
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::{INSTALL, VENDORS, distribution, drivers_of, smallest, vendor_places};

    #[test]
    fn systems_are_known_by_what_they_are_like() {
        let known = |text: &str| distribution(text);
        assert_eq!(known("NAME=x\nID=debian\n"), Some("Debian, Ubuntu"));
        assert_eq!(
            known("ID=linuxmint\nID_LIKE=\"ubuntu debian\""),
            Some("Debian, Ubuntu")
        );
        assert_eq!(known("ID=manjaro\nID_LIKE=arch"), Some("Arch"));
        assert_eq!(
            known("ID=\"rocky\"\nID_LIKE=\"rhel centos fedora\""),
            Some("Fedora")
        );
        assert_eq!(known("ID=nixos"), None);
        for text in ["ID=debian", "ID=fedora", "ID=arch"] {
            assert!(INSTALL.iter().any(|(name, _)| known(text) == Some(name)));
        }
    }

    #[test]
    fn drivers_are_tried() {
        let dir = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
        write("a.icd", "libthere-is-none.so.7\n");
        write("b.icd", "");
        write("c.txt", "libc.so.6");
        let found = drivers_of(dir.path());
        assert_eq!(found.len(), 2);
        assert_eq!(found[0].library, "libthere-is-none.so.7");
        assert!(found[0].failure.as_ref().unwrap().contains("there-is-none"));
        assert!(found[1].failure.as_ref().unwrap().contains("no library"));
        let one = drivers_of(&dir.path().join("gone.icd"));
        assert!(one[0].failure.is_some());
        let bare = drivers_of(Path::new("there-is-none.icd"));
        assert!(bare[0].named_by.starts_with(VENDORS) && bare[0].failure.is_some());
        // What is no folder and does not end so is a library, and no text that names one.
        let library = dir.path().join("c.txt");
        let direct = drivers_of(&library);
        assert_eq!(direct[0].library, library.to_str().unwrap());
        assert!(direct[0].failure.is_some());
        let named = drivers_of(Path::new("libthere-is-none.so.7"));
        assert_eq!(named[0].library, "libthere-is-none.so.7");
    }

    #[test]
    fn the_smallest_limit_above_a_process_holds() {
        let dir = tempfile::tempdir().unwrap();
        let (root, group) = (dir.path(), dir.path().join("a/b"));
        std::fs::create_dir_all(&group).unwrap();
        let write = |place: &Path, text: &str| std::fs::write(place.join("m"), text).unwrap();
        write(&group, "max\n");
        assert_eq!(smallest(root, &group, "m"), None);
        write(&root.join("a"), "4096\n");
        write(root, "8192\n");
        assert_eq!(smallest(root, &group, "m"), Some(4096));
        assert_eq!(smallest(&group, &group, "m"), None);
    }

    #[test]
    fn variables_say_where_drivers_are_named() {
        let set = |name: &str| (name == "OCL_ICD_VENDORS").then(|| "/opt/icd".to_owned());
        assert_eq!(vendor_places(set), [std::path::PathBuf::from("/opt/icd")]);
        assert_eq!(
            vendor_places(|_| Some(String::new())).len(),
            usize::from(cfg!(unix))
        );
    }
}
