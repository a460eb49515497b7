//! Discrete time-variant LQR (18)-(23) along a trajectory.

use crate::dims::{Registers, dispatch, kernels};
use crate::kernels::{backward, combine, eliminate, mirror, rank_update, shift_add};
use crate::slab::{Knots, Slab};
use nalgebra::DMatrix;
use upswing_model::{
    ActuatedVector, Dims, LARGEST_STATE, Linearization, MOST_JOINTS, Model, Sizes, State, States, Workspace,
};
use upswing_trajectory::{Gain, Gains, Trajectory};

/// The Riccati equation (21) has no stabilising solution at the trajectory's end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no gain stabilises the end of the trajectory: the Riccati equation (21) has no solution there")]
pub struct NotStabilisable;

/// Weights Q_c and R_c of (20).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LqrWeights {
    /// Diagonal of Q_c along the trajectory: 1/rad^2 or 1/m^2 for positions, times s^2 for velocities.
    pub q: State,
    /// The same for the gain that holds x_N. With the weights of the trajectory that gain is unstable if the bearings of the
    /// pendulum have more friction than 0.2 N m s/rad, as at small speeds they have where they stick.
    pub q_end: State,
    /// r of R_c = r I, s^4/rad^2 or s^4/m^2.
    pub r: f64,
}

/// How the gains of (23) are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Recursion {
    /// With the period T_s, as in the paper.
    Periods,
    /// With a few longer periods, and extrapolated to T_s (Richardson, *The deferred approach to the limit*, Phil. Trans. R. Soc. A 226,
    /// 1927); with T_s itself where that takes no more steps.
    Extrapolated,
}

/// Numbers of periods per interval from which gains are extrapolated, one after the other until they suffice: the sequence of Bulirsch and
/// Stoer (Numer. Math. 8, 1966).
const PERIODS: [usize; 8] = [2, 3, 4, 6, 8, 12, 16, 24];
/// Largest change of a gain by the last of them, relative to the largest entry of the gain. What the next one would change, which is about
/// the error, is a tenth of it or less for the entries of all shipped databases.
const LARGEST_CHANGE: f64 = 1e-3;

/// Solves (21), then iterates (23) backwards, with A and B interpolated between the knots; keeps the gains at the knots: those of the
/// last period that begins there or before. `ts`: control period T_s, s.
///
/// # Errors
/// [`NotStabilisable`] if (21) has no stabilising solution at x_N.
pub fn synthesize(
    model: &Model,
    trajectory: &Trajectory,
    weights: &LqrWeights,
    ts: f64,
    recursion: Recursion,
    work: &mut Workspace,
) -> Result<Gains, NotStabilisable> {
    let (sizes, n) = (model.sizes(), trajectory.intervals());
    let mut derivatives = Linearization::new(sizes);
    let mut linearise = |rows: &mut Slab<Knots>, k: usize, x: &State, u: &ActuatedVector| {
        model.linearize(x, u, work, &mut derivatives);
        for c in 0..sizes.unactuated() {
            rows.row_mut(k, c).copy_from_slice(derivatives.qdd_u(c));
        }
    };
    let mut rows = Slab::zeros(sizes, n + 1, sizes.unactuated());
    for (k, (x, u)) in trajectory.knots().enumerate() {
        linearise(&mut rows, k, x, u);
    }
    // The end is an equilibrium: u = 0 there, whatever the last knot's input.
    let mut at_end = Slab::zeros(sizes, 1, sizes.unactuated());
    linearise(&mut at_end, 0, trajectory.end(), &ActuatedVector::zeros(sizes));
    let gains = dispatch!(sizes, |d| all_gains(d, &rows, &at_end, trajectory, weights, ts, recursion))?;
    gains.as_slice().iter().all(|v| v.is_finite()).then_some(gains).ok_or(NotStabilisable)
}

/// The gains for the rows d qdd_U / dz of all knots, and for those at x_N with u = 0.
fn all_gains<D: Registers>(
    d: D,
    rows: &Slab<Knots>,
    at_end: &Slab<Knots>,
    trajectory: &Trajectory,
    weights: &LqrWeights,
    ts: f64,
    recursion: Recursion,
) -> Result<Gains, NotStabilisable> {
    let LqrWeights { q, q_end, r } = weights;
    let (sizes, h) = (rows.sizes(), trajectory.h());
    let at_end = at_end.panel(0);
    let terminal = |q: &State| algebraic_riccati(sizes, at_end, q, *r, ts).ok_or(NotStabilisable);

    let mut end = CostToGo::new(&terminal(q_end)?, sizes);
    end.step(d, (at_end, at_end, 0.0), q_end, *r, ts)?;
    let mut gains = Gains::zeros(sizes, trajectory.intervals());
    end.gain(d, gains.end_mut());

    let x = terminal(q)?;
    // X grows with the length of a period as the weights of (20) do.
    let by_longer =
        |count: usize| gains_of_longer_periods(d, rows, &(&x * (ts * count as f64 / h)), weights, h, count);
    let extrapolated = match recursion {
        Recursion::Periods => None,
        Recursion::Extrapolated => extrapolate(h / ts, by_longer),
    };
    match extrapolated {
        Some(extrapolated) => {
            for k in 0..=extrapolated.intervals() {
                gains.knot_mut(k).copy_from_slice(extrapolated.knot(k).as_slice());
            }
        }
        None => {
            // A trajectory shorter than a period has no other gain.
            for k in 0..=trajectory.intervals() {
                end.gain(d, gains.knot_mut(k));
            }
            every_period(d, rows, CostToGo::new(&x, sizes), trajectory, weights, ts, &mut gains)?;
        }
    }
    Ok(gains)
}

/// The gains (23) at the knots, from the terminal weight `cost` on, with the control period `ts`, s.
fn every_period<D: Registers>(
    d: D,
    rows: &Slab<Knots>,
    mut cost: CostToGo,
    trajectory: &Trajectory,
    LqrWeights { q, r, .. }: &LqrWeights,
    ts: f64,
    gains: &mut Gains,
) -> Result<(), NotStabilisable> {
    let (n, h) = (trajectory.intervals(), trajectory.h());
    let steps = (trajectory.t_f / ts).floor() as usize;
    let mut next_knot = n;
    for i in (0..steps).rev() {
        let t = i as f64 * ts;
        let k = ((t / h) as usize).min(n - 1);
        cost.step(d, (rows.panel(k), rows.panel(k + 1), t / h - k as f64), q, *r, ts)?;
        while next_knot > 0 && t <= next_knot as f64 * h {
            cost.gain(d, gains.knot_mut(next_knot));
            next_knot -= 1;
        }
    }
    if steps > 0 {
        cost.gain(d, gains.knot_mut(0));
    }
    Ok(())
}

/// The gains (23) at the knots with `count` periods per interval of length `h` (s) instead of those of T_s, from the terminal weight `x` on.
fn gains_of_longer_periods<D: Registers>(
    d: D,
    rows: &Slab<Knots>,
    x: &DMatrix<f64>,
    LqrWeights { q, r, .. }: &LqrWeights,
    h: f64,
    count: usize,
) -> Result<Gains, NotStabilisable> {
    let (sizes, n, period) = (rows.sizes(), rows.panels() - 1, h / count as f64);
    let mut gains = Gains::zeros(sizes, n);
    let mut cost = CostToGo::new(x, sizes);
    for k in (0..n).rev() {
        for i in (0..count).rev() {
            let share = i as f64 / count as f64;
            cost.step(d, (rows.panel(k), rows.panel(k + 1), share), q, *r, period)?;
            if (k + 1, i + 1) == (n, count) {
                // No period begins at the end: the last one serves it.
                cost.gain(d, gains.knot_mut(n));
            }
        }
        cost.gain(d, gains.knot_mut(k));
    }
    Ok(gains)
}

/// The gains for `count` periods per interval, not necessarily whole, from those `by_periods` for some of [`PERIODS`]: the polynomial in
/// the length of the period. `None` if it takes as many periods.
fn extrapolate(count: f64, by_periods: impl Fn(usize) -> Result<Gains, NotStabilisable>) -> Option<Gains> {
    let mut computed: Vec<Gains> = Vec::new();
    let mut before: Option<Gains> = None;
    for used in 1..=PERIODS.len() {
        let counts = &PERIODS[..used];
        if counts.iter().sum::<usize>() as f64 >= count {
            break;
        }
        computed.push(by_periods(counts[used - 1]).ok()?);
        let mut gains = Gains::zeros(computed[0].sizes(), computed[0].intervals());
        for (i, part) in computed.iter().enumerate() {
            // Lagrange's polynomial for the lengths 1 / count.
            let own = 1.0 / counts[i] as f64;
            let others = counts.iter().filter(|c| **c != counts[i]).map(|c| 1.0 / *c as f64);
            let weight = others.map(|other| (1.0 / count - other) / (own - other)).product();
            shift_add(gains.as_mut_slice(), weight, part.as_slice());
        }
        if before.is_some_and(|before| change(&before, &gains) <= LARGEST_CHANGE) {
            return Some(gains);
        }
        before = Some(gains);
    }
    None
}

/// Largest difference of a gain at a knot, relative to its largest entry. Infinite if a number is not finite.
fn change(before: &Gains, after: &Gains) -> f64 {
    let of_knot = |(before, after): (Gain<'_>, Gain<'_>)| {
        let largest = after.as_slice().iter().fold(f64::MIN_POSITIVE, |most, v| most.max(v.abs()));
        let differences = before.as_slice().iter().zip(after.as_slice()).map(|(b, a)| (a - b).abs());
        // A maximum would lose a NaN.
        differences.fold(0.0, |worst: f64, d| if d.is_finite() { worst.max(d) } else { f64::INFINITY })
            / largest
    };
    before.knots().zip(after.knots()).map(of_knot).fold(0.0, f64::max)
}

/// The cost-to-go x' P x of (23), the factors of the gain of the last step, and the memory of a step.
#[derive(Clone, Debug)]
struct CostToGo {
    /// P, symmetric, one panel of as many rows as a state has entries.
    p: Slab<States>,
    /// d qdd_U / dx, one panel of n_U rows, and d qdd_U / du, n_U rows of n_A entries, at the time of the step.
    a: Slab<States>,
    b: Vec<f64>,
    /// L and the inverse of D of L D L' = R + Gamma' P Gamma, n_A rows of n_A entries and n_A entries.
    lower: Vec<f64>,
    inverse: Vec<f64>,
    /// The factors of the update of P, of n_U + n_A rows each: [Ts a; -D^-1 G]' and [V; G] with G = L^-1 Gamma' P Phi and the rows V
    /// of P Phi of the unactuated velocities. Beside G stands what the elimination leaves of R + Gamma' P Gamma.
    left: Slab<States>,
    right: Slab<Knots>,
}

impl CostToGo {
    /// From the terminal weight `p`.
    fn new(p: &DMatrix<f64>, sizes: Sizes) -> Self {
        let (actuated, unactuated) = (sizes.actuated(), sizes.unactuated());
        let mut rows = Slab::zeros(sizes, 1, sizes.state());
        for i in 0..sizes.state() {
            rows.row_mut(0, i).copy_from_slice(p.column(i).as_slice());
        }
        Self {
            p: rows,
            a: Slab::zeros(sizes, 1, unactuated),
            b: vec![0.0; unactuated * actuated],
            lower: vec![0.0; actuated * actuated],
            inverse: vec![0.0; actuated],
            left: Slab::zeros(sizes, 1, unactuated + actuated),
            right: Slab::zeros(sizes, 1, unactuated + actuated),
        }
    }

    /// Moves P one period back, with the rows d qdd_U / dz after a `share` of the way between those of two knots.
    #[inline(always)]
    fn step<D: Registers>(
        &mut self,
        d: D,
        (from, to, share): (&[f64], &[f64], f64),
        q: &State,
        r: f64,
        ts: f64,
    ) -> Result<(), NotStabilisable> {
        riccati_step(d, self, from, to, share, q, r, ts).then_some(()).ok_or(NotStabilisable)
    }

    /// K = -(R + Gamma' P Gamma)^-1 Gamma' P Phi of the last step into `out`, n_A rows of 2n entries.
    fn gain<D: Registers>(&self, d: D, out: &mut [f64]) {
        let (actuated, unactuated, state, row) = (d.actuated(), d.unactuated(), d.state(), d.state_row());
        let mut k = [0.0; MOST_JOINTS * LARGEST_STATE];
        let k = &mut k[..actuated * row];
        k.copy_from_slice(&self.left.panel(0)[unactuated * row..]);
        backward(&self.lower, actuated, k, row);
        for (out, k) in out.chunks_exact_mut(state).zip(k.chunks_exact(row)) {
            out.copy_from_slice(&k[..state]);
        }
    }
}

kernels! {
    /// One step of (23); `false` if R + Gamma' P Gamma is not positive definite. With `Phi = I + Ts A` and
    /// `A = [[0, I], [0], [a]]`, `Gamma = Ts [[0], [I], [b]]` all products are a few row operations.
    fn riccati_step(
        d: D,
        work: &mut CostToGo,
        from: &[f64],
        to: &[f64],
        share: f64,
        q: &State,
        r: f64,
        ts: f64,
    ) -> bool {
        let (n, actuated, unactuated) = (d.joints(), d.actuated(), d.unactuated());
        let (state, row, knot_row) = (d.state(), d.state_row(), d.knot_row());
        // First row of the unactuated velocities.
        let v_u = n + actuated;
        let p = &mut work.p.as_mut_slice()[..state * row];
        let a = &mut work.a.as_mut_slice()[..unactuated * row];
        let b = &mut work.b[..unactuated * actuated];
        for m in 0..unactuated {
            let (from, to) = (&from[m * knot_row..][..knot_row], &to[m * knot_row..][..knot_row]);
            let (a, b) = (&mut a[m * row..][..state], &mut b[m * actuated..][..actuated]);
            for j in 0..state {
                a[j] = from[j] + (to[j] - from[j]) * share;
            }
            for j in 0..actuated {
                b[j] = from[state + j] + (to[state + j] - from[state + j]) * share;
            }
        }
        // R + Gamma' P Gamma
        let (v, g) = work.right.as_mut_slice().split_at_mut(unactuated * knot_row);
        for i in 0..actuated {
            let mut line = [0.0; LARGEST_STATE];
            let line = &mut line[..row];
            line.copy_from_slice(&p[(n + i) * row..][..row]);
            combine(line, unactuated, &b[i..], actuated, &p[v_u * row..], row);
            let out = &mut g[i * knot_row + state..][..actuated];
            out.copy_from_slice(&line[n..v_u]);
            for m in 0..unactuated {
                shift_add(out, line[v_u + m], &b[m * actuated..]);
            }
            for j in 0..actuated {
                out[j] *= ts * ts;
            }
            out[i] += r;
        }
        // P Phi
        for i in 0..state {
            let line = &mut p[i * row..][..row];
            let mut on_v = [0.0; MOST_JOINTS];
            for m in 0..unactuated {
                on_v[m] = ts * line[v_u + m];
            }
            let (q, v) = line.split_at_mut(n);
            shift_add(&mut v[..n], ts, q);
            combine(line, unactuated, &on_v, 1, a, row);
        }
        // V, and L^-1 Gamma' P Phi
        for m in 0..unactuated {
            v[m * knot_row..][..state].copy_from_slice(&p[(v_u + m) * row..][..state]);
        }
        for i in 0..actuated {
            let mut line = [0.0; LARGEST_STATE];
            let line = &mut line[..row];
            line.copy_from_slice(&p[(n + i) * row..][..row]);
            combine(line, unactuated, &b[i..], actuated, &p[v_u * row..], row);
            for j in 0..state {
                g[i * knot_row + j] = ts * line[j];
            }
        }
        if !eliminate(d, g, knot_row, state, actuated, &mut work.lower, &mut work.inverse) {
            return false;
        }
        // Q + Phi' (P Phi) - K' (R + Gamma' P Gamma) K: its lower half, and the same above the diagonal. Without exact
        // symmetry rounding grows over 17 000 steps.
        let (on_v, on_g) = work.left.as_mut_slice().split_at_mut(unactuated * row);
        for j in 0..on_v.len() {
            on_v[j] = ts * a[j];
        }
        for i in 0..actuated {
            for j in 0..state {
                on_g[i * row + j] = -work.inverse[i] * g[i * knot_row + j];
            }
        }
        for i in n..state {
            let (low, high) = p.split_at_mut(i * row);
            shift_add(&mut high[..row], ts, &low[(i - n) * row..]);
        }
        let (left, right) = (work.left.as_slice(), work.right.as_slice());
        rank_update(d, p, row, state, unactuated + actuated, left, row, right, knot_row);
        for i in 0..state {
            p[i * row + i] += q[i];
        }
        mirror(d, p, row, state);
        true
    }
}

/// Phi = I + Ts A and Gamma = Ts B for the rows d qdd_U / dz of a knot.
fn discretised(sizes: Sizes, rows: &[f64], ts: f64) -> (DMatrix<f64>, DMatrix<f64>) {
    let (n, actuated, state) = (sizes.joints(), sizes.actuated(), sizes.state());
    let mut phi = DMatrix::identity(state, state);
    let mut gamma = DMatrix::zeros(state, actuated);
    for i in 0..n {
        phi[(i, n + i)] += ts;
    }
    for i in 0..actuated {
        gamma[(n + i, i)] = ts;
    }
    for (m, row) in rows.chunks_exact(sizes.knot_row()).enumerate() {
        let i = n + actuated + m;
        for j in 0..state {
            phi[(i, j)] += ts * row[j];
        }
        for j in 0..actuated {
            gamma[(i, j)] = ts * row[state + j];
        }
    }
    (phi, gamma)
}

/// X of (21) by structured doubling (Chu, Fan, Lin, Wang, *Structure-preserving algorithms for periodic
/// discrete-time algebraic Riccati equations*, Int. J. Control 77, 2004): each step doubles the horizon.
fn algebraic_riccati(sizes: Sizes, rows: &[f64], q: &State, r: f64, ts: f64) -> Option<DMatrix<f64>> {
    /// 2^40 periods of 125 us are four years.
    const DOUBLINGS: usize = 40;
    let (mut a, gamma) = discretised(sizes, rows, ts);
    let mut g = &gamma * gamma.transpose() / r;
    let mut h = DMatrix::from_fn(q.len(), q.len(), |i, j| if i == j { q[i] } else { 0.0 });
    for _ in 0..DOUBLINGS {
        let w = (DMatrix::identity(q.len(), q.len()) + &g * &h).lu();
        let (w_a, w_g) = (w.solve(&a)?, w.solve(&g)?);
        let step = a.transpose() * &h * &w_a;
        g += &a * w_g * a.transpose();
        a *= w_a;
        h += &step;
        h = (&h + h.transpose()) * 0.5;
        g = (&g + g.transpose()) * 0.5;
        if !h.iter().all(|v| v.is_finite()) {
            return None;
        }
        if step.amax() <= 1e-13 * h.amax() {
            return Some(h);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dims::{Avx2, Baseline};
    use crate::random::Random;
    use upswing_model::Fixed;

    /// Random rows d qdd_U / dz of two knots, unstable in the last position.
    fn rows(random: &mut Random, sizes: Sizes) -> Slab<Knots> {
        let mut rows = Slab::zeros(sizes, 2, sizes.unactuated());
        for k in 0..2 {
            for m in 0..sizes.unactuated() {
                let row = rows.row_mut(k, m);
                row.fill_with(|| 3.0 * random.next());
                row[sizes.joints() - 1] += 20.0;
            }
        }
        rows
    }

    fn positive(random: &mut Random, n: usize) -> DMatrix<f64> {
        let seed = DMatrix::from_fn(n, n, |_, _| random.next());
        &seed * seed.transpose() + DMatrix::identity(n, n)
    }

    fn all_sizes() -> impl Iterator<Item = Sizes> {
        (2..=MOST_JOINTS).flat_map(|n| (1..n).filter_map(move |actuated| Sizes::new(n, actuated)))
    }

    /// P and K after one step from `p`.
    fn stepped<D: Registers>(
        d: D,
        p: &DMatrix<f64>,
        rows: &Slab<Knots>,
        q: &State,
        r: f64,
        ts: f64,
    ) -> (DMatrix<f64>, DMatrix<f64>) {
        let sizes = rows.sizes();
        let state = sizes.state();
        let mut work = CostToGo::new(p, sizes);
        work.step(d, (rows.panel(0), rows.panel(1), 0.25), q, r, ts).expect("positive definite");
        let mut gain = vec![0.0; sizes.actuated() * state];
        work.gain(d, &mut gain);
        let p = DMatrix::from_fn(state, state, |i, j| work.p.row(0, i)[j]);
        (p, DMatrix::from_row_slice(sizes.actuated(), state, &gain))
    }

    #[test]
    fn a_structured_step_equals_the_dense_formula_23_for_all_sizes() {
        let mut random = Random(1);
        let (ts, r) = (1e-2, 0.01);
        for sizes in all_sizes() {
            let rows = rows(&mut random, sizes);
            let q = State::from_fn(sizes, |i| 1.0 + i as f64);
            let p = positive(&mut random, sizes.state());
            let (next, gain) = stepped(Baseline(sizes), &p, &rows, &q, r, ts);
            let near = discretised(sizes, rows.panel(0), ts);
            let far = discretised(sizes, rows.panel(1), ts);
            let (phi, gamma) = (near.0 * 0.75 + far.0 * 0.25, near.1 * 0.75 + far.1 * 0.25);
            let pivot =
                DMatrix::identity(sizes.actuated(), sizes.actuated()) * r + gamma.transpose() * &p * &gamma;
            let k = -pivot.try_inverse().expect("invertible") * gamma.transpose() * &p * &phi;
            let weight = DMatrix::from_fn(q.len(), q.len(), |i, j| if i == j { q[i] } else { 0.0 });
            let want =
                weight + phi.transpose() * &p * &phi + (gamma.transpose() * &p * &phi).transpose() * &k;
            let (on_k, on_p) = ((&gain - &k).amax() / k.amax(), (&next - &want).amax() / want.amax());
            assert!(on_k < 1e-9, "{sizes:?}: K differs by {on_k:e}");
            assert!(on_p < 1e-10, "{sizes:?}: P differs by {on_p:e}");
            assert_eq!(next, next.transpose(), "{sizes:?}");
        }
    }

    /// Compares the instances of `fixed` and of the sizes `sizes` read at run time, for all registers.
    fn all_instances_agree<D: Dims>(sizes: Sizes, fixed: D) {
        let mut random = Random(2);
        let rows = rows(&mut random, sizes);
        let q = State::repeat(sizes, 1.0);
        let p = positive(&mut random, sizes.state());
        let want = stepped(Baseline(sizes), &p, &rows, &q, 0.1, 1e-2);
        assert_eq!(stepped(Baseline(fixed), &p, &rows, &q, 0.1, 1e-2), want, "{sizes:?}");
        if let (Some(run), Some(fixed)) = (Avx2::detect(sizes), Avx2::detect(fixed)) {
            assert_eq!(stepped(run, &p, &rows, &q, 0.1, 1e-2), want, "{sizes:?}, AVX2");
            assert_eq!(stepped(fixed, &p, &rows, &q, 0.1, 1e-2), want, "{sizes:?}, AVX2");
        }
    }

    #[test]
    fn sizes_and_registers_leave_the_bits_as_they_are() {
        all_sizes().for_each(|sizes| all_instances_agree(sizes, sizes));
        all_instances_agree(Sizes::new(9, 7).expect("a chain"), Fixed::<9, 7>);
        all_instances_agree(Sizes::new(2, 1).expect("a chain"), Fixed::<2, 1>);
    }

    #[test]
    fn the_terminal_weight_is_a_fixed_point_of_23() {
        let (ts, r) = (1e-2, 0.01);
        for (n, actuated) in [(2, 1), (3, 2), (9, 7), (16, 14)] {
            let sizes = Sizes::new(n, actuated).expect("a chain");
            let mut rows = rows(&mut Random(3), sizes);
            let first = rows.panel(0).to_vec();
            rows.panel_mut(1).copy_from_slice(&first);
            let q = State::repeat(sizes, 1.0);
            let x = algebraic_riccati(sizes, &first, &q, r, ts).expect("stabilisable");
            let (again, _) = stepped(Baseline(sizes), &x, &rows, &q, r, ts);
            let moves = (again - &x).amax() / x.amax();
            assert!(moves < 1e-9, "{sizes:?}: moves by {moves:e}");
        }
    }
}
