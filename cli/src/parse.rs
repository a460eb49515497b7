//! Parsers of values on the command line.

use upswing_config::{Config, GivenOutsideLimits, PendulumStart};
use upswing_model::{Posture, StartError, State};
use upswing_planner::database::standing;
use upswing_process::Failure;
use upswing_record::Window;

/// Duration of a week, s.
pub const WEEK: f64 = 604_800.0;

/// Joint angles in degrees, separated by commas, as typed by a user.
#[derive(Clone, Debug, PartialEq)]
pub struct Degrees(pub Vec<f64>);

impl std::str::FromStr for Degrees {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        text.trim_matches(|c| c == '[' || c == ']')
            .split(',')
            .map(|part| {
                let part = part.trim();
                part.parse::<f64>().map_err(|_| {
                    format!("expected joint angles in deg, separated by commas, as in 0,-15,0,-95,0,10,0; got `{part}`")
                })
            })
            .collect::<Result<_, _>>()
            .map(Self)
    }
}

impl std::fmt::Display for Degrees {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let parts: Vec<_> = self.0.iter().map(f64::to_string).collect();
        f.write_str(&parts.join(","))
    }
}

/// A position of a joint, deg or m, as typed by a user: `joint_1=30`.
#[derive(Clone, Debug, PartialEq)]
pub struct JointValue {
    /// Name of the joint.
    pub joint: String,
    /// deg or m
    pub value: f64,
}

impl std::str::FromStr for JointValue {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |value: &str| value.trim().parse::<f64>().ok().filter(|v| v.is_finite());
        text.split_once('=')
            .and_then(|(joint, value)| Some(Self { joint: joint.trim().to_owned(), value: number(value)? }))
            .ok_or_else(|| {
                format!("expected a joint and its position in deg or m, as in joint_1=30; got `{text}`")
            })
    }
}

/// Returns the number of the manoeuvre `name` of the settings, and the values that the options `--to` give to its target, rad or m: NaN for
/// a joint without option.
///
/// # Errors
/// [`Failure::BadInput`] if there is no such manoeuvre, if it does not ask for one of the joints, if a joint has two values, or one outside
/// its limits.
pub fn given_values(config: &Config, name: &str, to: &[JointValue]) -> Result<(usize, Vec<f64>), Failure> {
    let Some(number) = config.manoeuvres.iter().position(|manoeuvre| manoeuvre.name == name) else {
        let names: Vec<_> = config.manoeuvres.iter().map(|m| format!("`{}`", m.name)).collect();
        let refusal = format!("unknown manoeuvre `{name}`: this system has {}", names.join(", "));
        return Err(Failure::BadInput(refusal));
    };
    let joints: Vec<usize> = config.manoeuvres[number].given().map(|axis| axis.joint).collect();
    let mut given = vec![f64::NAN; joints.len()];
    for JointValue { joint, value } in to {
        let Some(i) = joints.iter().position(|i| config.model.joint_name(*i) == joint) else {
            let names: Vec<_> = joints.iter().map(|i| format!("`{}`", config.model.joint_name(*i))).collect();
            let expected = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
            let refusal = format!("--to: `{name}` takes values of the joints {expected}; got `{joint}`");
            return Err(Failure::BadInput(refusal));
        };
        if !given[i].is_nan() {
            return Err(Failure::BadInput(format!("--to: joint `{joint}` twice: give one value")));
        }
        given[i] = config.model.joint_kind(joints[i]).position(*value);
        GivenOutsideLimits::check(config, joints[i], given[i])
            .map_err(|e| Failure::BadInput(format!("--to: {e}")))?;
    }
    Ok((number, given))
}

/// Options of the manoeuvre of a computation.
#[derive(Clone, Debug, clap::Args)]
pub struct ManoeuvreArgs {
    /// Manoeuvre of the settings [default: the first one]
    #[arg(long, value_name = "NAME")]
    pub manoeuvre: Option<String>,
    /// Where joints end in a manoeuvre whose target is given by the request, deg or m [default: where they start]
    #[arg(long, value_name = "JOINT=VALUE", num_args = 1..)]
    pub to: Vec<JointValue>,
}

impl ManoeuvreArgs {
    /// Returns the number of the manoeuvre, its given values (rad or m), and the state in which it starts.
    ///
    /// # Errors
    /// [`Failure::BadInput`] as [`given_values`] and [`StartArgs::state`], or if the unactuated joints do not stand in the start pose of a
    /// manoeuvre from standing.
    pub fn of(&self, config: &Config, start: &StartArgs) -> Result<(usize, Vec<f64>, State), Failure> {
        let first = config.manoeuvres.first().map_or("", |manoeuvre| manoeuvre.name.as_str());
        let name = self.manoeuvre.as_deref().unwrap_or(first);
        let (number, mut given) = given_values(config, name, &self.to)?;
        let hanging = start.state(config)?;
        let x = match config.manoeuvres[number].start {
            Posture::Hanging => hanging,
            Posture::Standing => standing(config, number, &hanging.q_a()).ok_or_else(|| {
                Failure::BadInput("--start: the unactuated joints cannot stand in this pose".into())
            })?,
        };
        for (value, axis) in given.iter_mut().zip(config.manoeuvres[number].given()) {
            if value.is_nan() {
                *value = x[axis.joint];
            }
        }
        Ok((number, given, x))
    }
}

/// Options of a start at rest.
#[derive(Clone, Debug, clap::Args)]
pub struct StartArgs {
    /// Start positions of the actuated joints, deg or m
    #[arg(long, value_name = "Q1,..", allow_hyphen_values = true)]
    pub start: Degrees,
    /// Start the unactuated joints at 0 (as in the paper's database) instead of their rest position
    #[arg(long)]
    pub zero: bool,
}

impl StartArgs {
    /// Returns the start state.
    ///
    /// # Errors
    /// As [`start_state`].
    pub fn state(&self, config: &Config) -> Result<State, Failure> {
        start_state(config, "--start", &self.start, self.pendulum())
    }

    /// Returns the position of the pendulum at the start.
    pub fn pendulum(&self) -> PendulumStart {
        if self.zero { PendulumStart::Zero } else { PendulumStart::Rest }
    }
}

/// Returns the state at rest with the angles of an `option` like `--start`.
///
/// # Errors
/// [`Failure::BadInput`] with joint, value and limit.
pub fn start_state(
    config: &Config,
    option: &str,
    start: &Degrees,
    pendulum: PendulumStart,
) -> Result<State, Failure> {
    let refuse = |e: StartError| Failure::BadInput(format!("{option}: {e}"));
    let q_a = config.model.actuated_from_shown(&start.0).map_err(refuse)?;
    config.start_state(&q_a, pendulum).map_err(refuse)
}

/// Returns the time window of a recording from the options `--from` and `--to`, s.
///
/// # Errors
/// [`Failure::BadInput`] if the window is empty.
pub fn window(from: f64, to: Option<f64>) -> Result<Window, Failure> {
    let to = to.unwrap_or(f64::INFINITY);
    if !(from >= 0.0 && from < to) {
        let got = format!("{from} to {to}");
        return Err(Failure::BadInput(format!("--from, --to: expected 0 <= from < to in s, got {got}")));
    }
    Ok(Window { from, to })
}
