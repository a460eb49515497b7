//! `upswing config`: the embedded settings as files.

use super::print_line;
use std::path::PathBuf;
use upswing_config::Config;
use upswing_config::process::{Failure, ProcessArgs};

/// Writes or checks settings.
#[derive(Clone, Debug, clap::Args)]
pub struct ConfigArgs {
    /// What to do.
    #[command(subcommand)]
    pub command: ConfigCommand,
}

/// What to do with settings.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum ConfigCommand {
    /// Write the embedded settings, robot and database to a folder; overwrites nothing
    Export {
        /// The folder
        dir: PathBuf,
    },
    /// Read the settings and say whether they are valid
    Check(ProcessArgs),
}

/// Writes or checks settings.
///
/// # Errors
/// [`Failure::BadInput`] that names file, key and reason.
pub fn run(args: &ConfigArgs) -> Result<(), Failure> {
    match &args.command {
        ConfigCommand::Export { dir } => {
            Config::export(dir)?;
            print_line(&format!("wrote {}", dir.display()))
        }
        ConfigCommand::Check(process) => {
            process.load()?;
            print_line(&"the settings are valid")
        }
    }
}
