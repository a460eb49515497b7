//! Each shipped system flies its manoeuvres one after the other, controller and plant in one process: it ends each plan where the plan
//! ends, in Balance or in Hold, without a trip and within its limits. Manoeuvres with given values are flown to both ends of their ranges
//! and to a place between them that no database has.

use upswing_config::{Config, Manoeuvre, System};
use upswing_ipc::{Mode, PlanMessage};
use upswing_model::{Posture, State};
use upswing_ocp::qp::QpSolver;
use upswing_planner::replan::{Effort, Planner};
use upswing_plant::Plant;
use upswing_rig::closed_loop::ClosedLoop;
use upswing_rig::course::SETTLE;
use upswing_trajectory::Trajectory;
use upswingd::plan::accept;
use upswingd::step::StepRequest;

/// Time after the end of a plan, s, and its last part, in which the system has to be where the plan ends.
const AFTER: f64 = 3.0;
const LAST: f64 = 0.5;
/// Largest distances from the end of the plan: of a balanced system, and of an actuated and an unactuated joint after a plan that ends
/// hanging, rad or m: nobody controls the unactuated ones then.
const BALANCED: f64 = 0.03;
const HELD: f64 = 0.01;
const HANGING: f64 = 0.1;
/// Largest position beyond the limits of a joint that is held at their ends, rad or m: two steps of 2e-5, which its encoder does not
/// resolve for certain.
const STEP: f64 = 4e-5;

struct Flight<'a> {
    config: &'a Config,
    planner: &'a Planner,
    solver: QpSolver,
    system: ClosedLoop,
}

impl Flight<'_> {
    fn seconds(&self, cycles: u64) -> f64 {
        cycles as f64 * self.config.daemon.cycle.period.seconds()
    }

    /// One cycle; its true state, if nothing tripped.
    fn cycle(&mut self, request: Option<StepRequest>) -> Result<State, String> {
        let model = &self.config.model;
        let output = self.system.cycle(&mut { request }).ok_or("no measurement")?;
        if let Some(Err(refusal)) = output.answer {
            return Err(refusal.text(model));
        }
        if let Some(trip) = output.record.trip {
            let (t, x) = (output.record.telemetry.t_plan, self.system.controller.state());
            return Err(format!("{} at {t:.3} s, q {:.3?}, qd {:.3?}", trip.text(model), x.q(), x.qd()));
        }
        let tau = output.record.telemetry.vectors(model.order()).map_err(|e| e.to_string())?.tau;
        let limits = &self.config.robot.limits;
        for i in 0..tau.len() {
            if tau[i].abs() > limits.tau_max[i] {
                return Err(format!("torque {} of joint `{}`", tau[i], model.joint_name(i)));
            }
        }
        let x = State::new(self.system.plant.position(), self.system.plant.velocity());
        for i in 0..limits.q_max.len() {
            let name = model.joint_name(i);
            if i < tau.len() && !(limits.q_min[i] - STEP..=limits.q_max[i] + STEP).contains(&x.q()[i]) {
                return Err(format!("joint `{name}` is at {}", x.q()[i]));
            }
            if x.qd()[i].abs() > limits.qd_max[i] {
                return Err(format!("joint `{name}` moves at {}", x.qd()[i]));
            }
        }
        Ok(x)
    }

    /// Plans a manoeuvre from the present state and flies it; returns the plan.
    fn fly(&mut self, number: usize, given: &[f64]) -> Result<Trajectory, String> {
        let start = *self.system.controller.state();
        let effort = Effort::iterations(self.config.planner.replan.iterations);
        let replan = self.planner.replan_with(&mut self.solver, number, given, &start, &effort);
        let replan = replan.map_err(|e| e.to_string())?;
        let message = PlanMessage::new(&replan.plan(self.config), self.config.model.order());
        let plan = accept(&message, self.config).map_err(|e| e.to_string())?;
        let id = plan.id;
        self.cycle(Some(StepRequest::Load(plan)))?;
        self.cycle(Some(StepRequest::Start(id)))?;
        let manoeuvre = &self.config.manoeuvres[number];
        let (trajectory, mut passed) = (replan.trajectory, 2);
        let end = *trajectory.end();
        while self.seconds(passed) < trajectory.t_f + AFTER {
            let x = self.cycle(None)?;
            passed += 1;
            if self.seconds(passed) > trajectory.t_f + AFTER - LAST {
                self.check_end(manoeuvre, &x, &end)?;
            }
        }
        Ok(trajectory)
    }

    /// Checks the state `x` some time after a plan that ends in `end`.
    fn check_end(&self, manoeuvre: &Manoeuvre, x: &State, end: &State) -> Result<(), String> {
        let mode = self.system.controller.mode();
        if mode != Mode::from_posture(manoeuvre.end) {
            return Err(format!("mode {mode}"));
        }
        let off = x.q() - end.q();
        let (arm, free) = match manoeuvre.end {
            Posture::Standing => (BALANCED, BALANCED),
            Posture::Hanging => (HELD, HANGING),
        };
        if off.actuated().amax() > arm || off.unactuated().amax() > free {
            return Err(format!("{off:.4?} from the end of the plan"));
        }
        Ok(())
    }
}

/// Flies all manoeuvres of a system that can follow one another, and returns a line for each.
fn flights(system: &System) -> Result<Vec<String>, String> {
    let mut config = Config::load(system).map_err(|e| e.to_string())?;
    let first = config.manoeuvres.first().ok_or("no manoeuvre")?;
    // From near a corner of the grid: the longest way.
    let poses = (0..first.grid.poses()).map(|number| first.grid.pose(number));
    let mut starts =
        poses.filter(|q_a| first.start_state(&config.model, &config.robot.planning, q_a).is_some());
    config.plant.start.q = starts.next().ok_or("no start")?;
    let plant = Plant::new(&config).map_err(|e| e.to_string())?;
    let planner = Planner::new(config.clone()).map_err(|e| e.to_string())?;
    let mut flight = Flight {
        config: &config,
        planner: &planner,
        solver: planner.solver(),
        system: ClosedLoop::new(&config, plant),
    };
    flight.cycle(None)?;
    flight.cycle(Some(StepRequest::Enable))?;
    while flight.seconds(flight.system.plant.seq()) < SETTLE {
        flight.cycle(None)?;
    }
    let mut posture = Posture::Hanging;
    let mut left: Vec<_> = (0..config.manoeuvres.len()).collect();
    let mut lines = Vec::new();
    // Those that end in the posture in which they begin come first.
    while let Some(next) = left
        .iter()
        .position(|&i| config.manoeuvres[i].start == posture && config.manoeuvres[i].end == posture)
        .or_else(|| left.iter().position(|&i| config.manoeuvres[i].start == posture))
    {
        let number = left.remove(next);
        let manoeuvre = &config.manoeuvres[number];
        posture = manoeuvre.end;
        let between = [0.0, 1.0, 0.37];
        let asked = if manoeuvre.given().count() == 0 { 1 } else { between.len() };
        for share in &between[..asked] {
            let given: Vec<_> =
                manoeuvre.given().map(|axis| axis.from + (axis.to - axis.from) * share).collect();
            let name = format!("{} {given:.3?}", manoeuvre.name);
            let flown = flight.fly(number, &given).map_err(|e| format!("{name}: {e}"))?;
            lines.push(format!("{name}: {:.3} s", flown.t_f));
        }
    }
    if !left.is_empty() {
        return Err(format!(
            "no way to {:?}",
            left.iter().map(|i| &config.manoeuvres[*i].name).collect::<Vec<_>>()
        ));
    }
    Ok(lines)
}

#[test]
fn all_manoeuvres_of_all_of_them() {
    let mut wrong = Vec::new();
    for shipped in System::shipped() {
        match flights(&System::Shipped(shipped)) {
            Ok(lines) => println!("{}: {}", shipped.name(), lines.join(", ")),
            Err(e) => wrong.push(format!("{}: {e}", shipped.name())),
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}
