//! Random starts fill the ranges of the grid evenly, are at rest there, and depend on seed and number alone.

use upswing_config::{Config, GridAxis};
use upswing_model::{JointVector, Workspace};
use upswing_rig::montecarlo::{NoStart, RandomStarts, Spread};

fn config() -> Config {
    Config::embedded().expect("embedded settings")
}

#[test]
fn starts_are_at_rest_within_40_degrees() {
    let config = config();
    let starts = RandomStarts { config: &config, seed: 7 };
    let mut work = Workspace::default();
    for index in 0..500 {
        let x = starts.start(index).expect("a start");
        let varied: Vec<usize> = config.manoeuvres[0].grid.axes.iter().map(|a| a.joint).collect();
        for a in &config.manoeuvres[0].grid.axes {
            assert!((a.from..=a.to).contains(&x[a.joint]), "start {index}, joint {}", a.joint + 1);
        }
        assert!((0..7).all(|i| varied.contains(&i) || x[i] == 0.0));
        assert!(x.q_u().amax() <= 40_f64.to_radians());
        assert_eq!(x.qd(), JointVector::zeros(x.sizes()));
        let torque = config.model.gravity_torque(&x.q(), &mut work);
        assert!(torque.unactuated().amax() < 1e-9, "start {index} is no equilibrium");
    }
}

#[test]
fn joint_1_which_no_rule_restricts_is_uniform() {
    let config = config();
    let starts = RandomStarts { config: &config, seed: 0 };
    let GridAxis { from, to, .. } = config.manoeuvres[0].grid.axes[0];
    let mut tenths = [0; 10];
    for index in 0..5000 {
        let x = starts.start(index).expect("a start");
        tenths[((x[0] - from) / (to - from) * 10.0) as usize] += 1;
    }
    // Chi-square with 9 degrees of freedom: above 27.9 once in a thousand seeds.
    let chi_square: f64 = tenths.iter().map(|n| (f64::from(*n) - 500.0).powi(2) / 500.0).sum();
    assert!(chi_square < 27.9, "{tenths:?}");
}

#[test]
fn seed_and_number_are_all_that_matters() {
    let config = config();
    let starts = RandomStarts { config: &config, seed: 1 };
    let first: Vec<_> = (0..20).map(|i| starts.start(i)).collect();
    let backwards: Vec<_> = (0..20).rev().map(|i| starts.start(i)).collect();
    assert!(first.iter().eq(backwards.iter().rev()));
    let other = RandomStarts { config: &config, seed: 2 };
    assert!((0..20).all(|i| other.start(i) != first[i as usize]));
    assert!((1..20).all(|i| first[i] != first[0]));
}

#[test]
fn ranges_without_a_rest_position_are_refused() {
    let mut config = config();
    // At a pitch of 0 the pendulum would rest at -90 deg.
    for a in &mut config.manoeuvres[0].grid.axes {
        (a.from, a.to) = (0.0, 0.0);
    }
    assert_eq!(RandomStarts { config: &config, seed: 0 }.start(0), Err(NoStart));
}

#[test]
fn a_spread_is_made_of_the_values_themselves() {
    let spread = Spread::of((1..=200).rev().map(f64::from)).expect("values");
    assert_eq!(spread, Spread { min: 1.0, p01: 2.0, median: 100.0, p99: 198.0, max: 200.0 });
    assert_eq!(Spread::of([]), None);
    let one = Spread::of([3.5]).expect("a value");
    assert!([one.min, one.p01, one.median, one.p99, one.max].iter().all(|v| *v == 3.5));
}
