//! The files of a new system, made from a URDF: its limits and names filled in, manoeuvres whose targets are equilibria of the model, and
//! what remains to be decided.

mod pose;
mod text;

use crate::conflict::{in_file, unit};
use crate::file::TextFile;
use crate::overlay::{self, Settings};
use crate::{ConfigError, DAEMON, MANOEUVRES, PLANNER, PLANT, ROBOT, RobotSettings, URDF, manoeuvre};
use pose::Pose;
use upswing_model::{JointKind, Limits, Model, Urdf, Workspace};

/// A new system: its files, and a report of them.
#[derive(Clone, Debug, serde::Serialize)]
pub struct NewSystem {
    /// Path relative to a folder, and text of each file.
    #[serde(skip)]
    pub files: Vec<(&'static str, String)>,
    /// The joints, from base to tip.
    pub joints: Vec<NewJoint>,
    /// Names of the manoeuvres, the first one being that of the demo.
    pub manoeuvres: Vec<String>,
    /// Sentences about elements of the URDF that are not read.
    pub ignored: Vec<String>,
    /// Sentences about what remains to be decided or checked.
    pub to_decide: Vec<String>,
}

/// A joint of a new system, in the units of files: deg or m.
#[derive(Clone, Debug, serde::Serialize)]
pub struct NewJoint {
    /// Name in the URDF.
    pub name: String,
    /// Whether it has a motor.
    pub is_actuated: bool,
    /// Unit of the position: "deg" or "m".
    pub unit: &'static str,
    /// Lowest and highest position.
    pub range: [f64; 2],
    /// Largest speed, per s.
    pub speed: f64,
    /// Largest torque or force of the motor, N m or N; 0 without one.
    pub torque: f64,
    /// Position in the pose of the target, unactuated joints hanging.
    pub hanging: f64,
    /// Position in the target of the swing-up, if there is one.
    pub standing: Option<f64>,
}

/// How a new system differs from its URDF.
#[derive(Clone, Debug, Default)]
pub struct Changes {
    /// Names of joints without a motor, for which the URDF states one.
    pub free: Vec<String>,
    /// Name of the last link of the chain, if the URDF has several branches: joints that do not lead to it are fixed.
    pub tip: Option<String>,
}

/// Range of an actuated joint for which the URDF states none, rad.
const TURNS: f64 = std::f64::consts::TAU;
/// Speed of an unactuated joint for which the URDF states none, as a multiple of the largest one in a fall from upright.
const FALL_SPEEDS: f64 = 2.0;
/// Share of the speed of the unactuated joints that plans may use.
const FREE_SHARE: f64 = 0.9;
/// Shares of the motors' torque that plans may use: the first one with which the motors hold a pose.
const TORQUE_SHARES: [f64; 3] = [0.5, 0.7, 0.9];
/// Natural periods of the slowest swing in which a swing-up has to be possible.
const PERIODS: f64 = 4.0;

impl NewSystem {
    /// The files of a system with the robot in the `urdf` text of the file called `file`.
    ///
    /// # Errors
    /// [`ConfigError`] if the URDF gives no model, or if no pose is found in which the unactuated joints hang or stand within their ranges.
    pub fn new(file: &str, urdf: &str, changes: &Changes) -> Result<Self, ConfigError> {
        let refuse = |cause| ConfigError::Urdf { file: file.to_owned(), cause };
        let mut urdf = urdf.to_owned();
        if let Some(tip) = &changes.tip {
            urdf = Urdf::with_one_chain(&urdf, tip).map_err(refuse)?;
        }
        urdf = Urdf::with_free_joints(&urdf, &changes.free).map_err(refuse)?;
        let description = Urdf::read(&urdf).map_err(refuse)?;
        let model = Model::from_description(&description).map_err(refuse)?;
        let no_pose = |reason: String| ConfigError::NoPose { file: file.to_owned(), reason };

        let mut limits = *model.rated_limits();
        let (sizes, stated) = (model.sizes(), limits);
        for i in (0..sizes.joints()).filter(|i| stated.q_max[*i].is_infinite()) {
            (limits.q_min[i], limits.q_max[i]) = (-TURNS, TURNS);
        }
        let name = file.rsplit('/').next().unwrap_or(file);
        let settings = |limits: &Limits, torque_share| -> Result<(String, RobotSettings), ConfigError> {
            let text = text::robot(name, &model, &stated, limits, torque_share);
            let file = TextFile { name: ROBOT.name.into(), text: text.clone() };
            let robot = Settings::new(file, &ROBOT)
                .read(&model, |robot: &mut RobotSettings| robot.validate(&model))?;
            Ok((text, robot))
        };
        // Speeds do not matter to the pose, but determine those that the URDF does not state.
        let any_speed = |qd: f64| if qd.is_infinite() { 1.0 } else { qd };
        let preliminary = Limits { qd_max: limits.qd_max.map(any_speed), ..limits };
        let mut pose = Err(String::new());
        let mut torque_share = TORQUE_SHARES[0];
        for share in TORQUE_SHARES {
            torque_share = share;
            pose = Pose::find(&model, &settings(&preliminary, share)?.1.planning);
            if pose.is_ok() {
                break;
            }
        }
        let pose = pose.map_err(no_pose)?;
        for i in sizes.actuated()..sizes.joints() {
            if limits.qd_max[i].is_infinite() {
                limits.qd_max[i] =
                    speed_in_file(model.joint_kind(i), FALL_SPEEDS * pose.fall_speed[i - sizes.actuated()]);
            }
        }

        let (robot_text, robot) = settings(&limits, torque_share)?;
        let (manoeuvres_text, manoeuvres) = manoeuvres(name, &pose, &robot, &model)?;
        let plant_text = text::plant(name, &model, &pose, &description);

        let complete = |defaults: &overlay::Defaults, text: &str| {
            // Texts of this module, which tests load.
            overlay::complete(defaults.text, text).unwrap_or_else(|_| text.to_owned())
        };
        let files = vec![
            (URDF, urdf),
            (ROBOT.name, complete(&ROBOT, &robot_text)),
            (MANOEUVRES, manoeuvres_text),
            (PLANNER.name, complete(&PLANNER, &text::planner(&pose))),
            (DAEMON.name, complete(&DAEMON, &text::daemon(&model, &limits))),
            (PLANT.name, complete(&PLANT, &plant_text)),
        ];
        let to_decide = to_decide(&description, &model, &stated, &limits, &pose, &manoeuvres);
        let joints = (0..sizes.joints()).map(|joint| {
            let i = model.order().coordinate(joint);
            let kind = model.joint_kind(i);
            NewJoint {
                name: model.joint_name(i).to_owned(),
                is_actuated: model.order().is_actuated(joint),
                unit: unit(kind),
                range: [limits.q_min[i], limits.q_max[i]].map(|q| in_file(kind, q)),
                speed: in_file(kind, limits.qd_max[i]),
                torque: if model.order().is_actuated(joint) { limits.tau_max[i] } else { 0.0 },
                hanging: in_file(kind, pose.hanging[i]),
                standing: pose.standing.map(|q| in_file(kind, q[i])),
            }
        });
        let ignored = description.warnings.iter().filter(|warning| !warning.contains("friction is part of"));
        Ok(Self {
            joints: joints.collect(),
            ignored: ignored.cloned().collect(),
            files,
            manoeuvres,
            to_decide,
        })
    }
}

/// A speed (rad/s or m/s), rounded up to two digits in the unit of files.
fn speed_in_file(kind: JointKind, speed: f64) -> f64 {
    let shown = kind.shown(speed).0;
    let digit = libm::pow(10.0, libm::log10(shown).floor() - 1.0);
    kind.position((shown / digit).ceil() * digit)
}

/// The text of the manoeuvres and their names: those that the checks of `manoeuvres.toml` accept.
fn manoeuvres(
    name: &str,
    pose: &Pose,
    robot: &RobotSettings,
    model: &Model,
) -> Result<(String, Vec<String>), ConfigError> {
    let mut accepted = text::manoeuvres_header(name);
    let mut names = Vec::new();
    let mut refusal = None;
    for (name, text) in text::manoeuvres(pose, &robot.planning, model) {
        let file = TextFile { name: MANOEUVRES.into(), text: format!("{accepted}{text}") };
        match manoeuvre::read(&file, robot, model) {
            Ok(_) => {
                accepted = file.text;
                names.push(name.to_owned());
            }
            Err(e) => refusal = refusal.or(Some(e)),
        }
    }
    match refusal {
        Some(e) if names.is_empty() => Err(e),
        _ => Ok((accepted, names)),
    }
}

/// What the URDF leaves open, one sentence each.
fn to_decide(
    description: &Urdf,
    model: &Model,
    stated: &Limits,
    limits: &Limits,
    pose: &Pose,
    manoeuvres: &[String],
) -> Vec<String> {
    let (sizes, order) = (model.sizes(), model.order());
    let mut open = Vec::new();
    for joint in 0..sizes.joints() {
        let (i, actuated) = (order.coordinate(joint), order.is_actuated(joint));
        let (kind, name) = (model.joint_kind(i), model.joint_name(i));
        let (position, per_s) = (unit(kind), format!("{}/s", unit(kind)));
        if stated.q_max[i].is_infinite() {
            let turns = in_file(kind, TURNS);
            let why =
                if actuated { "a cable or stop may allow less" } else { "it turns over in both directions" };
            open.push(format!(
                "`{name}`: the URDF has no range; assumed -{turns} to {turns} {position}: {why}"
            ));
        }
        if !actuated {
            let c = i - sizes.actuated();
            let fall = in_file(kind, pose.fall_speed[c]).round();
            let speed = in_file(kind, limits.qd_max[i]);
            if stated.qd_max[i].is_infinite() {
                open.push(format!(
                    "`{name}`: the URDF has no speed limit; assumed {speed} {per_s}, a fall from upright reaches up to {fall}"
                ));
            } else if limits.qd_max[i] * FREE_SHARE < pose.fall_speed[c] {
                open.push(format!(
                    "`{name}`: the URDF allows {speed} {per_s}, a fall from upright may reach {fall}: raise the limit in robot.urdf and robot.toml"
                ));
            }
        }
    }
    let free: Vec<_> =
        (sizes.actuated()..sizes.joints()).map(|i| format!("`{}`", model.joint_name(i))).collect();
    open.push(format!(
        "without motor: {}; if that is wrong, correct `effort` in the URDF, or name the free joints with --free",
        free.join(", ")
    ));
    let has_friction = |actuated: bool| {
        description.joints.iter().any(|joint| {
            let of = model.coordinate(&joint.name).map(|i| i < sizes.actuated());
            of == Some(actuated) && (joint.damping > 0.0 || joint.friction > 0.0)
        })
    };
    if !has_friction(false) {
        open.push("friction of the free joints: the URDF has none; [friction] in plant.toml".into());
    }
    if !has_friction(true) {
        open.push("friction of the motors' joints: the URDF has none; [friction] in plant.toml, [drives] in robot.toml".into());
    }
    open.push("encoders, delays, brakes and torque loop of the real machine: plant.toml".into());
    open.push("shares of speed and torque that plans may use: [usage] in robot.toml".into());
    match manoeuvres.first() {
        Some(first) => open.push(format!("target and start poses of `{first}`: manoeuvres.toml")),
        None => open.push("manoeuvres: manoeuvres.toml".into()),
    }
    if !manoeuvres.iter().any(|name| name == text::SWING_UP) {
        open.push(format!("no swing-up: {}", pose.no_standing));
    }
    open
}

/// Largest torque of each motor that holds `pose`, as a share of what plans may use.
fn holding_share(model: &Model, planning: &Limits, q: &upswing_model::JointVector) -> f64 {
    let torque = model.gravity_torque(q, &mut Workspace::default());
    let shares = (0..model.sizes().actuated()).map(|i| (torque[i] / planning.tau_max[i]).abs());
    shares.fold(0.0, f64::max)
}
