#!/usr/bin/env python3
"""Writes the goldens of tests/net_reference.rs: what PyTorch computes in float64.

    pip install torch numpy safetensors && python tests/golden/make_goldens.py

All inputs come from one integer hash that limpid has too (src/net/tensor.rs), so that only results are stored; the
inputs of the layers are stored as well and show that both sides draw the same numbers.
"""

import math
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from safetensors.numpy import save_file

HERE = Path(__file__).parent
GAMMA = np.uint64(0x9E3779B97F4A7C15)
torch.set_default_dtype(torch.float64)


def mix(z):
    """The finalizer of splitmix64, on uint64 (arrays)."""
    with np.errstate(over="ignore"):
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return z ^ (z >> np.uint64(31))


def hashes(seed, count):
    with np.errstate(over="ignore"):
        counters = np.arange(1, count + 1, dtype=np.uint64) * GAMMA
        return mix(mix(np.uint64(seed)) + counters)


def seed_of(name):
    """64-bit FNV-1a."""
    h = 0xCBF29CE484222325
    for byte in name.encode():
        h = ((h ^ byte) * 0x100000001B3) & 0xFFFFFFFFFFFFFFFF
    return h


def uniform(shape, name):
    """Uniform in [-1, 1), exact in float32."""
    u = (hashes(seed_of(name), math.prod(shape)) >> np.uint64(40)).astype(np.float64) / 2**24
    return (2 * u - 1).reshape(shape)


def integers(shape, name):
    """Integers from -3 to 3."""
    h = hashes(seed_of(name), math.prod(shape)) >> np.uint64(40)
    return (h % np.uint64(7)).astype(np.float64).reshape(shape) - 3


# --- layers: rows of the case table (src/net/layer/case.rs), each (layer, integers?, batch, cin, cout, h, w, slope)

ROWS = [
    ("conv2d", False, 1, 1, 1, 1, 1, None),
    ("conv2d", False, 1, 1, 1, 3, 5, None),
    ("conv2d", False, 1, 3, 101, 5, 1, None),
    ("conv2d", False, 1, 101, 3, 1, 64, None),
    ("conv2d", False, 3, 6, 32, 13, 11, None),
    ("conv2d", True, 1, 101, 3, 2, 3, None),
    ("leaky_relu", False, 1, 3, 3, 5, 7, 0.1),
    ("leaky_relu", True, 3, 3, 3, 1, 31, 0.1),
    ("leaky_relu", True, 1, 6, 6, 17, 19, 0.0),
    ("max_pool2d", False, 1, 3, 3, 3, 3, None),
    ("max_pool2d", False, 1, 6, 6, 2, 71, None),
    ("max_pool2d", True, 3, 6, 6, 17, 19, None),
    ("upsample2d", False, 1, 1, 1, 1, 1, None),
    ("upsample2d", False, 1, 3, 3, 3, 5, None),
    ("upsample2d", False, 3, 3, 3, 2, 4, None),
    ("concat", False, 1, 3, 9, 3, 5, None),
    ("concat", False, 1, 6, 7, 1, 71, None),
    ("concat", False, 3, 43, 49, 5, 7, None),
]


def layer_golden(out, layer, whole, batch, cin, cout, h, w, slope):
    name = f"{layer}_n{batch}_c{cin}-{cout}_h{h}_w{w}"
    # limpid's slope is a float32, 0.1 printed short.
    name += f"_slope{slope:g}" if slope is not None else ""
    name += "_integers" if whole else ""
    draw = lambda part, shape: torch.tensor((integers if whole else uniform)(shape, f"{name}/{part}"), requires_grad=True)
    leaves = {"input0": draw("input0", (batch, cin, h, w))}
    x = leaves["input0"]
    if layer == "conv2d":
        leaves["weight"] = draw("weight", (cout, cin, 3, 3))
        leaves["bias"] = draw("bias", (cout,))
        y = F.conv2d(x, leaves["weight"], leaves["bias"], padding=1)
    elif layer == "leaky_relu":
        y = F.leaky_relu(x, float(np.float32(slope)))
    elif layer == "max_pool2d":
        y = F.max_pool2d(x, 2)
    elif layer == "upsample2d":
        y = F.interpolate(x, scale_factor=2, mode="nearest")
    elif layer == "concat":
        leaves["input1"] = draw("input1", (batch, cout - cin, h, w))
        y = torch.cat([x, leaves["input1"]], 1)
    dy = draw("output_gradient", tuple(y.shape)).detach()
    y.backward(dy)
    for part, value in leaves.items():
        out[f"{name}/{part}"] = value.detach().numpy().astype(np.float32)
        out[f"{name}/{part}.gradient"] = value.grad.numpy()
    out[f"{name}/output_gradient"] = dy.numpy().astype(np.float32)
    out[f"{name}/output"] = y.detach().numpy()


# --- networks


def parameter(name, shape):
    """Weights uniform within Glorot's limit, biases within 0.1; rounded to float32."""
    limit = math.sqrt(6 / (9 * (shape[0] + shape[1]))) if len(shape) == 4 else 0.1
    return torch.tensor((limit * uniform(shape, f"golden/{name}")).astype(np.float32).astype(np.float64), requires_grad=True)


class Net:
    """Convolutions by name, created as they are first used."""

    def __init__(self):
        self.parameters = {}

    def conv(self, name, x, cout, slope=0.1):
        if f"{name}.weight" not in self.parameters:
            self.parameters[f"{name}.weight"] = parameter(f"{name}.weight", (cout, x.shape[1], 3, 3))
            self.parameters[f"{name}.bias"] = parameter(f"{name}.bias", (cout,))
        y = F.conv2d(x, self.parameters[f"{name}.weight"], self.parameters[f"{name}.bias"], padding=1)
        return y if slope is None else F.leaky_relu(y, float(np.float32(slope)))


def up_cat(x, skip):
    return torch.cat([F.interpolate(x, scale_factor=2, mode="nearest"), skip], 1)


def seed(net, x):
    skip1 = net.conv("enc_conv1b", net.conv("enc_conv1a", x, 32), 32)
    skip2 = net.conv("enc_conv2", F.max_pool2d(skip1, 2), 43)
    skip3 = net.conv("enc_conv3", F.max_pool2d(skip2, 2), 57)
    skip4 = net.conv("enc_conv4", F.max_pool2d(skip3, 2), 76)
    skip5 = net.conv("enc_conv5", F.max_pool2d(skip4, 2), 101)
    y = net.conv("bottleneck", F.max_pool2d(skip5, 2), 101)
    for level, skip, cout in [(5, skip5, 76), (4, skip4, 57), (3, skip3, 43), (2, skip2, 32)]:
        y = net.conv(f"dec_conv{level}b", net.conv(f"dec_conv{level}a", up_cat(y, skip), cout), cout)
    y = net.conv("dec_conv1b", net.conv("dec_conv1a", up_cat(y, skip1), 128), 64)
    return net.conv("out_conv", y, 3, slope=None)


def trunk(net, x):
    """Widths of tests/common/networks.rs, `small_base`: the features of the five levels, the coarsest first."""
    conv = lambda name, x, cout: net.conv(name, x, cout, slope=0.0)
    pool = lambda x: F.max_pool2d(x, 2)
    pool1 = pool(conv("enc_conv1", conv("enc_conv0", x, 16), 16))
    pool2 = pool(conv("enc_conv2", pool1, 32))
    pool3 = pool(conv("enc_conv3", pool2, 16))
    pool4 = pool(conv("enc_conv4", pool3, 32))
    features = [conv("enc_conv5b", conv("enc_conv5a", pool4, 48), 48)]
    for level, skip, widths in [(4, pool3, (48, 48)), (3, pool2, (32, 32)), (2, pool1, (16, 48)), (1, x, (48, 16))]:
        a = conv(f"dec_conv{level}a", up_cat(features[-1], skip), widths[0])
        features.append(conv(f"dec_conv{level}b", a, widths[1]))
    return features


def base(net, x):
    return net.conv("dec_conv0", trunk(net, x)[-1], 3, slope=None)


PU = dict(slope=1.41283765e03, scale=1.64593172, power=4.31384981e-01, offset=-2.94139609e-03, log=1.92653254e-01,
          shift=6.26026094e-03, log_offset=9.98620152e-01, ends=(1.57945760e-06, 3.22087631e-02),
          ends_t=(2.23151711e-03, 3.70974749e-01), largest=3.13511904)


def pu(x):
    power = PU["scale"] * x.clamp_min(1e-9) ** PU["power"] + PU["offset"]
    logarithm = PU["log"] * torch.log(x + PU["shift"]) + PU["log_offset"]
    t = torch.where(x <= PU["ends"][1], power, logarithm)
    return torch.where(x <= PU["ends"][0], PU["slope"] * x, t) / PU["largest"]


def pu_inverse(t):
    t = t * PU["largest"]
    power = ((t - PU["offset"]) / PU["scale"]) ** (1 / PU["power"])
    logarithm = torch.exp((t - PU["log_offset"]) / PU["log"]) - PU["shift"]
    x = torch.where(t <= PU["ends_t"][1], power, logarithm)
    return torch.where(t <= PU["ends_t"][0], t / PU["slope"], x)


def patches(x, side):
    """(n, c, h, w) as (n, c, side * side, h, w): what lies about each pixel, zeros beyond the edge."""
    n, c, h, w = x.shape
    return F.unfold(x, side, padding=side // 2).reshape(n, c, side * side, h, w)


def spline(h, w):
    """Quadratic B-spline of the distances of 3x3 coarser pixels, (9, h, w)."""
    def along(size):
        x = torch.arange(size, dtype=torch.float64)
        steps = torch.arange(-1, 2, dtype=torch.float64)[:, None]
        d = (steps + 0.5 - (x % 2 + 0.5) / 2).abs()
        return torch.where(d < 0.5, 0.75 - d**2, 0.5 * (1.5 - d) ** 2)

    return torch.einsum("ih,jw->ijhw", along(h), along(w)).reshape(9, h, w)


def kpn(net, x):
    """Filters of 5x5 noisy pixels and 3x3 coarser ones, weights the softmax over those inside the picture times a spline of the
    coarser ones' distance; what is all zero lies past its end. Nothing before the noisy pixels is differentiated."""
    features = trunk(net, x)
    x = x.detach()
    inside = (x != 0).any(1, keepdim=True).to(x.dtype)
    texture = torch.where((x[:, 3:6] == 0).all(1, keepdim=True), 1.0, x[:, 3:6] + 0.05)
    levels = [(pu_inverse(x[:, :3]) / texture * inside, inside)]
    for _ in range(4):
        color, mask = levels[-1]
        count = F.avg_pool2d(mask, 2) * 4
        levels.append((F.avg_pool2d(color, 2) * 4 / count.clamp_min(1), count.clamp_max(1)))
    out = None
    for level, feature in zip((4, 3, 2, 1, 0), features):
        color, mask = levels[level]
        taps, masks = patches(color, 5), patches(mask, 5)
        if out is not None:
            up = lambda t: t.repeat_interleave(2, -1).repeat_interleave(2, -2)
            taps = torch.cat([taps, up(patches(out[0], 3))], 2)
            masks = torch.cat([masks, up(patches(out[1], 3))], 2)
        logits = net.conv(f"kernel_conv{level}", feature, taps.shape[2], slope=None)[:, None]
        if out is not None:
            logits = torch.cat([logits[:, :, :25], logits[:, :, 25:] + spline(*color.shape[2:]).log()], 2)
        weights = torch.softmax(logits.masked_fill(masks == 0, -1e30), 2) * masks
        out = (weights * taps).sum(2), (masks.sum(2) > 0).to(x.dtype)
    return pu(out[0] * texture)


def tiny(net, x):
    skip = net.conv("enc", x, 3)
    middle = net.conv("middle", F.max_pool2d(skip, 2), 4)
    return net.conv("out", up_cat(middle, skip), 2, slope=None)


def network_golden(out, name, build, batch, channels, h, w):
    """Output, loss, gradients: norms of all, the biases' whole, the weights' first and last 32."""
    net = Net()
    case = f"{name}_n{batch}_h{h}_w{w}"
    drawn = uniform((batch, channels, h, w), f"{case}/input")
    if name == "kpn":
        # Albedo is not negative, and a part lies past the picture's end.
        drawn = np.abs(drawn)
        drawn[:, :, h - 5 :], drawn[:, :, :, w - 3 :] = 0, 0
    x = torch.tensor(drawn, requires_grad=True)
    y = build(net, x)
    loss = F.l1_loss(y, torch.tensor(uniform(tuple(y.shape), f"{case}/target")))
    loss.backward()
    out[f"{case}/output"] = y.detach().numpy()
    out[f"{case}/loss"] = np.array([loss.item()])
    gradients = {key: value.grad.numpy() for key, value in net.parameters.items()} | {"input": x.grad.numpy()}
    for key, gradient in gradients.items():
        out[f"{case}/{key}.norm"] = np.array([np.linalg.norm(gradient)])
        flat = gradient.ravel()
        out[f"{case}/{key}.ends"] = flat if len(flat) <= 128 else np.concatenate([flat[:32], flat[-32:]])


def adam_golden(out, steps=3):
    """The tiny network and its losses over three steps of torch.optim.Adam, a new input for each."""
    net = Net()
    tiny(net, torch.zeros(1, 2, 4, 4))
    optimiser = torch.optim.Adam(net.parameters.values(), lr=1e-3, betas=(0.9, 0.99), eps=1e-7)
    losses = []
    for step in range(steps):
        optimiser.zero_grad()
        y = tiny(net, torch.tensor(uniform((2, 2, 6, 4), f"adam/{step}/input")))
        loss = F.l1_loss(y, torch.tensor(uniform((2, 2, 6, 4), f"adam/{step}/target")))
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
        flat = [value.detach().numpy().ravel() for value in net.parameters.values()]
        out[f"adam/{step}/parameters"] = np.concatenate(flat)
    out["adam/losses"] = np.array(losses)


def main():
    about = {"made_by": f"tests/golden/make_goldens.py with PyTorch {torch.__version__}, float64"}
    layers, networks = {}, {}
    for row in ROWS:
        layer_golden(layers, *row)
    network_golden(networks, "seed", seed, 1, 6, 32, 32)
    network_golden(networks, "seed", seed, 2, 6, 64, 32)
    network_golden(networks, "base", base, 1, 9, 32, 32)
    network_golden(networks, "base", base, 2, 9, 48, 16)
    network_golden(networks, "kpn", kpn, 1, 9, 32, 32)
    network_golden(networks, "kpn", kpn, 2, 9, 48, 16)
    network_golden(networks, "tiny", tiny, 3, 2, 6, 4)
    adam_golden(networks)
    for stem, tensors in [("layers", layers), ("networks", networks)]:
        contiguous = {key: np.ascontiguousarray(value) for key, value in tensors.items()}
        save_file(contiguous, HERE / f"{stem}.safetensors", metadata=about)


if __name__ == "__main__":
    main()
