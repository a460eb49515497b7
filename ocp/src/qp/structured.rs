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
use crate::fixed::{NU, NX, NZ, State, vector};
use crate::kkt::{
    Factor, Kkt, KnotDynamics, KnotMatrix, KnotParts, KnotVector, NewtonStep, Rhs, SolveWorkspace, TargetRow,
};
use crate::rows::KNOT_ROW;
use upswing_model::{LimitKind, Sizes};

/// Number of bounded quantities: torques of knot 0, then states and torques of each knot, then dt.
const fn bounded_quantities(intervals: usize) -> usize {
    NU + intervals * NZ + 1
}

/// Where the torques of a knot begin among the bounded quantities; the states, if any, stand before them.
const fn torque_at(k: usize) -> usize {
    k * NZ
}

/// Share of the way to the boundary that a step goes at most.
const TO_BOUNDARY: f64 = 0.995;
/// Smallest slack: angles and velocities near one are not known better, and the matrix, whose entries grow with the
/// inverse, could not be factorised.
const RESOLUTION: f64 = 1e-14;
/// Shortest step that counts as progress.
const SHORTEST: f64 = 1e-12;
/// Least slack and product of slack and multiplier of a cold start; the half ranges of the limits are about 1.
/// Tuned, as the next pair: ten times more or less costs one or two iterations.
const COLD: (f64, f64) = (1e-1, 1e-1);
/// The same of a warm start.
const WARM: (f64, f64) = (1e-3, 1e-5);

/// Jacobian of the torques of a knot, each scaled to half its range; rows padded to full vector registers.
type TorqueJacobian = [[f64; KNOT_ROW]; NU];

/// Solver and its memory.
#[derive(Clone, Debug)]
pub struct Structured {
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
    jacobian: Vec<TorqueJacobian>,
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
    sigma: Vec<f64>,
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
        }
    }

    /// Steps that belong to the step `sign` * dw of the distance to the bound.
    fn expand(&mut self, sign: f64, dw: &[f64], compliance: f64) {
        for (i, dw) in dw.iter().enumerate() {
            let da = sign * dw + self.residual[i];
            let dy = (self.target[i] - self.multiplier[i] * da) / self.stretch(i, compliance);
            self.multiplier_step[i] = dy;
            self.slack_step[i] = da + compliance * dy;
        }
    }

    /// Distance that a multiplier's pull acts on: the slack, and what the bound yields.
    fn stretch(&self, i: usize, compliance: f64) -> f64 {
        self.slack[i] + compliance * self.multiplier[i]
    }

    /// Largest step that keeps slacks and multipliers from falling below zero.
    fn longest(&self) -> f64 {
        let mut rate = 0.0_f64;
        for i in 0..self.slack.len() {
            rate = rate.max(-self.slack_step[i] / self.slack[i]);
            rate = rate.max(-self.multiplier_step[i] / self.multiplier[i]);
        }
        1.0 / rate
    }

    /// Sum of the products of slacks and multipliers.
    fn product(&self) -> f64 {
        self.slack.iter().zip(&self.multiplier).map(|(a, y)| a * y).sum()
    }

    /// The same for the distances beyond the resolution.
    fn resolved_product(&self) -> f64 {
        self.slack.iter().zip(&self.multiplier).map(|(a, y)| (a - RESOLUTION) * y).sum()
    }

    fn product_after(&self, alpha: f64) -> f64 {
        (0..self.slack.len())
            .map(|i| {
                (self.slack[i] + alpha * self.slack_step[i])
                    * (self.multiplier[i] + alpha * self.multiplier_step[i])
            })
            .sum()
    }

    fn advance(&mut self, alpha: f64) {
        for i in 0..self.slack.len() {
            self.slack[i] = (self.slack[i] + alpha * self.slack_step[i]).max(RESOLUTION);
            self.multiplier[i] += alpha * self.multiplier_step[i];
        }
    }
}

impl Structured {
    /// Allocates everything for programs of `n` intervals.
    pub(super) fn new(sizes: Sizes, n: usize) -> Self {
        let knot = KnotDynamics::zeros();
        // More target rows than states would contradict each other.
        let row = TargetRow::unit(sizes, 0, 0.0);
        let kkt = Kkt {
            h: 0.0,
            hessian: vec![KnotMatrix::zeros(); n + 1],
            with_t: vec![KnotVector::zeros(); n + 1],
            t_t: 0.0,
            dynamics: vec![knot; n + 1],
            target: vec![row; NX],
        };
        let rows = bounded_quantities(n);
        let zeros = || vec![0.0; rows];
        Self {
            factor: Factor::new(n),
            damping: 0.0,
            work: SolveWorkspace::new(n, NX),
            rhs: kkt.zero_rhs(),
            residual: kkt.zero_rhs(),
            at: NewtonStep::zeros(n, NX),
            step: NewtonStep::zeros(n, NX),
            kkt,
            jacobian: vec![[[0.0; KNOT_ROW]; NU]; n + 1],
            lower: zeros(),
            upper: zeros(),
            compliance: 0.0,
            value: zeros(),
            value_step: zeros(),
            below: Side::new(rows),
            above: Side::new(rows),
            pull: zeros(),
            sigma: zeros(),
            solution: QpSolution::zeros(sizes, n),
        }
    }

    pub(super) fn solution(&self) -> &QpSolution {
        &self.solution
    }

    /// Takes over the constant parts of `qp`.
    fn load(&mut self, qp: &Qp) {
        let (n, targets) = (qp.intervals(), qp.target.len());
        if self.at.lambda.len() != n || self.solution.z.sizes() != qp.sizes() {
            *self = Self::new(qp.sizes(), n);
        }
        if self.kkt.target.len() != targets {
            self.kkt.target.clone_from(&qp.target);
            self.work = SolveWorkspace::new(n, targets);
            (self.rhs, self.residual) = (self.kkt.zero_rhs(), self.kkt.zero_rhs());
            (self.at, self.step) = (NewtonStep::zeros(n, targets), NewtonStep::zeros(n, targets));
        }
        self.compliance = qp.compliance;
        self.kkt.h = qp.h;
        self.kkt.target.clone_from_slice(&qp.target);
        for (k, dynamics) in self.kkt.dynamics.iter_mut().enumerate() {
            *dynamics = KnotDynamics::of(&qp.dynamics, k);
        }
        for (k, (lower, upper)) in qp.torque.bounds.iter().enumerate() {
            let at = torque_at(k);
            for i in 0..NU {
                let scale = 2.0 / (upper[i] - lower[i]);
                self.lower[at + i] = lower[i] * scale;
                self.upper[at + i] = upper[i] * scale;
                let row = qp.torque.jacobian.row(k, i);
                for j in 0..NZ {
                    self.jacobian[k][i][j] = row[j] * scale;
                }
            }
            if k > 0 {
                let (lower, upper) = &qp.x[k - 1];
                self.lower[at - NX..at].copy_from_slice(lower);
                self.upper[at - NX..at].copy_from_slice(upper);
            }
        }
        let t = self.t_row();
        (self.lower[t], self.upper[t]) = qp.t;
    }

    /// Where dt is among the bounded quantities.
    fn t_row(&self) -> usize {
        self.lower.len() - 1
    }

    /// w of a step of z and t.
    fn bounded(jacobian: &[TorqueJacobian], z: &[KnotVector], t: f64, out: &mut [f64]) {
        for (k, (z, jacobian)) in z.iter().zip(jacobian).enumerate() {
            let at = torque_at(k);
            if k > 0 {
                out[at - NX..at].copy_from_slice(&z.as_slice()[..NX]);
            }
            for (out, row) in out[at..at + NU].iter_mut().zip(jacobian) {
                let mut sum = 0.0;
                for j in 0..NZ {
                    sum += row[j] * z[j];
                }
                *out = sum;
            }
        }
        if let Some(last) = out.last_mut() {
            *last = t;
        }
    }

    /// Adds C' `pull` to the gradient.
    fn add_pull(jacobian: &[TorqueJacobian], pull: &[f64], rhs: &mut Rhs) {
        for (k, (g, jacobian)) in rhs.g.iter_mut().zip(jacobian).enumerate() {
            let at = torque_at(k);
            let mut sum = [0.0; KNOT_ROW];
            for (row, p) in jacobian.iter().zip(&pull[at..at + NU]) {
                for j in 0..KNOT_ROW {
                    sum[j] += p * row[j];
                }
            }
            if k > 0 {
                for j in 0..NX {
                    sum[j] += pull[at - NX + j];
                }
            } else {
                // The start is given: nothing pulls at it.
                sum[..NX].fill(0.0);
            }
            for j in 0..NZ {
                g[j] += sum[j];
            }
        }
        rhs.g_t += pull.last().copied().unwrap_or(0.0);
    }

    /// Starting point: no step; multipliers of the last QP if `warm`.
    fn start(&mut self, qp: &Qp, warm: bool) {
        self.at.z.fill(KnotVector::zeros());
        self.at.z[0].x_mut().copy_from_slice(&qp.start);
        self.at.t = 0.0;
        Self::bounded(&self.jacobian, &self.at.z, 0.0, &mut self.value);
        let (slack, barrier) = if warm { WARM } else { COLD };
        if !warm {
            self.at.lambda.fill(State::zeros());
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
    fn residuals(&mut self, qp: &Qp) {
        let r = &mut self.residual;
        for (k, g) in r.g.iter_mut().enumerate() {
            *g = self.at.z[k].component_mul(&vector(qp.weight.vector(k)))
                + vector::<NZ>(qp.gradient.vector(k));
        }
        r.g_t = qp.weight_t * self.at.t + qp.gradient_t;
        r.defects.iter_mut().zip(qp.defects.vectors()).for_each(|(r, defect)| *r = vector(defect));
        r.start = vector(&qp.start);
        r.target.iter_mut().zip(&qp.target).for_each(|(r, row)| *r = -row.value);
        self.kkt.add_constraints(&self.at, r);
        Self::bounded(&self.jacobian, &self.at.z, self.at.t, &mut self.value);
        let compliance = self.compliance;
        for i in 0..self.value.len() {
            let (below, above) = (&mut self.below, &mut self.above);
            self.pull[i] = above.multiplier[i] - below.multiplier[i];
            below.residual[i] =
                self.value[i] - self.lower[i] - below.slack[i] + compliance * below.multiplier[i];
            above.residual[i] =
                self.upper[i] - self.value[i] - above.slack[i] + compliance * above.multiplier[i];
        }
        Self::add_pull(&self.jacobian, &self.pull, r);
    }

    /// Largest residuals: of the constraints, and of stationarity relative to the multipliers.
    fn sizes(&self) -> (f64, f64) {
        let r = &self.residual;
        let largest = |v: &[f64]| v.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        let primal = r.defects.iter().map(|d| d.amax()).fold(largest(&r.target), f64::max);
        let primal = primal.max(largest(&self.below.residual)).max(largest(&self.above.residual));
        let dual = r.g.iter().map(|g| g.amax()).fold(r.g_t.abs(), f64::max);
        let multipliers =
            self.at.lambda.iter().map(|l| l.amax()).fold(largest(&self.at.lambda_target), f64::max);
        let multipliers =
            multipliers.max(largest(&self.below.multiplier)).max(largest(&self.above.multiplier));
        (primal, dual / multipliers.max(1.0))
    }

    /// The matrix at the iterate.
    fn condense(&mut self, qp: &Qp) {
        for i in 0..self.sigma.len() {
            let (below, above) = (&self.below, &self.above);
            self.sigma[i] = below.multiplier[i] / below.stretch(i, self.compliance)
                + above.multiplier[i] / above.stretch(i, self.compliance);
        }
        self.kkt.t_t = qp.weight_t + self.sigma[self.t_row()];
        for k in 0..=qp.intervals() {
            let at = torque_at(k);
            let jacobian = &self.jacobian[k];
            let sigma = &self.sigma[at..at + NU];
            let hessian = self.kkt.hessian[k].as_mut_slice();
            for (j, column) in hessian.chunks_exact_mut(NZ).enumerate() {
                let mut sum = [0.0; KNOT_ROW];
                for (row, sigma) in jacobian.iter().zip(sigma) {
                    let s = sigma * row[j];
                    for i in 0..KNOT_ROW {
                        sum[i] += s * row[i];
                    }
                }
                column.copy_from_slice(&sum[..NZ]);
                column[j] += qp.weight.vector(k)[j];
                if k > 0 && j < NX {
                    column[j] += self.sigma[at - NX + j];
                }
            }
        }
    }

    /// Factorises. Near the end rounding may cost a pivot its sign: then a little damping keeps the step near the
    /// iterate, whose residuals show what the step missed.
    fn factor(&mut self) -> bool {
        const DAMPINGS: [f64; 3] = [0.0, 1e-6, 1e-3];
        DAMPINGS.into_iter().any(|damping| {
            self.damping = damping;
            self.kkt.factor_into(damping, damping, &mut self.factor)
        })
    }

    /// A step of everything, for the complementarity targets of both sides.
    fn direction(&mut self, refinements: (usize, f64)) {
        self.rhs.copy_from(&self.residual);
        let (a, b) = (&self.below, &self.above);
        for i in 0..self.pull.len() {
            self.pull[i] = (b.target[i] - b.multiplier[i] * b.residual[i]) / b.stretch(i, self.compliance)
                - (a.target[i] - a.multiplier[i] * a.residual[i]) / a.stretch(i, self.compliance);
        }
        Self::add_pull(&self.jacobian, &self.pull, &mut self.rhs);
        let (rhs, damping) = (&self.rhs, (self.damping, self.damping));
        self.kkt.solve_into(&self.factor, rhs, damping, refinements, &mut self.work, &mut self.step);
        Self::bounded(&self.jacobian, &self.step.z, self.step.t, &mut self.value_step);
        self.below.expand(1.0, &self.value_step, self.compliance);
        self.above.expand(-1.0, &self.value_step, self.compliance);
    }

    fn advance(&mut self, alpha: f64) {
        self.at.z.iter_mut().zip(&self.step.z).for_each(|(z, dz)| *z += dz * alpha);
        self.at.t += alpha * self.step.t;
        self.at.lambda.iter_mut().zip(&self.step.lambda).for_each(|(l, dl)| *l += dl * alpha);
        self.at.lambda_target.iter_mut().zip(&self.step.lambda_target).for_each(|(m, dm)| *m += dm * alpha);
        self.below.advance(alpha);
        self.above.advance(alpha);
    }

    /// Whether the multipliers prove that no point meets all constraints: they combine the constraints to
    /// v' xi <= -c with c > 0, while |v' xi| < c for every xi within its bounds.
    fn contradiction(&mut self, qp: &Qp) -> Option<ConflictingBound> {
        /// Inputs that no arm reaches, rad/s^2.
        const LARGEST_INPUT: f64 = 1e4;
        // Bounds that yield contradict nothing.
        if self.compliance > 0.0 {
            return None;
        }
        // v: what is left of the gradient without the objective.
        let mut slope = 0.0;
        let mut excess = 0.0;
        for k in 0..=qp.intervals() {
            let weighted = self.at.z[k].component_mul(&vector(qp.weight.vector(k)));
            let mut v = self.residual.g[k] - weighted - vector::<NZ>(qp.gradient.vector(k));
            if k == 0 {
                // All that acts on the start is a constant.
                v.x_mut().fill(0.0);
                let on_start = self.on_start();
                excess += on_start.dot(&vector(&qp.start));
            }
            for i in 0..NX {
                if k > 0 {
                    let (lower, upper) = &qp.x[k - 1];
                    slope += v[i].abs() * lower[i].abs().max(upper[i].abs());
                }
            }
            slope += v.u().lp_norm(1) * LARGEST_INPUT;
        }
        let v_t = self.residual.g_t - qp.weight_t * self.at.t - qp.gradient_t;
        slope += v_t.abs() * qp.t.0.abs().max(qp.t.1.abs());
        for (lambda, r) in self.at.lambda.iter().zip(qp.defects.vectors()) {
            excess += lambda.dot(&vector(r));
        }
        for (m, row) in self.at.lambda_target.iter().zip(&qp.target) {
            excess -= m * row.value;
        }
        for i in 0..self.lower.len() {
            excess += self.below.multiplier[i] * self.lower[i] - self.above.multiplier[i] * self.upper[i];
        }
        (excess > slope).then(|| self.heaviest())
    }

    /// Coefficient of dx_0 in the sum of all constraints with their multipliers.
    fn on_start(&self) -> State {
        let lambda = &self.at.lambda[0];
        let by_defects = self.kkt.dynamics[0].apply_transposed(lambda) * (-0.5 * self.kkt.h);
        let mut out: State = by_defects.x().into();
        out -= lambda;
        for i in 0..NU {
            let pull = self.above.multiplier[i] - self.below.multiplier[i];
            for j in 0..NX {
                out[j] += pull * self.jacobian[0][i][j];
            }
        }
        out
    }

    /// The limit whose multipliers, measured against its range and summed over all knots, are the largest, and the
    /// knot with the largest of them.
    fn heaviest(&self) -> ConflictingBound {
        /// Limits of one knot, and the duration.
        const KINDS: usize = NZ + 1;
        let kind = |row: usize| if row == self.t_row() { NZ } else { (row + NX) % NZ };
        let mut sums = [[0.0; KINDS]; 2];
        for (sums, side) in sums.iter_mut().zip([&self.below, &self.above]) {
            for i in 0..self.lower.len() {
                sums[kind(i)] += side.multiplier[i] * (self.upper[i] - self.lower[i]);
            }
        }
        let (mut upper, mut heaviest) = (false, 0);
        for i in 0..KINDS {
            for is_upper in [false, true] {
                if sums[usize::from(is_upper)][i] > sums[usize::from(upper)][heaviest] {
                    (upper, heaviest) = (is_upper, i);
                }
            }
        }
        let side = if upper { &self.above } else { &self.below };
        let (mut knot, mut most) = (0, 0.0);
        for i in (0..self.t_row()).filter(|i| kind(*i) == heaviest) {
            if side.multiplier[i] > most {
                (knot, most) = ((i + NX) / NZ, side.multiplier[i]);
            }
        }
        let bound = match heaviest {
            i if i < NX => {
                let (kind, joint) = LimitKind::of_row(i, self.solution.z.sizes());
                Bound::Joint(kind, joint)
            }
            i if i < NZ => Bound::Joint(LimitKind::Torque, i - NX),
            _ => Bound::Duration,
        };
        ConflictingBound { bound, knot, upper }
    }

    /// Solves `qp`, from the multipliers of the last one if `warm`.
    pub(super) fn solve(&mut self, qp: &Qp, warm: bool, options: &QpOptions<'_>) -> QpStatus {
        self.load(qp);
        self.start(qp, warm);
        let mut status = self.run(qp, options);
        if warm && matches!(status, QpStatus::Stalled(_)) {
            self.start(qp, false);
            status = self.run(qp, options);
        }
        for (k, z) in self.at.z.iter().enumerate() {
            self.solution.z.vector_mut(k).copy_from_slice(z.as_slice());
        }
        self.solution.t = self.at.t;
        status
    }

    fn run(&mut self, qp: &Qp, options: &QpOptions<'_>) -> QpStatus {
        for iteration in 0..=options.max_iterations {
            self.solution.iterations = iteration;
            self.residuals(qp);
            let (primal, dual) = self.sizes();
            let rows = self.lower.len();
            let mean = |below: f64, above: f64| (below + above) / (2 * rows) as f64;
            let mu = mean(self.below.product(), self.above.product());
            let resolved = mean(self.below.resolved_product(), self.above.resolved_product());
            if primal.max(dual) <= options.tolerance && resolved <= options.complementarity {
                return QpStatus::Solved;
            }
            if let Some(conflict) = self.contradiction(qp) {
                return QpStatus::Infeasible(Some(conflict));
            }
            if let Some(status) = options.stop() {
                return status;
            }
            self.condense(qp);
            if !self.factor() {
                return QpStatus::Stalled(Stall::Factorisation);
            }
            for side in [&mut self.below, &mut self.above] {
                for i in 0..rows {
                    side.target[i] = -side.slack[i] * side.multiplier[i];
                }
            }
            // The predictor only chooses how far to go; the corrector is the step.
            self.direction((0, 0.0));
            let alpha = self.below.longest().min(self.above.longest()).min(1.0);
            let after = mean(self.below.product_after(alpha), self.above.product_after(alpha));
            let centring = (after / mu).powi(3);
            // Closer to the boundary than asked for, rounding would spoil stationarity.
            let aim = (centring * mu).max(0.1 * options.complementarity);
            for side in [&mut self.below, &mut self.above] {
                for i in 0..rows {
                    side.target[i] = aim
                        - side.slack[i] * side.multiplier[i]
                        - side.slack_step[i] * side.multiplier_step[i];
                }
            }
            self.direction((1, 1e-6));
            let alpha = (TO_BOUNDARY * self.below.longest().min(self.above.longest())).min(1.0);
            if !(alpha > SHORTEST) {
                return QpStatus::Stalled(Stall::ShortStep);
            }
            self.advance(alpha);
        }
        QpStatus::Stalled(Stall::Iterations)
    }
}
