//! Times the derivatives of the dynamics at one knot; `bench/derivatives/run` calls it.
//!
//! First derivatives are A and B (19) with those of the motor torque; second ones are the Hessian of w . qdd_U + mu . tau. Each at one knot alone,
//! and at four knots side by side as in the optimisation, divided by four. With a second argument, states, inputs, factors and results go
//! to a file of doubles for a peer.

use std::hint::black_box;
use std::time::Instant;
use upswing_model::{
    ActuatedVector, Dims, JointVector, Lanes, Linearization, Model, Scalar, State, Workspace,
};

/// Random states; points in a block, short enough that few blocks are interrupted, and rounds over all points.
const STATES: usize = 256;
const BLOCK: usize = 32;
const ROUNDS: usize = 100;
const LANES: usize = 4;

/// A point of the derivatives, with the factors w and mu of the Hessian.
struct Point<T> {
    x: Vec<T>,
    u: Vec<T>,
    w: Vec<T>,
    mu: Vec<T>,
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (urdf, file) = match arguments.as_slice() {
        [urdf] => (urdf, None),
        [urdf, file] => (urdf, Some(file)),
        _ => {
            eprintln!("error: expected URDF or URDF FILE, got {arguments:?}");
            std::process::exit(2);
        }
    };
    let text = std::fs::read_to_string(urdf).unwrap_or_else(|e| panic!("{urdf}: {e}"));
    let model = Model::from_urdf(&text).unwrap_or_else(|e| panic!("{urdf}: {e}"));
    let points = points(&model);
    if let Some(file) = file {
        std::fs::write(file, results(&model, &points)).unwrap_or_else(|e| panic!("{file}: {e}"));
    }
    let lanes: Vec<Point<Lanes<LANES>>> = points.chunks_exact(LANES).map(side_by_side).collect();
    let [first, both] = times(&model, &points);
    let [first_lanes, both_lanes] = times(&model, &lanes).map(|us| us / LANES as f64);
    println!("{:<50} {first:.3} us", "A, B, d tau / dz");
    println!("{:<50} {first_lanes:.3} us", "A, B, d tau / dz, four knots side by side");
    println!("{:<50} {both:.3} us", "A, B, d tau / dz and Hessian");
    println!("{:<50} {both_lanes:.3} us", "A, B, d tau / dz and Hessian, four side by side");
}

/// Random states within the limits of the URDF.
fn points(model: &Model) -> Vec<Point<f64>> {
    let (sizes, limits) = (model.sizes(), model.rated_limits());
    let mut random = random();
    (0..STATES)
        .map(|_| {
            let q = JointVector::from_fn(sizes, |_| 3.0 * random());
            let qd = limits.qd_max.map(|qd| qd.min(10.0) * random());
            let u = ActuatedVector::from_fn(sizes, |_| 10.0 * random());
            let w = (0..sizes.unactuated()).map(|_| random()).collect();
            let mu = (0..sizes.actuated()).map(|_| random()).collect();
            Point { x: State::new(&q, &qd).to_vec(), u: u.to_vec(), w, mu }
        })
        .collect()
}

fn side_by_side(points: &[Point<f64>]) -> Point<Lanes<LANES>> {
    let join = |part: fn(&Point<f64>) -> &Vec<f64>| {
        (0..part(&points[0]).len())
            .map(|i| Lanes(std::array::from_fn(|lane| part(&points[lane])[i])))
            .collect()
    };
    Point { x: join(|p| &p.x), u: join(|p| &p.u), w: join(|p| &p.w), mu: join(|p| &p.mu) }
}

/// Times of a call for the first derivatives, and for those and the Hessian: medians of means over blocks, us.
fn times<T: Scalar>(model: &Model, points: &[Point<T>]) -> [f64; 2] {
    let sizes = model.sizes();
    let (mut work, mut first) = (Workspace::default(), Linearization::new(sizes));
    let mut hessian = vec![T::ZERO; sizes.knot() * sizes.knot_row()];
    [false, true].map(|second| {
        let mut block = |points: &[Point<T>]| {
            let begin = Instant::now();
            for p in points {
                model.linearize(black_box(&p.x), black_box(&p.u), &mut work, &mut first);
                if second {
                    model.hessian(&p.w, &p.mu, &first, &mut work, &mut hessian);
                }
                black_box((&first, &hessian));
            }
            1e6 * begin.elapsed().as_secs_f64() / points.len() as f64
        };
        let mut us: Vec<f64> = (0..ROUNDS).flat_map(|_| points.chunks(BLOCK)).map(&mut block).collect();
        us.sort_by(f64::total_cmp);
        us[us.len() / 2]
    })
}

/// Numbers of joints and of motors; for each point x, u, w, mu, qdd_U, tau, then by rows their first derivatives (tau before qdd_U), then the Hessian.
fn results(model: &Model, points: &[Point<f64>]) -> Vec<u8> {
    let sizes = model.sizes();
    let (knot, stride) = (sizes.knot(), sizes.knot_row());
    let (mut work, mut first) = (Workspace::default(), Linearization::new(sizes));
    let mut hessian = vec![0.0; knot * stride];
    let mut numbers = vec![sizes.joints() as f64, sizes.actuated() as f64];
    for p in points {
        model.linearize(&p.x, &p.u, &mut work, &mut first);
        model.hessian(&p.w, &p.mu, &first, &mut work, &mut hessian);
        let value = first.value();
        for part in [&p.x, &p.u, &p.w, &p.mu, &value.qdd_u[..], &value.tau[..]] {
            numbers.extend(part);
        }
        (0..sizes.actuated()).for_each(|a| numbers.extend(first.tau(a)));
        (0..sizes.unactuated()).for_each(|c| numbers.extend(first.qdd_u(c)));
        hessian.chunks_exact(stride).for_each(|row| numbers.extend(&row[..knot]));
    }
    numbers.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// Numbers in [-1, 1) that are the same in each run (splitmix64).
fn random() -> impl FnMut() -> f64 {
    let mut state = 1_u64;
    move || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}
