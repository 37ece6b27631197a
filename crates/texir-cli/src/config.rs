//! Options of every command, and settings: `--config` gives defaults; what is typed wins.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde::{Deserialize, Serialize};
use texir_core::fit::{FitSettings, Mode};
use texir_core::text_file::read_text;
use toml::{Table, Value};

use crate::failure::Failure;

/// Options of every command.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Common options")]
pub struct Common {
    /// Device to compute on; `auto` prefers a GPU [default: auto]
    #[arg(long, global = true, value_enum)]
    pub backend: Option<BackendChoice>,
    /// Use the GPU adapter whose name contains NAME
    #[arg(long, global = true, value_name = "NAME")]
    pub adapter: Option<String>,
    /// Random seed; equal seeds give equal results on the same adapter [default: 0]
    #[arg(long, global = true, value_name = "N")]
    pub seed: Option<u32>,
    /// Take settings from a TOML file, such as the settings.toml of an earlier fit
    #[arg(long, global = true, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Override one setting, such as fit.full.alternations=0; repeatable
    #[arg(long = "set", global = true, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Print more detail
    #[arg(short, long, global = true)]
    pub verbose: bool,
    /// Print only results, warnings and errors
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    pub quiet: bool,
    /// Print results as JSON on standard output
    #[arg(long, global = true)]
    pub json: bool,
}

/// Device to compute on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BackendChoice {
    /// A hardware GPU if there is one, otherwise the CPU.
    #[default]
    Auto,
    /// A GPU, software adapters such as lavapipe included; fails without one.
    Gpu,
    /// The CPU.
    Cpu,
}

/// A `--config` file, and what `settings.toml` holds.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Where the passes run.
    pub backend: BackendChoice,
    /// Part of the GPU adapter's name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adapter: Option<String>,
    /// The fit, and the seed of everything random.
    pub fit: FitSettings,
    /// What was typed after `--set`.
    #[serde(skip)]
    set: Vec<String>,
}

impl Config {
    /// The file's settings, where one is given, under the typed ones.
    pub fn resolve(common: &Common) -> Result<Self, Failure> {
        // All settings are in it, so that one of several that belong together may be changed alone.
        let mut table = Table::try_from(Self::default()).unwrap_or_default();
        let mut file = Self::default();
        if let Some(path) = &common.config {
            merge(&mut table, read(path)?);
            file = from_table(&table, path.display())?;
        }
        for assignment in &common.set {
            let from = format!("--set {assignment}");
            let change: Table = assignment.parse().map_err(|_| {
                let is_number =
                    assignment.split_once('=').is_some_and(|(_, value)| value.trim().parse::<f64>().is_ok());
                let help = if is_number {
                    "a point needs digits on both sides, as in 0.5"
                } else {
                    "text needs quotes, and those need quotes of the shell, as in --set 'fit.mode=\"paper\"'"
                };
                Failure::new(format!("{from}: expected KEY=VALUE, the value as TOML has it")).help(help)
            })?;
            merge(&mut table, change);
            file = from_table(&table, &from)?;
        }
        // Those that belong together may only be right together.
        let all = common.config.iter().map(|path| path.display().to_string());
        let all: Vec<String> = all.chain(common.set.iter().map(|assignment| format!("--set {assignment}"))).collect();
        file.fit.validate().map_err(|e| wrong(all.join(", "), e))?;
        let seed = common.seed.unwrap_or(file.fit.seed);
        let config = Self {
            backend: common.backend.unwrap_or(file.backend),
            adapter: common.adapter.clone().or(file.adapter),
            fit: FitSettings { seed, ..file.fit },
            set: common.set.clone(),
        };
        if let (BackendChoice::Cpu, Some(adapter)) = (config.backend, &config.adapter) {
            return Err(Failure::new(format!("adapter \"{adapter}\" is a GPU's, but the backend is `cpu`"))
                .help("leave out --adapter, or use --backend gpu"));
        }
        Ok(config)
    }

    /// Errors where a setting was typed that the fit's mode does not read. (A file may hold those of both.)
    pub fn check_set(&self) -> Result<(), Failure> {
        // Each mode has a table of its own.
        let name = match self.fit.mode {
            Mode::Full => "paper",
            Mode::Paper => "full",
        };
        let help = format!("leave it out, or choose that mode (--set 'fit.mode=\"{name}\"')");
        self.refuse(|setting| setting == name, &format!("this setting applies only to --mode {name}"), &help)
    }

    /// The same of a command that fits in every mode.
    pub fn check_set_of_all_modes(&self) -> Result<(), Failure> {
        self.refuse(|setting| setting == "mode", "this command runs every mode", "leave it out")
    }

    /// The same of a command that fits nothing.
    pub fn check_set_without_fit(&self) -> Result<(), Failure> {
        let why = "this command runs no fit and ignores this setting";
        self.refuse(|setting| setting != "seed", why, "leave it out; --help lists what this command has instead")
    }

    /// Errors where one of the fit's settings was typed that `is_idle`.
    fn refuse(&self, is_idle: impl Fn(&str) -> bool, why: &str, help: &str) -> Result<(), Failure> {
        let sets_idle = |assignment: &&String| fit_of(assignment).keys().any(|setting| is_idle(setting));
        self.set
            .iter()
            .find(sets_idle)
            .map_or(Ok(()), |idle| Err(Failure::new(format!("--set {idle}: {why}")).help(help)))
    }
}

/// What an assignment sets of the fit.
fn fit_of(assignment: &str) -> Table {
    let table: Table = assignment.parse().unwrap_or_default();
    table.get("fit").and_then(Value::as_table).cloned().unwrap_or_default()
}

/// The settings of a table, the last of which come `from` somewhere.
fn from_table(table: &Table, from: impl Display) -> Result<Config, Failure> {
    table.clone().try_into().map_err(|e| wrong(from, e))
}

fn wrong(from: impl Display, what: impl Display) -> Failure {
    Failure::new(format!("{from}: {what}"))
        .help("every fit writes its settings to settings.toml, which is a complete example")
}

fn read(path: &Path) -> Result<Table, Failure> {
    read_text(path)?.parse().map_err(|e| Failure::new(format!("{}: {e}", path.display())))
}

/// Puts `change` into `table`, joining tables of one name.
fn merge(table: &mut Table, change: Table) {
    for (key, value) in change {
        match (table.get_mut(&key), value) {
            (Some(Value::Table(inner)), Value::Table(change)) => merge(inner, change),
            (_, value) => drop(table.insert(key, value)),
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use texir_core::fit::settings::AcceptanceSettings;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        common: Common,
    }

    fn common(arguments: &[&str]) -> Common {
        Line::try_parse_from(["texir"].iter().chain(arguments)).unwrap().common
    }

    #[test]
    fn typed_options_win_over_the_file() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "backend = \"cpu\"\n[fit]\nseed = 7\n").unwrap();
        let path = file.path().to_str().unwrap();
        let config = Config::resolve(&common(&["--config", path])).unwrap();
        assert_eq!((config.fit.seed, config.backend), (7, BackendChoice::Cpu));
        let config = Config::resolve(&common(&["--config", path, "--seed", "9"])).unwrap();
        assert_eq!((config.fit.seed, config.backend), (9, BackendChoice::Cpu));
    }

    #[test]
    fn single_settings_change() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "[fit.paper.stage_two]\nquantile = 0.3\n").unwrap();
        let path = file.path().to_str().unwrap();
        let config =
            Config::resolve(&common(&["--config", path, "--set", "fit.paper.stage_two.enabled=false"])).unwrap();
        assert_eq!((config.fit.paper.stage_two.enabled, config.fit.paper.stage_two.quantile), (false, 0.3));
        assert!(Config::resolve(&common(&["--set", "fit.paper.stage_two"])).is_err());
        // One of several that have no defaults of their own.
        let config = Config::resolve(&common(&["--set", "fit.full.roughness.colours.prior=0.25"])).unwrap();
        let usual = FitSettings::default().full.roughness.colours;
        assert_eq!(config.fit.full.roughness.colours, AcceptanceSettings { prior: 0.25, ..usual });
        let error = format!("{:?}", Config::resolve(&common(&["--set", "fit.mode=paper"])).unwrap_err());
        assert!(
            error.contains("--set fit.mode=paper: expected KEY=VALUE") && error.contains("text needs quotes"),
            "{error}"
        );
        let error =
            format!("{:?}", Config::resolve(&common(&["--set", "fit.paper.stage_two.quantile=.3"])).unwrap_err());
        assert!(error.contains("digits on both sides") && !error.contains("quotes"), "{error}");
        assert!(Config::resolve(&common(&["--set", "fit.mode=\"paper\""])).is_ok());
        assert!(Config::resolve(&common(&["--set", "fit.paper.stage_too.enabled=false"])).is_err());
    }

    #[test]
    fn what_is_wrong_is_said_of_where_it_was_written() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "[fit.paper.parameters]\nalbedo_range = [0.0, 0.9]\n").unwrap();
        let path = file.path().to_str().unwrap();
        let said = |set: &[&str]| {
            let set = set.iter().flat_map(|set| ["--set", set]);
            let arguments: Vec<&str> = ["--config", path].into_iter().chain(set).collect();
            Config::resolve(&common(&arguments)).err().map(|failure| failure.to_string()).unwrap_or_default()
        };
        let typed = said(&["fit.seed=3", "fit.emitter=3"]);
        assert!(typed.starts_with("--set fit.emitter=3: ") && typed.contains("emitter"), "{typed}");
        // One that is wrong beside another is neither's fault alone.
        let start = "fit.paper.parameters.albedo_start=0.95";
        let both = said(&[start]);
        assert!(both.starts_with(&format!("{path}, --set {start}: ")), "{both}");
        assert_eq!(said(&[start, "fit.paper.parameters.albedo_range=[0.0, 1.0]"]), "");
    }

    #[test]
    fn settings_of_the_fit_are_refused_where_nothing_is_fitted() {
        let checked = |set: &str| Config::resolve(&common(&["--set", set])).unwrap().check_set_without_fit();
        let error = format!("{:?}", checked("fit.atlas_size=256").unwrap_err());
        assert!(error.contains("--set fit.atlas_size=256"), "{error}");
        assert!(checked("fit.seed=3").is_ok() && checked("backend=\"cpu\"").is_ok());
    }

    #[test]
    fn settings_of_the_other_mode_are_refused() {
        let checked = |mode: &str, set: &str| {
            Config::resolve(&common(&["--set", &format!("fit.mode=\"{mode}\""), "--set", set])).unwrap().check_set()
        };
        for (mode, other, set) in
            [("full", "paper", "fit.paper.stage_two.enabled=false"), ("paper", "full", "fit={full={alternations=3}}")]
        {
            let error = format!("{:?}", checked(mode, set).unwrap_err());
            assert!(error.contains(set) && error.contains(&format!("fit.mode=\\\"{other}")), "{error}");
            assert!(checked(other, set).is_ok() && checked(mode, "fit.emitter_ratio = 3.0").is_ok());
        }
    }

    #[test]
    fn mistakes_name_the_file_and_the_field() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "[fit]\nsede = 7\n").unwrap();
        let path = file.path().to_str().unwrap();
        let error = Config::resolve(&common(&["--config", path])).unwrap_err().to_string();
        assert!(error.contains(path) && error.contains("sede"), "{error}");
        assert!(Config::resolve(&common(&["--backend", "cpu", "--adapter", "llvmpipe"])).is_err());
    }

    #[test]
    fn a_written_configuration_reads_back() {
        let config = Config { fit: FitSettings { seed: 3, ..FitSettings::default() }, ..Config::default() };
        let text = toml::to_string_pretty(&config).unwrap();
        assert_eq!(toml::from_str::<Config>(&text).unwrap().fit, config.fit);
    }
}
