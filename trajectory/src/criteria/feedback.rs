//! Criteria for the gains of a plan: their torques, and the stability of the closed loop with its delays.

use super::{AMPLIFIED_INTERVALS, MOST_STEP, PlanCriteria, UnmetCriterion, finite, same_sizes};
use crate::{Gain, Gains, Trajectory};
use nalgebra::DMatrix;
use upswing_model::{ActuatedVector, LimitKind, Linearization, Model, Posture, Sizes, State, Workspace};

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
    /// Dimension of the state of the closed loop.
    fn dimension(&self, sizes: Sizes) -> usize {
        sizes.state() + sizes.joints() + self.cycles * sizes.actuated()
    }

    /// The matrix of the closed loop over one period, for the deviation s = (x, z, delayed inputs u, oldest first): x of (19)
    /// with `a` and `b`, z the state of the differential filter, u = K [q, v] (22) with the filtered velocities v.
    fn closed_loop(&self, a: &DMatrix<f64>, b: &DMatrix<f64>, gain: Gain<'_>) -> DMatrix<f64> {
        let (ts, sizes) = (self.period, gain.sizes());
        let (n, n_a, n_x) = (sizes.joints(), sizes.actuated(), sizes.state());
        // Two terms of the exponential: one alone drives an undamped pendulum.
        let half = DMatrix::identity(n_x, n_x) * ts + a * (0.5 * ts * ts);
        let (phi, gamma) = (DMatrix::identity(n_x, n_x) + &half * a, half * b);
        // u = K_s s
        let mut k = DMatrix::zeros(n_a, self.dimension(sizes));
        k.columns_mut(0, n_x).copy_from(&DMatrix::from_row_slice(n_a, n_x, gain.as_slice()));
        if let Some(t_1) = self.velocity_filter {
            for j in 0..n {
                for i in 0..n_a {
                    let share = k[(i, n + j)] / t_1;
                    k[(i, j)] += share;
                    k[(i, n + j)] = 0.0;
                    k[(i, n_x + j)] = -share;
                }
            }
        }
        let mut m = DMatrix::zeros(self.dimension(sizes), self.dimension(sizes));
        m.view_mut((0, 0), (n_x, n_x)).copy_from(&phi);
        let forgotten = self.velocity_filter.map_or(1.0, |t_1| -(-ts / t_1).exp_m1());
        for i in 0..n {
            (m[(n_x + i, n_x + i)], m[(n_x + i, i)]) = (1.0 - forgotten, forgotten);
        }
        let queue = n_x + n;
        if self.cycles == 0 {
            let mut x = m.rows_mut(0, n_x);
            x += gamma * &k;
        } else {
            m.view_mut((0, queue), (n_x, n_a)).copy_from(&gamma);
            for i in 0..(self.cycles - 1) * n_a {
                m[(queue + i, queue + n_a + i)] = 1.0;
            }
            m.rows_mut(queue + (self.cycles - 1) * n_a, n_a).copy_from(&k);
        }
        m
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
        let mut work = Workspace::default();
        let x_n = trajectory.end();
        let stands = model.posture(&x_n.q(), &mut work) == Posture::Standing;
        let none = ActuatedVector::zeros(model.sizes());
        let last = stands.then_some((x_n, &none, gains.end()));
        let knots = trajectory.knots().zip(gains.knots()).map(|((x, u), gain)| (x, u, gain));
        for (knot, (x, u, gain)) in knots.chain(last).enumerate() {
            self.check_step(model, x, u, gain, knot, &mut work)?;
        }
        let mut linearization = Linearization::new(model.sizes());
        let mut closed_loop = |x: &State, u: &ActuatedVector, gain: Gain<'_>| {
            model.linearize(x, u, &mut work, &mut linearization);
            self.delays.closed_loop(&linearization.a(), &linearization.b(), gain)
        };
        // From one knot to the middle between two.
        let periods = (0.5 * trajectory.h() / self.delays.period).round().max(1.0) as u32;
        let unit = self.square_of_state(model.sizes()) * (AMPLIFIED_INTERVALS / n as f64);
        let mut p = unit.clone();
        if let Some((x, u, gain)) = last {
            let m = closed_loop(x, u, gain);
            p = lyapunov(&power(&m, 2 * periods), &unit)
                .ok_or_else(|| UnmetCriterion::Unstable { radius: spectral_radius(m) })?;
            self.check_amplification(&p, n, model.sizes())?;
        }
        let mut half =
            |k: usize| power(&closed_loop(&trajectory.x[k], &trajectory.u[k], gains.knot(k)), periods);
        let mut after = half(n);
        for k in (0..n).rev() {
            let before = half(k);
            let interval = &after * &before;
            p = &unit + congruence(&p, &interval);
            self.check_amplification(&p, k, model.sizes())?;
            after = before;
        }
        Ok(())
    }

    /// The torque M~ K dx with which a gain answers a deviation dx of one row by the start tolerance.
    fn check_step(
        &self,
        model: &Model,
        x: &State,
        u: &ActuatedVector,
        gain: Gain<'_>,
        knot: usize,
        work: &mut Workspace,
    ) -> Result<(), UnmetCriterion> {
        model.hybrid_dynamics(x, u, work);
        let reduced_inertia = model.reduced_inertia(work);
        for row in 0..x.len() {
            let tau = &reduced_inertia * &gain.column(row) * self.tolerance[row];
            for joint in 0..tau.len() {
                let (got, most) = (tau[joint].abs(), MOST_STEP * self.tau_max[joint]);
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
    fn check_amplification(&self, p: &DMatrix<f64>, knot: usize, sizes: Sizes) -> Result<(), UnmetCriterion> {
        let (n, n_x) = (sizes.joints(), sizes.state());
        // The deviation s of one row by its tolerance, where the filter has settled on it: two numbers are not 0, and s' P s has four
        // terms.
        let from = |row: usize| {
            let settled = match row.checked_sub(n) {
                None => (n_x + row, 1.0),
                Some(joint) => (n_x + joint, -self.delays.velocity_filter.unwrap_or(0.0)),
            };
            let s = [(row, 1.0), settled];
            let terms = s.iter().flat_map(|(i, a)| s.iter().map(move |(j, b)| a * p[(*i, *j)] * b));
            terms.sum::<f64>().sqrt() * self.tolerance[row]
        };
        // A maximum would lose a NaN.
        let got = (0..n_x)
            .map(from)
            .fold(0.0, |worst: f64, v| if v.is_nan() { f64::INFINITY } else { worst.max(v) });
        let most = self.amplification;
        if got <= most { Ok(()) } else { Err(UnmetCriterion::Amplification { knot, got, most }) }
    }

    /// Quadratic form |x|^2, in units of the start tolerance, of a state of the closed loop.
    fn square_of_state(&self, sizes: Sizes) -> DMatrix<f64> {
        let mut unit = DMatrix::zeros(self.delays.dimension(sizes), self.delays.dimension(sizes));
        for row in 0..sizes.state() {
            unit[(row, row)] = self.tolerance[row].powi(-2);
        }
        unit
    }
}

/// P of the Lyapunov equation P = Q + M' P M, the sum of (M')^i Q M^i over all i, by doubling; `None` if M is not stable.
fn lyapunov(m: &DMatrix<f64>, q: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    /// 2^40 intervals of 20 ms are seven hundred years.
    const DOUBLINGS: usize = 40;
    let (mut m, mut p) = (m.clone(), q.clone());
    for _ in 0..DOUBLINGS {
        let step = congruence(&p, &m);
        p += &step;
        // A maximum would lose a NaN.
        if !p.iter().all(|v| v.is_finite()) {
            return None;
        }
        if step.amax() <= 1e-12 * p.amax() {
            return Some(p);
        }
        m = &m * &m;
    }
    None
}

/// M' P M. With the transpose written out it is two products of the fast kind; `tr_mul` takes one scalar product per entry, three times as
/// long.
fn congruence(p: &DMatrix<f64>, m: &DMatrix<f64>) -> DMatrix<f64> {
    m.transpose() * (p * m)
}

/// m^n for `n` of 1 or above.
fn power(m: &DMatrix<f64>, n: u32) -> DMatrix<f64> {
    let mut result = m.clone();
    // The bits below the highest one, from the top.
    for bit in (0..n.ilog2()).rev() {
        result = &result * &result;
        if n >> bit & 1 == 1 {
            result = &result * m;
        }
    }
    result
}

/// The largest magnitude of an eigenvalue of `m`: the limit of |M^n|^(1/n) for n = 2^k by repeated squaring, each time scaled to
/// norm 1. Infinite if it is not finite.
fn spectral_radius(mut m: DMatrix<f64>) -> f64 {
    /// 2^40 periods of 125 us are four years.
    const SQUARINGS: i32 = 40;
    // log |M^n| / n
    let mut rate = 0.0;
    for k in 0..SQUARINGS {
        let norm = m.amax();
        if norm == 0.0 {
            return 0.0;
        }
        rate += norm.ln() / f64::from(k).exp2();
        m /= norm;
        m = &m * &m;
    }
    if rate.is_finite() { rate.exp() } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DVector;
    use std::collections::VecDeque;

    /// Numbers without a pattern, from -1 to 1.
    fn number(i: usize, j: usize) -> f64 {
        ((i * 7919 + j * 104_729 + 17) % 1009) as f64 / 504.5 - 1.0
    }

    fn matrix(size: usize, radius: f64) -> DMatrix<f64> {
        let m = DMatrix::from_fn(size, size, number);
        let largest = m.complex_eigenvalues().iter().map(|e| e.norm()).fold(0.0, f64::max);
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
    fn a_power_is_that_many_products() {
        let m = matrix(5, 0.9);
        let mut product = DMatrix::identity(5, 5);
        for n in 1..40 {
            product = &product * &m;
            assert!((power(&m, n) - &product).amax() < 1e-14, "{n}");
        }
    }

    #[test]
    fn the_spectral_radius_is_that_of_the_eigenvalues() {
        for size in [2, 7, 34] {
            for radius in [1e-3, 0.5, 0.999_999, 1.000_001, 3.0] {
                let got = spectral_radius(matrix(size, radius));
                assert!((got / radius - 1.0).abs() < 1e-9, "{size}: {got}, expected {radius}");
            }
        }
        // One that is not normal at all: far from its radius for a long time.
        let jordan = DMatrix::from_row_slice(3, 3, &[0.9996, 1e3, 0.0, 0.0, 0.9996, 1e3, 0.0, 0.0, 0.9996]);
        assert!((spectral_radius(jordan) - 0.9996).abs() < 1e-9);
        assert_eq!(spectral_radius(DMatrix::zeros(3, 3)), 0.0);
        assert_eq!(spectral_radius(DMatrix::from_element(3, 3, f64::NAN)), f64::INFINITY);
        assert!((spectral_radius(DMatrix::from_element(3, 3, 1e300)) / 3e300 - 1.0).abs() < 1e-9);
    }

    #[test]
    fn the_sum_of_all_squares_solves_the_equation_of_lyapunov() {
        let q = DMatrix::from_fn(9, 9, |i, j| f64::from(u8::from(i == j)) * (1.0 + i as f64));
        for radius in [0.1, 0.9, 0.9999] {
            let m = matrix(9, radius);
            let p = lyapunov(&m, &q).expect("stable");
            assert!((&q + m.tr_mul(&(&p * &m)) - &p).amax() < 1e-9 * p.amax(), "{radius}");
        }
        for radius in [1.0001, 2.0, 1e6] {
            assert_eq!(lyapunov(&matrix(9, radius), &q), None, "{radius}");
        }
        assert_eq!(lyapunov(&DMatrix::from_element(9, 9, f64::NAN), &q), None);
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
        let m = delays.closed_loop(&a, &b, gains.end());
        let mut s = DVector::zeros(delays.dimension(sizes));
        let mut x = DVector::from_fn(n_x, |i, _| number(i, 7));
        let mut z = x.rows(0, n) * 0.9;
        s.rows_mut(0, n_x).copy_from(&x);
        s.rows_mut(n_x, n).copy_from(&z);
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
