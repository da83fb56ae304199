//! The options of a configuration that were typed on the command line.

use clap::parser::ValueSource;
use clap::{Arg, ArgMatches, Args, Command, FromArgMatches};

use mhsplat::base::error::{Error, Result};
use mhsplat::config::{MhConfig, RUN_CONTROL, Surrogate, TrainConfig};

/// The options of a configuration that have flags.
#[derive(Args)]
struct Flags {
    #[command(flatten)]
    config: TrainConfig,
    /// Measure of a birth's effect on the loss, for the mh sampler; unless mh.birth says otherwise, births are faint where a probe estimates them, and do not split their sources.
    #[arg(long, value_enum, default_value_t = MhConfig::default().surrogate)]
    surrogate: Surrogate,
}

/// Flags of [`TrainConfig`] that win over a configuration file: only those that were typed. Goes with an option `resume`, which
/// conflicts with all of them but [`RUN_CONTROL`] and the number of iterations.
pub struct Overrides(ArgMatches);

impl Overrides {
    /// Returns true if a flag says how long the run is.
    pub fn set_length(&self) -> bool {
        ["iterations", "time_budget", "budget_cpu"]
            .iter()
            .any(|id| self.0.contains_id(id))
    }

    /// Returns the number of iterations that was typed.
    pub fn iterations(&self) -> Option<u32> {
        self.0.get_one("iterations").copied()
    }

    /// Returns the first key in which two configurations differ and which a resumed run may not change; `None` if there is none.
    pub fn fixed_difference(a: &TrainConfig, b: &TrainConfig) -> Option<String> {
        let flags = Flags::augment_args(Command::new("options"));
        let control = |arg: &&Arg| arg.get_help_heading() == Some(RUN_CONTROL);
        let control = flags.get_arguments().filter(control);
        let names: Vec<&str> = control.filter_map(Arg::get_long).collect();
        let [a, b] = [a, b].map(|config| serde_json::to_value(config).unwrap_or_default());
        let fixed = |key: &&String| !names.contains(&key.as_str()) && *key != "lengths";
        let keys = a.as_object()?.keys().filter(fixed);
        let mut other = keys.filter(|key| a.get(key) != b.get(key));
        other.next().cloned()
    }

    /// Returns `config` with the typed flags in place of its own values.
    pub fn over(&self, mut config: TrainConfig) -> Result<TrainConfig> {
        let typed = |id: &str| self.0.contains_id(id);
        // One kind of budget takes the place of the other.
        if typed("time_budget") || typed("budget_cpu") {
            (config.time_budget, config.budget_cpu) = (None, None);
        }
        let wrong = |e: clap::Error| Error::config("train", e.to_string());
        let surrogate = config.mh.surrogate;
        let mut flags = Flags { config, surrogate };
        flags.update_from_arg_matches(&self.0).map_err(wrong)?;
        flags.config.mh.surrogate = flags.surrogate;
        Ok(flags.config)
    }
}

impl FromArgMatches for Overrides {
    fn from_arg_matches(matches: &ArgMatches) -> clap::error::Result<Self> {
        let mut typed = matches.clone();
        for id in matches.ids() {
            // An update takes a default for a value, too.
            if matches.value_source(id.as_str()) != Some(ValueSource::CommandLine) {
                let _ = typed.try_clear_id(id.as_str());
            }
        }
        Ok(Self(typed))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> clap::error::Result<()> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl Args for Overrides {
    fn augment_args(command: Command) -> Command {
        let before = command.get_arguments().count();
        let options = Flags::augment_args(Command::new("options"));
        let fixed_on_resume = |(place, arg): (usize, &Arg)| {
            let arg = arg.clone().display_order(before + place);
            match arg.get_help_heading() {
                Some(RUN_CONTROL) => arg,
                // A run goes on to another end.
                _ if arg.get_id() == "iterations" => arg,
                _ => arg.conflicts_with("resume"),
            }
        };
        command.args(options.get_arguments().enumerate().map(fixed_on_resume))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}
