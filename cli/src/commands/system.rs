//! `upswing system`: writes the folder of a new system from a URDF.

use super::print;
use serde::Serialize;
use std::path::{Path, PathBuf};
use upswing_config::{Changes, NewSystem, read_file};
use upswing_process::Failure;
use upswing_process::output::{Destination, Overwrite};

/// Makes systems.
///
/// Example: upswing system new my-robot --urdf robot.urdf
#[derive(Clone, Debug, clap::Args)]
pub struct SystemArgs {
    /// The action.
    #[command(subcommand)]
    pub command: SystemCommand,
}

/// Actions on systems.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum SystemCommand {
    /// Write the commented settings of the robot in a URDF to a new folder, and list what is left to decide
    ///
    /// The robot is one chain of joints, some with a motor and some without. Limits, names and units are filled in; the manoeuvres end in
    /// equilibria of the model.
    ///
    /// Example: upswing system new my-robot --urdf robot.urdf --free pole && upswing demo --system ./my-robot
    New(NewArgs),
}

/// Options of a new system.
#[derive(Clone, Debug, clap::Args)]
pub struct NewArgs {
    /// Folder to write: a new or an empty one
    pub dir: Destination,
    /// Robot description
    #[arg(long, value_name = "FILE")]
    pub urdf: PathBuf,
    /// Joints without a motor although the URDF states an effort; the copied URDF gets effort="0"
    #[arg(long, value_name = "JOINT", num_args = 1..)]
    pub free: Vec<String>,
    /// Last link of the chain, if the robot has several branches; joints that do not lead to it are fixed at 0 in the copied URDF
    #[arg(long, value_name = "LINK")]
    pub tip: Option<String>,
    /// Print one JSON document on stdout instead of text
    #[arg(long)]
    pub json: bool,
}

/// Makes a system.
///
/// # Errors
/// [`Failure::BadInput`] if the folder is not empty, or the URDF gives no system.
pub fn run(args: &SystemArgs) -> Result<(), Failure> {
    let SystemCommand::New(args) = &args.command;
    check_empty(&args.dir)?;
    let file = args.urdf.display().to_string();
    let refuse = |e: &dyn std::fmt::Display| Failure::BadInput(format!("--urdf: {file}: {e}"));
    let bytes =
        read_file(&args.urdf).map_err(|e| refuse(&format!("cannot be read ({e}): name an existing file")))?;
    let text =
        String::from_utf8(bytes).map_err(|_| refuse(&"expected UTF-8 text: save the file as UTF-8"))?;
    let changes = Changes { free: args.free.clone(), tip: args.tip.clone() };
    let system = NewSystem::new(&file, &text, &changes)?;
    write(&args.dir, &system)?;
    let files = system.files.iter().map(|(name, _)| *name).collect();
    print(args.json, &SystemNewResult { dir: args.dir.to_path_buf(), files, system })
}

/// Refuses a folder with files, or a file in its place.
fn check_empty(dir: &Path) -> Result<(), Failure> {
    let refuse = |e: &dyn std::fmt::Display| Failure::BadInput(format!("{}: {e}", dir.display()));
    match dir.read_dir() {
        Ok(mut entries) => match entries.next() {
            None => Ok(()),
            Some(_) => {
                Err(refuse(&"expected a new or empty folder, got one with files: choose another name"))
            }
        },
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(e) => Err(refuse(&format!("expected a new or empty folder ({e}): choose another name"))),
    }
}

fn write(dir: &Path, system: &NewSystem) -> Result<(), Failure> {
    std::fs::create_dir_all(dir)
        .map_err(|e| Failure::BadInput(format!("{}: cannot be created: {e}", dir.display())))?;
    for (name, text) in &system.files {
        Overwrite::default().output(&dir.join(name)).write(text.as_bytes()).map_err(Failure::bad_input)?;
    }
    Ok(())
}

#[derive(Serialize)]
struct SystemNewResult {
    dir: PathBuf,
    files: Vec<&'static str>,
    #[serde(flatten)]
    system: NewSystem,
}

impl std::fmt::Display for SystemNewResult {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { dir, files, system } = self;
        writeln!(f, "wrote {}: {}", dir.display(), files.join(", "))?;
        writeln!(f, "manoeuvres: {}", system.manoeuvres.join(", "))?;
        let width = system.joints.iter().map(|joint| joint.name.len()).max().unwrap_or_default().max(5);
        let row = |name: &str, others: [&str; 5]| {
            let [range, speed, motor, hanging, standing] = others;
            format!("  {name:<width$}  {range:>22}  {speed:>13}  {motor:>9}  {hanging:>8}  {standing:>8}")
        };
        writeln!(f, "{}", row("joint", ["range", "speed", "motor", "hanging", "standing"]))?;
        for joint in &system.joints {
            let unit = joint.unit;
            let [low, high] = joint.range.map(short);
            let force = if unit == "m" { "N" } else { "N m" };
            let motor =
                if joint.is_actuated { format!("{} {force}", short(joint.torque)) } else { "free".into() };
            let others = [
                &format!("{low} to {high} {unit}"),
                &format!("{} {unit}/s", short(joint.speed)),
                &motor,
                &short(joint.hanging),
                &joint.standing.map_or("-".into(), short),
            ];
            writeln!(f, "{}", row(&joint.name, others.map(String::as_str)))?;
        }
        for (title, sentences) in
            [("not read from the URDF", &system.ignored), ("left to decide", &system.to_decide)]
        {
            if !sentences.is_empty() {
                writeln!(f, "{title}")?;
                sentences.iter().try_for_each(|sentence| writeln!(f, "- {sentence}"))?;
            }
        }
        let option = upswing_config::System::Folder(dir.clone());
        write!(f, "next: upswing demo --system {option}")
    }
}

/// A number with at most two decimals.
fn short(value: f64) -> String {
    // Without the sign of a zero.
    ((value * 100.0).round() / 100.0 + 0.0).to_string()
}
