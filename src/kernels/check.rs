//! The self-check of a kernel family: small rows of the case table against the layer's f64 reference, within the bounds of
//! rounding.

use crate::Result;
use crate::net::kernel::Family;
use crate::net::layer::{Case, Data, cases, concat, conv2d, upsample2d, winograd};
use crate::net::plan::Fusion;
use crate::net::tensor::{Tensor, seed_of};

/// What kernels are chosen for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Forward passes.
    Inference,
    /// Forward and backward passes.
    Training,
}

impl Purpose {
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Inference => "inference",
            Self::Training => "training",
        }
    }
}

/// The kernels in which families differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The convolution.
    Forward,
    /// The convolution by Winograd, of an operand in one part.
    Winograd,
    /// The same of two operands, the first of them upsampled.
    WinogradUpsampled,
    /// The gradient of a convolution's input.
    InputGradient,
    /// The gradient of a convolution's weights.
    WeightGradient,
}

impl Part {
    /// In words.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Forward => "convolution",
            Self::Winograd => "Winograd convolution",
            Self::WinogradUpsampled => "Winograd convolution of an upsampled operand",
            Self::InputGradient => "input gradient",
            Self::WeightGradient => "weight gradient",
        }
    }

    fn serves(self, family: Family, purpose: Purpose) -> bool {
        match self {
            Self::Forward => true,
            Self::Winograd => Fusion::training(family) == Fusion::Winograd,
            Self::WinogradUpsampled => purpose == Purpose::Inference && Fusion::best(family) == Fusion::InPlace,
            Self::InputGradient | Self::WeightGradient => purpose == Purpose::Training,
        }
    }
}

/// Kernels and the rows that they are checked on: no multiples of a tile, a subgroup or a block of channels; blocks of output
/// channels left over and not; batches.
const ROWS: [(Part, &str); 9] = [
    (Part::Forward, "conv2d_n3_c6-32_h13_w11"),
    (Part::Forward, "conv2d_n3_c43-43_h5_w7_one_hot_weight"),
    (Part::Forward, "conv2d_n3_c43-3_h31_w2"),
    (Part::Winograd, "conv2d_n1_c101-101_h4_w4"),
    (Part::Winograd, "conv2d_n3_c43-3_h31_w2"),
    (Part::WinogradUpsampled, "conv2d_n1_c202-76_h4_w6"),
    (Part::InputGradient, "conv2d_n3_c6-32_h13_w11"),
    (Part::WeightGradient, "conv2d_n3_c6-32_h13_w11"),
    (Part::WeightGradient, "conv2d_n3_c43-3_h31_w2"),
];

/// A kernel on a row of the case table.
#[derive(Clone, Debug)]
pub struct Row {
    /// The kernel.
    pub part: Part,
    /// The row.
    pub case: Case,
    /// Its tensors; `inputs` are two for an upsampled operand: a quarter of the pixels of the first half of the channels,
    /// and the other half.
    pub data: Data,
}

impl Row {
    fn new(part: Part, case: Case) -> Self {
        let mut data = case.data();
        if part == Part::WinogradUpsampled {
            let [n, cin, h, w] = data.inputs[0].shape;
            let half = cin / 2;
            let uniform = |name: &str, shape| Tensor::uniform(shape, seed_of(&format!("{}/{name}", case.name)));
            data.inputs = vec![uniform("low", [n, half, h / 2, w / 2]), uniform("high", [n, cin - half, h, w])];
        }
        Self { part, case, data }
    }

    /// What the kernels of a family should make of their operands, and how far sums in f32 may be from it.
    #[must_use]
    pub fn expected(&self, family: Family) -> (Tensor<f64>, Tensor<f64>) {
        let d = &Data {
            inputs: self.data.inputs.iter().map(|x| family.operand(x)).collect(),
            weight: family.operand(&self.data.weight),
            output_gradient: family.operand(&self.data.output_gradient),
            ..self.data.clone()
        };
        let (weight, dy) = (d.weight.to_f64(), d.output_gradient.to_f64());
        let bias: Vec<f64> = d.bias.iter().copied().map(f64::from).collect();
        let x = match &d.inputs[..] {
            [low, high] => concat::reference(&upsample2d::reference(&low.to_f64()), &high.to_f64()),
            inputs => inputs[0].to_f64(),
        };
        match self.part {
            Part::Forward => (conv2d::reference(&x, &weight, &bias), self.case.bounds(d).output),
            Part::Winograd | Part::WinogradUpsampled => {
                (conv2d::reference(&x, &weight, &bias), winograd::bound(&x, &weight, &bias))
            }
            Part::InputGradient => {
                let bound = conv2d::backward_bounds(&x, &weight, &dy).input;
                (conv2d::reference_input_gradient(&weight, &dy), bound)
            }
            Part::WeightGradient => {
                let bound = conv2d::backward_bounds(&x, &weight, &dy).weight;
                (conv2d::reference_weight_gradient(&x, &dy), bound)
            }
        }
    }
}

/// The rows of a family's check.
#[must_use]
pub fn rows(family: Family, purpose: Purpose) -> Vec<Row> {
    let all = cases();
    let chosen = ROWS.iter().filter(|(part, _)| part.serves(family, purpose));
    let row = |(part, name): &(Part, &str)| Some(Row::new(*part, all.iter().find(|c| c.name == *name)?.clone()));
    chosen.filter_map(row).collect()
}

/// Has `run` compute every row of a family; kernel, row and error of the first that is off by more than its bound.
pub fn check(family: Family, purpose: Purpose, mut run: impl FnMut(&Row) -> Result<Tensor>) -> Result<Option<String>> {
    for row in rows(family, purpose) {
        let actual = run(&row)?;
        let (expected, bound) = row.expected(family);
        if let Some(what) = difference(&actual, &expected, &bound) {
            return Ok(Some(format!("{}, {}: {what}", row.part.name(), row.case.name)));
        }
    }
    Ok(None)
}

/// The first element that is off by more than its bound, or is no number.
fn difference(actual: &Tensor, expected: &Tensor<f64>, bound: &Tensor<f64>) -> Option<String> {
    if actual.shape != expected.shape {
        return Some(format!("shape {:?} instead of {:?}", actual.shape, expected.shape));
    }
    // A NaN is not within any bound.
    let within = |i: &usize| (f64::from(actual.data[*i]) - expected.data[*i]).abs() <= bound.data[*i];
    let i = (0..actual.len()).find(|i| !within(i))?;
    let (a, b, bound) = (actual.data[i], expected.data[i], bound.data[i]);
    Some(format!("element {i} is {a:e} instead of {b:e}, off by more than {bound:e}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_is_in_the_case_table() {
        let (cpu, portable) = (Family::Cpu { lanes: 8 }, Family::Portable);
        assert_eq!(rows(cpu, Purpose::Inference).len(), 6);
        assert_eq!(rows(cpu, Purpose::Training).len(), 8);
        assert_eq!(rows(portable, Purpose::Inference).len(), 3);
    }

    #[test]
    fn what_rounds_right_passes_and_one_wrong_element_does_not() {
        let cpu = Family::Cpu { lanes: 16 };
        for purpose in [Purpose::Inference, Purpose::Training] {
            let right = |row: &Row| Ok(row.expected(cpu).0.to_f32());
            assert_eq!(check(cpu, purpose, right).unwrap(), None);
            for (i, wrong_row) in rows(cpu, purpose).iter().enumerate() {
                let (_, bound) = wrong_row.expected(cpu);
                let last = bound.len() - 1;
                for wrong in [4.0 * bound.data[last] + 1e-4, f64::NAN, f64::INFINITY] {
                    let mut seen = 0;
                    let run = |row: &Row| {
                        let mut result = right(row)?;
                        if seen == i {
                            result.data[last] += wrong as f32;
                        }
                        seen += 1;
                        Ok(result)
                    };
                    let failure = check(cpu, purpose, run).unwrap().expect("a failure");
                    let start = format!("{}, {}: element {last} ", wrong_row.part.name(), wrong_row.case.name);
                    assert!(failure.starts_with(&start), "{failure}");
                }
            }
        }
    }

    #[test]
    fn a_result_of_another_shape_fails() {
        let run = |_: &Row| Ok(Tensor::zeros([1, 2, 3, 4]));
        let failure = check(Family::Cpu { lanes: 8 }, Purpose::Inference, run).unwrap().expect("a failure");
        assert!(failure.contains("shape [1, 2, 3, 4]"), "{failure}");
    }
}
