//! Parsers of values on the command line.

use upswing_config::Config;
use upswing_config::PendulumStart;
use upswing_model::{StartError, State};
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
    let radians: Vec<f64> = start.0.iter().map(|d| d.to_radians()).collect();
    config
        .start_state(&radians, pendulum)
        .map_err(|e: StartError| Failure::BadInput(format!("{option}: {e}")))
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
