//! What the shipped systems are, for `upswing demo --list`.

use serde::Serialize;
use std::fmt;
use std::ops::Range;
use upswing_config::{Config, ConfigError, System};

/// The shipped systems; the first one is the default.
#[derive(Serialize)]
pub struct SystemList {
    systems: Vec<SystemSummary>,
}

/// A system in a few words.
#[derive(Serialize)]
struct SystemSummary {
    name: String,
    description: String,
    /// Names of the actuated joints, in the chain's order.
    actuated: Vec<String>,
    /// Names of the unactuated joints, in the chain's order.
    unactuated: Vec<String>,
    /// Names of the manoeuvres; the first one is that of the demo.
    manoeuvres: Vec<String>,
}

impl SystemList {
    /// Reads the shipped systems.
    ///
    /// # Errors
    /// None in a released program: its tests load the embedded settings.
    pub fn shipped() -> Result<Self, ConfigError> {
        let summary =
            |system| Config::load(&System::Shipped(system)).map(|config| SystemSummary::of(&config));
        Ok(Self { systems: System::shipped().map(summary).collect::<Result<_, _>>()? })
    }
}

impl SystemSummary {
    fn of(config: &Config) -> Self {
        let Config { model, robot, manoeuvres, .. } = config;
        let sizes = model.sizes();
        let names = |joints: Range<usize>| joints.map(|joint| model.joint_name(joint).to_owned()).collect();
        Self {
            name: config.system().to_string(),
            description: robot.description.clone(),
            actuated: names(0..sizes.actuated()),
            unactuated: names(sizes.actuated()..sizes.joints()),
            manoeuvres: manoeuvres.iter().map(|manoeuvre| manoeuvre.name.clone()).collect(),
        }
    }
}

impl fmt::Display for SystemList {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let width = self.systems.iter().map(|system| system.name.len()).max().unwrap_or_default();
        for (i, system) in self.systems.iter().enumerate() {
            let SystemSummary { name, description, actuated, unactuated, manoeuvres } = system;
            let end = if i == 0 { "" } else { "\n" };
            write!(f, "{end}{name:width$}  {description}")?;
            for (what, names) in
                [("actuated", actuated), ("unactuated", unactuated), ("manoeuvres", manoeuvres)]
            {
                write!(f, "\n{:width$}  {what:10}  {}", "", names.join(", "))?;
            }
        }
        Ok(())
    }
}
