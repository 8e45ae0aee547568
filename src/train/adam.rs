//! Adam (Kingma and Ba 2015), with PyTorch's formula.

/// The settings of the optimiser.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adam {
    /// The step size before bias correction.
    pub learning_rate: f64,
    /// The decay of the mean of the gradient.
    pub beta1: f64,
    /// The decay of the mean of its square.
    pub beta2: f64,
    /// Added to the root of the corrected mean square.
    pub epsilon: f64,
}

impl Default for Adam {
    /// The paper's 1e-3, 0.9, 0.99. It gives no epsilon: 1e-10, for deep layers have gradients of 1e-8, which a larger one
    /// would keep from learning.
    fn default() -> Self {
        Self { learning_rate: 1e-3, beta1: 0.9, beta2: 0.99, epsilon: 1e-10 }
    }
}

/// What Adam keeps from step to step, for the reference.
#[derive(Clone, Debug, PartialEq)]
pub struct ReferenceState {
    /// Steps done.
    pub step: u64,
    /// The mean of the gradient, for each parameter.
    pub mean: Vec<f64>,
    /// The mean of its square, for each parameter.
    pub mean_square: Vec<f64>,
    /// Factor of the learning rate, for each parameter.
    pub scales: Vec<f64>,
}

impl ReferenceState {
    /// The state before the first step; `scales` are factors of the learning rate,
    /// [`Architecture::parameter_scales`](crate::net::architecture::Architecture::parameter_scales).
    pub fn new(scales: &[f32]) -> Self {
        let zeros = vec![0.0; scales.len()];
        let scales = scales.iter().copied().map(f64::from).collect();
        Self { step: 0, mean: zeros.clone(), mean_square: zeros, scales }
    }
}

impl Adam {
    /// One step, with `t` its number from 1:
    /// `m = beta1 m + (1 - beta1) g`, `v = beta2 v + (1 - beta2) g²`,
    /// `p -= scale * learning_rate * (m / (1 - beta1^t)) / (sqrt(v / (1 - beta2^t)) + epsilon)`.
    pub fn reference(&self, state: &mut ReferenceState, parameters: &mut [f64], gradient: &[f64]) {
        assert_eq!(parameters.len(), gradient.len());
        assert_eq!(parameters.len(), state.mean.len());
        state.step += 1;
        let (correction1, correction2) = self.corrections(state.step);
        for (i, (p, &g)) in parameters.iter_mut().zip(gradient).enumerate() {
            let (m, v) = (&mut state.mean[i], &mut state.mean_square[i]);
            *m = self.beta1 * *m + (1.0 - self.beta1) * g;
            *v = self.beta2 * *v + (1.0 - self.beta2) * g * g;
            *p -=
                state.scales[i] * self.learning_rate * (*m / correction1) / ((*v / correction2).sqrt() + self.epsilon);
        }
    }

    /// The bias corrections of step `t`, counted from 1: `1 - beta1^t` and `1 - beta2^t`.
    pub fn corrections(&self, step: u64) -> (f64, f64) {
        (1.0 - self.beta1.powf(step as f64), 1.0 - self.beta2.powf(step as f64))
    }
}
