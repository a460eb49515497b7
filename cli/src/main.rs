//! The operator's command line.

use clap::{CommandFactory, Parser, Subcommand};
use std::process::ExitCode;
use upswing::commands;
use upswing_config::process::{finish, start_logging};

/// Swings up and balances a spherical pendulum on a 7-DoF robot.
///
/// Exit codes: 0 success, 1 it ran but the answer is no, 2 bad input.
#[derive(Parser)]
#[command(version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Demo(commands::demo::DemoArgs),
    Request(commands::request::RequestArgs),
    Disturb(commands::disturb::DisturbArgs),
    Soak(commands::soak::SoakArgs),
    Status(commands::status::StatusArgs),
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
    Man(commands::completions::ManArgs),
    /// Run as the control daemon, like `upswingd`
    Daemon(upswingd::DaemonArgs),
    /// Run as the planner, like `upswing-planner`
    Planner(upswing_planner::service::PlannerArgs),
    /// Run as the plant simulator, like `upswing-plant`
    Plant(upswing_plant::PlantArgs),
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    start_logging();
    finish(match &cli.command {
        Command::Demo(args) => commands::demo::run(args),
        Command::Request(args) => commands::request::run(args),
        Command::Disturb(args) => commands::disturb::run(args),
        Command::Soak(args) => commands::soak::run(args),
        Command::Status(args) => commands::status::run(args),
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
        Command::Completions(args) => commands::completions::completions(args, &mut Cli::command()),
        Command::Man(args) => commands::completions::man(args, Cli::command()),
        Command::Daemon(args) => upswingd::run(args.clone()),
        Command::Planner(args) => upswing_planner::service::run(args),
        Command::Plant(args) => upswing_plant::run(args.clone()),
    })
}
