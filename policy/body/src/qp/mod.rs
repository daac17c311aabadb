//! Strictly convex quadratic programs of a few hundred unknowns: minimise `½ xᵀ H x + gᵀ x`
//! subject to `A x >= b`.
//!
//! The solver is the dual active-set method of D. Goldfarb and A. Idnani, "A numerically stable
//! dual method for solving strictly convex quadratic programs", Mathematical Programming 27,
//! 1983. It starts from the unconstrained minimum, or from the constraints that were active last
//! time, and adds violated constraints one by one, so a problem with few active constraints is
//! cheap. Nothing is allocated after [`Solver::new`].

mod active_set;
mod dense;

pub use active_set::{Solver, Status};

/// A problem; its storage is reused from one problem to the next.
#[derive(Debug, Clone, Default)]
pub struct Problem {
    /// Number of unknowns.
    n: usize,
    /// Number of constraints.
    m: usize,
    /// `H`, column-major; only the lower triangle is read.
    hessian: Vec<f64>,
    /// `g`.
    gradient: Vec<f64>,
    /// Rows of `A`, one after the other.
    rows: Vec<f64>,
    /// `b`.
    bounds: Vec<f64>,
}

impl Problem {
    /// Room for `n_max` unknowns and `m_max` constraints.
    #[must_use]
    pub fn with_capacity(n_max: usize, m_max: usize) -> Self {
        Self {
            n: 0,
            m: 0,
            hessian: Vec::with_capacity(n_max * n_max),
            gradient: Vec::with_capacity(n_max),
            rows: Vec::with_capacity(n_max * m_max),
            bounds: Vec::with_capacity(m_max),
        }
    }

    /// Empties the problem for `n` unknowns.
    pub fn reset(&mut self, n: usize) {
        self.n = n;
        self.m = 0;
        self.hessian.clear();
        self.hessian.resize(n * n, 0.0);
        self.gradient.clear();
        self.gradient.resize(n, 0.0);
        self.rows.clear();
        self.bounds.clear();
    }

    /// Number of unknowns.
    #[must_use]
    pub fn unknowns(&self) -> usize {
        self.n
    }

    /// Number of constraints.
    #[must_use]
    pub fn constraints(&self) -> usize {
        self.m
    }

    /// `H`, column-major; only the lower triangle counts.
    #[must_use]
    pub fn hessian(&self) -> &[f64] {
        &self.hessian
    }

    /// `H`, to be filled.
    pub fn hessian_mut(&mut self) -> &mut [f64] {
        &mut self.hessian
    }

    /// `g`.
    #[must_use]
    pub fn gradient(&self) -> &[f64] {
        &self.gradient
    }

    /// `g`, to be filled.
    pub fn gradient_mut(&mut self) -> &mut [f64] {
        &mut self.gradient
    }

    /// Adds the constraint `row · x >= bound` and gives its row, all zero, to be filled.
    pub fn constrain(&mut self, bound: f64) -> &mut [f64] {
        let start = self.rows.len();
        self.rows.resize(start + self.n, 0.0);
        self.bounds.push(bound);
        self.m += 1;
        &mut self.rows[start..]
    }

    /// Drops all constraints from number `keep` on.
    pub fn truncate(&mut self, keep: usize) {
        self.m = self.m.min(keep);
        self.rows.truncate(self.m * self.n);
        self.bounds.truncate(self.m);
    }

    /// Row and bound of a constraint.
    #[must_use]
    pub fn constraint(&self, index: usize) -> (&[f64], f64) {
        (
            &self.rows[index * self.n..(index + 1) * self.n],
            self.bounds[index],
        )
    }

    /// The objective at `x`.
    #[must_use]
    pub fn objective(&self, x: &[f64]) -> f64 {
        let n = self.n;
        let mut sum = dense::dot(&self.gradient, x);
        for column in 0..n {
            let below = dense::dot(
                &self.hessian[column * n + column + 1..(column + 1) * n],
                &x[column + 1..n],
            );
            sum += x[column] * (0.5 * self.hessian[column * n + column] * x[column] + below);
        }
        sum
    }

    /// By how much `x` violates the worst constraint, in units of a row of length one.
    #[must_use]
    pub fn violation(&self, x: &[f64]) -> f64 {
        (0..self.m)
            .map(|index| {
                let (row, bound) = self.constraint(index);
                (bound - dense::dot(row, x)) / dense::dot(row, row).sqrt().max(f64::MIN_POSITIVE)
            })
            .fold(0.0, f64::max)
    }
}
