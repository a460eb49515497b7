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
    command: CliCommand,
}

#[derive(Subcommand)]
enum CliCommand {
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
    Bench(commands::bench::BenchArgs),
    Config(commands::config::ConfigArgs),
    System(commands::system::SystemArgs),
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
        CliCommand::Demo(args) => commands::demo::run(args),
        CliCommand::Request(args) => commands::request::run(args),
        CliCommand::Disturb(args) => commands::disturb::run(args),
        CliCommand::Soak(args) => commands::soak::run(args),
        CliCommand::Status(args) => commands::status::run(args),
        CliCommand::Monitor(args) => commands::monitor::run(args),
        CliCommand::Metrics(args) => commands::metrics::run(args),
        CliCommand::Doctor(args) => commands::doctor::run(args),
        CliCommand::Record(args) => commands::record::run(args),
        CliCommand::Replay(args) => commands::replay::run(args),
        CliCommand::Report(args) => commands::report::run(args),
        CliCommand::Export(args) => commands::export::run(args),
        CliCommand::Plan(args) => commands::plan::run(args),
        CliCommand::Optimize(args) => commands::optimize::run(args),
        CliCommand::Db(args) => commands::db::run(args),
        CliCommand::Model(args) => commands::model::run(args),
        CliCommand::MonteCarlo(args) => commands::montecarlo::run(args),
        CliCommand::Bench(args) => commands::bench::run(args),
        CliCommand::Config(args) => commands::config::run(args),
        CliCommand::System(args) => commands::system::run(args),
        CliCommand::Completions(args) => commands::completions::completions(args, &mut whole_command()),
        CliCommand::Man(args) => commands::completions::man(args, whole_command()),
        CliCommand::Daemon(args) => upswingd::run(args),
        CliCommand::Planner(args) => upswing_planner::service::run(args),
        CliCommand::Plant(args) => upswing_plant::run(args),
    }
}
