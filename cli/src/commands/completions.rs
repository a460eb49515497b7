//! `upswing completions` and `upswing man`: completion scripts for shells, and man pages.

use super::print;
use clap_complete::Shell;
use serde::Serialize;
use std::path::PathBuf;
use upswing_process::Failure;
use upswing_process::output::{Destination, OutputError, Overwrite};

/// Name of the program.
const NAME: &str = "upswing";
/// Date of the version in Cargo.toml, for man pages.
const DATE: &str = "2026-11-28";

/// Prints a completion script for a shell.
///
/// Example: upswing completions bash > ~/.local/share/bash-completion/completions/upswing
#[derive(Clone, Debug, clap::Args)]
pub struct CompletionsArgs {
    /// The shell
    #[arg(value_enum)]
    pub shell: Shell,
    /// Print one JSON document on stdout instead of the script
    #[arg(long)]
    pub json: bool,
}

/// Writes a man page for each command.
///
/// Example: upswing man ~/.local/share/man/man1 && man upswing-demo
#[derive(Clone, Debug, clap::Args)]
pub struct ManArgs {
    /// Output folder, created if need be
    pub dir: Destination,
    /// Overwriting of existing files.
    #[command(flatten)]
    pub overwrite: Overwrite,
    /// Print one JSON document on stdout instead of text
    #[arg(long)]
    pub json: bool,
}

#[derive(Serialize)]
struct CompletionsResult {
    shell: String,
    script: String,
}

impl std::fmt::Display for CompletionsResult {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.script)
    }
}

#[derive(Serialize)]
struct ManResult {
    dir: PathBuf,
    pages: usize,
}

impl std::fmt::Display for ManResult {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} pages in {}", self.pages, self.dir.display())
    }
}

/// Prints the completion script for `command`.
///
/// # Errors
/// [`Failure::Failed`] if stdout cannot be written.
pub fn completions(args: &CompletionsArgs, command: &mut clap::Command) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, command, NAME, &mut script);
    let script = String::from_utf8(script).map_err(Failure::failed)?;
    print(args.json, &CompletionsResult { shell: args.shell.to_string(), script })
}

/// Collects file names and texts of the man pages of a command and its subcommands.
fn pages(command: &clap::Command, all: &mut Vec<(String, String)>) -> std::io::Result<()> {
    command.get_subcommands().try_for_each(|command| pages(command, all))?;
    let name = command.get_display_name().unwrap_or_else(|| command.get_name());
    let page = clap_mangen::Man::new(command.clone()).title(name).date(DATE);
    let mut text = Vec::new();
    page.render(&mut text)?;
    // mandoc warns about two breaks with a blank line between them: a vertical space replaces them.
    all.push((page.get_filename(), String::from_utf8_lossy(&text).replace("\n.br\n\n.br\n", "\n.sp\n")));
    Ok(())
}

/// Writes the man pages of `command`.
///
/// # Errors
/// [`Failure::BadInput`] if a file of the folder cannot be written.
pub fn man(args: &ManArgs, command: clap::Command) -> Result<(), Failure> {
    let bad = |e: &dyn std::fmt::Display| {
        Failure::BadInput(format!("cannot write man pages to {}: {e}", args.dir.display()))
    };
    std::fs::create_dir_all(&*args.dir).map_err(|e| bad(&e))?;
    let mut command = command.disable_help_subcommand(true);
    command.build();
    let mut all = Vec::new();
    pages(&command, &mut all).map_err(|e| bad(&e))?;
    let output = |name: &str| args.overwrite.output(&args.dir.join(name));
    let write = || -> Result<(), OutputError> {
        all.iter().try_for_each(|(name, _)| output(name).check())?;
        all.iter().try_for_each(|(name, text)| output(name).write(text.as_bytes()))
    };
    write().map_err(|e| bad(&e))?;
    print(args.json, &ManResult { dir: args.dir.to_path_buf(), pages: all.len() })
}
