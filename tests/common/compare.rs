//! The comparators of all numerical tests. Each returns an error that names the worst element; `harness.rs` shows that
//! they can fail.
#![allow(dead_code)]

use limpid::net::tensor::Tensor;

/// What a comparator found.
pub type Outcome = Result<(), String>;

/// `|a - b| <= atol + rtol * |b|` for every element, all finite, lengths equal and not zero.
pub fn close<A: Copy + Into<f64>, B: Copy + Into<f64>>(actual: &[A], expected: &[B], atol: f64, rtol: f64) -> Outcome {
    let bound: Vec<f64> = expected.iter().map(|&b| atol + rtol * b.into().abs()).collect();
    within(actual, expected, &bound)
}

/// `|a - b| <= bound` element by element, all finite, lengths equal and not zero.
pub fn within<A: Copy + Into<f64>, B: Copy + Into<f64>>(actual: &[A], expected: &[B], bound: &[f64]) -> Outcome {
    if actual.len() != expected.len() || bound.len() != expected.len() {
        return Err(format!("lengths: {} actual, {} expected, {} bounds", actual.len(), expected.len(), bound.len()));
    }
    if actual.is_empty() {
        return Err("nothing to compare".into());
    }
    let (mut failures, mut worst) = (0, (f64::NEG_INFINITY, String::new()));
    for (i, ((&a, &b), &bound)) in actual.iter().zip(expected).zip(bound).enumerate() {
        let (a, b): (f64, f64) = (a.into(), b.into());
        let error = (a - b).abs();
        // Written so that a NaN anywhere, the bound too, is a failure.
        if a.is_finite() && b.is_finite() && bound.is_finite() && error <= bound {
            continue;
        }
        failures += 1;
        let excess = if error.is_finite() && bound.is_finite() { error - bound } else { f64::INFINITY };
        if excess > worst.0 {
            worst = (excess, format!("element {i}: {a:e}, expected {b:e}, off by {error:e}, allowed {bound:e}"));
        }
    }
    if failures == 0 {
        Ok(())
    } else {
        Err(format!("{failures} of {} elements differ; worst: {}", actual.len(), worst.1))
    }
}

/// [`close`] for tensors: the shapes are equal too.
pub fn tensors_close<A, B>(actual: &Tensor<A>, expected: &Tensor<B>, atol: f64, rtol: f64) -> Outcome
where
    A: Copy + Into<f64>,
    B: Copy + Into<f64>,
{
    same_shape(actual.shape, expected.shape)?;
    close(&actual.data, &expected.data, atol, rtol)
}

/// [`within`] for tensors: the shapes are equal too.
pub fn tensors_within<A, B>(actual: &Tensor<A>, expected: &Tensor<B>, bound: &Tensor<f64>) -> Outcome
where
    A: Copy + Into<f64>,
    B: Copy + Into<f64>,
{
    same_shape(actual.shape, expected.shape)?;
    same_shape(bound.shape, expected.shape)?;
    within(&actual.data, &expected.data, &bound.data)
}

fn same_shape(actual: [usize; 4], expected: [usize; 4]) -> Outcome {
    if actual == expected { Ok(()) } else { Err(format!("shape {actual:?}, expected {expected:?}")) }
}

/// The same bits in every element, all finite, lengths equal and not zero. (0 and -0 differ.)
pub fn same_bits(actual: &[f32], expected: &[f32]) -> Outcome {
    if actual.len() != expected.len() || actual.is_empty() {
        return Err(format!("lengths: {} actual, {} expected", actual.len(), expected.len()));
    }
    let bad = |(a, b): (&f32, &f32)| a.to_bits() != b.to_bits() || !a.is_finite();
    match actual.iter().zip(expected).position(bad) {
        Some(i) => Err(format!(
            "element {i}: {:e} ({:08x}), expected {:e} ({:08x})",
            actual[i],
            actual[i].to_bits(),
            expected[i],
            expected[i].to_bits()
        )),
        None => Ok(()),
    }
}

/// `||a - b|| / ||b||`; an error where anything is not finite, lengths differ, or `b` is zero.
pub fn relative_l2<A: Copy + Into<f64>, B: Copy + Into<f64>>(actual: &[A], expected: &[B]) -> Result<f64, String> {
    if actual.len() != expected.len() {
        return Err(format!("lengths: {} actual, {} expected", actual.len(), expected.len()));
    }
    let (mut difference, mut norm) = (0.0, 0.0);
    for (&a, &b) in actual.iter().zip(expected) {
        let (a, b): (f64, f64) = (a.into(), b.into());
        difference += (a - b) * (a - b);
        norm += b * b;
    }
    let relative = (difference / norm).sqrt();
    if relative.is_finite() { Ok(relative) } else { Err(format!("||a - b||² = {difference}, ||b||² = {norm}")) }
}

/// Relative L2 error of at most `limit`.
pub fn l2_close<A: Copy + Into<f64>, B: Copy + Into<f64>>(actual: &[A], expected: &[B], limit: f64) -> Outcome {
    let error = relative_l2(actual, expected)?;
    if error <= limit { Ok(()) } else { Err(format!("relative L2 error {error:e}, allowed {limit:e}")) }
}

/// Where a difference is required: relative L2 difference of at least `least`, all finite, lengths equal.
pub fn different<A: Copy + Into<f64>, B: Copy + Into<f64>>(actual: &[A], expected: &[B], least: f64) -> Outcome {
    let difference = relative_l2(actual, expected)?;
    if difference >= least {
        Ok(())
    } else {
        Err(format!("relative L2 difference {difference:e}, at least {least:e} required"))
    }
}

/// Panics, naming `what`, where a comparator found a difference.
#[track_caller]
pub fn require(what: &str, outcome: Outcome) {
    if let Err(e) = outcome {
        panic!("{what}: {e}");
    }
}
