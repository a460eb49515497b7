use upswing_model::*;
use upswing_planner::interior_point::*;
use upswing_planner::problem::*;
use std::time::Instant;
fn main() {
    let model = Model::from_urdf(include_str!("../../config/robot.urdf")).unwrap();
    let j: serde_json::Value = serde_json::from_str(&std::fs::read_to_string("/work/shared/reference/optimal_trajectories.json").unwrap()).unwrap();
    let mut limits = *model.rated_limits();
    limits.qd_max *= 0.5; limits.tau_max *= 0.5;
    limits.q_max[7] = 200f64.to_radians(); limits.q_min[7] = -limits.q_max[7];
    let paper = std::env::args().any(|a| a == "paper");
    for t in j["trajectories"].as_array().unwrap() {
        let mut q = JointVector::zeros();
        for i in 0..7 { q[i] = t["start_deg"][i].as_f64().unwrap().to_radians(); }
        let mut w = Workspace::default();
        let q = model.rest_position(&q, &mut w).unwrap();
        let p = Problem { model: &model, limits, torque: if paper { TorqueConstraint::WithoutCoriolis{ lower: -ActuatedVector::from([6.,7.,3.,4.,1.,1.,0.1]), upper: ActuatedVector::from([6.,8.,3.,4.,1.,1.,0.1])} } else { TorqueConstraint::Exact }, input_weight: 0.01, t_f: (0.3, 8.0),
            start: state(&q, &JointVector::zeros()), target: upright_target(90f64.to_radians(), 180f64.to_radians()) };
        let u: Vec<ActuatedVector> = t["u"].as_array().unwrap().iter().map(|v| ActuatedVector::from_fn(|i,_| v[i].as_f64().unwrap())).collect();
        let ref_cost = p.cost(t["t_f"].as_f64().unwrap(), &u);
        let t0 = Instant::now();
        let s = solve(&p, &p.straight_line(2.0), &Options::default());
        println!("{:?} it {} cost {:.5} (ipopt {:.5}, {:.5}; {:+.3} %) tf {:.4} viol {:.1e} stat {:.1e} time {:.2}s q9 {:.2}", s.status, s.iterations, s.cost, t["cost"].as_f64().unwrap(), ref_cost, 100.0*(s.cost/ref_cost-1.0), s.trajectory.t_f, s.violation, s.stationarity, t0.elapsed().as_secs_f64(), q[8].to_degrees());
    }
}
