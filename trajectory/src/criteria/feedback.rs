//! Criteria for the gains of a plan: their torques, and the stability of the closed loop with its delays.

use super::matrix::Matrix;
use super::{AMPLIFIED_INTERVALS, MOST_STEP, PlanCriteria, UnmetCriterion, finite, same_sizes};
use crate::{Gain, Gains, Trajectory};
use upswing_model::{ActuatedVector, LimitKind, Linearization, Model, Posture, Sizes, Workspace};

/// Delays of the feedback loop of the daemon.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopDelays {
    /// T_s, control period, s.
    pub period: f64,
    /// T_1, time constant of the differential filter of the velocities, s; `None` where its lag is compensated.
    pub velocity_filter: Option<f64>,
    /// Periods from a measurement until its torque acts; 0: the torque acts in the period that begins with the
    /// measurement.
    pub cycles: usize,
}

impl LoopDelays {
    /// Number of states of the differential filter.
    fn filter_states(&self, sizes: Sizes) -> usize {
        if self.velocity_filter.is_some() { sizes.joints() } else { 0 }
    }

    /// Dimension of the state of the closed loop.
    fn dimension(&self, sizes: Sizes) -> usize {
        sizes.state() + self.filter_states(sizes) + self.cycles * sizes.actuated()
    }
}

/// The matrix of the closed loop over one period, with the memory for it.
struct ClosedLoop {
    delays: LoopDelays,
    /// (19)
    a: Matrix,
    b: Matrix,
    /// I T_s + A T_s^2 / 2
    half: Matrix,
    phi: Matrix,
    gamma: Matrix,
    /// u = K_s s
    k: Matrix,
    gamma_k: Matrix,
    m: Matrix,
}

impl ClosedLoop {
    fn new(delays: LoopDelays, sizes: Sizes) -> Self {
        let (n_a, n_x, dimension) = (sizes.actuated(), sizes.state(), delays.dimension(sizes));
        Self {
            delays,
            a: Matrix::zeros(n_x, n_x),
            b: Matrix::zeros(n_x, n_a),
            half: Matrix::zeros(n_x, n_x),
            phi: Matrix::zeros(n_x, n_x),
            gamma: Matrix::zeros(n_x, n_a),
            k: Matrix::zeros(n_a, dimension),
            gamma_k: Matrix::zeros(n_x, dimension),
            m: Matrix::zeros(dimension, dimension),
        }
    }

    /// The matrix for the deviation s = (x, z, delayed inputs u, oldest first): x of (19) with its derivatives, z the state of the
    /// differential filter, if there is one, u = K [q, v] (22) with the filtered velocities v.
    fn at(&mut self, derivatives: &Linearization, gain: Gain<'_>) -> &Matrix {
        let sizes = gain.sizes();
        let (n, n_x) = (sizes.joints(), sizes.state());
        for i in 0..n {
            self.a[(i, n + i)] = 1.0;
        }
        for i in 0..sizes.actuated() {
            self.b[(n + i, i)] = 1.0;
        }
        for (i, row) in (n + sizes.actuated()..n_x).zip(0..) {
            let (in_x, in_u) = derivatives.qdd_u(row).split_at(n_x);
            self.a.row_mut(i).copy_from_slice(in_x);
            self.b.row_mut(i).copy_from_slice(in_u);
        }
        self.set(gain);
        &self.m
    }

    /// The matrix with A and B that are there.
    fn set(&mut self, gain: Gain<'_>) {
        let (ts, sizes) = (self.delays.period, gain.sizes());
        let (n, n_a, n_x) = (sizes.joints(), sizes.actuated(), sizes.state());
        // Two terms of the exponential: one alone drives an undamped pendulum.
        for i in 0..n_x {
            let entries = self.half.row_mut(i).iter_mut().zip(self.a.row(i));
            entries.for_each(|(half, a)| *half = 0.5 * ts * ts * a);
            self.half[(i, i)] += ts;
        }
        self.phi.set_product(&self.half, &self.a);
        (0..n_x).for_each(|i| self.phi[(i, i)] += 1.0);
        self.gamma.set_product(&self.half, &self.b);
        self.k.fill(0.0);
        for (i, row) in gain.rows().enumerate() {
            self.k.row_mut(i)[..n_x].copy_from_slice(row);
        }
        if let Some(t_1) = self.delays.velocity_filter {
            for j in 0..n {
                for i in 0..n_a {
                    let share = self.k[(i, n + j)] / t_1;
                    self.k[(i, j)] += share;
                    self.k[(i, n + j)] = 0.0;
                    self.k[(i, n_x + j)] = -share;
                }
            }
        }
        self.m.fill(0.0);
        for i in 0..n_x {
            self.m.row_mut(i)[..n_x].copy_from_slice(self.phi.row(i));
        }
        if let Some(t_1) = self.delays.velocity_filter {
            let forgotten = -libm::expm1(-ts / t_1);
            for i in 0..n {
                self.m[(n_x + i, n_x + i)] = 1.0 - forgotten;
                self.m[(n_x + i, i)] = forgotten;
            }
        }
        let queue = n_x + self.delays.filter_states(sizes);
        if self.delays.cycles == 0 {
            self.gamma_k.set_product(&self.gamma, &self.k);
            for i in 0..n_x {
                let entries = self.m.row_mut(i).iter_mut().zip(self.gamma_k.row(i));
                entries.for_each(|(m, added)| *m += added);
            }
        } else {
            for i in 0..n_x {
                self.m.row_mut(i)[queue..queue + n_a].copy_from_slice(self.gamma.row(i));
            }
            for i in 0..(self.delays.cycles - 1) * n_a {
                self.m[(queue + i, queue + n_a + i)] = 1.0;
            }
            let newest = queue + (self.delays.cycles - 1) * n_a;
            for i in 0..n_a {
                self.m.row_mut(newest + i).copy_from_slice(self.k.row(i));
            }
        }
    }
}

impl PlanCriteria {
    /// The part of [`Self::check`] about the gains, for a trajectory that meets [`Self::check_motion`].
    ///
    /// For each gain: the torque with which it answers a deviation of one row of the state by the start tolerance. For all
    /// of them, with the gain that holds x_N where the unactuated joints stand: the [amplification](UnmetCriterion::Amplification) of the closed
    /// loop from every knot on.
    ///
    /// # Errors
    /// The first criterion that the gains do not meet, with its numbers.
    pub fn check_feedback(
        &self,
        model: &Model,
        trajectory: &Trajectory,
        gains: &Gains,
    ) -> Result<(), UnmetCriterion> {
        let n = trajectory.intervals();
        if gains.intervals() != n {
            let (expected, got) = (n + 1, gains.intervals() + 1);
            return Err(UnmetCriterion::Knots { what: "K", expected, got });
        }
        same_sizes("K", model, std::iter::once(gains.sizes()))?;
        finite("K", gains.knots().map(|k| k.as_slice()))?;
        finite("the final K", std::iter::once(gains.end().as_slice()))?;
        let (mut work, mut linearization) = (Workspace::default(), Linearization::new(model.sizes()));
        let x_n = trajectory.end();
        let stands = model.posture(&x_n.q(), &mut work) == Posture::Standing;
        let none = ActuatedVector::zeros(model.sizes());
        let last = stands.then_some((x_n, &none, gains.end()));
        // From one knot to the middle between two.
        let periods = (0.5 * trajectory.h() / self.delays.period).round().max(1.0) as u32;
        let unit = self.square_of_state(model.sizes(), AMPLIFIED_INTERVALS / n as f64);
        let square = || Matrix::zeros(unit.rows(), unit.rows());
        let (mut interval, mut scratch) = (square(), square());
        let mut closed_loop = ClosedLoop::new(self.delays, model.sizes());
        // The closed loop over half an interval with the gain of each knot.
        let mut halves = Vec::with_capacity(n + 2);
        let knots = trajectory.knots().zip(gains.knots()).map(|((x, u), gain)| (x, u, gain));
        for (knot, (x, u, gain)) in knots.chain(last).enumerate() {
            model.linearize(x, u, &mut work, &mut linearization);
            self.check_step(model, &linearization, gain, knot)?;
            let mut half = square();
            half.set_power(closed_loop.at(&linearization, gain), periods, &mut scratch);
            halves.push(half);
        }
        let mut p = unit.clone();
        if last.is_some() {
            let half = &halves[n + 1];
            interval.set_product(half, half);
            p = lyapunov(&interval, &unit)
                .ok_or_else(|| UnmetCriterion::Unstable { radius: spectral_radius(closed_loop.m) })?;
            self.check_amplification(&p, n, model.sizes())?;
        }
        let mut next = square();
        for k in (0..n).rev() {
            interval.set_product(&halves[k + 1], &halves[k]);
            next.set_congruence(&p, &interval, &mut scratch);
            next.add(&unit);
            std::mem::swap(&mut p, &mut next);
            self.check_amplification(&p, k, model.sizes())?;
        }
        Ok(())
    }

    /// The torque M~ K dx with which a gain answers a deviation dx of one row by the start tolerance; M~ is d tau / du.
    fn check_step(
        &self,
        model: &Model,
        linearization: &Linearization,
        gain: Gain<'_>,
        knot: usize,
    ) -> Result<(), UnmetCriterion> {
        let n_x = model.sizes().state();
        for joint in 0..model.sizes().actuated() {
            let reduced_inertia = &linearization.tau(joint)[n_x..];
            for row in 0..n_x {
                let column = gain.as_slice()[row..].iter().step_by(n_x);
                let dtau_dx = reduced_inertia.iter().zip(column).map(|(m, k)| m * k).sum::<f64>();
                let (got, most) = ((dtau_dx * self.tolerance[row]).abs(), MOST_STEP * self.tau_max[joint]);
                if !(got <= most) {
                    let (name, unit) =
                        (model.joint_name(joint).to_owned(), LimitKind::Torque.unit(model.joint_kind(joint)));
                    return Err(UnmetCriterion::Step { knot, joint, name, unit, got, most });
                }
            }
        }
        Ok(())
    }

    /// `p`: quadratic form of the sum of the squares of the state, in units of the start tolerance, at `knot` and all later
    /// knots of [`AMPLIFIED_INTERVALS`].
    fn check_amplification(&self, p: &Matrix, knot: usize, sizes: Sizes) -> Result<(), UnmetCriterion> {
        let (n, n_x) = (sizes.joints(), sizes.state());
        // The deviation s of one row by its tolerance, where the filter has settled on it: at most two numbers are not 0.
        let from = |row: usize| {
            let settled = self.delays.velocity_filter.map(|t_1| match row.checked_sub(n) {
                None => (n_x + row, 1.0),
                Some(joint) => (n_x + joint, -t_1),
            });
            let s = || std::iter::once((row, 1.0)).chain(settled);
            let terms = s().flat_map(|(i, a)| s().map(move |(j, b)| a * p[(i, j)] * b));
            terms.sum::<f64>().sqrt() * self.tolerance[row]
        };
        // A maximum would lose a NaN.
        let got = (0..n_x)
            .map(from)
            .fold(0.0, |worst: f64, v| if v.is_nan() { f64::INFINITY } else { worst.max(v) });
        let most = self.amplification;
        if got <= most { Ok(()) } else { Err(UnmetCriterion::Amplification { knot, got, most }) }
    }

    /// Quadratic form `factor` |x|^2, in units of the start tolerance, of a state of the closed loop.
    fn square_of_state(&self, sizes: Sizes, factor: f64) -> Matrix {
        let mut unit = Matrix::zeros(self.delays.dimension(sizes), self.delays.dimension(sizes));
        for row in 0..sizes.state() {
            unit[(row, row)] = factor * self.tolerance[row].powi(-2);
        }
        unit
    }
}

/// P of the Lyapunov equation P = Q + M' P M, the sum of (M')^i Q M^i over all i, by doubling; `None` if M is not stable.
fn lyapunov(m: &Matrix, q: &Matrix) -> Option<Matrix> {
    /// 2^40 intervals of 20 ms are seven hundred years.
    const DOUBLINGS: usize = 40;
    let (mut m, mut p) = (m.clone(), q.clone());
    let (mut step, mut scratch) = (q.clone(), q.clone());
    for _ in 0..DOUBLINGS {
        step.set_congruence(&p, &m, &mut scratch);
        p.add(&step);
        // A maximum would lose a NaN.
        if !p.as_slice().iter().all(|v| v.is_finite()) {
            return None;
        }
        if step.amax() <= 1e-12 * p.amax() {
            return Some(p);
        }
        scratch.set_product(&m, &m);
        std::mem::swap(&mut m, &mut scratch);
    }
    None
}

/// The largest magnitude of an eigenvalue of `m`: the limit of |M^n|^(1/n) for n = 2^k by repeated squaring, each time scaled to
/// norm 1. Infinite if it is not finite.
fn spectral_radius(mut m: Matrix) -> f64 {
    /// 2^40 periods of 125 us are four years.
    const SQUARINGS: i32 = 40;
    let mut square = m.clone();
    // log |M^n| / n
    let mut rate = 0.0;
    for k in 0..SQUARINGS {
        let norm = m.amax();
        if norm == 0.0 {
            return 0.0;
        }
        rate += libm::log(norm) / libm::exp2(f64::from(k));
        m.divide(norm);
        square.set_product(&m, &m);
        std::mem::swap(&mut m, &mut square);
    }
    if rate.is_finite() { libm::exp(rate) } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};
    use std::collections::VecDeque;

    /// Numbers without a pattern, from -1 to 1.
    fn number(i: usize, j: usize) -> f64 {
        ((i * 7919 + j * 104_729 + 17) % 1009) as f64 / 504.5 - 1.0
    }

    fn matrix(size: usize, radius: f64) -> DMatrix<f64> {
        let m = DMatrix::from_fn(size, size, number);
        let largest = m.complex_eigenvalues().iter().map(|e| e.re.hypot(e.im)).fold(0.0, f64::max);
        m * (radius / largest)
    }

    /// A and B of some dynamics x'' = ...
    fn dynamics(sizes: Sizes) -> (DMatrix<f64>, DMatrix<f64>) {
        let (n, n_x) = (sizes.joints(), sizes.state());
        let a = DMatrix::from_fn(n_x, n_x, |i, j| match i {
            i if i < n => f64::from(u8::from(j == n + i)),
            _ => 3.0 * number(i, j),
        });
        let b = DMatrix::from_fn(n_x, sizes.actuated(), |i, j| if i < n { 0.0 } else { number(i, j + 50) });
        (a, b)
    }

    #[test]
    fn the_spectral_radius_is_that_of_the_eigenvalues() {
        for size in [2, 7, 34] {
            for radius in [1e-3, 0.5, 0.999_999, 1.000_001, 3.0] {
                let got = spectral_radius((&matrix(size, radius)).into());
                assert!((got / radius - 1.0).abs() < 1e-9, "{size}: {got}, expected {radius}");
            }
        }
        // One that is not normal at all: far from its radius for a long time.
        let jordan = DMatrix::from_row_slice(3, 3, &[0.9996, 1e3, 0.0, 0.0, 0.9996, 1e3, 0.0, 0.0, 0.9996]);
        assert!((spectral_radius((&jordan).into()) - 0.9996).abs() < 1e-9);
        assert_eq!(spectral_radius(Matrix::zeros(3, 3)), 0.0);
        assert_eq!(spectral_radius((&DMatrix::from_element(3, 3, f64::NAN)).into()), f64::INFINITY);
        assert!((spectral_radius((&DMatrix::from_element(3, 3, 1e300)).into()) / 3e300 - 1.0).abs() < 1e-9);
    }

    #[test]
    fn the_sum_of_all_squares_solves_the_equation_of_lyapunov() {
        let q = DMatrix::from_fn(9, 9, |i, j| f64::from(u8::from(i == j)) * (1.0 + i as f64));
        for radius in [0.1, 0.9, 0.9999] {
            let m = matrix(9, radius);
            let p = DMatrix::from(&lyapunov(&(&m).into(), &(&q).into()).expect("stable"));
            assert!((&q + m.tr_mul(&(&p * &m)) - &p).amax() < 1e-9 * p.amax(), "{radius}");
        }
        for radius in [1.0001, 2.0, 1e6] {
            assert_eq!(lyapunov(&(&matrix(9, radius)).into(), &(&q).into()), None, "{radius}");
        }
        assert_eq!(lyapunov(&(&DMatrix::from_element(9, 9, f64::NAN)).into(), &(&q).into()), None);
    }

    #[test]
    fn the_closed_loop_is_plant_filter_and_delay_one_after_the_other() {
        for (joints, actuated) in [(2, 1), (5, 2), (9, 7)] {
            for velocity_filter in [Some(0.012), None] {
                for cycles in [0, 1, 3] {
                    let delays = LoopDelays { period: 1e-3, velocity_filter, cycles };
                    let error = error_of_closed_loop(Sizes::new(joints, actuated).expect("a chain"), &delays);
                    assert!(
                        error < 1e-3,
                        "{joints} joints, {velocity_filter:?}, {cycles} periods: {error:e}"
                    );
                }
            }
        }
    }

    /// Largest difference, relative to the state, of the closed loop over 50 periods to its parts one after the other.
    fn error_of_closed_loop(sizes: Sizes, delays: &LoopDelays) -> f64 {
        let (n, n_a, n_x) = (sizes.joints(), sizes.actuated(), sizes.state());
        let (a, b) = dynamics(sizes);
        let k = DMatrix::from_fn(n_a, n_x, |i, j| 40.0 * number(i, j + 99));
        let mut gains = Gains::zeros(sizes, 20);
        // Column by column of K': by rows of K.
        gains.end_mut().copy_from_slice(k.transpose().as_slice());
        let mut closed_loop = ClosedLoop::new(*delays, sizes);
        (closed_loop.a, closed_loop.b) = ((&a).into(), (&b).into());
        closed_loop.set(gains.end());
        let m = DMatrix::from(&closed_loop.m);
        let mut s = DVector::zeros(delays.dimension(sizes));
        let mut x = DVector::from_fn(n_x, |i, _| number(i, 7));
        let mut z = x.rows(0, n) * 0.9;
        s.rows_mut(0, n_x).copy_from(&x);
        s.rows_mut(n_x, delays.filter_states(sizes)).copy_from(&z.rows(0, delays.filter_states(sizes)));
        let mut on_its_way = VecDeque::from(vec![DVector::zeros(n_a); delays.cycles]);
        for _ in 0..50 {
            let q = x.rows(0, n).into_owned();
            let mut measured = x.clone();
            if let Some(t_1) = delays.velocity_filter {
                measured.rows_mut(n, n).copy_from(&((&q - &z) / t_1));
                // As `upswingd`'s filter: what the angles were for one period.
                z += (q - &z) * (1.0 - (-delays.period / t_1).exp());
            }
            on_its_way.push_back(&k * measured);
            let u = on_its_way.pop_front().expect("one more than the delay");
            // The input is constant over a period: its exact solution in small steps.
            for _ in 0..1000 {
                x += (&a * &x + &b * &u) * (delays.period / 1000.0);
            }
            s = &m * s;
        }
        (s.rows(0, n_x) - &x).amax() / x.amax()
    }
}
