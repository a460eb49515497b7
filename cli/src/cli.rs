//! Parser of the whole command line, and the call of its command.

use crate::commands;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use upswing_process::{Failure, ProcessArgs};

/// Swings up and balances a spherical pendulum on a 7-DoF robot.
///
/// Exit codes: 0 success, 1 the command ran but its result is negative, 2 invalid input. Results go to stdout, everything else to
/// stderr; progress bars and colours are for terminals only, and NO_COLOR switches colours off. --json prints one JSON document, in SI
/// units. Existing files are overwritten only with --force; if a write fails, the old file stays.
///
/// Example: upswing demo
#[derive(Parser)]
#[command(name = "upswing", version)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Demo(commands::demo::DemoArgs),
    Request(commands::request::RequestArgs),
    Disturb(commands::disturb::DisturbArgs),
    // Hidden: a test for developers, not for operators.
    #[command(hide = true)]
    Soak(commands::soak::SoakArgs),
    Status(commands::status::StatusArgs),
    Monitor(commands::monitor::MonitorArgs),
    Metrics(commands::metrics::MetricsArgs),
    Doctor(commands::doctor::DoctorArgs),
    Record(commands::record::RecordArgs),
    Replay(commands::replay::ReplayArgs),
    Report(commands::report::ReportArgs),
    Export(commands::export::ExportArgs),
    Plan(commands::plan::PlanArgs),
    Optimize(commands::optimize::OptimizeArgs),
    Db(commands::db::DbArgs),
    Model(commands::model::ModelArgs),
    #[command(name = "montecarlo")]
    MonteCarlo(commands::montecarlo::MonteCarloArgs),
    Config(commands::config::ConfigArgs),
    Completions(commands::completions::CompletionsArgs),
    // Hidden: for packagers, not for operators.
    #[command(hide = true)]
    Man(commands::completions::ManArgs),
    /// Run as the control daemon, like `upswingd`
    ///
    /// Example: upswing daemon --domain robot
    Daemon(ProcessArgs),
    /// Run as the planner, like `upswing-planner`
    ///
    /// Example: upswing planner --domain robot
    Planner(ProcessArgs),
    /// Run as the plant simulator, like `upswing-plant`
    ///
    /// Example: upswing plant --domain robot --clock wall
    Plant(upswing_plant::PlantArgs),
}

impl Cli {
    /// Reads the command line; exits the process after --help, --version or an invalid command line.
    pub fn read() -> Self {
        let matches = whole_command().get_matches();
        Self::from_arg_matches(&matches).unwrap_or_else(|e| e.exit())
    }
}

/// Returns the parser of the whole command line. A negative number is the value of the option before it.
fn whole_command() -> clap::Command {
    fn with_negative(command: clap::Command) -> clap::Command {
        let numbers = |arg: clap::Arg| {
            let takes_values = arg.get_action().takes_values();
            arg.allow_negative_numbers(takes_values)
        };
        command.mut_args(numbers).mut_subcommands(with_negative)
    }
    with_negative(Cli::command())
}

/// Runs the command that was read.
///
/// # Errors
/// [`Failure`] of the command.
pub fn run(cli: &Cli) -> Result<(), Failure> {
    match &cli.command {
        Command::Demo(args) => commands::demo::run(args),
        Command::Request(args) => commands::request::run(args),
        Command::Disturb(args) => commands::disturb::run(args),
        Command::Soak(args) => commands::soak::run(args),
        Command::Status(args) => commands::status::run(args),
        Command::Monitor(args) => commands::monitor::run(args),
        Command::Metrics(args) => commands::metrics::run(args),
        Command::Doctor(args) => commands::doctor::run(args),
        Command::Record(args) => commands::record::run(args),
        Command::Replay(args) => commands::replay::run(args),
        Command::Report(args) => commands::report::run(args),
        Command::Export(args) => commands::export::run(args),
        Command::Plan(args) => commands::plan::run(args),
        Command::Optimize(args) => commands::optimize::run(args),
        Command::Db(args) => commands::db::run(args),
        Command::Model(args) => commands::model::run(args),
        Command::MonteCarlo(args) => commands::montecarlo::run(args),
        Command::Config(args) => commands::config::run(args),
        Command::Completions(args) => commands::completions::completions(args, &mut whole_command()),
        Command::Man(args) => commands::completions::man(args, whole_command()),
        Command::Daemon(args) => upswingd::run(args),
        Command::Planner(args) => upswing_planner::service::run(args),
        Command::Plant(args) => upswing_plant::run(args),
    }
}
