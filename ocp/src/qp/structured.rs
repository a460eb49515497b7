//! A primal-dual interior-point method for [`Qp`] on top of the stage-wise factorisation of [`crate::kkt`]:
//! Mehrotra's predictor and corrector (*On the implementation of a primal-dual interior point method*, SIAM J.
//! Optim. 2, 1992) with slacks of their own, so that no iterate need meet any constraint.
//!
//! With w = (dx_k, J_k dz_k / half range, dt) for all bounded quantities, l <= w <= u, slacks a = w - l and b = u - w
//! and their multipliers y, v > 0, a Newton step eliminates slacks and multipliers: sigma = y / a + v / b joins the
//! Hessian of the knot, and a matrix of the form of [`Kkt`] is left. The multipliers of defects and target rows are
//! iterates, too, and every step corrects them: the error of a step is a residual of the next one.
//!
//! A softened bound yields: w >= l - c y with the compliance c, which is a quadratic penalty of weight 1 / c.

use super::{Bound, ConflictingBound, Qp, QpOptions, QpSolution, QpStatus, Stall};
use crate::dims::{Registers, dispatch, kernels};
use crate::kernels::{amax, combine, dot, shift_add};
use crate::kkt::{self, Factor, Kkt, NewtonStep, Rhs, SolveWorkspace, TargetRow};
use crate::slab::LARGEST_KNOT;
use upswing_model::{Dims, LimitKind, Sizes, State};

/// Number of bounded quantities: torques of knot 0, then states and torques of each knot, then dt.
fn bounded_quantities(sizes: Sizes, intervals: usize) -> usize {
    sizes.actuated() + intervals * sizes.knot() + 1
}

/// Where the torques of a knot begin among the bounded quantities; the states, if any, stand before them.
#[inline(always)]
fn torque_at(d: impl Dims, k: usize) -> usize {
    k * d.knot()
}

/// Share of the way to the boundary that a step goes at most.
const TO_BOUNDARY: f64 = 0.995;
/// Smallest slack: positions and velocities near one are not known better, and the matrix, whose entries grow with the
/// inverse, could not be factorised.
const RESOLUTION: f64 = 1e-14;
/// Shortest step that counts as progress.
const SHORTEST: f64 = 1e-12;
/// Least slack and product of slack and multiplier of a cold start; the half ranges of the limits are about 1.
/// Tuned, as the next pair: ten times more or less costs one or two iterations.
const COLD: (f64, f64) = (1e-1, 1e-2);
/// Of a warm start, the slack in units of the change since the last solution, and the product in units of its square: what the
/// multipliers of the last solution miss is of the size of the change, which the defects show.
const WARM: (f64, f64) = (3e-2, 3e-2);
/// The change counts as no smaller.
const SMALLEST_CHANGE: f64 = 1e-6;

/// Share of the residuals that a step without refinement may leave: the stiffness of the target costs as much.
const UNREFINED: f64 = 1e-5;
/// How often a step is refined at most, and the share of the right-hand side that is left then, where steps miss what they aim at.
const REFINEMENTS: (usize, f64) = (2, 1e-9);

/// How the linear system of a step is solved.
#[derive(Clone, Copy, Debug)]
enum Linear {
    /// Without multipliers.
    Predictor,
    /// With another gradient than the predictor's.
    Corrector,
    /// As the corrector, with iterative refinement.
    Refined,
}

/// Solver and its memory.
#[derive(Clone, Debug)]
pub struct Structured {
    /// The matrix; its rows J_k are the Jacobians of the torques, each scaled to half its range.
    kkt: Kkt,
    factor: Factor,
    /// Of the factorisation.
    damping: f64,
    work: SolveWorkspace,
    rhs: Rhs,
    /// Residuals of stationarity, the defects, and residuals of start and target at `at`.
    residual: Rhs,
    /// Iterate: dz, dt and the multipliers of defects and target rows.
    at: NewtonStep,
    step: NewtonStep,
    lower: Vec<f64>,
    upper: Vec<f64>,
    /// By how much a bound yields to a unit of its multiplier.
    compliance: f64,
    /// w, and its step.
    value: Vec<f64>,
    value_step: Vec<f64>,
    below: Side,
    above: Side,
    /// What a bounded quantity contributes to the gradient.
    pull: Vec<f64>,
    solution: QpSolution,
}

/// Slacks of one side, their multipliers, the steps of both, and the residual of the slack.
#[derive(Clone, Debug)]
struct Side {
    slack: Vec<f64>,
    multiplier: Vec<f64>,
    slack_step: Vec<f64>,
    multiplier_step: Vec<f64>,
    /// w - l or u - w, less the slack, plus what the bound yields.
    residual: Vec<f64>,
    /// What slack times multiplier shall change by, to first order.
    target: Vec<f64>,
    /// One over the distance that a multiplier's pull acts on: the slack, and what the bound yields.
    inverse: Vec<f64>,
}

impl Side {
    fn new(rows: usize) -> Self {
        let zeros = || vec![0.0; rows];
        Self {
            slack: zeros(),
            multiplier: zeros(),
            slack_step: zeros(),
            multiplier_step: zeros(),
            residual: zeros(),
            target: zeros(),
            inverse: zeros(),
        }
    }
}

kernels! {
    /// w of a step of z and t.
    fn bounded(d: D, jacobian: &[f64], z: &[f64], t: f64, out: &mut [f64]) {
        let (actuated, state, row) = (d.actuated(), d.state(), d.knot_row());
        for k in 0..z.len() / row {
            let at = torque_at(d, k);
            let (z, jacobian) = (&z[k * row..][..row], &jacobian[k * actuated * row..][..actuated * row]);
            if k > 0 {
                out[at - state..at].copy_from_slice(&z[..state]);
            }
            for i in 0..actuated {
                out[at + i] = dot(&jacobian[i * row..][..row], z);
            }
        }
        if let Some(last) = out.last_mut() {
            *last = t;
        }
    }

    /// Adds C' `pull` to the gradient.
    fn add_pull(d: D, jacobian: &[f64], pull: &[f64], rhs: &mut Rhs) {
        let (actuated, state, row) = (d.actuated(), d.state(), d.knot_row());
        let g = rhs.g.as_mut_slice();
        for k in 0..g.len() / row {
            let at = torque_at(d, k);
            let (g, jacobian) = (&mut g[k * row..][..row], &jacobian[k * actuated * row..][..actuated * row]);
            let mut sum = [0.0; LARGEST_KNOT];
            let sum = &mut sum[..row];
            combine(sum, actuated, &pull[at..], 1, jacobian, row);
            if k > 0 {
                shift_add(&mut sum[..state], 1.0, &pull[at - state..at]);
            } else {
                // The start is given: nothing pulls at it.
                sum[..state].fill(0.0);
            }
            shift_add(g, 1.0, sum);
        }
        rhs.g_t += pull.last().copied().unwrap_or(0.0);
    }

    /// Gradient of the objective at `z`.
    fn objective(d: D, z: &[f64], qp: &Qp, out: &mut [f64]) {
        let (weight, gradient) = (qp.weight.as_slice(), qp.gradient.as_slice());
        let (z, weight, gradient) = (&z[..out.len()], &weight[..out.len()], &gradient[..out.len()]);
        for i in 0..out.len() {
            out[i] = z[i] * weight[i] + gradient[i];
        }
    }

    /// Residuals of the slacks for the bounded quantities `value`, and what the multipliers pull.
    fn slack_residuals(
        d: D,
        value: &[f64],
        lower: &[f64],
        upper: &[f64],
        compliance: f64,
        below: &mut Side,
        above: &mut Side,
        pull: &mut [f64],
    ) {
        for i in 0..value.len() {
            pull[i] = above.multiplier[i] - below.multiplier[i];
            below.residual[i] = value[i] - lower[i] - below.slack[i] + compliance * below.multiplier[i];
            above.residual[i] = upper[i] - value[i] - above.slack[i] + compliance * above.multiplier[i];
        }
    }

    /// sigma of all bounded quantities.
    fn sigmas(d: D, below: &mut Side, above: &mut Side, compliance: f64, sigma: &mut [f64]) {
        for i in 0..sigma.len() {
            below.inverse[i] = 1.0 / (below.slack[i] + compliance * below.multiplier[i]);
            above.inverse[i] = 1.0 / (above.slack[i] + compliance * above.multiplier[i]);
            sigma[i] = below.multiplier[i] * below.inverse[i] + above.multiplier[i] * above.inverse[i];
        }
    }

    /// H_k of all knots: the weights, and sigma of states and of torques.
    fn hessians(d: D, weight: &[f64], sigma: &[f64], diagonal: &mut [f64], of_torque: &mut [f64]) {
        let (actuated, state, row) = (d.actuated(), d.state(), d.knot_row());
        diagonal.copy_from_slice(weight);
        for (k, diagonal) in diagonal.chunks_exact_mut(row).enumerate() {
            let at = torque_at(d, k);
            of_torque[k * actuated..][..actuated].copy_from_slice(&sigma[at..at + actuated]);
            if k > 0 {
                shift_add(&mut diagonal[..state], 1.0, &sigma[at - state..at]);
            }
        }
    }

    /// What the bounded quantities pull in a step for the targets of both sides.
    fn pulls(d: D, below: &Side, above: &Side, pull: &mut [f64]) {
        let (a, b) = (below, above);
        for i in 0..pull.len() {
            pull[i] = (b.target[i] - b.multiplier[i] * b.residual[i]) * b.inverse[i]
                - (a.target[i] - a.multiplier[i] * a.residual[i]) * a.inverse[i];
        }
    }

    /// Steps of slacks and multipliers that belong to the step `sign` * `dw` of the distance to the bound.
    fn expand(d: D, side: &mut Side, sign: f64, dw: &[f64], compliance: f64) {
        for i in 0..dw.len() {
            let da = sign * dw[i] + side.residual[i];
            let dy = (side.target[i] - side.multiplier[i] * da) * side.inverse[i];
            side.multiplier_step[i] = dy;
            side.slack_step[i] = da + compliance * dy;
        }
    }

    /// Largest step that keeps slacks and multipliers from falling below zero.
    fn longest(d: D, side: &Side) -> f64 {
        // Four maxima side by side.
        let mut rates = [0.0_f64; 4];
        for (value, step) in [(&side.slack, &side.slack_step), (&side.multiplier, &side.multiplier_step)] {
            let ((value, value_rest), (step, step_rest)) = (value.as_chunks::<4>(), step.as_chunks::<4>());
            for i in 0..value.len().min(step.len()) {
                for l in 0..4 {
                    let rate = -step[i][l] / value[i][l];
                    rates[l] = if rate > rates[l] { rate } else { rates[l] };
                }
            }
            for l in 0..value_rest.len().min(step_rest.len()) {
                rates[l] = rates[l].max(-step_rest[l] / value_rest[l]);
            }
        }
        1.0 / rates[0].max(rates[1]).max(rates[2]).max(rates[3])
    }

    /// Sum of the products of slacks and multipliers after a step of the length `alpha`.
    fn product_after(d: D, side: &Side, alpha: f64) -> f64 {
        let (slack, multiplier) = (side.slack.as_chunks::<4>(), side.multiplier.as_chunks::<4>());
        let (slack_step, multiplier_step) =
            (side.slack_step.as_chunks::<4>(), side.multiplier_step.as_chunks::<4>());
        let after = |slack: f64, slack_step: f64, multiplier: f64, multiplier_step: f64| {
            (slack + alpha * slack_step) * (multiplier + alpha * multiplier_step)
        };
        let mut sums = [0.0; 4];
        for i in 0..slack.0.len() {
            for l in 0..4 {
                sums[l] +=
                    after(slack.0[i][l], slack_step.0[i][l], multiplier.0[i][l], multiplier_step.0[i][l]);
            }
        }
        for l in 0..slack.1.len() {
            sums[l] += after(slack.1[l], slack_step.1[l], multiplier.1[l], multiplier_step.1[l]);
        }
        (sums[0] + sums[1]) + (sums[2] + sums[3])
    }

    /// Sum of the products of slacks and multipliers, and the same for the distances beyond the resolution.
    fn products(d: D, side: &Side) -> (f64, f64) {
        let (slack, multiplier) = (side.slack.as_chunks::<4>(), side.multiplier.as_chunks::<4>());
        let (mut sums, mut resolved) = ([0.0; 4], [0.0; 4]);
        let mut add = |l: usize, slack: f64, multiplier: f64| {
            sums[l] += slack * multiplier;
            resolved[l] += (slack - RESOLUTION) * multiplier;
        };
        for i in 0..slack.0.len() {
            for l in 0..4 {
                add(l, slack.0[i][l], multiplier.0[i][l]);
            }
        }
        for l in 0..slack.1.len() {
            add(l, slack.1[l], multiplier.1[l]);
        }
        let sum = |sums: [f64; 4]| (sums[0] + sums[1]) + (sums[2] + sums[3]);
        (sum(sums), sum(resolved))
    }

    /// The targets of a predictor step: no product of slack and multiplier.
    fn aim_at_zero(d: D, side: &mut Side) {
        for i in 0..side.target.len() {
            side.target[i] = -side.slack[i] * side.multiplier[i];
        }
    }

    /// The targets of a corrector step: the product `aim`, with the second order of the predictor's step.
    fn aim_at(d: D, side: &mut Side, aim: f64) {
        for i in 0..side.target.len() {
            side.target[i] =
                aim - side.slack[i] * side.multiplier[i] - side.slack_step[i] * side.multiplier_step[i];
        }
    }

    /// Moves slacks and multipliers by a step of the length `alpha`.
    fn advance(d: D, side: &mut Side, alpha: f64) {
        for i in 0..side.slack.len() {
            side.slack[i] = (side.slack[i] + alpha * side.slack_step[i]).max(RESOLUTION);
            side.multiplier[i] += alpha * side.multiplier_step[i];
        }
    }
}

impl Structured {
    /// Allocates everything for programs of `n` intervals.
    pub(super) fn new(sizes: Sizes, n: usize) -> Self {
        // More target rows than states would contradict each other.
        let row = TargetRow { coefficients: State::zeros(sizes), value: 0.0 };
        let targets = sizes.state();
        let kkt = Kkt::of_products(sizes, n, &vec![row; targets]);
        let rows = bounded_quantities(sizes, n);
        let zeros = || vec![0.0; rows];
        Self {
            factor: Factor::new(sizes, n),
            damping: 0.0,
            work: SolveWorkspace::new(sizes, n, targets),
            rhs: kkt.zero_rhs(),
            residual: kkt.zero_rhs(),
            at: NewtonStep::zeros(sizes, n, targets),
            step: NewtonStep::zeros(sizes, n, targets),
            kkt,
            lower: zeros(),
            upper: zeros(),
            compliance: 0.0,
            value: zeros(),
            value_step: zeros(),
            below: Side::new(rows),
            above: Side::new(rows),
            pull: zeros(),
            solution: QpSolution::zeros(sizes, n),
        }
    }

    pub(super) fn solution(&self) -> &QpSolution {
        &self.solution
    }

    /// Takes over the constant parts of `qp`.
    fn load(&mut self, qp: &Qp) {
        let (sizes, n, targets) = (qp.sizes(), qp.intervals(), qp.target.len());
        if (self.kkt.sizes(), self.kkt.intervals()) != (sizes, n) {
            *self = Self::new(sizes, n);
        }
        if self.kkt.target.len() != targets {
            self.kkt.target.clone_from(&qp.target);
            self.work = SolveWorkspace::new(sizes, n, targets);
            (self.rhs, self.residual) = (self.kkt.zero_rhs(), self.kkt.zero_rhs());
            (self.at, self.step) =
                (NewtonStep::zeros(sizes, n, targets), NewtonStep::zeros(sizes, n, targets));
        }
        self.compliance = qp.compliance;
        self.kkt.h = qp.h;
        self.kkt.target.clone_from_slice(&qp.target);
        self.kkt.dynamics.copy_from(&qp.dynamics);
        let state = sizes.state();
        for (k, (lower, upper)) in qp.torque.bounds.iter().enumerate() {
            let at = torque_at(sizes, k);
            for i in 0..sizes.actuated() {
                let scale = 2.0 / (upper[i] - lower[i]);
                self.lower[at + i] = lower[i] * scale;
                self.upper[at + i] = upper[i] * scale;
                for (scaled, j) in
                    self.kkt.products.jacobian.row_mut(k, i).iter_mut().zip(qp.torque.jacobian.row(k, i))
                {
                    *scaled = j * scale;
                }
            }
            if k > 0 {
                let (lower, upper) = &qp.x[k - 1];
                self.lower[at - state..at].copy_from_slice(lower);
                self.upper[at - state..at].copy_from_slice(upper);
            }
        }
        let t = self.t_row();
        (self.lower[t], self.upper[t]) = qp.t;
    }

    /// Where dt is among the bounded quantities.
    fn t_row(&self) -> usize {
        self.lower.len() - 1
    }

    /// Starting point: no step; multipliers of the last QP if `warm`.
    fn start<D: Registers>(&mut self, d: D, qp: &Qp, warm: bool) {
        self.at.z.clear();
        self.at.z.x_mut(0).copy_from_slice(&qp.start);
        self.at.t = 0.0;
        bounded(d, self.kkt.products.jacobian.as_slice(), self.at.z.as_slice(), 0.0, &mut self.value);
        let (slack, barrier) = if warm {
            let change = amax(qp.defects.as_slice()).max(amax(&qp.start)).max(SMALLEST_CHANGE);
            ((WARM.0 * change).min(COLD.0), (WARM.1 * change * change).min(COLD.1))
        } else {
            COLD
        };
        if !warm {
            self.at.lambda.clear();
            self.at.lambda_target.fill(0.0);
        }
        for i in 0..self.value.len() {
            for (side, distance) in [
                (&mut self.below, self.value[i] - self.lower[i]),
                (&mut self.above, self.upper[i] - self.value[i]),
            ] {
                side.slack[i] = distance.max(slack);
                let central = barrier / side.slack[i];
                side.multiplier[i] = if warm { side.multiplier[i].max(central) } else { central };
            }
        }
    }

    /// All residuals at the iterate.
    fn residuals<D: Registers>(&mut self, d: D, qp: &Qp) {
        let r = &mut self.residual;
        objective(d, self.at.z.as_slice(), qp, r.g.as_mut_slice());
        r.g_t = qp.weight_t * self.at.t + qp.gradient_t;
        r.defects.copy_from(&qp.defects);
        r.start = qp.start;
        r.target.iter_mut().zip(&qp.target).for_each(|(r, row)| *r = -row.value);
        kkt::add_constraints(d, &self.kkt, &self.at, r);
        slack_residuals(
            d,
            &self.value,
            &self.lower,
            &self.upper,
            self.compliance,
            &mut self.below,
            &mut self.above,
            &mut self.pull,
        );
        add_pull(d, self.kkt.products.jacobian.as_slice(), &self.pull, r);
    }

    /// Largest residuals: of the constraints, and of stationarity relative to the multipliers.
    fn largest_residuals(&self) -> (f64, f64) {
        let r = &self.residual;
        let primal = amax(r.defects.as_slice())
            .max(amax(&r.target))
            .max(amax(&self.below.residual))
            .max(amax(&self.above.residual));
        let dual = amax(r.g.as_slice()).max(r.g_t.abs());
        let multipliers = amax(self.at.lambda.as_slice())
            .max(amax(&self.at.lambda_target))
            .max(amax(&self.below.multiplier))
            .max(amax(&self.above.multiplier));
        (primal, dual / multipliers.max(1.0))
    }

    /// The matrix at the iterate.
    fn condense<D: Registers>(&mut self, d: D, qp: &Qp) {
        // Until the next step, the memory of a step holds sigma.
        let sigma = &mut self.value_step;
        sigmas(d, &mut self.below, &mut self.above, self.compliance, sigma);
        self.kkt.t_t = qp.weight_t + sigma.last().copied().unwrap_or(0.0);
        let products = &mut self.kkt.products;
        hessians(d, qp.weight.as_slice(), sigma, products.diagonal.as_mut_slice(), &mut products.sigma);
    }

    /// Factorises. Near the end rounding may cost a pivot its sign: then a little damping keeps the step near the
    /// iterate, whose residuals show what the step missed.
    fn factorise<D: Registers>(&mut self, d: D) -> bool {
        const DAMPINGS: [f64; 3] = [0.0, 1e-6, 1e-3];
        DAMPINGS.into_iter().any(|damping| {
            self.damping = damping;
            kkt::factorise(d, &self.kkt, damping, damping, &mut self.factor)
        })
    }

    /// A step of everything, for the complementarity targets of both sides.
    fn direction<D: Registers>(&mut self, d: D, linear: Linear) {
        self.rhs.copy_from(&self.residual);
        pulls(d, &self.below, &self.above, &mut self.pull);
        add_pull(d, self.kkt.products.jacobian.as_slice(), &self.pull, &mut self.rhs);
        let Self { kkt, factor, rhs, work, step, .. } = self;
        match linear {
            Linear::Predictor => kkt::predict(d, kkt, factor, rhs, work, step),
            Linear::Corrector => kkt::correct(d, kkt, factor, rhs, work, step),
            Linear::Refined => {
                let damping = (self.damping, self.damping);
                kkt::solve(d, kkt, factor, rhs, damping, REFINEMENTS, work, step);
            }
        }
        bounded(
            d,
            self.kkt.products.jacobian.as_slice(),
            self.step.z.as_slice(),
            self.step.t,
            &mut self.value_step,
        );
        expand(d, &mut self.below, 1.0, &self.value_step, self.compliance);
        expand(d, &mut self.above, -1.0, &self.value_step, self.compliance);
    }

    /// Whether the multipliers prove that no point meets all constraints: they combine the constraints to
    /// v' xi <= -c with c > 0, while |v' xi| < c for every xi within its bounds.
    fn contradiction(&self, qp: &Qp) -> Option<ConflictingBound> {
        /// Inputs that no robot reaches, rad/s^2 or m/s^2.
        const LARGEST_INPUT: f64 = 1e4;
        // Bounds that yield contradict nothing.
        if self.compliance > 0.0 {
            return None;
        }
        let state = self.kkt.sizes().state();
        let mut excess =
            self.on_start().dot(&qp.start) + dot(self.at.lambda.as_slice(), qp.defects.as_slice());
        for (m, row) in self.at.lambda_target.iter().zip(&qp.target) {
            excess -= m * row.value;
        }
        excess += dot(&self.below.multiplier, &self.lower) - dot(&self.above.multiplier, &self.upper);
        if !(excess > 0.0) {
            return None;
        }
        // v: what is left of the gradient without the objective.
        let mut slope = 0.0;
        for k in 0..=qp.intervals() {
            let (residual, z) = (self.residual.g.vector(k), self.at.z.vector(k));
            let (weight, gradient) = (qp.weight.vector(k), qp.gradient.vector(k));
            let v = |i: usize| residual[i] - z[i] * weight[i] - gradient[i];
            // All that acts on the start is a constant.
            if k > 0 {
                let (lower, upper) = &qp.x[k - 1];
                for i in 0..state {
                    slope += v(i).abs() * lower[i].abs().max(upper[i].abs());
                }
            }
            for i in state..z.len() {
                slope += v(i).abs() * LARGEST_INPUT;
            }
        }
        let v_t = self.residual.g_t - qp.weight_t * self.at.t - qp.gradient_t;
        slope += v_t.abs() * qp.t.0.abs().max(qp.t.1.abs());
        (excess > slope).then(|| self.heaviest())
    }

    /// Coefficient of dx_0 in the sum of all constraints with their multipliers.
    fn on_start(&self) -> State {
        let sizes = self.kkt.sizes();
        let lambda = self.at.lambda.state(0);
        let mut by_defects = [0.0; LARGEST_KNOT];
        self.kkt.dynamics.apply_transposed(0, &lambda, &mut by_defects[..sizes.knot()]);
        let mut out = State::from_fn(sizes, |i| by_defects[i] * (-0.5 * self.kkt.h) - lambda[i]);
        for i in 0..sizes.actuated() {
            let pull = self.above.multiplier[i] - self.below.multiplier[i];
            shift_add(&mut out, pull, self.kkt.products.jacobian.row(0, i));
        }
        out
    }

    /// The limit whose multipliers, measured against its range and summed over all knots, are the largest, and the
    /// knot with the largest of them.
    fn heaviest(&self) -> ConflictingBound {
        let sizes = self.kkt.sizes();
        let (state, knot) = (sizes.state(), sizes.knot());
        // Limits of one knot, and the duration.
        let kind = |row: usize| if row == self.t_row() { knot } else { (row + state) % knot };
        let mut sums = [[0.0; LARGEST_KNOT + 1]; 2];
        for (sums, side) in sums.iter_mut().zip([&self.below, &self.above]) {
            for i in 0..self.lower.len() {
                sums[kind(i)] += side.multiplier[i] * (self.upper[i] - self.lower[i]);
            }
        }
        let (mut upper, mut heaviest) = (false, 0);
        for i in 0..=knot {
            for is_upper in [false, true] {
                if sums[usize::from(is_upper)][i] > sums[usize::from(upper)][heaviest] {
                    (upper, heaviest) = (is_upper, i);
                }
            }
        }
        let side = if upper { &self.above } else { &self.below };
        let (mut at, mut most) = (0, 0.0);
        for i in (0..self.t_row()).filter(|i| kind(*i) == heaviest) {
            if side.multiplier[i] > most {
                (at, most) = ((i + state) / knot, side.multiplier[i]);
            }
        }
        let bound = match heaviest {
            i if i < state => {
                let (kind, joint) = LimitKind::of_row(i, sizes);
                Bound::Joint(kind, joint)
            }
            i if i < knot => Bound::Joint(LimitKind::Torque, i - state),
            _ => Bound::Duration,
        };
        ConflictingBound { bound, knot: at, upper }
    }

    /// Solves `qp`, from the multipliers of the last one if `warm`.
    pub(super) fn solve(&mut self, qp: &Qp, warm: bool, options: &QpOptions<'_>) -> QpStatus {
        dispatch!(qp.sizes(), |d| self.solve_with(d, qp, warm, options))
    }

    fn solve_with<D: Registers>(&mut self, d: D, qp: &Qp, warm: bool, options: &QpOptions<'_>) -> QpStatus {
        self.load(qp);
        if !kkt::change_variables(d, &self.kkt, &mut self.factor) {
            return QpStatus::Stalled(Stall::Factorisation);
        }
        self.start(d, qp, warm);
        let mut status = self.run(d, qp, options);
        if warm && matches!(status, QpStatus::Stalled(_)) {
            self.start(d, qp, false);
            status = self.run(d, qp, options);
        }
        self.solution.z.copy_from(&self.at.z);
        self.solution.t = self.at.t;
        status
    }

    fn run<D: Registers>(&mut self, d: D, qp: &Qp, options: &QpOptions<'_>) -> QpStatus {
        // The residuals that a good step would have left.
        let mut expected = f64::INFINITY;
        let pairs = (2 * self.lower.len()) as f64;
        let mean = |below: f64, above: f64| (below + above) / pairs;
        for iteration in 0..=options.max_iterations {
            self.solution.iterations = iteration;
            self.residuals(d, qp);
            let (primal, dual) = self.largest_residuals();
            let (below, above) = (products(d, &self.below), products(d, &self.above));
            let (mu, resolved) = (mean(below.0, above.0), mean(below.1, above.1));
            if primal.max(dual) <= options.tolerance && resolved <= options.complementarity {
                return QpStatus::Solved;
            }
            // Where all constraints hold, none contradict each other.
            if primal > options.tolerance
                && let Some(conflict) = self.contradiction(qp)
            {
                return QpStatus::Infeasible(Some(conflict));
            }
            if let Some(status) = options.stop() {
                return status;
            }
            self.condense(d, qp);
            if !self.factorise(d) {
                return QpStatus::Stalled(Stall::Factorisation);
            }
            for side in [&mut self.below, &mut self.above] {
                aim_at_zero(d, side);
            }
            // The predictor only chooses how far to go; the corrector is the step.
            self.direction(d, Linear::Predictor);
            let alpha = longest(d, &self.below).min(longest(d, &self.above)).min(1.0);
            let after = mean(product_after(d, &self.below, alpha), product_after(d, &self.above, alpha));
            let centring = (after / mu).powi(3);
            // Closer to the boundary than asked for, rounding would spoil stationarity.
            let aim = (centring * mu).max(0.1 * options.complementarity);
            for side in [&mut self.below, &mut self.above] {
                aim_at(d, side, aim);
            }
            // What a step misses is a residual of the next one; refinement costs more, unless steps miss by much.
            let missed = primal.max(dual) > 10.0 * expected.max(options.tolerance);
            self.direction(d, if missed { Linear::Refined } else { Linear::Corrector });
            let alpha = (TO_BOUNDARY * longest(d, &self.below).min(longest(d, &self.above))).min(1.0);
            if !(alpha > SHORTEST) {
                return QpStatus::Stalled(Stall::ShortStep);
            }
            expected = (1.0 - alpha).max(UNREFINED) * primal.max(dual);
            self.at.add_scaled(alpha, &self.step);
            shift_add(&mut self.value, alpha, &self.value_step);
            for side in [&mut self.below, &mut self.above] {
                advance(d, side, alpha);
            }
        }
        QpStatus::Stalled(Stall::Iterations)
    }
}

#[cfg(test)]
mod tests;
