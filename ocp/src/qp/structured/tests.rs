//! The structured back end finds the solutions of a sparse solver of other authors for random programs of all sizes, from cold and from
//! the multipliers of another program, with hard and with softened bounds, with the same bits in every instance.

use super::*;
use crate::dims::{Avx2, Baseline};
use crate::kkt::Dynamics;
use crate::qp::{Backend, QpSolver, TorqueRows};
use crate::random::Random;
use crate::slab::{Knots, Slab};
use upswing_model::{ActuatedVector, Fixed, MOST_JOINTS, States};

/// Tolerances with which inputs agree even where a bound is weakly active.
const PRECISE: QpOptions<'_> = QpOptions {
    tolerance: 1e-9,
    complementarity: 1e-14,
    max_iterations: 100,
    deadline: None,
    cancelled: None,
};

/// Sizes of chains: few, many and all but one joint actuated.
fn some_sizes() -> impl Iterator<Item = Sizes> {
    (2..=MOST_JOINTS).flat_map(|n| {
        let mut actuated = [1, n / 2, n - 1];
        actuated.sort_unstable();
        let mut before = 0;
        actuated
            .into_iter()
            .filter_map(move |a| (std::mem::replace(&mut before, a) != a).then(|| Sizes::new(n, a)).flatten())
    })
}

/// A program of `n` intervals around a point that meets all constraints, with some bounds close to it.
fn program(random: &mut Random, sizes: Sizes, n: usize) -> Qp {
    let mut point = Slab::<Knots>::zeros(sizes, n + 1, 1);
    let mut weight = point.clone();
    let mut gradient = point.clone();
    let mut dynamics = Dynamics::zeros(sizes, n);
    let mut jacobian = Slab::<Knots>::zeros(sizes, n + 1, sizes.actuated());
    for k in 0..=n {
        point.vector_mut(k).fill_with(|| 0.3 * random.next());
        weight.vector_mut(k).fill_with(|| 1.0 + 0.9 * random.next());
        gradient.vector_mut(k).fill_with(|| 3.0 * random.next());
        dynamics.f.vector_mut(k).fill_with(|| random.next());
        for i in 0..sizes.unactuated() {
            dynamics.rows.row_mut(k, i).fill_with(|| 2.0 * random.next());
        }
        for i in 0..sizes.actuated() {
            jacobian.row_mut(k, i).fill_with(|| random.next());
        }
    }
    let (h, t) = (0.1, 0.1 * random.next());
    let mut defects = Slab::<States>::zeros(sizes, n, 1);
    let f = |k: usize| {
        dynamics.apply(k, point.vector(k)) * (0.5 * h) + dynamics.f.state(k) * (t / (2 * n) as f64)
    };
    for k in 0..n {
        defects.set(k, &(f(k) + f(k + 1) - (point.x(k + 1) - point.x(k))));
    }
    let target = (0..sizes.actuated())
        .map(|_| {
            let coefficients = State::from_fn(sizes, |_| random.next());
            TargetRow { coefficients, value: coefficients.dot(&point.x(n)) }
        })
        .collect();
    let mut room = || 0.6 + 0.5 * random.next();
    let x = (1..=n)
        .map(|k| {
            let x = point.x(k);
            (x.map(|x| x - room()), x.map(|x| x + room()))
        })
        .collect();
    let bounds = (0..=n)
        .map(|k| {
            let mut tau = ActuatedVector::zeros(sizes);
            for i in 0..sizes.actuated() {
                tau[i] = dot(jacobian.row(k, i), point.vector(k));
            }
            (tau.map(|tau| tau - room()), tau.map(|tau| tau + room()))
        })
        .collect();
    Qp {
        weight,
        weight_t: 1.0,
        gradient,
        gradient_t: random.next(),
        h,
        dynamics,
        defects,
        start: point.x(0),
        target,
        x,
        t: (t - 0.2, t + 0.2),
        torque: TorqueRows { jacobian, bounds },
        compliance: 0.0,
    }
}

/// Largest difference of z and t of two solutions.
fn difference(a: &QpSolution, b: &QpSolution) -> f64 {
    let z = a.z.as_slice().iter().zip(b.z.as_slice()).map(|(a, b)| (a - b).abs());
    z.fold((a.t - b.t).abs(), f64::max)
}

/// Number of bounds that the solution touches.
fn active(solver: &Structured) -> usize {
    let touches = |side: &Side| side.slack.iter().filter(|slack| **slack < 1e-6).count();
    touches(&solver.below) + touches(&solver.above)
}

#[test]
fn solutions_are_those_of_clarabel_for_all_sizes() {
    const N: usize = 8;
    let mut random = Random(1);
    for sizes in some_sizes() {
        let mut structured = Structured::new(sizes, N);
        let mut clarabel = QpSolver::new(Backend::Clarabel, sizes, N);
        let mut touched = 0;
        for round in 0..3 {
            let qp = program(&mut random, sizes, N);
            assert_eq!(structured.solve(&qp, false, &PRECISE), QpStatus::Solved, "{sizes:?}, {round}");
            assert_eq!(clarabel.solve(&qp, &PRECISE), QpStatus::Solved, "{sizes:?}, {round}");
            let miss = difference(structured.solution(), clarabel.solution());
            assert!(miss < 1e-6, "{sizes:?}, {round}: {miss:e}");
            touched += active(&structured);
        }
        assert!(touched >= 3, "{sizes:?}: only {touched} bounds are active");
    }
}

#[test]
fn a_warm_start_ends_where_a_cold_one_does() {
    const N: usize = 12;
    let mut random = Random(2);
    for sizes in some_sizes().step_by(4) {
        let (mut warm, mut cold) = (Structured::new(sizes, N), Structured::new(sizes, N));
        let mut qp = program(&mut random, sizes, N);
        assert_eq!(warm.solve(&qp, false, &PRECISE), QpStatus::Solved, "{sizes:?}");
        for g in qp.gradient.as_mut_slice() {
            *g *= 1.05;
        }
        assert_eq!(warm.solve(&qp, true, &PRECISE), QpStatus::Solved, "{sizes:?}");
        assert_eq!(cold.solve(&qp, false, &PRECISE), QpStatus::Solved, "{sizes:?}");
        let miss = difference(warm.solution(), cold.solution());
        assert!(miss < 1e-6, "{sizes:?}: {miss:e}");
    }
}

#[test]
fn softened_bounds_yield_where_hard_ones_contradict() {
    const N: usize = 8;
    let mut random = Random(3);
    for sizes in some_sizes().step_by(3) {
        let mut qp = program(&mut random, sizes, N);
        // The first velocity jumps, though no input is that large.
        let v = sizes.joints();
        (qp.x[2].0[v], qp.x[2].1[v]) = (50.0, 60.0);
        (qp.x[4].0[v], qp.x[4].1[v]) = (-60.0, -50.0);
        let mut structured = Structured::new(sizes, N);
        let status = structured.solve(&qp, false, &PRECISE);
        assert!(matches!(status, QpStatus::Infeasible(Some(_))), "{sizes:?}: {status:?}");
        let mut clarabel = QpSolver::new(Backend::Clarabel, sizes, N);
        assert!(matches!(clarabel.solve(&qp, &PRECISE), QpStatus::Infeasible(_)), "{sizes:?}");
        qp.compliance = 1e-2;
        assert_eq!(structured.solve(&qp, false, &PRECISE), QpStatus::Solved, "{sizes:?}");
        assert_eq!(clarabel.solve(&qp, &PRECISE), QpStatus::Solved, "{sizes:?}");
        let scale = amax(structured.solution().z.as_slice());
        let miss = difference(structured.solution(), clarabel.solution()) / scale;
        assert!(miss < 1e-6, "{sizes:?}: {miss:e}");
    }
}

/// Compares the instances of `fixed` and of the sizes `sizes` read at run time, for all registers.
fn all_instances_agree<D: Dims>(sizes: Sizes, fixed: D) {
    const N: usize = 15;
    fn solved<D: Registers>(d: D, qp: &Qp) -> (Slab<Knots>, f64, usize) {
        let mut solver = Structured::new(qp.sizes(), N);
        assert_eq!(solver.solve_with(d, qp, false, &PRECISE), QpStatus::Solved);
        let QpSolution { z, t, iterations } = solver.solution;
        (z, t, iterations)
    }
    let qp = program(&mut Random(4), sizes, N);
    let want = solved(Baseline(sizes), &qp);
    assert_eq!(solved(Baseline(fixed), &qp), want, "{sizes:?}");
    if let (Some(run), Some(fixed)) = (Avx2::detect(sizes), Avx2::detect(fixed)) {
        assert_eq!(solved(run, &qp), want, "{sizes:?}, AVX2");
        assert_eq!(solved(fixed, &qp), want, "{sizes:?}, AVX2");
    }
}

#[test]
fn sizes_and_registers_leave_the_bits_as_they_are() {
    some_sizes().step_by(3).for_each(|sizes| all_instances_agree(sizes, sizes));
    all_instances_agree(Sizes::new(9, 7).expect("a chain"), Fixed::<9, 7>);
    all_instances_agree(Sizes::new(2, 1).expect("a chain"), Fixed::<2, 1>);
}
