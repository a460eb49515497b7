//! A move of a few centimetres takes as long as it needs, not as long as the move of the nearest database entry.

use upswing_config::{Config, PendulumStart, System};
use upswing_planner::replan::{Effort, Planner};

/// From a place between those of the database, whose nearest entry moves further, to others nearby, m.
const START: [f64; 2] = [0.3, -0.2];
const ENDS: [[f64; 2]; 3] = [[0.305, -0.2], [0.31, -0.19], [0.32, -0.22]];
/// Longest duration as a multiple of that of the full optimisation, which ends in an optimum: a plan adapted
/// from an entry nearby keeps to limits that are a little smaller.
const LONGER: f64 = 1.2;

fn config() -> Config {
    Config::load(&"xy-spherical".parse::<System>().expect("a shipped system")).expect("settings")
}

#[test]
fn beside_the_full_optimisation() {
    let with_database = Planner::new(config()).expect("the shipped databases");
    let without = Planner::with_entries(config(), 0, "nothing".into(), Vec::new()).expect("a planner");
    let start = config().start_state(&START, PendulumStart::Rest).expect("a start");
    let manoeuvre = config().manoeuvres.iter().position(|m| m.name == "move").expect("a manoeuvre");
    let effort = Effort::iterations(config().planner.replan.iterations);
    for end in ENDS {
        let [t_f, optimum] = [&with_database, &without].map(|planner| {
            let replan = planner.replan_with(&mut planner.solver(), manoeuvre, &end, &start, &effort);
            replan.unwrap_or_else(|e| panic!("{end:?}: {e}")).trajectory.t_f
        });
        assert!(t_f < LONGER * optimum, "to {end:?}: {t_f} s, the optimum takes {optimum} s");
    }
}
