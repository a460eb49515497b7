//! `upswing config`: writes the files of a system to a folder, or checks settings.

use super::{CommonArgs, print};
use serde::Serialize;
use std::path::PathBuf;
use upswing_planner::export;
use upswing_process::Failure;
use upswing_process::output::{Destination, Overwrite};

/// Writes or checks settings.
///
/// Example: upswing config export my-config && upswing config check --system ./my-config
#[derive(Clone, Debug, clap::Args)]
pub struct ConfigArgs {
    /// The action.
    #[command(subcommand)]
    pub command: ConfigCommand,
}

/// Actions on settings.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum ConfigCommand {
    /// Write all files of a system to a folder: robot, settings in full and with comments, manoeuvres, databases
    ///
    /// Example: upswing config export my-config --system cart-pole
    Export {
        /// Output folder
        dir: Destination,
        /// Overwriting of existing files.
        #[command(flatten)]
        overwrite: Overwrite,
        /// Options of every command.
        #[command(flatten)]
        common: CommonArgs,
    },
    /// Read the settings and check whether they are valid
    ///
    /// Example: upswing config check --system ./my-config
    Check(CommonArgs),
}

/// Writes or checks settings.
///
/// # Errors
/// [`Failure::BadInput`] with file, key and reason.
pub fn run(args: &ConfigArgs) -> Result<(), Failure> {
    match &args.command {
        ConfigCommand::Export { dir, overwrite, common } => {
            export(&common.process.load()?, dir, *overwrite).map_err(Failure::bad_input)?;
            print(common.json, &ConfigResult { success: true, dir: Some(dir.to_path_buf()) })
        }
        ConfigCommand::Check(common) => {
            common.process.load()?;
            print(common.json, &ConfigResult { success: true, dir: None })
        }
    }
}

#[derive(Serialize)]
struct ConfigResult {
    success: bool,
    dir: Option<PathBuf>,
}

impl std::fmt::Display for ConfigResult {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.dir {
            Some(dir) => write!(f, "wrote {}", dir.display()),
            None => f.write_str("the settings are valid"),
        }
    }
}
