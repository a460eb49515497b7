//! `upswing config`: writes the embedded settings to files, or checks settings.

use super::{CommonArgs, print};
use serde::Serialize;
use std::path::PathBuf;
use upswing_planner::export;
use upswing_process::Failure;
use upswing_process::output::{Destination, Overwrite};

/// Writes or checks settings.
///
/// Example: upswing config export my-config && upswing config check --config my-config
#[derive(Clone, Debug, clap::Args)]
pub struct ConfigArgs {
    /// The action.
    #[command(subcommand)]
    pub command: ConfigCommand,
}

/// Actions on settings.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum ConfigCommand {
    /// Write the embedded settings, robot and database to a folder
    ///
    /// Example: upswing config export my-config
    Export {
        /// Output folder
        dir: Destination,
        /// Overwriting of existing files.
        #[command(flatten)]
        overwrite: Overwrite,
        /// Print one JSON document on stdout instead of text
        #[arg(long)]
        json: bool,
    },
    /// Read the settings and check whether they are valid
    ///
    /// Example: upswing config check --config my-config
    Check(CommonArgs),
}

/// Writes or checks settings.
///
/// # Errors
/// [`Failure::BadInput`] with file, key and reason.
pub fn run(args: &ConfigArgs) -> Result<(), Failure> {
    match &args.command {
        ConfigCommand::Export { dir, overwrite, json } => {
            export(dir, *overwrite).map_err(Failure::bad_input)?;
            print(*json, &ConfigResult { success: true, dir: Some(dir.to_path_buf()) })
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
