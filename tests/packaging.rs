//! Texts of containers and clusters, which are checked without a container engine or Slurm.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::cli::{program, room, stderr};

/// Packages of a container beside those that `.ci/install` installs, with the reason.
const MORE: [&str; 1] = [
    // The loader without the files for building.
    "ocl-icd-libopencl1",
];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn text(name: &str) -> String {
    fs::read_to_string(root().join(name)).unwrap()
}

/// Instructions of a Containerfile, those over several lines as one.
fn instructions(file: &str) -> Vec<String> {
    let lines = file.lines().filter(|line| !line.starts_with('#'));
    let joined = lines.collect::<Vec<_>>().join("\n").replace("\\\n", " ");
    joined.lines().map(|l| l.trim().to_owned()).collect()
}

/// Files that are copied from the repository.
fn copied(file: &str) -> Vec<String> {
    let copies = instructions(file).into_iter();
    let copies = copies.filter_map(|l| l.strip_prefix("COPY ").map(str::to_owned));
    let own = copies.filter(|l| !l.starts_with("--from"));
    own.flat_map(|line| {
        let mut names: Vec<String> = line.split_whitespace().map(str::to_owned).collect();
        names.pop();
        names
    })
    .collect()
}

/// Packages that are installed.
fn installed(file: &str) -> Vec<String> {
    let mut names = Vec::new();
    for line in instructions(file) {
        for part in line
            .split("&&")
            .filter(|part| part.contains("apt-get install"))
        {
            let words = part
                .split_whitespace()
                .skip_while(|w| *w != "install")
                .skip(1);
            names.extend(words.filter(|w| !w.starts_with('-')).map(str::to_owned));
        }
    }
    names
}

/// True if `.ci/install` or `.ci/mpi` names the package as a whole word.
fn is_known(package: &str) -> bool {
    let named = |script: &str| {
        let script = text(script);
        let mut words = script.split(|c: char| !(c.is_alphanumeric() || c == '-'));
        words.any(|word| word == package)
    };
    MORE.contains(&package) || named(".ci/install") || named(".ci/mpi")
}

#[test]
fn the_container_takes_what_there_is() {
    let file = text(".packaging/Containerfile");
    let names = copied(&file);
    for needed in ["Cargo.toml", "Cargo.lock", "build.rs", "kernels", "src"] {
        assert!(names.iter().any(|n| n == needed), "{needed}: {names:?}");
    }
    for name in &names {
        assert!(root().join(name).exists(), "{name}");
    }
    // Every target of the manifest has its file.
    for folder in ["benches", "tests/main.rs"] {
        assert!(names.iter().any(|n| n == folder), "{folder}: {names:?}");
    }
    let packages = installed(&file);
    assert!(packages.len() >= 3, "{packages:?}");
    for package in &packages {
        assert!(is_known(package), "{package} is in no list");
    }
    let manifest = text("Cargo.toml");
    let version = manifest.split("rust-version = \"").nth(1).unwrap();
    let version = version.split('"').next().unwrap();
    assert!(file.contains(&format!("rust:{version}-")), "{version}");
    assert!(file.contains("POCL_CACHE_DIR=/cache/"));
}

#[test]
fn wrong_containers_are_found() {
    let wrong = "FROM x\n# COPY none /\nCOPY a b \\\n  c/d /to/\nCOPY --from=build /e /f\n\
        RUN apt-get update && apt-get install -y one \\\n two && rm three\n";
    assert_eq!(copied(wrong), ["a", "b", "c/d"]);
    assert_eq!(installed(wrong), ["one", "two"]);
    assert!(!is_known("opencl") && is_known("pocl-opencl-icd"));
}

/// A container's user has no home, and nothing but its output and the cache can be written. PoCL would count
/// the compiler's warnings on stderr, most of them on processors without AVX-512.
#[test]
fn training_needs_no_home_and_kernels_compile_in_silence() {
    let dir = tempfile::tempdir().unwrap();
    let (run, cache) = (dir.path().join("run"), dir.path().join("pocl"));
    // Where not even root can make a folder.
    let nowhere = "/proc/nowhere";
    let homeless = |cache: &Path| {
        let mut command = program();
        command.env("HOME", nowhere).env_remove("XDG_CACHE_HOME");
        command.env("POCL_CACHE_DIR", cache);
        command
    };
    let mut command = homeless(&cache);
    command.args(["train", &room(), "-o", crate::cli::text(&run)]);
    command.args(["--iterations", "20", "--max-size", "48"]);
    let trained = command.output().unwrap();
    assert!(trained.status.success(), "{}", stderr(&trained));
    assert!(run.join("scene.ply").is_file());
    assert!(
        !stderr(&trained).contains(" generated."),
        "{}",
        stderr(&trained)
    );
    let refused = homeless(Path::new(nowhere))
        .arg("devices")
        .output()
        .unwrap();
    // Other drivers have no such folder.
    if !refused.status.success() {
        crate::faults::refuses(&refused, &["no device found", "POCL_CACHE_DIR"]);
    }
}

/// The scripts of the guide, as they stand there.
fn scripts() -> Vec<String> {
    let guide = text("docs/guide/clusters.md");
    let begins = guide.match_indices("    #!/bin/bash\n").map(|(at, _)| at);
    let script = |at: usize| {
        let lines = guide[at..].lines().take_while(|l| l.starts_with("    "));
        lines.map(|l| format!("{}\n", l.trim())).collect()
    };
    begins.map(script).collect()
}

/// Runs a script with an `srun` that notes its command and ends as told; returns its exit code and what was noted.
fn queued(dir: &Path, script: &str, ends: i32) -> (i32, String) {
    let notes = dir.join("notes");
    let _ = fs::remove_file(&notes);
    for name in ["srun", "scontrol"] {
        let file: PathBuf = dir.join(name);
        let own = format!(
            "#!/bin/bash\necho {name} \"$SRUN_CPUS_PER_TASK\" \"$@\" >> {notes:?}\nexit {ends}\n"
        );
        fs::write(&file, own).unwrap();
        fs::set_permissions(&file, fs::Permissions::from_mode(0o755)).unwrap();
    }
    let path = format!("{}:{}", dir.display(), std::env::var("PATH").unwrap());
    let run = Command::new("bash")
        .args(["-uc", script])
        .env("PATH", path)
        .envs([("SLURM_CPUS_PER_TASK", "16"), ("SLURM_JOB_ID", "77")])
        .envs([
            ("SLURM_ARRAY_TASK_ID", "3"),
            ("SLURM_ARRAY_TASK_COUNT", "8"),
            ("SLURM_ARRAY_JOB_ID", "70"),
        ])
        .output()
        .unwrap();
    let said = fs::read_to_string(&notes).unwrap_or_default();
    (run.status.code().unwrap(), said)
}

#[test]
fn jobs_of_the_guide_queue_themselves_again_and_share_the_runs() {
    let dir = tempfile::tempdir().unwrap();
    let scripts = scripts();
    let [nodes, cells, train, array] = &scripts[..] else {
        panic!("{scripts:?}")
    };
    for (script, how, job) in [
        (
            nodes,
            " --mpi=pmix --kill-on-bad-exit=1 mhsplat train dataset -o run",
            "77",
        ),
        (cells, " mhsplat train parts/cell-3 -o parts/run-3", "70_3"),
        (train, " mhsplat train dataset -o run", "77"),
    ] {
        let (code, said) = queued(dir.path(), script, 130);
        assert_eq!(code, 130);
        let begins = format!("srun 16{how} --resume-or-start");
        let again = format!("scontrol 16 requeue {job}\n");
        assert!(
            said.starts_with(&begins) && said.ends_with(&again),
            "{said}"
        );
        for ends in [0, 2] {
            let (code, said) = queued(dir.path(), script, ends);
            assert!(code == ends && !said.contains("requeue"), "{said}");
        }
    }
    let (_, said) = queued(dir.path(), array, 0);
    assert_eq!(
        said,
        "srun 16 mhsplat experiment room.toml -o out --shard 3/8\n"
    );
}
