//! Plant conditions: differences between the simulated plant and the settings of planner and controller.

use crate::montecarlo::RandomStarts;
use upswing_config::{Config, ConfigError};

/// Largest difference of a random scale from 1.
const SPREAD: f64 = 0.1;

/// Settings of the plant that differ from those of planner and controller.
#[derive(Clone, Debug)]
pub struct PlantCondition {
    /// Name of the condition, as on the command line.
    pub name: String,
    /// Purpose of the condition, a sentence.
    pub purpose: String,
    parameter: RandomParameter,
    plant: Config,
}

/// Parameter of the plant that is drawn at random for each start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum RandomParameter {
    Nothing,
    ArmMass,
    PendulumMass,
    PendulumLength,
}

impl PlantCondition {
    /// The condition `name`: `nominal`, `arm-mass`, `pendulum-mass`, `pendulum-length`, or a scenario of the plant.
    ///
    /// # Errors
    /// [`ConfigError`] if the scenario does not exist or is invalid.
    pub fn new(name: &str, config: &Config) -> Result<Self, ConfigError> {
        let mut plant = config.clone();
        let (parameter, purpose) = match name {
            "nominal" => (RandomParameter::Nothing, "The plant of the settings.".into()),
            "arm-mass" => {
                (RandomParameter::ArmMass, "All masses and inertias of the arm scaled by 0.9 to 1.1.".into())
            }
            "pendulum-mass" => (
                RandomParameter::PendulumMass,
                "Masses and inertias of the pendulum scaled by 0.9 to 1.1.".into(),
            ),
            "pendulum-length" => {
                (RandomParameter::PendulumLength, "The rod's length scaled by 0.9 to 1.1.".into())
            }
            scenario => (RandomParameter::Nothing, plant.use_scenario(scenario)?),
        };
        Ok(Self { name: name.into(), purpose, parameter, plant })
    }

    /// Settings of the plant for start number `index`.
    pub fn plant(&self, starts: &RandomStarts<'_>, index: u64) -> Config {
        let mut config = self.plant.clone();
        let scale = 1.0 - SPREAD + 2.0 * SPREAD * starts.share(index);
        let model = &mut config.plant.model;
        match self.parameter {
            RandomParameter::Nothing => {}
            RandomParameter::ArmMass => model.actuated_mass_scale *= scale,
            RandomParameter::PendulumMass => model.unactuated_mass_scale *= scale,
            RandomParameter::PendulumLength => model.unactuated_length_scale *= scale,
        }
        config
    }
}
