//! A whole network in f64, from the layers' references: the oracle of every device plan.

use super::architecture::{Architecture, ConvParameters, Op};
use super::layer::{concat, conv2d, demodulate, kernel_filter, leaky_relu, masked_pool2d, max_pool2d, upsample2d};
use super::tensor::Tensor;

/// The gradients of a loss.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradients {
    /// With respect to the flat parameter vector.
    pub parameters: Vec<f64>,
    /// With respect to the value of each node (after the activation); the first is the network's input.
    pub values: Vec<Tensor<f64>>,
}

/// The value of every node, the last one the output (N, Cout, H, W).
///
/// `parameters` is the flat vector of [`Architecture::tensors`]; `input` (N, Cin, H, W), H and W multiples of the alignment.
pub fn forward(architecture: &Architecture, parameters: &[f64], input: &Tensor<f64>) -> Vec<Tensor<f64>> {
    check(architecture, parameters, input);
    let mut values: Vec<Tensor<f64>> = Vec::with_capacity(architecture.nodes().len());
    for node in architecture.nodes() {
        let from = |i: usize| &values[node.inputs[i]];
        let value = match node.op {
            Op::Input { .. } => input.clone(),
            Op::Conv { cin, cout, slope } => {
                let (weight, bias) = conv_parameters(&node.parameters, parameters, cin, cout);
                let linear = conv2d::reference(from(0), &weight, bias);
                match slope {
                    Some(slope) => leaky_relu::reference(&linear, f64::from(slope)),
                    None => linear,
                }
            }
            Op::MaxPool => max_pool2d::reference(from(0)),
            Op::Upsample => upsample2d::reference(from(0)),
            Op::Concat => concat::reference(from(0), from(1)),
            Op::Demodulate => demodulate::reference(from(0)),
            Op::MaskedPool => masked_pool2d::reference(from(0)),
            Op::KernelFilter => kernel_filter::reference(from(0), from(1), node.inputs.get(2).map(|&i| &values[i])),
            Op::Modulate => demodulate::modulate_reference(from(0), from(1)),
        };
        values.push(value);
    }
    values
}

/// All gradients, from the `values` of [`forward`] and the gradient of a loss with respect to the output.
pub fn backward(
    architecture: &Architecture,
    parameters: &[f64],
    values: &[Tensor<f64>],
    output_gradient: &Tensor<f64>,
) -> Gradients {
    let exact = |t: &Tensor<f64>| t.clone();
    backward_with(architecture, parameters, values, output_gradient, &exact)
}

/// [`backward`] with what `operand` makes of the values and weights that convolutions multiply.
pub fn backward_with(
    architecture: &Architecture,
    parameters: &[f64],
    values: &[Tensor<f64>],
    output_gradient: &Tensor<f64>,
    operand: &dyn Fn(&Tensor<f64>) -> Tensor<f64>,
) -> Gradients {
    let nodes = architecture.nodes();
    let mut gradient = Gradients {
        parameters: vec![0.0; parameters.len()],
        values: values.iter().map(|value| Tensor::zeros(value.shape)).collect(),
    };
    add(&mut gradient.values[nodes.len() - 1], output_gradient);
    for (id, node) in nodes.iter().enumerate().rev() {
        let dy = gradient.values[id].clone();
        let to_inputs = match node.op {
            Op::Input { .. } => vec![],
            Op::Conv { cin, cout, slope } => {
                let dy = match slope {
                    Some(slope) => leaky_relu::reference_backward(&values[id], &dy, f64::from(slope)),
                    None => dy,
                };
                let (weight, _) = conv_parameters(&node.parameters, parameters, cin, cout);
                let all = conv2d::reference_backward(&operand(&values[node.inputs[0]]), &operand(&weight), &dy);
                if let Some(ConvParameters { weight, bias }) = &node.parameters {
                    gradient.parameters[weight.clone()].copy_from_slice(&all.weight.data);
                    gradient.parameters[bias.clone()].copy_from_slice(&all.bias);
                }
                vec![all.input]
            }
            Op::MaxPool => vec![max_pool2d::reference_backward(&values[node.inputs[0]], &dy)],
            Op::Upsample => vec![upsample2d::reference_backward(&dy)],
            Op::Concat => {
                let (first, second) = concat::reference_backward(&dy, nodes[node.inputs[0]].channels);
                vec![first, second]
            }
            // Nothing before the noisy pixels has parameters.
            Op::Demodulate | Op::MaskedPool => vec![],
            Op::KernelFilter => {
                let coarse = node.inputs.get(2).map(|&i| &values[i]);
                let [logits, fine] = [0, 1].map(|i| &values[node.inputs[i]]);
                let all = kernel_filter::reference_backward(logits, fine, coarse, &dy);
                std::iter::once(all.logits).chain(all.coarse).collect()
            }
            Op::Modulate => {
                let [x, input] = [0, 1].map(|i| &values[node.inputs[i]]);
                vec![demodulate::modulate_reference_backward(x, input, &dy)]
            }
        };
        for (input, part) in node.differentiated().into_iter().zip(&to_inputs) {
            add(&mut gradient.values[input], part);
        }
    }
    gradient
}

/// A convolution's weights and bias out of the flat vector.
fn conv_parameters<'a>(
    place: &Option<ConvParameters>,
    parameters: &'a [f64],
    cin: usize,
    cout: usize,
) -> (Tensor<f64>, &'a [f64]) {
    let ConvParameters { weight, bias } = place.as_ref().expect("a convolution has parameters");
    (Tensor::new([cout, cin, 3, 3], parameters[weight.clone()].to_vec()), &parameters[bias.clone()])
}

fn add(sum: &mut Tensor<f64>, part: &Tensor<f64>) {
    assert_eq!(sum.shape, part.shape);
    sum.data.iter_mut().zip(&part.data).for_each(|(s, p)| *s += p);
}

fn check(architecture: &Architecture, parameters: &[f64], input: &Tensor<f64>) {
    let [_, channels, height, width] = input.shape;
    let alignment = architecture.alignment();
    assert_eq!(channels, architecture.input_channels(), "channels of the input");
    assert_eq!((height % alignment, width % alignment), (0, 0), "{height}x{width} is no multiple of {alignment}");
    assert_eq!(parameters.len(), architecture.parameter_count(), "parameters");
}
