//! Offsets of the torque sensors are measured from the load that closed brakes hold, so that the arm keeps its pose when
//! they open, also where axes 1 and 3 are parallel and 0.5 N m accelerates most.

use upswing_config::{Config, PendulumStart};
use upswing_ipc::Mode;
use upswing_model::ActuatedVector;
use upswing_plant::Plant;
use upswing_rig::closed_loop::ClosedLoop;
use upswingd::step::StepRequest;

#[test]
fn the_arm_stays_where_it_is_when_the_brakes_open() {
    let mut config = Config::embedded().expect("embedded settings");
    config.use_scenario("torque-offset").expect("the scenario");
    for q2_deg in [0.0, 0.5, -3.0, 40.0] {
        let mut q = ActuatedVector::zeros(config.model.sizes());
        (q[1], q[3], q[5]) = (f64::to_radians(q2_deg), -1.5, 0.1);
        let x = config.start_state(&q, PendulumStart::Rest).expect("a pose with a rest");
        let plant = Plant::at(&config, &x.q(), &x.qd()).expect("inside its limits");
        let mut system = ClosedLoop::new(&config, plant);
        system.cycle(&mut None);
        let mut order = Some(StepRequest::Enable);
        let mut fastest: f64 = 0.0;
        for _ in 0..4000 {
            system.cycle(&mut order);
            fastest = fastest.max(system.plant.velocity().actuated().amax());
        }
        let mode = system.controller.mode();
        let astray = (system.plant.position() - x.q()).actuated().amax();
        let text = format!("q2 {q2_deg} deg: {mode}, {fastest:.4} rad/s at most, {astray:.5} rad astray");
        println!("{text}");
        assert!(mode == Mode::Hold && fastest < 0.05 && astray < 0.001, "{text}");
    }
}
