//! Encoder noise has its standard deviation and no mean, bias is a constant, and both depend on the seed alone.

mod common;

use common::{at_rest, level_pose, measured_position, settings, sizes};
use upswing_config::Config;
use upswing_model::JointVector;
use upswing_plant::Plant;

const CYCLES: usize = 4_000;

fn noisy(seed: u64) -> Config {
    let mut config = settings();
    let encoder = &mut config.plant.encoder;
    // So fine that rounding is negligible.
    encoder.resolution.fill(1e-9);
    encoder.noise = JointVector::from_fn(sizes(), |i| 1e-4 * (i as f64 + 1.0));
    encoder.bias = JointVector::from_fn(sizes(), |i| 0.01 * (i as f64 - 4.0));
    encoder.seed = seed;
    config
}

/// Errors of all encoders over a run with closed brakes, rad.
fn errors(config: &Config) -> Vec<JointVector> {
    let mut plant = Plant::at(config, &level_pose(), &at_rest()).unwrap();
    let run = (0..CYCLES).map(|_| {
        let measured = measured_position(&plant);
        assert_eq!(measured, measured_position(&plant), "measuring again gives the same");
        let error = measured - plant.position();
        plant.step(None);
        error
    });
    run.collect()
}

#[test]
fn mean_and_deviation_are_those_of_the_settings() {
    let config = noisy(5);
    let errors = errors(&config);
    let n = CYCLES as f64;
    let encoder = &config.plant.encoder;
    let mean = JointVector::from_fn(sizes(), |i| errors.iter().map(|e| e[i]).sum::<f64>() / n);
    for i in 0..sizes().joints() {
        let sigma = encoder.noise[i];
        assert!(
            (mean[i] - encoder.bias[i]).abs() < 5.0 * sigma / n.sqrt(),
            "joint {}: mean {}",
            i + 1,
            mean[i]
        );
        let variance = errors.iter().map(|e| (e[i] - mean[i]).powi(2)).sum::<f64>() / (n - 1.0);
        // Five standard deviations of the estimate.
        let tolerance = 5.0 / (2.0 * n).sqrt();
        assert!((variance.sqrt() / sigma - 1.0).abs() < tolerance, "joint {}", i + 1);
        let beyond = errors.iter().filter(|e| (e[i] - mean[i]).abs() > 2.0 * sigma).count() as f64 / n;
        assert!((beyond - 0.0455).abs() < 0.017, "joint {}: {beyond} beyond two deviations", i + 1);
    }
}

#[test]
fn noise_is_white_and_independent_between_joints() {
    let config = noisy(6);
    let (errors, encoder) = (errors(&config), &config.plant.encoder);
    let unit = |e: &JointVector, i: usize| (e[i] - encoder.bias[i]) / encoder.noise[i];
    let tolerance = 5.0 / (CYCLES as f64).sqrt();
    for i in 0..sizes().joints() {
        let next: f64 = errors.windows(2).map(|pair| unit(&pair[0], i) * unit(&pair[1], i)).sum();
        assert!((next / CYCLES as f64).abs() < tolerance, "joint {}: from cycle to cycle", i + 1);
        for j in 0..i {
            let other: f64 = errors.iter().map(|e| unit(e, i) * unit(e, j)).sum();
            assert!((other / CYCLES as f64).abs() < tolerance, "joints {} and {}", i + 1, j + 1);
        }
    }
}

#[test]
fn equal_seeds_give_equal_noise_and_others_do_not() {
    let bits = |seed| {
        errors(&noisy(seed))
            .iter()
            .flat_map(|e| e.iter().map(|v| v.to_bits()).collect::<Vec<_>>())
            .collect::<Vec<_>>()
    };
    assert_eq!(bits(1), bits(1));
    assert_ne!(bits(1), bits(2));
}
