//! The Python module around the program.

use std::process::{Command, Output};

/// Runs a script with the module and this build's program in an empty folder; `None`, said, where there is no Python.
fn python(script: &str) -> Option<Output> {
    let root = env!("CARGO_MANIFEST_DIR");
    let folder = tempfile::tempdir().unwrap();
    let ran = Command::new("python3")
        .args(["-B", "-c", script])
        .current_dir(&folder)
        .env("PYTHONPATH", format!("{root}/.packaging/python"))
        .env("MHSPLAT_PROGRAM", env!("CARGO_BIN_EXE_mhsplat"))
        .env("ROOM", format!("{root}/data/room-tiny"))
        .output();
    match ran {
        Ok(output) => Some(output),
        Err(_) => {
            println!("skipped: python3 is not installed");
            None
        }
    }
}

/// Runs a script that asserts what holds.
fn holds(script: &str) {
    let Some(output) = python(script) else { return };
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
}

#[test]
fn a_run_from_python_has_its_figures_and_pages() {
    holds(
        r#"
import os, mhsplat
room = os.environ["ROOM"]
run = mhsplat.train(room, output="run", iterations=40, max_size=48, eval_every=20, export=["splat", "spz"], quiet=True, json=False)
assert [row["iteration"] for row in run.metrics] == [20, 40], run.metrics
last = run.metrics[-1]
assert isinstance(last["gaussians"], int) and abs(last["psnr"] - run.final["psnr"]) < 1e-9
assert run.record["config"]["iterations"] == 40 and run.record["config"]["max-size"] == 48
assert run.scene.stat().st_size > 10_000
assert run.viewer(show=False).name == "scene.html" and run.report(show=False).name == "report.html"
scores = mhsplat.command("eval", run.path, json=True)
assert abs(scores["psnr"] - run.final["psnr"]) < 0.01, scores
assert repr(mhsplat.Run("run")) == "Run('run')"
assert mhsplat.command("completions", "bash").startswith("_mhsplat")
"#,
    );
}

/// A terminal interrupts all programs that it runs, and Python ends the run that it began: the run has it once.
#[cfg(unix)]
#[test]
fn an_interrupt_leaves_a_checkpoint() {
    holds(
        r#"
import os, signal, subprocess, sys, time
script = "import os, mhsplat; mhsplat.train(os.environ['ROOM'], output='run', iterations=200000, max_size=48, eval_every=50)"
child = subprocess.Popen([sys.executable, "-c", script], start_new_session=True, stderr=subprocess.PIPE, text=True)
for _ in range(1200):
    if os.path.exists("run/metrics.csv") or child.poll() is not None:
        break
    time.sleep(0.05)
os.killpg(child.pid, signal.SIGINT)
said = child.communicate(timeout=60)[1]
assert child.returncode != 0 and "KeyboardInterrupt" in said, said
assert os.path.exists("run/checkpoint/state.safetensors"), said
"#,
    );
}

#[test]
fn what_the_program_refuses_is_an_error_with_its_message() {
    holds(
        r#"
import mhsplat
def fails(kind, call):
    try:
        call()
    except kind as error:
        return error
    raise AssertionError("no error")
error = fails(mhsplat.Error, lambda: mhsplat.train("missing-folder", output="run"))
assert error.code == 2 and "missing-folder" in str(error), error
error = fails(mhsplat.Error, lambda: mhsplat.train("x", output="run", iterations=-5))
assert error.code == 2 and "-5" in str(error), error
error = fails(mhsplat.Error, lambda: mhsplat.command("train", "x", no_such_option=True))
assert error.code == 2 and "--no-such-option" in str(error), error
assert "run.json" in str(fails(FileNotFoundError, lambda: mhsplat.Run(".")))
"#,
    );
}
