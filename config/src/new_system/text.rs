//! The texts of the files of a new system.

use super::pose::Pose;
use crate::conflict::{in_file, unit};
use std::fmt::Write as _;
use upswing_model::{JointKind, JointVector, Limits, Model, Urdf, UrdfJoint};

/// Name of the manoeuvre from hanging to standing.
pub(super) const SWING_UP: &str = "swing-up";

/// Share of a joint's range to both sides of the target in which the grid has start poses.
const GRID: f64 = 0.25;
/// Largest number of joints that a grid or a request varies.
const VARIED: usize = 3;

/// The first paragraph of a file.
fn header(what: &str, name: &str) -> String {
    format!(
        "# {what}, made from {name} by `upswing system new`.\n\
         # Degrees only in keys that end in _deg or _deg_s, m in those that end in _m or _m_s"
    )
}

/// The joints (indices in sorted vectors) in the chain's order that are `among` the given ones.
fn in_chain(model: &Model, among: impl Fn(usize) -> bool) -> Vec<usize> {
    let order = model.order();
    (0..model.sizes().joints()).map(|joint| order.coordinate(joint)).filter(|i| among(*i)).collect()
}

fn is_prismatic(model: &Model, i: usize) -> bool {
    model.joint_kind(i) == JointKind::Prismatic
}

/// Name of a joint as a key of TOML.
fn key(name: &str) -> String {
    let is_bare = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    if !name.is_empty() && name.chars().all(is_bare) { name.to_owned() } else { string(name) }
}

/// A text as a string of TOML.
fn string(text: &str) -> String {
    toml::Value::from(text).to_string()
}

/// A table of values by joint name.
fn table(model: &Model, joints: &[usize], value: impl Fn(usize) -> String) -> String {
    let entries = joints.iter().map(|i| format!("{} = {}", key(model.joint_name(*i)), value(*i)));
    format!("{{ {} }}", entries.collect::<Vec<_>>().join(", "))
}

/// Names of those of the `joints` whose limit is not `stated`, as a remark behind a comment.
fn assumed(model: &Model, joints: &[usize], stated: &JointVector) -> String {
    let names = joints.iter().filter(|i| stated[**i].is_infinite()).map(|i| model.joint_name(*i));
    let names = names.collect::<Vec<_>>().join(", ");
    if names.is_empty() { String::new() } else { format!(" Assumed for {names}: robot.urdf has none.") }
}

/// `robot.toml`: the keys that differ from the defaults. `stated` are the limits of the URDF, infinite where it has none.
pub(super) fn robot(
    name: &str,
    model: &Model,
    stated: &Limits,
    limits: &Limits,
    torque_share: f64,
) -> String {
    let mut text = header("Limits and drives of the robot", name);
    text += "; in other keys of a prismatic joint rad is m, and N m is N. Joints have their names in robot.urdf; those\n\
             # with effort=\"0\" there have no motor: they are the unactuated ones. A value per joint is one number for all joints, or a table of\n\
             # joint names, `default` standing for those that it does not name: { default = 100, joint_3 = 50 }.\n\n";
    let _ = writeln!(
        text,
        "# What the robot is, in a few words.\ndescription = {}\n",
        string(&format!("Robot of {name}"))
    );
    text += "# Limits at 100 %; robot.urdf has the same where it states them.\n[limits]\n";
    for (prismatic, unit) in [(true, "m"), (false, "deg")] {
        let joints = in_chain(model, |i| is_prismatic(model, i) == prismatic);
        let Some(first) = joints.first() else { continue };
        let kind = model.joint_kind(*first);
        let range =
            |i: usize| format!("[{}, {}]", in_file(kind, limits.q_min[i]), in_file(kind, limits.q_max[i]));
        let remark = assumed(model, &joints, &stated.q_max);
        let _ = writeln!(
            text,
            "# Ranges, [lowest, highest], {unit}.{remark}\nq_{unit} = {}",
            table(model, &joints, range)
        );
        let speed = |i: usize| in_file(kind, limits.qd_max[i]).to_string();
        let remark = assumed(model, &joints, &stated.qd_max);
        let _ = writeln!(text, "# Speeds, {unit}/s.{remark}\nqd_{unit}_s = {}", table(model, &joints, speed));
    }
    let motors = in_chain(model, |i| i < model.sizes().actuated());
    let units = motors.iter().map(|i| if is_prismatic(model, *i) { "N" } else { "N m" });
    let mut units: Vec<_> = units.collect();
    units.sort_unstable();
    units.dedup();
    let effort = table(model, &motors, |i| limits.tau_max[i].to_string());
    let _ = writeln!(text, "# Motors, {}.\ntau_nm = {effort}\n", units.join(" and "));
    let comment = if torque_share == super::TORQUE_SHARES[0] {
        "Section VI: 50 %."
    } else {
        "Assumed: with less the motors do not hold the robot."
    };
    let _ = writeln!(
        text,
        "[usage]\n# Share of tau_nm, in (0, 1]. {comment}\ntorque_fraction = {torque_share}\n# Share of the speed of the unactuated joints, in (0, 1]. Assumed: the free joints fall faster than motors turn.\n\
         velocity_fraction_unactuated = {}",
        super::FREE_SHARE
    );
    text
}

/// What the URDF states `of` the joints that are `among` the given ones, by name; `None` if that is 0.
fn friction(
    model: &Model,
    description: &Urdf,
    among: &dyn Fn(usize) -> bool,
    of: &dyn Fn(&UrdfJoint) -> f64,
) -> Option<String> {
    let value = |i: usize| {
        let joint = description.joints.iter().find(|joint| joint.name == model.joint_name(i));
        joint.map_or(0.0, of)
    };
    let joints = in_chain(model, among);
    joints.iter().any(|i| value(*i) > 0.0).then(|| table(model, &joints, |i| value(i).to_string()))
}

/// Whether one or two motors move the machine, which is fast then, and moves far to catch its free joints.
fn is_small(model: &Model) -> bool {
    model.sizes().actuated() <= 2
}

/// `planner.toml`: the keys that differ from the defaults.
pub(super) fn planner(pose: &Pose) -> String {
    /// Default and largest possible duration, s.
    const DURATION: f64 = 8.0;
    const LONGEST: f64 = 60.0;
    let duration = super::PERIODS * pose.slowest_period();
    if duration <= DURATION {
        return String::new();
    }
    format!(
        "[offline]\n# Assumed: {} periods of the slowest swing.\nt_f_max_s = {:.1}\n",
        super::PERIODS,
        duration.min(LONGEST).round()
    )
}

/// `daemon.toml`: the keys that differ from the defaults.
pub(super) fn daemon(model: &Model, limits: &Limits) -> String {
    /// Default of the deceleration, rad/s^2.
    const DECELERATION: f64 = 6.0;
    if !is_small(model) {
        return String::new();
    }
    let actuated = model.sizes().actuated();
    // From the largest speed within a quarter of the range.
    let deceleration = |i: usize| limits.qd_max[i].powi(2) / (0.5 * (limits.q_max[i] - limits.q_min[i]));
    let deceleration = two_digits((0..actuated).map(deceleration).fold(DECELERATION, f64::max));
    let levels = if actuated == 1 && !is_prismatic(model, 0) {
        "# Assumed: half a turn of the only motor is its work space.\n\
         tracking_error_rad = { warn = 0.5, trip = 1.5 }\nbalance_error_rad = { warn = 0.5, trip = 1.5 }\n"
    } else {
        ""
    };
    format!(
        "[cycle]\n# The motion is fast: without the correction the lag of the filter would be an error of the torque law.\n\
         velocity = \"model\"\n\n\
         [stop]\n# Assumed: from its largest speed each motor is at rest within a quarter of its range.\n\
         deceleration_rad_s2 = {deceleration}\n\n\
         [disturbance]\n# Assumed: friction and errors of the masses that are no collision.\ntorque_fraction = 0.25\n\n\
         [limits]\n# Assumed, below torque_fraction of [disturbance].\n\
         collision_torque_fraction = {{ warn = 0.1, trip = 0.2 }}\n{levels}"
    )
}

/// A number rounded to two digits.
fn two_digits(value: f64) -> f64 {
    format!("{value:.1e}").parse().unwrap_or(value)
}

/// `plant.toml`: the keys that differ from the defaults.
pub(super) fn plant(name: &str, model: &Model, pose: &Pose, description: &Urdf) -> String {
    let mut text = header("The simulated robot, drives and encoders", name);
    text += "; in other keys of a prismatic joint rad is m, and N m is N. A value per joint is one number for all joints, or a table\n\
             # of joint names.\n";
    let actuated = model.sizes().actuated();
    let keys = [
        ("viscous", friction(model, description, &|_| true, &|joint| joint.damping)),
        ("coulomb", friction(model, description, &|_| true, &|joint| joint.friction)),
    ];
    let keys: Vec<_> =
        keys.into_iter().filter_map(|(key, value)| Some(format!("{key} = {}\n", value?))).collect();
    if !keys.is_empty() {
        let _ = write!(
            text,
            "\n# Friction torque: viscous * qd + coulomb * tanh(qd / coulomb_smoothing). Numbers of robot.urdf (`damping`, `friction`).\n\
             [friction]\n{}",
            keys.concat()
        );
    }
    let _ = writeln!(
        text,
        "\n# The state after power-up, at rest: the actuated joints of the first target.\n[start]"
    );
    for (prismatic, unit) in [(true, "m"), (false, "deg")] {
        let joints = in_chain(model, |i| i < actuated && is_prismatic(model, i) == prismatic);
        if !joints.is_empty() {
            let _ = writeln!(
                text,
                "q_{unit} = {}",
                table(model, &joints, |i| position(model, i, pose.hanging[i]))
            );
        }
    }
    text
}

/// A position as files state it.
fn position(model: &Model, i: usize, q: f64) -> String {
    // Without the sign of a zero.
    (in_file(model.joint_kind(i), q) + 0.0).to_string()
}

/// The first paragraph of `manoeuvres.toml`.
pub(super) fn manoeuvres_header(name: &str) -> String {
    let mut text = header("Manoeuvres", name);
    text += ". A target has rows over the positions of the joints: of one `joint`, or the sum { coefficients = { a = 1, b = -1 },\n\
             # value_deg = 90 }; velocities without a row are 0. It has to be an equilibrium of the unactuated joints. A row with `given` takes its\n\
             # value from the request (`upswing request move --to JOINT=VALUE`); from, to and points (or one value) are those of the database.\n\
             # `grid` has the start poses of the database (`upswing db build`). The first manoeuvre is the one of the demo.\n";
    text
}

/// Names and texts of manoeuvres that may suit the robot.
pub(super) fn manoeuvres(pose: &Pose, planning: &Limits, model: &Model) -> Vec<(&'static str, String)> {
    let actuated = model.sizes().actuated();
    let motors = in_chain(model, |i| i < actuated);
    let free = in_chain(model, |i| i >= actuated);
    let points = if motors.len() == 1 { 5 } else { 3 };
    let value = |i: usize, q: f64| format!("value_{} = {}", unit(model.joint_kind(i)), position(model, i, q));
    let row = |i: usize, rest: &str| format!("    {{ joint = {}, {rest} }},\n", string(model.joint_name(i)));
    // Positions around the target.
    let around = |i: usize| {
        let reach = GRID * (planning.q_max[i] - planning.q_min[i]);
        let (from, to) = (pose.hanging[i] - reach, pose.hanging[i] + reach);
        let [from, to] =
            [from.max(planning.q_min[i]), to.min(planning.q_max[i])].map(|q| position(model, i, q));
        let unit = unit(model.joint_kind(i));
        format!("from_{unit} = {from}, to_{unit} = {to}, points = {points}")
    };
    let varied = |i: &usize| motors.iter().take(VARIED).any(|motor| motor == i);
    let fixed: String = motors.iter().map(|i| row(*i, &value(*i, pose.hanging[*i]))).collect();
    let given = motors.iter().map(|i| {
        if varied(i) {
            row(*i, &format!("given = true, {}", around(*i)))
        } else {
            row(*i, &value(*i, pose.hanging[*i]))
        }
    });
    let given: String = given.collect();
    let grid =
        motors.iter().map(|i| row(*i, &if varied(i) { around(*i) } else { value(*i, pose.hanging[*i]) }));
    let grid: String = grid.collect();
    let rest: String = free.iter().map(|i| row(*i, "rest = true")).collect();
    let manoeuvre = |comment: &str, name: &str, start: &str, end: &str, target: String| {
        format!(
            "\n# {comment}\n[[manoeuvre]]\nname = \"{name}\"\nstart = \"{start}\"\nend = \"{end}\"\ntarget = [\n{target}]\ngrid = [\n{grid}]\n"
        )
    };

    let mut all = Vec::new();
    let upright = pose.standing.map(|q| free.iter().map(|i| row(*i, &value(*i, q[*i]))).collect::<String>());
    if let Some(upright) = &upright {
        let comment = "The unactuated joints end at the maximum of the potential energy.";
        all.push((
            SWING_UP,
            manoeuvre(comment, SWING_UP, "hanging", "standing", format!("{fixed}{upright}")),
        ));
        all.push((
            "swing-down",
            format!("\n[[manoeuvre]]\nname = \"swing-down\"\nreverses = \"{SWING_UP}\"\n"),
        ));
    }
    // An actuated base carries what swings from place to place.
    if model.order().is_actuated(0) {
        let comment = "From rest to rest, without residual swing.";
        all.push(("move", manoeuvre(comment, "move", "hanging", "hanging", format!("{given}{rest}"))));
        if let Some(upright) = &upright {
            let comment = "From place to place while the unactuated joints stand.";
            all.push((
                "carry",
                manoeuvre(comment, "carry", "standing", "standing", format!("{given}{upright}")),
            ));
        }
    }
    all
}
