//! Joint encoders with bias, noise and resolution.

use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};
use std::f64::consts::TAU;
use upswing_config::EncoderSettings;
use upswing_model::JointVector;

/// The encoders of all joints.
#[derive(Clone, Debug)]
pub(crate) struct Encoders {
    settings: EncoderSettings,
    random: Pcg64,
}

impl Encoders {
    pub(crate) fn new(settings: &EncoderSettings) -> Self {
        Self { settings: *settings, random: Pcg64::seed_from_u64(settings.seed) }
    }

    /// Readings of the true positions `q` (rad or m): q + bias + noise, rounded to the resolution, rad or m. Each call draws new
    /// noise.
    pub(crate) fn read(&mut self, q: &JointVector) -> JointVector {
        let EncoderSettings { resolution, noise, bias, .. } = self.settings;
        JointVector::from_fn(q.sizes(), |i| {
            let mut position = q[i] + bias[i];
            if noise[i] > 0.0 {
                position += noise[i] * self.standard_normal();
            }
            (position / resolution[i]).round() * resolution[i]
        })
    }

    /// A sample of the standard normal distribution, by the Box-Muller transform.
    fn standard_normal(&mut self) -> f64 {
        /// 2^-53: the uniform numbers are multiples of it.
        const UNIT: f64 = f64::EPSILON / 2.0;
        let mut uniform = || ((self.random.next_u64() >> 11) + 1) as f64 * UNIT;
        // Uniform numbers in (0, 1], so that the logarithm is finite.
        (-2.0 * libm::log(uniform())).sqrt() * libm::cos(TAU * uniform())
    }
}
