//! Parsers of values on the command line.

use upswing_config::{Config, PendulumStart};
use upswing_model::{StartError, State};
use upswing_planner::wanted;
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

/// Returns the number of the manoeuvre `name` of the settings (`None`: the first one), and the values that the options `--to` give to its
/// target, rad or m: NaN for a joint without option.
///
/// # Errors
/// [`Failure::BadInput`] if there is no such manoeuvre, if it does not ask for one of the joints, if a joint has two values, or one outside
/// its limits.
pub fn given_values(
    config: &Config,
    name: Option<&str>,
    to: &[JointValue],
) -> Result<(usize, Vec<f64>), Failure> {
    let number = wanted::manoeuvre_number(config, name).map_err(Failure::bad_input)?;
    let model = &config.model;
    let si = |JointValue { joint, value }: &JointValue| {
        model.coordinate(joint).map_or(*value, |i| model.joint_kind(i).position(*value))
    };
    let to = to.iter().map(|value| (value.joint.as_str(), si(value)));
    let given = wanted::given_values(config, number, to);
    given.map(|given| (number, given)).map_err(|e| Failure::BadInput(format!("--to: {e}")))
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
    /// [`Failure::BadInput`] as [`given_values`], with the joint, value and limit of a start outside the limits, or if the unactuated joints
    /// do not stand in the start pose of a manoeuvre from standing.
    pub fn of(&self, config: &Config, start: &StartArgs) -> Result<(usize, Vec<f64>, State), Failure> {
        let (number, mut given) = given_values(config, self.manoeuvre.as_deref(), &self.to)?;
        let refuse = |e: &dyn std::fmt::Display| Failure::BadInput(format!("--start: {e}"));
        let q_a = config.model.actuated_from_shown(&start.start.0).map_err(|e| refuse(&e))?;
        let x = wanted::start_of(config, number, &q_a, start.pendulum()).map_err(|e| refuse(&e))?;
        wanted::complete_given(config, number, &mut given, &x);
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
