//! Cubic splines through values at a constant rate: twice continuously differentiable, with the
//! third derivative continuous at the second and the last but one knot ("not-a-knot").

use std::array::from_fn;

/// A value with its first and second derivative over time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jet<const N: usize> {
    /// The value.
    pub value: [f64; N],
    /// Its change per second.
    pub first: [f64; N],
    /// The change of that per second.
    pub second: [f64; N],
}

/// A spline of `N` channels.
#[derive(Debug, Clone, PartialEq)]
pub struct Spline<const N: usize> {
    rate: f64,
    /// Value and second derivative over the knot's number, of every knot.
    knots: Vec<([f64; N], [f64; N])>,
}

impl<const N: usize> Spline<N> {
    /// Through `values` at `rate` knots a second, the first one at time zero. One value gives a
    /// constant, two a line, three a parabola; none gives zero.
    #[must_use]
    pub fn new(values: &[[f64; N]], rate: f64) -> Self {
        let curvature = curvatures(values);
        let knots = values.iter().copied().zip(curvature).collect();
        Self { rate, knots }
    }

    /// Time of the last knot, seconds.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.knots.len().saturating_sub(1) as f64 / self.rate
    }

    /// The spline at a time in seconds; before its first and after its last knot it goes on
    /// straight.
    #[must_use]
    pub fn at(&self, seconds: f64) -> Jet<N> {
        let zero = [0.0; N];
        if self.knots.len() < 2 {
            let value = self.knots.first().map_or(zero, |knot| knot.0);
            return Jet {
                value,
                first: zero,
                second: zero,
            };
        }
        let last = (self.knots.len() - 1) as f64;
        let wanted = seconds * self.rate;
        // NaN ends at the first knot.
        let at = wanted.max(0.0).min(last);
        let index = (at as usize).min(self.knots.len() - 2);
        let jet = self.segment(index, at - index as f64);
        let beyond = (wanted - at) / self.rate;
        if beyond == 0.0 || !beyond.is_finite() {
            return jet;
        }
        Jet {
            value: from_fn(|n| jet.value[n] + jet.first[n] * beyond),
            first: jet.first,
            second: zero,
        }
    }

    /// Between knot `index` and the next, `u` (0 to 1) of the way.
    fn segment(&self, index: usize, u: f64) -> Jet<N> {
        let ((y0, m0), (y1, m1)) = (self.knots[index], self.knots[index + 1]);
        let v = 1.0 - u;
        let (cubic0, cubic1) = (v * (v * v - 1.0) / 6.0, u * (u * u - 1.0) / 6.0);
        let (slope0, slope1) = ((1.0 - 3.0 * v * v) / 6.0, (3.0 * u * u - 1.0) / 6.0);
        let rate = self.rate;
        Jet {
            value: from_fn(|n| v * y0[n] + u * y1[n] + cubic0 * m0[n] + cubic1 * m1[n]),
            first: from_fn(|n| (y1[n] - y0[n] + slope0 * m0[n] + slope1 * m1[n]) * rate),
            second: from_fn(|n| (v * m0[n] + u * m1[n]) * rate * rate),
        }
    }
}

/// Second derivatives at the knots, over the knots' number.
fn curvatures<const N: usize>(values: &[[f64; N]]) -> Vec<[f64; N]> {
    let count = values.len();
    let difference = |i: usize| -> [f64; N] {
        from_fn(|n| values[i + 1][n] - 2.0 * values[i][n] + values[i - 1][n])
    };
    match count {
        0..=2 => return vec![[0.0; N]; count],
        3 => return vec![difference(1); 3],
        _ => {}
    }
    // Inner knots satisfy m[i-1] + 4 m[i] + m[i+1] = 6 d[i]. "Not a knot" is m[0] = 2 m[1] - m[2],
    // which makes the second knot's equation 6 m[1] = 6 d[1]; the same holds at the other end.
    let mut curvature = vec![[0.0; N]; count];
    curvature[1] = difference(1);
    curvature[count - 2] = difference(count - 2);
    // Forward elimination, then substitution, for the knots between those two.
    let mut pivots = vec![0.0; count];
    for i in 2..count - 2 {
        let d = difference(i);
        let (behind, pivot): ([f64; N], f64) = if i == 2 {
            (curvature[1], 0.25)
        } else {
            (curvature[i - 1], 1.0 / (4.0 - pivots[i - 1]))
        };
        pivots[i] = pivot;
        curvature[i] = from_fn(|n| (6.0 * d[n] - behind[n]) * pivot);
    }
    for i in (2..count - 2).rev() {
        let ahead = curvature[i + 1];
        let pivot = pivots[i];
        curvature[i] = from_fn(|n| curvature[i][n] - pivot * ahead[n]);
    }
    curvature[0] = from_fn(|n| 2.0 * curvature[1][n] - curvature[2][n]);
    let end = count - 1;
    curvature[end] = from_fn(|n| 2.0 * curvature[end - 1][n] - curvature[end - 2][n]);
    curvature
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_cubic_is_met_exactly() {
        let cubic = |t: f64| [1.0 - 2.0 * t + 3.0 * t * t - 0.5 * t * t * t, t];
        let rate = 30.0;
        for count in [4, 5, 6, 7, 40] {
            let values: Vec<_> = (0..count).map(|i| cubic(f64::from(i) / rate)).collect();
            let spline = Spline::new(&values, rate);
            for step in 0..=100 {
                let t = spline.duration() * f64::from(step) / 100.0;
                let jet = spline.at(t);
                assert!(
                    (jet.value[0] - cubic(t)[0]).abs() < 1e-9,
                    "{count} knots at {t}"
                );
                let first = -2.0 + 6.0 * t - 1.5 * t * t;
                assert!((jet.first[0] - first).abs() < 1e-7, "{count} knots at {t}");
                assert!(
                    (jet.second[0] - (6.0 - 3.0 * t)).abs() < 1e-5,
                    "{count} knots at {t}"
                );
                assert!((jet.value[1] - t).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn few_knots_and_none() {
        assert_eq!(Spline::<1>::new(&[], 60.0).at(0.5).value, [0.0]);
        assert_eq!(Spline::new(&[[2.0]], 60.0).at(9.0).value, [2.0]);
        assert_eq!(Spline::new(&[[0.0], [1.0]], 1.0).at(0.25).value, [0.25]);
        let parabola = Spline::new(&[[0.0], [1.0], [4.0]], 1.0);
        assert!((parabola.at(1.5).value[0] - 2.25).abs() < 1e-12);
        assert_eq!(parabola.at(f64::NAN).value, [0.0]);
    }

    proptest! {
        #[test]
        fn knots_are_met_and_all_is_continuous(
            values in prop::collection::vec(-10.0f64..10.0, 4..40), rate in 1.0f64..120.0,
        ) {
            let values: Vec<[f64; 1]> = values.into_iter().map(|v| [v]).collect();
            let spline = Spline::new(&values, rate);
            for (i, value) in values.iter().enumerate() {
                let t = i as f64 / rate;
                prop_assert!((spline.at(t).value[0] - value[0]).abs() < 1e-9);
                let (before, after) = (spline.at(t - 1e-9), spline.at(t + 1e-9));
                let inner = i > 0 && i + 1 < values.len();
                prop_assert!((before.first[0] - after.first[0]).abs() < 1e-3 * rate);
                let jump = (before.second[0] - after.second[0]).abs();
                prop_assert!(!inner || jump < 1e-3 * rate * rate, "{jump}");
            }
        }
    }
}
