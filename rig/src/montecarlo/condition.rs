//! In what the plant differs from what planner and controller believe.

use crate::montecarlo::RandomStarts;
use upswing_config::{Config, ConfigError};

/// By how much a drawn scale may differ from 1.
const SPREAD: f64 = 0.1;

/// A plant that planner and controller do not know.
#[derive(Clone, Debug)]
pub struct PlantCondition {
    /// As on the command line.
    pub name: String,
    /// What it is for.
    pub purpose: String,
    drawn: Drawn,
    plant: Config,
}

/// What is drawn anew for each start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Drawn {
    Nothing,
    ArmMass,
    PendulumMass,
    PendulumLength,
}

impl PlantCondition {
    /// The condition of this name: `nominal`, `arm-mass`, `pendulum-mass`, `pendulum-length`, or a scenario of the
    /// plant.
    ///
    /// # Errors
    /// [`ConfigError`] if there is no such scenario, or it cannot be used.
    pub fn new(name: &str, config: &Config) -> Result<Self, ConfigError> {
        let mut plant = config.clone();
        let (drawn, purpose) = match name {
            "nominal" => (Drawn::Nothing, "The plant of the settings.".into()),
            "arm-mass" => (Drawn::ArmMass, "All masses and inertias of the arm scaled by 0.9 to 1.1.".into()),
            "pendulum-mass" => {
                (Drawn::PendulumMass, "Masses and inertias of the pendulum scaled by 0.9 to 1.1.".into())
            }
            "pendulum-length" => (Drawn::PendulumLength, "The rod's length scaled by 0.9 to 1.1.".into()),
            scenario => (Drawn::Nothing, plant.use_scenario(scenario)?),
        };
        Ok(Self { name: name.into(), purpose, drawn, plant })
    }

    /// Settings of the plant for start number `index`.
    pub fn plant(&self, starts: &RandomStarts<'_>, index: u64) -> Config {
        let mut config = self.plant.clone();
        let scale = 1.0 - SPREAD + 2.0 * SPREAD * starts.share(index);
        let model = &mut config.plant.model;
        match self.drawn {
            Drawn::Nothing => {}
            Drawn::ArmMass => model.arm_mass_scale *= scale,
            Drawn::PendulumMass => model.pendulum_mass_scale *= scale,
            Drawn::PendulumLength => model.pendulum_length_scale *= scale,
        }
        config
    }
}
