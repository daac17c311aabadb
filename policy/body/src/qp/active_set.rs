//! The dual active-set iteration.

use super::Problem;
use super::dense::{axpy, cholesky, dot, inverse_transpose, solve};

/// How a solve ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// The minimum.
    Solved,
    /// No point satisfies all constraints; `x` minimises under those taken in so far.
    Infeasible,
    /// Too many iterations; `x` minimises under the active constraints.
    IterationLimit,
    /// `H` is not positive definite or something is not finite; `x` is zero.
    Unsound,
}

/// A constraint violated by less than this (row of length one, relative to the size of its
/// bound) holds.
const TOLERANCE: f64 = 1e-9;
/// A row whose part outside the active rows is shorter than this, relative to its length, is
/// taken to depend on them.
const DEPENDENT: f64 = 1e-9;
/// Iterations allowed for each constraint.
const ITERATIONS_PER_CONSTRAINT: usize = 20;

/// A solver and its workspace.
#[derive(Debug, Clone)]
pub struct Solver {
    n: usize,
    /// Cholesky factor of `H`.
    factor: Vec<f64>,
    /// `J = L⁻ᵀ Q`, column-major: the first `q` columns belong to the active rows `N`, with
    /// `Jᵀ N = [R; 0]`.
    j: Vec<f64>,
    /// `R`, upper triangular, column-major with `n` values to a column.
    r: Vec<f64>,
    x: Vec<f64>,
    /// Lengths of the constraint rows.
    norms: Vec<f64>,
    /// Whether a constraint is in the active set.
    is_active: Vec<bool>,
    active: Vec<usize>,
    multipliers: Vec<f64>,
    /// `Jᵀ a` of the row being added.
    d: Vec<f64>,
    /// Primal direction.
    z: Vec<f64>,
    /// Dual direction.
    dual: Vec<f64>,
    iterations: usize,
}

/// What one step of the iteration came to.
enum Advance {
    Added,
    Dropped,
    Infeasible,
}

impl Solver {
    /// A workspace for at most `n_max` unknowns and `m_max` constraints.
    #[must_use]
    pub fn new(n_max: usize, m_max: usize) -> Self {
        Self {
            n: 0,
            factor: vec![0.0; n_max * n_max],
            j: vec![0.0; n_max * n_max],
            r: vec![0.0; n_max * n_max],
            x: vec![0.0; n_max],
            norms: Vec::with_capacity(m_max),
            is_active: Vec::with_capacity(m_max),
            active: Vec::with_capacity(n_max + 1),
            multipliers: Vec::with_capacity(n_max + 1),
            d: vec![0.0; n_max],
            z: vec![0.0; n_max],
            dual: vec![0.0; n_max],
            iterations: 0,
        }
    }

    /// The point that the last solve ended at.
    #[must_use]
    pub fn x(&self) -> &[f64] {
        &self.x[..self.n]
    }

    /// The active constraints of the last solve, in the order in which they came in.
    #[must_use]
    pub fn active(&self) -> &[usize] {
        &self.active
    }

    /// The multipliers of the active constraints, all positive, for rows as they were given.
    pub fn multipliers(&self) -> impl Iterator<Item = f64> {
        self.active
            .iter()
            .zip(&self.multipliers)
            .map(|(&row, u)| u / self.norms[row])
    }

    /// Constraints added and dropped in the last solve.
    #[must_use]
    pub fn iterations(&self) -> usize {
        self.iterations
    }

    /// Minimises. `guess` names constraints that may well be active; a wrong guess costs time,
    /// not the result.
    ///
    /// # Panics
    /// When the problem is larger than the workspace.
    pub fn solve(&mut self, problem: &Problem, guess: &[usize]) -> Status {
        let n = problem.unknowns();
        assert!(
            n <= self.x.len(),
            "{n} unknowns in a workspace for {}",
            self.x.len()
        );
        self.n = n;
        self.iterations = 0;
        self.active.clear();
        self.multipliers.clear();
        if !self.prepare(problem) {
            self.x[..n].fill(0.0);
            return Status::Unsound;
        }
        self.start_from(problem, guess);
        let limit = ITERATIONS_PER_CONSTRAINT * (problem.constraints() + 1);
        while let Some((row, slack)) = self.most_violated(problem) {
            if let Some(status) = self.take_in(problem, row, slack, limit) {
                return status;
            }
        }
        Status::Solved
    }

    /// Factorises, measures the rows and goes to the unconstrained minimum.
    fn prepare(&mut self, problem: &Problem) -> bool {
        let n = self.n;
        self.norms.clear();
        self.is_active.clear();
        for index in 0..problem.constraints() {
            let (row, bound) = problem.constraint(index);
            let norm = dot(row, row).sqrt();
            if !norm.is_finite() || !bound.is_finite() {
                return false;
            }
            self.norms.push(norm.max(f64::MIN_POSITIVE));
            self.is_active.push(false);
        }
        self.factor[..n * n].copy_from_slice(problem.hessian());
        if !cholesky(&mut self.factor, n) {
            return false;
        }
        inverse_transpose(&self.factor, n, &mut self.j);
        for (x, g) in self.x.iter_mut().zip(problem.gradient()) {
            *x = -g;
        }
        solve(&self.factor, n, &mut self.x[..n]);
        self.x[..n].iter().all(|x| x.is_finite())
    }

    /// Slack of a constraint in units of a row of length one.
    fn slack(&self, problem: &Problem, index: usize) -> f64 {
        let (row, bound) = problem.constraint(index);
        (dot(row, &self.x[..self.n]) - bound) / self.norms[index]
    }

    fn most_violated(&self, problem: &Problem) -> Option<(usize, f64)> {
        let mut worst = None;
        let mut least = 0.0;
        for index in (0..problem.constraints()).filter(|&index| !self.is_active[index]) {
            let slack = self.slack(problem, index);
            let size = 1.0 + problem.constraint(index).1.abs() / self.norms[index];
            if slack < -TOLERANCE * size && slack < least {
                least = slack;
                worst = Some((index, slack));
            }
        }
        worst
    }

    /// Takes the guessed constraints as equations and drops those whose multiplier comes out
    /// negative: a point from which the dual iteration can go on.
    fn start_from(&mut self, problem: &Problem, guess: &[usize]) {
        for &row in guess {
            if row < problem.constraints() && !self.is_active[row] {
                self.project(problem, row);
                if self.remainder() > DEPENDENT {
                    self.append(row, 0.0);
                }
            }
        }
        // Slacks at the unconstrained minimum, which `x` still is.
        loop {
            let q = self.active.len();
            for place in 0..q {
                self.dual[place] = -self.slack(problem, self.active[place]);
            }
            self.solve_transposed(q);
            self.d[..q].copy_from_slice(&self.dual[..q]);
            self.solve_upper(q);
            self.multipliers.copy_from_slice(&self.dual[..q]);
            let least = (0..q).min_by(|&a, &b| self.dual[a].total_cmp(&self.dual[b]));
            match least {
                Some(place) if self.dual[place] < 0.0 => self.remove(place),
                _ => break,
            }
        }
        for place in 0..self.active.len() {
            let column = &self.j[place * self.n..(place + 1) * self.n];
            axpy(self.d[place], column, &mut self.x[..self.n]);
        }
    }

    /// Brings a violated constraint into the active set, dropping others on the way.
    fn take_in(
        &mut self,
        problem: &Problem,
        row: usize,
        mut slack: f64,
        limit: usize,
    ) -> Option<Status> {
        let mut multiplier = 0.0;
        loop {
            self.iterations += 1;
            if self.iterations > limit {
                return Some(Status::IterationLimit);
            }
            match self.advance(problem, row, slack, &mut multiplier) {
                Advance::Added => return None,
                Advance::Dropped => slack = self.slack(problem, row),
                Advance::Infeasible => return Some(Status::Infeasible),
            }
        }
    }

    fn advance(
        &mut self,
        problem: &Problem,
        row: usize,
        slack: f64,
        multiplier: &mut f64,
    ) -> Advance {
        let (n, q) = (self.n, self.active.len());
        self.project(problem, row);
        self.z[..n].fill(0.0);
        for k in q..n {
            axpy(self.d[k], &self.j[k * n..(k + 1) * n], &mut self.z[..n]);
        }
        self.dual[..q].copy_from_slice(&self.d[..q]);
        self.solve_upper(q);

        let (mut partial, mut blocking) = (f64::INFINITY, None);
        for place in 0..q {
            if self.dual[place] > 0.0 {
                let ratio = self.multipliers[place] / self.dual[place];
                if ratio < partial {
                    (partial, blocking) = (ratio, Some(place));
                }
            }
        }
        let rest = self.remainder();
        let curvature: f64 = dot(&self.d[q..n], &self.d[q..n]);
        let full = if rest > DEPENDENT {
            -slack / curvature
        } else {
            f64::INFINITY
        };
        let step = partial.min(full);
        if !step.is_finite() {
            return Advance::Infeasible;
        }
        if full.is_finite() {
            axpy(step, &self.z[..n], &mut self.x[..n]);
        }
        for place in 0..q {
            self.multipliers[place] = (self.multipliers[place] - step * self.dual[place]).max(0.0);
        }
        *multiplier += step;
        match blocking {
            Some(place) if partial < full => {
                self.remove(place);
                Advance::Dropped
            }
            _ => {
                self.append(row, *multiplier);
                Advance::Added
            }
        }
    }

    /// `d = Jᵀ a` for a row scaled to length one.
    fn project(&mut self, problem: &Problem, row: usize) {
        let (values, _) = problem.constraint(row);
        let scale = 1.0 / self.norms[row];
        let columns = self.j.chunks_exact(self.n);
        for (d, column) in self.d[..self.n].iter_mut().zip(columns) {
            *d = scale * dot(column, values);
        }
    }

    /// Length of the part of `d` outside the active rows, over its whole length.
    fn remainder(&self) -> f64 {
        let outside = &self.d[self.active.len()..self.n];
        let whole = dot(&self.d[..self.n], &self.d[..self.n]);
        (dot(outside, outside) / whole.max(f64::MIN_POSITIVE)).sqrt()
    }

    /// Adds the row that `d` belongs to: a reflection of the free columns of `J` brings the rest
    /// of `d` onto the first of them.
    fn append(&mut self, row: usize, multiplier: f64) {
        let (n, q) = (self.n, self.active.len());
        let length = dot(&self.d[q..n], &self.d[q..n]).sqrt();
        // The sign that adds, not cancels.
        let pivot = if self.d[q] > 0.0 { -length } else { length };
        let first = self.d[q] - pivot;
        self.d[q] = first;
        let square = dot(&self.d[q..n], &self.d[q..n]);
        if square > 0.0 {
            self.z[..n].fill(0.0);
            for k in q..n {
                axpy(self.d[k], &self.j[k * n..(k + 1) * n], &mut self.z[..n]);
            }
            for k in q..n {
                let factor = -2.0 * self.d[k] / square;
                axpy(factor, &self.z[..n], &mut self.j[k * n..(k + 1) * n]);
            }
        }
        self.r[q * n..q * n + q].copy_from_slice(&self.d[..q]);
        self.r[q * n + q] = pivot;
        self.active.push(row);
        self.multipliers.push(multiplier);
        self.is_active[row] = true;
    }

    /// Drops the active row at `place`; rotations of neighbouring columns of `J` make `R` upper
    /// triangular again.
    fn remove(&mut self, place: usize) {
        let n = self.n;
        let row = self.active.remove(place);
        self.multipliers.remove(place);
        self.is_active[row] = false;
        let q = self.active.len();
        for column in place..q {
            let (left, right) = self.r.split_at_mut((column + 1) * n);
            left[column * n..column * n + column + 2].copy_from_slice(&right[..column + 2]);
        }
        for k in place..q {
            let (a, b) = (self.r[k * n + k], self.r[k * n + k + 1]);
            let length = a.hypot(b);
            if length == 0.0 {
                continue;
            }
            let (c, s) = (a / length, b / length);
            for column in k..q {
                let (a, b) = (self.r[column * n + k], self.r[column * n + k + 1]);
                self.r[column * n + k] = c * a + s * b;
                self.r[column * n + k + 1] = c * b - s * a;
            }
            let (left, right) = self.j.split_at_mut((k + 1) * n);
            for (a, b) in left[k * n..].iter_mut().zip(&mut right[..n]) {
                (*a, *b) = (c * *a + s * *b, c * *b - s * *a);
            }
        }
    }

    /// `dual = R⁻¹ dual`.
    fn solve_upper(&mut self, q: usize) {
        for k in (0..q).rev() {
            self.dual[k] /= self.r[k * self.n + k];
            let value = self.dual[k];
            axpy(
                -value,
                &self.r[k * self.n..k * self.n + k],
                &mut self.dual[..k],
            );
        }
    }

    /// `dual = R⁻ᵀ dual`.
    fn solve_transposed(&mut self, q: usize) {
        for k in 0..q {
            let sum = dot(&self.r[k * self.n..k * self.n + k], &self.dual[..k]);
            self.dual[k] = (self.dual[k] - sum) / self.r[k * self.n + k];
        }
    }
}
