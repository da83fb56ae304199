//! `mhsplat experiment`.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::cli::common::{Common, DeviceOption, Outcome};
use crate::cli::lab::Form;
use crate::cli::output;
use mhsplat::base::error::{Error, Result};
use mhsplat::config::parse_duration;
use mhsplat::lab::experiment;
use mhsplat::lab::experiment::{Experiment, Job, Launch, Outcome as Ended, Shard};

/// Arguments.
#[derive(clap::Args)]
pub struct ExperimentArgs {
    /// TOML file: output, budget, seeds, cap-from, [train], [[scene]] and [[setting]]; see data/experiments.
    file: PathBuf,
    /// Folder that the scenes' paths are relative to [default: the file's]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Folder of all runs: a new one, or that of the same experiment, which goes on [default: the file's output]
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Time for this session (90s, 10m, 3h) [default: the file's budget]
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    budget: Option<f64>,
    /// Train every N-th run alone, from the I-th on, for job arrays: I of 1 to N is another part for each job.
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,
    /// List the runs with their states, and train nothing.
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    device: DeviceOption,
    #[command(flatten)]
    form: Form,
}

/// Trains what is missing and writes the comparisons.
pub fn run(args: &ExperimentArgs, common: &Common) -> Result<Outcome> {
    let mut experiment = Experiment::read(&args.file, args.data.as_deref())?;
    if let Some(dir) = &args.output {
        experiment.output.clone_from(dir);
    }
    experiment.budget = args.budget.or(experiment.budget);
    experiment.shard = args.shard;
    if args.dry_run {
        return list(&experiment, common.json);
    }
    let stop = crate::cli::signals::stop_flag();
    let mut processes = Processes {
        device: args.device.selector(),
        threads: args.device.threads(),
        stop: stop.clone(),
        began: Instant::now(),
    };
    let mut note = |text: &str| output::note(text);
    let ended = experiment::run(&experiment, &mut processes, &stop, &mut note);
    if matches!(ended, Err(Error::Interrupted)) {
        output::note("stopped; run the same command to resume");
    }
    let ended = ended?;
    if args.shard.is_none() || experiment::is_complete(&experiment) {
        compare(&experiment, &ended, args, common)?;
    } else {
        if common.json {
            output::json(&ended)?;
        }
        let done = ended.done;
        output::note(&format!(
            "{done} runs of this shard are done; after those of all shards the command without --shard compares them"
        ));
    }
    if ended.left > 0 {
        output::note(&format!(
            "the budget ended before {} runs; run the same command to resume",
            ended.left
        ));
    }
    for (run, why) in &ended.failed {
        output::note(&format!("failed: {run}: {why}"));
    }
    match ended.failed.first() {
        None => Ok(Outcome::Done),
        Some((run, why)) => Err(Error::input(
            run,
            format!("failed ({why}); {} runs failed in all", ended.failed.len()),
            "the same command tries them again",
        )),
    }
}

/// Writes the comparisons and prints them.
fn compare(e: &Experiment, ended: &Ended, args: &ExperimentArgs, common: &Common) -> Result<()> {
    let summary = experiment::write(e)?;
    if common.json {
        output::json(&summary)?;
    } else {
        args.form.print(&summary.report());
    }
    let page = e.output.join("summary.html");
    output::note(&format!(
        "{} runs done; page: {}",
        ended.done,
        page.display()
    ));
    Ok(())
}

/// A run of the matrix with its state.
#[derive(serde::Serialize)]
struct Listed {
    run: String,
    state: &'static str,
    why: String,
}

fn list(experiment: &Experiment, json: bool) -> Result<Outcome> {
    experiment.check_scenes()?;
    let mut all = Vec::new();
    for run in experiment::mine(experiment).iter().flatten() {
        let found = experiment::look(experiment, run);
        let (state, why) = found.words();
        all.push(Listed {
            run: run.dir.display().to_string(),
            state,
            why,
        });
    }
    if json {
        output::json(&all)?;
    } else {
        for l in &all {
            output::line(&format!("{}: {}: {}", l.run, l.state, l.why));
        }
    }
    Ok(Outcome::Done)
}

/// Trains each run in a process of its own, as by hand.
struct Processes {
    device: Option<String>,
    threads: Option<usize>,
    stop: Arc<AtomicBool>,
    began: Instant,
}

impl Processes {
    fn command(&self, job: &Job) -> Result<Command> {
        // All runs by the program that is running now, even where a newer one has taken its place on disk.
        let program = match Path::new("/proc/self/exe") {
            linux if linux.exists() => linux.to_path_buf(),
            _ => std::env::current_exe().map_err(|e| Error::io("mhsplat", e))?,
        };
        let mut command = Command::new(program);
        command.arg("train").arg(&job.dataset);
        if job.resume {
            command.arg("--resume").arg(&job.dir);
        } else {
            command.arg("-o").arg(&job.dir);
            command.arg("--config").arg(&job.config);
        }
        if let Some(device) = &self.device {
            command.arg("--device").arg(device);
        }
        if let Some(threads) = self.threads {
            command.arg("--threads").arg(threads.to_string());
        }
        command.arg("--until-stdin-ends");
        command
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        Ok(command)
    }

    /// Waits for the end; if the user asks to stop, ends the stdin of the process, which stops it.
    fn wait(&self, child: &mut Child) -> Result<ExitStatus> {
        loop {
            if self.stop.load(Ordering::Relaxed) {
                drop(child.stdin.take());
            }
            let ended = child
                .try_wait()
                .map_err(|e| Error::io("mhsplat train", e))?;
            if let Some(status) = ended {
                return Ok(status);
            }
            std::thread::sleep(Duration::from_millis(50));
        }
    }
}

impl Launch for Processes {
    fn train(&mut self, job: &Job) -> Result<()> {
        let spawned = self.command(job)?.spawn();
        let mut child = spawned.map_err(|e| Error::io("mhsplat train", e))?;
        let lines = child
            .stderr
            .take()
            .map(|stderr| std::thread::spawn(move || experiment::last_error(stderr)));
        let status = self.wait(&mut child)?;
        let said = lines.and_then(|l| l.join().ok()).flatten();
        match status.code() {
            Some(0) => Ok(()),
            Some(130) => Err(Error::Interrupted),
            _ if self.stop.load(Ordering::Relaxed) => Err(Error::Interrupted),
            _ => {
                let said = said.unwrap_or_else(|| status.to_string());
                let what = said.trim_start_matches("error: ").to_owned();
                Err(Error::input(&job.dir, what, "train it by hand to see more"))
            }
        }
    }

    fn seconds(&self) -> f64 {
        self.began.elapsed().as_secs_f64()
    }
}
