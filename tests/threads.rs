//! The number of cores: as asked for, as the process may use, and without a bearing on results.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::cli::{mhsplat, program, room, stderr, text};
use crate::faults::{refuses, shim};
use mhsplat::base::cores::Cores;
use mhsplat::device::Device;
use mhsplat::run::RunRecord;
use serde_json::Value;

/// Cores that this process may use.
fn most() -> usize {
    Cores::allowed().count()
}

/// A machine with one core has nothing to divide.
fn has_two() -> bool {
    let two = most() > 1;
    if !two {
        println!("skipped: one core");
    }
    two
}

/// Gives a command the environment of another one.
fn surround(outer: &mut Command, inner: &Command) {
    for (name, value) in inner.get_envs() {
        match value {
            Some(value) => outer.env(name, value),
            None => outer.env_remove(name),
        };
    }
}

/// The command on the first core that this process may use; `None` without `taskset`.
fn on_one_core(command: &Command) -> Option<Command> {
    let mut mine = Command::new("taskset");
    mine.args(["-cp", &std::process::id().to_string()]);
    let listed = String::from_utf8(mine.output().ok()?.stdout).ok()?;
    let core = listed.rsplit(' ').next()?.split([',', '-']).next()?.trim();
    let mut bound = Command::new("taskset");
    bound.args(["-c", core]).arg(command.get_program());
    bound.args(command.get_args());
    surround(&mut bound, command);
    Some(bound)
}

/// A short training with these options.
fn training(run: &Path, options: &[&str]) -> Command {
    let mut command = program();
    command.args(["train", &room(), "-o", text(run), "-q"]);
    command.args(["--iterations", "300", "--max-size", "64", "--device", "cpu"]);
    command.args(options);
    command
}

fn trained(mut command: Command) {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
}

#[test]
fn the_number_of_cores_changes_no_byte_of_a_scene() {
    let dir = tempfile::tempdir().unwrap();
    if !has_two() {
        return;
    }
    let [one, two] = ["1", "2"].map(|n| {
        let run = dir.path().join(n);
        trained(training(&run, &["--threads", n]));
        run
    });
    let scenes = [&one, &two].map(|run| fs::read(run.join("scene.ply")).unwrap());
    assert!(scenes[0] == scenes[1], "the scenes differ");
    let cores = [one, two].map(|run| RunRecord::read(&run).unwrap().device.cores);
    assert_eq!(cores, [Some(1), Some(2)]);
}

#[test]
fn numbers_that_cannot_be_are_refused() {
    let more = (most() + 1).to_string();
    for wrong in ["0", &more] {
        for command in [
            &["train", "nowhere", "-o", "nowhere/run"][..],
            &["eval", "nowhere"],
            &["verify"],
            &["experiment", "nowhere.toml"],
        ] {
            let refused = mhsplat(&[command, &["--threads", wrong]].concat());
            let words = ["--threads: ", wrong, &format!("1 to {} expected", most())];
            refuses(&refused, &words);
        }
    }
    for wrong in ["-1", "x", "1.5"] {
        let refused = mhsplat(&["verify", "--threads", wrong]);
        refuses(&refused, &["--threads", wrong]);
    }
}

#[test]
fn a_library_can_take_fewer_cores() {
    if !has_two() {
        return;
    }
    for _ in 0..3 {
        let part = Device::open_on(Some("cpu"), Cores::new(Some(1)).unwrap()).unwrap();
        let whole = Device::open(Some("cpu")).unwrap();
        assert_eq!(part.info().cores, 1);
        assert_eq!(part.info().compute_units, whole.info().compute_units);
        assert_eq!(part.tuning(), whole.tuning());
    }
}

/// CPU seconds over seconds of a training, by `time` of the shell.
fn share(command: &Command) -> f64 {
    let script = "TIMEFORMAT='%R %U %S'; time \"$@\" 2>/dev/null >/dev/null";
    let mut shell = Command::new("bash");
    shell.args(["-c", script, "bash"]);
    shell.arg(command.get_program()).args(command.get_args());
    surround(&mut shell, command);
    let output = shell.output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let times: Vec<f64> = stderr(&output)
        .split_whitespace()
        .map(|t| t.parse().unwrap())
        .collect();
    let [wall, user, system] = times[..] else {
        panic!("{times:?}")
    };
    (user + system) / wall
}

#[test]
fn one_thread_takes_one_core() {
    if !has_two() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let one = share(&training(&dir.path().join("run"), &["--threads", "1"]));
    // The thread that enqueues works beside the device's; both cores are 1.6 and more with two.
    assert!(one < 1.3, "{one} CPU seconds per second");
}

#[test]
fn masks_and_schedulers_bound_the_cores() {
    if !has_two() {
        return;
    }
    let taken = |mut command: Command| -> Value {
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        let listed: Value = serde_json::from_slice(&output.stdout).unwrap();
        let devices = listed["devices"].as_array().unwrap().iter();
        let mut cpus = devices.filter(|d| d["kind"] == "cpu");
        cpus.next().unwrap()["cores"].clone()
    };
    let list = |given: Option<&str>| {
        let mut command = program();
        command.args(["devices", "--json"]);
        command.envs(given.map(|n| ("SLURM_CPUS_PER_TASK", n)));
        command
    };
    assert!(taken(list(None)).as_u64().unwrap() > 1);
    assert_eq!(taken(list(Some("1"))), 1);
    assert!(taken(list(Some("1000000"))).as_u64().unwrap() > 1);
    let Some(bound) = on_one_core(&list(None)) else {
        println!("skipped: no taskset");
        return;
    };
    assert_eq!(taken(bound), 1);
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    trained(on_one_core(&training(&run, &[])).unwrap());
    let device = RunRecord::read(&run).unwrap().device;
    assert_eq!(device.cores, Some(1));
    assert!(device.compute_units > device.cores);
    let more = on_one_core(&training(&run, &["--threads", "2"]));
    refuses(&more.unwrap().output().unwrap(), &["2; 1 to 1 expected"]);
}

/// A driver that divides no device: the whole of it is taken and that is told, unless a number was asked for.
#[test]
fn drivers_that_divide_nothing_are_told_of() {
    let dir = tempfile::tempdir().unwrap();
    let Some(library) = shim(dir.path()).filter(|_| has_two()) else {
        return;
    };
    let stubborn = |args: &[&str]| {
        let mut command = program();
        command.args(args).env("LD_PRELOAD", &library);
        command.env("MHSPLAT_FAULT", "clCreateSubDevices:1:-18");
        command.env("SLURM_CPUS_PER_TASK", "1").output().unwrap()
    };
    let listed = stubborn(&["devices"]);
    let line = crate::cli::stdout(&listed);
    assert!(line.contains("this process may use 1:"), "{line}");
    let asked = stubborn(&["verify", "--threads", "1", "--device", "cpu"]);
    let words = [
        "--threads: 1; ",
        "does not divide",
        "POCL_MAX_PTHREAD_COUNT",
    ];
    refuses(&asked, &words);
}
