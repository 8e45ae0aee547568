//! The case table: the shapes on which every kernel of every layer is tested and timed.

use super::{Kind, concat, conv2d, leaky_relu, max_pool2d, upsample2d};
use crate::net::tensor::{Tensor, hash, seed_of};

/// What fills the tensors of a case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pattern {
    /// Uniform in [-1, 1).
    Random,
    /// Integers -3 to 3: sums are exact in f32 in any order, pooling windows have ties, activations meet zero.
    Integers,
    /// One 1 in each image of the input and of the output gradient, all else 0; random weights, no bias.
    OneHotInput,
    /// One 1 in the weights of each output channel, all else 0; random input, no bias.
    OneHotWeight,
}

/// One row of the table.
#[derive(Clone, Debug, PartialEq)]
pub struct Case {
    /// Unique, made of the numbers below; the seed of the row's data.
    pub name: String,
    /// The layer.
    pub kind: Kind,
    /// Images.
    pub batch: usize,
    /// Channels of the input (of the first input, for concat).
    pub cin: usize,
    /// Channels of the output.
    pub cout: usize,
    /// Height of the input.
    pub height: usize,
    /// Width of the input.
    pub width: usize,
    /// The slope of leaky ReLU; 1 for every other layer.
    pub slope: f32,
    /// What fills the tensors.
    pub pattern: Pattern,
}

/// The tensors of a case.
#[derive(Clone, Debug, PartialEq)]
pub struct Data {
    /// One input, two for concat.
    pub inputs: Vec<Tensor<f32>>,
    /// The weights of a convolution, (Cout, Cin, 3, 3); empty otherwise.
    pub weight: Tensor<f32>,
    /// The bias of a convolution, (Cout); empty otherwise.
    pub bias: Vec<f32>,
    /// The gradient of a loss with respect to the output.
    pub output_gradient: Tensor<f32>,
}

/// The gradients of a case.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradients {
    /// With respect to each input.
    pub inputs: Vec<Tensor<f64>>,
    /// With respect to the weights; empty without weights.
    pub weight: Tensor<f64>,
    /// With respect to the bias; empty without weights.
    pub bias: Vec<f64>,
}

/// How far an f32 kernel may be from the reference, element by element.
#[derive(Clone, Debug, PartialEq)]
pub struct Bounds {
    /// On the output.
    pub output: Tensor<f64>,
    /// On the gradients.
    pub gradients: Gradients,
}

/// The shape of no tensor.
const NONE: [usize; 4] = [0; 4];

impl Case {
    fn new(kind: Kind, pattern: Pattern, slope: f32, [batch, cin, cout, height, width]: [usize; 5]) -> Self {
        let suffix = match pattern {
            Pattern::Random => "",
            Pattern::Integers => "_integers",
            Pattern::OneHotInput => "_one_hot_input",
            Pattern::OneHotWeight => "_one_hot_weight",
        };
        let slope_text = if kind == Kind::LeakyRelu { format!("_slope{slope}") } else { String::new() };
        let name = format!("{}_n{batch}_c{cin}-{cout}_h{height}_w{width}{slope_text}{suffix}", kind.name());
        Self { name, kind, batch, cin, cout, height, width, slope, pattern }
    }

    /// The shapes of the inputs, NCHW.
    pub fn input_shapes(&self) -> Vec<[usize; 4]> {
        let shape = |channels| [self.batch, channels, self.height, self.width];
        match self.kind {
            Kind::Concat => vec![shape(self.cin), shape(self.cout - self.cin)],
            Kind::Conv2d | Kind::LeakyRelu | Kind::MaxPool2d | Kind::Upsample2d => vec![shape(self.cin)],
        }
    }

    /// The shape of the weights, OIHW; zeros where the layer has none.
    pub fn weight_shape(&self) -> [usize; 4] {
        match self.kind {
            Kind::Conv2d => [self.cout, self.cin, 3, 3],
            Kind::LeakyRelu | Kind::MaxPool2d | Kind::Upsample2d | Kind::Concat => NONE,
        }
    }

    /// The shape of the output, NCHW.
    pub fn output_shape(&self) -> [usize; 4] {
        let inputs = self.input_shapes();
        match self.kind {
            Kind::Conv2d => conv2d::output_shape(inputs[0], self.weight_shape()),
            Kind::LeakyRelu => inputs[0],
            Kind::MaxPool2d => max_pool2d::output_shape(inputs[0]),
            Kind::Upsample2d => upsample2d::output_shape(inputs[0]),
            Kind::Concat => concat::output_shape(inputs[0], inputs[1]),
        }
    }

    /// Multiply-accumulates of one forward pass.
    pub fn macs(&self) -> usize {
        self.weight_shape().iter().product::<usize>() * self.batch * self.height * self.width
    }

    /// The row's tensors: always the same.
    pub fn data(&self) -> Data {
        let tensor = |part: &str, shape: [usize; 4]| {
            let seed = seed_of(&format!("{}/{part}", self.name));
            let one_hot = match part {
                "weight" | "bias" => self.pattern == Pattern::OneHotWeight,
                _ => self.pattern == Pattern::OneHotInput,
            };
            if one_hot {
                one_hot_tensor(shape, seed)
            } else if self.pattern == Pattern::Integers {
                let values = (0..shape.iter().product::<usize>() as u64).map(|i| (hash(seed, i) >> 40) % 7);
                Tensor::new(shape, values.map(|v| v as f32 - 3.0).collect())
            } else {
                Tensor::uniform(shape, seed)
            }
        };
        let inputs = self.input_shapes().into_iter().enumerate();
        let bias_count = self.weight_shape()[0];
        let has_bias = matches!(self.pattern, Pattern::Random | Pattern::Integers);
        let bias = if has_bias { tensor("bias", [1, 1, 1, bias_count]).data } else { vec![0.0; bias_count] };
        Data {
            inputs: inputs.map(|(i, shape)| tensor(&format!("input{i}"), shape)).collect(),
            weight: tensor("weight", self.weight_shape()),
            bias,
            output_gradient: tensor("output_gradient", self.output_shape()),
        }
    }

    /// The output, by the layer's definition.
    pub fn reference(&self, data: &Data) -> Tensor<f64> {
        let inputs: Vec<_> = data.inputs.iter().map(Tensor::to_f64).collect();
        match self.kind {
            Kind::Conv2d => conv2d::reference(&inputs[0], &data.weight.to_f64(), &to_f64(&data.bias)),
            Kind::LeakyRelu => leaky_relu::reference(&inputs[0], f64::from(self.slope)),
            Kind::MaxPool2d => max_pool2d::reference(&inputs[0]),
            Kind::Upsample2d => upsample2d::reference(&inputs[0]),
            Kind::Concat => concat::reference(&inputs[0], &inputs[1]),
        }
    }

    /// The gradients, by the layer's definition.
    pub fn reference_backward(&self, data: &Data) -> Gradients {
        let inputs: Vec<_> = data.inputs.iter().map(Tensor::to_f64).collect();
        let dy = data.output_gradient.to_f64();
        let inputs = match self.kind {
            Kind::Conv2d => {
                let all = conv2d::reference_backward(&inputs[0], &data.weight.to_f64(), &dy);
                return all.into();
            }
            Kind::LeakyRelu => {
                let slope = f64::from(self.slope);
                vec![leaky_relu::reference_backward(&leaky_relu::reference(&inputs[0], slope), &dy, slope)]
            }
            Kind::MaxPool2d => vec![max_pool2d::reference_backward(&inputs[0], &dy)],
            Kind::Upsample2d => vec![upsample2d::reference_backward(&dy)],
            Kind::Concat => <[_; 2]>::from(concat::reference_backward(&dy, self.cin)).into(),
        };
        Gradients { inputs, weight: Tensor::zeros(NONE), bias: Vec::new() }
    }

    /// How far a kernel that computes in f32 may be from the references; zero where its arithmetic is exact.
    pub fn bounds(&self, data: &Data) -> Bounds {
        let output = self.reference(data);
        let gradients = self.reference_backward(data);
        let exact = Bounds {
            output: Tensor::zeros(output.shape),
            gradients: Gradients {
                inputs: gradients.inputs.iter().map(|g| Tensor::zeros(g.shape)).collect(),
                weight: Tensor::zeros(gradients.weight.shape),
                bias: vec![0.0; gradients.bias.len()],
            },
        };
        match self.kind {
            Kind::Conv2d => self.conv2d_bounds(data, exact),
            Kind::MaxPool2d | Kind::Concat => exact,
            // One product, rounded once.
            Kind::LeakyRelu => {
                let rounding = |v: f64| conv2d::rounding_bound(1, v.abs());
                let inputs = gradients.inputs.iter().map(|g| g.map(rounding)).collect();
                Bounds { output: output.map(rounding), gradients: Gradients { inputs, ..exact.gradients } }
            }
            // A sum of four.
            Kind::Upsample2d => {
                let sum = upsample2d::reference_backward(&data.output_gradient.to_f64().map(f64::abs));
                let inputs = vec![sum.map(|v| conv2d::rounding_bound(4, v))];
                Bounds { gradients: Gradients { inputs, ..exact.gradients }, ..exact }
            }
        }
    }

    fn conv2d_bounds(&self, data: &Data, exact: Bounds) -> Bounds {
        let (input, weight, dy) = (data.inputs[0].to_f64(), data.weight.to_f64(), data.output_gradient.to_f64());
        let forward = || conv2d::forward_bound(&input, &weight, &to_f64(&data.bias));
        let backward = || conv2d::backward_bounds(&input, &weight, &dy).into();
        match self.pattern {
            Pattern::Random => Bounds { output: forward(), gradients: backward() },
            Pattern::Integers | Pattern::OneHotInput => exact,
            Pattern::OneHotWeight => Bounds { gradients: backward(), ..exact },
        }
    }
}

impl From<conv2d::Gradients> for Gradients {
    fn from(all: conv2d::Gradients) -> Self {
        Self { inputs: vec![all.input], weight: all.weight, bias: all.bias }
    }
}

fn to_f64(values: &[f32]) -> Vec<f64> {
    values.iter().copied().map(f64::from).collect()
}

/// A 1 at `hash(seed, n) % (C * H * W)` of each image `n`, 0 elsewhere.
fn one_hot_tensor(shape: [usize; 4], seed: u64) -> Tensor<f32> {
    let mut tensor = Tensor::zeros(shape);
    let image = shape[1] * shape[2] * shape[3];
    for n in 0..shape[0] {
        tensor.data[n * image + (hash(seed, n as u64) % image as u64) as usize] = 1.0;
    }
    tensor
}

/// The table. Sizes 1, odd, prime and above any workgroup; channels 1 to 202; one image and three.
pub fn cases() -> Vec<Case> {
    Kind::ALL.iter().flat_map(|&kind| rows(kind)).collect()
}

/// The rows of one layer.
fn rows(kind: Kind) -> Vec<Case> {
    use Pattern::{Integers, OneHotInput, OneHotWeight, Random};
    let same = |slope: f32, rows: &[(Pattern, [usize; 4])]| -> Vec<Case> {
        rows.iter().map(|&(pattern, [n, c, h, w])| Case::new(kind, pattern, slope, [n, c, c, h, w])).collect()
    };
    let free = |rows: &[(Pattern, [usize; 5])]| -> Vec<Case> {
        rows.iter().map(|&(pattern, shape)| Case::new(kind, pattern, 1.0, shape)).collect()
    };
    match kind {
        Kind::Conv2d => free(&[
            (Random, [1, 1, 1, 1, 1]),
            (Random, [1, 1, 1, 3, 5]),
            (Random, [1, 3, 101, 5, 1]),
            (Random, [1, 101, 3, 1, 64]),
            (Random, [3, 43, 3, 31, 2]),
            (Random, [3, 6, 32, 13, 11]),
            (Random, [1, 6, 32, 37, 70]),
            (Random, [1, 64, 3, 37, 70]),
            (Random, [3, 32, 43, 17, 35]),
            (Random, [1, 43, 57, 9, 8]),
            (Random, [1, 101, 101, 4, 4]),
            (Random, [1, 202, 76, 4, 6]),
            (Random, [1, 64, 128, 16, 16]),
            (Random, [1, 3, 6, 128, 130]),
            (Integers, [3, 57, 43, 19, 23]),
            (Integers, [1, 6, 32, 37, 70]),
            (Integers, [1, 101, 3, 2, 3]),
            (OneHotInput, [3, 6, 5, 9, 13]),
            (OneHotInput, [1, 32, 32, 33, 65]),
            (OneHotInput, [3, 1, 3, 3, 3]),
            (OneHotWeight, [1, 6, 101, 11, 17]),
            (OneHotWeight, [3, 43, 43, 5, 7]),
        ]),
        Kind::LeakyRelu => {
            let mut all = same(
                0.1,
                &[
                    (Random, [1, 1, 1, 1]),
                    (Random, [1, 3, 5, 7]),
                    (Random, [3, 6, 13, 11]),
                    (Random, [1, 43, 37, 70]),
                    (Random, [3, 57, 8, 9]),
                    (Random, [1, 101, 4, 4]),
                    (Integers, [1, 6, 37, 70]),
                    (Integers, [3, 3, 1, 31]),
                ],
            );
            all.extend(same(0.0, &[(Integers, [1, 6, 17, 19]), (Random, [3, 43, 5, 1])]));
            all.extend(same(0.25, &[(Random, [1, 1, 128, 130])]));
            all
        }
        Kind::MaxPool2d => same(
            1.0,
            &[
                (Random, [1, 1, 2, 2]),
                (Random, [1, 3, 3, 3]),
                (Random, [1, 6, 2, 71]),
                (Random, [3, 6, 13, 11]),
                (Random, [1, 43, 37, 70]),
                (Random, [3, 57, 8, 9]),
                (Random, [1, 101, 4, 4]),
                (Random, [1, 1, 128, 130]),
                (Integers, [1, 3, 37, 70]),
                (Integers, [3, 6, 17, 19]),
                (OneHotInput, [3, 6, 5, 6]),
            ],
        ),
        Kind::Upsample2d => same(
            1.0,
            &[
                (Random, [1, 1, 1, 1]),
                (Random, [1, 3, 3, 5]),
                (Random, [3, 3, 2, 4]),
                (Random, [1, 6, 1, 71]),
                (Random, [3, 6, 13, 11]),
                (Random, [1, 43, 37, 70]),
                (Random, [3, 57, 8, 9]),
                (Random, [1, 101, 4, 4]),
                (Integers, [1, 3, 37, 35]),
                (OneHotInput, [3, 6, 5, 6]),
            ],
        ),
        Kind::Concat => free(&[
            (Random, [1, 1, 2, 1, 1]),
            (Random, [1, 3, 9, 3, 5]),
            (Random, [1, 6, 7, 1, 71]),
            (Random, [3, 6, 49, 13, 11]),
            (Random, [3, 43, 49, 5, 7]),
            (Random, [1, 43, 86, 37, 70]),
            (Random, [3, 57, 114, 8, 9]),
            (Random, [1, 101, 202, 4, 4]),
            (Integers, [1, 1, 44, 37, 35]),
            (OneHotInput, [3, 6, 12, 5, 6]),
        ]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn every_layer_has_eight_rows_or_more_with_unique_names() {
        let all = cases();
        for &kind in Kind::ALL {
            assert!(all.iter().filter(|case| case.kind == kind).count() >= 8, "{}", kind.name());
        }
        let names: HashSet<_> = all.iter().map(|case| &case.name).collect();
        assert_eq!(names.len(), all.len());
    }

    #[test]
    fn every_layer_meets_one_pixel_odd_and_large_sizes_and_both_batches() {
        for &kind in Kind::ALL {
            let rows = rows(kind);
            let any =
                |what: &str, test: &dyn Fn(&Case) -> bool| assert!(rows.iter().any(test), "{}: {what}", kind.name());
            any("smallest", &|c| {
                c.output_shape()[2..] == [1, 1] || kind == Kind::Upsample2d && c.height * c.width == 1
            });
            any("odd", &|c| c.height % 2 == 1 && c.width % 2 == 1 && c.height > 1);
            any("above a workgroup", &|c| c.height * c.width > 1024);
            any("batch", &|c| c.batch == 3);
            any("few channels", &|c| c.cin == 3);
            any("many channels", &|c| c.cin == 101);
        }
    }

    #[test]
    fn data_fits_the_shapes_and_repeats() {
        for case in cases() {
            let data = case.data();
            assert_eq!(data, case.data());
            assert_eq!(data.inputs.iter().map(|t| t.shape).collect::<Vec<_>>(), case.input_shapes());
            assert_eq!(data.output_gradient.shape, case.output_shape());
            assert_eq!(data.bias.len(), case.weight_shape()[0]);
        }
    }

    #[test]
    fn one_hot_rows_have_one_hot_tensors() {
        for case in cases() {
            let (data, ones) = (case.data(), |t: &Tensor<f32>| t.data.iter().filter(|&&v| v != 0.0).count());
            match case.pattern {
                Pattern::OneHotInput => assert_eq!(ones(&data.inputs[0]), case.batch),
                Pattern::OneHotWeight => assert_eq!(ones(&data.weight), case.cout),
                Pattern::Random | Pattern::Integers => {}
            }
        }
    }
}
