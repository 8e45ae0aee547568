#!/usr/bin/env python3
"""Trains `base` or `kpn` with PyTorch on the pictures of scripts/training_pictures.py, or `seed` on a folder of `limpid dataset` (files of
`limpid render` will do, if they are named alike: NAME.noisy-0.exr, NAME.noisy-1.exr, NAME.target.exr): the peer of
`limpid train`, faster where a driver runs shaders on the CPU. The same networks and Adam. The loss of `base` and `kpn` is limpid's (five scales)
and a little relMSE; that of `seed` is MAE01 and a little of limpid's MAE. The file is one that limpid reads and trains on (`limpid train --init`).

    scripts/pytorch_train.py --pool DIR --architecture kpn --init weights/base.safetensors --minutes 60 --out kpn.safetensors
    scripts/pytorch_train.py --pool DATASET --architecture seed --init weights/seed.safetensors --minutes 60 --out seed.safetensors
"""
import argparse
import glob
import json
import math
import os
import random
import sys
import time

import numpy as np
import torch
import torch.nn.functional as F
from safetensors.torch import load_file, save_file

TRUNK = dict(enc_conv0=(9, 32), enc_conv1=(32, 32), enc_conv2=(32, 48), enc_conv3=(48, 64), enc_conv4=(64, 80), enc_conv5a=(80, 96),
             enc_conv5b=(96, 96), dec_conv4a=(160, 96), dec_conv4b=(96, 96), dec_conv3a=(144, 64), dec_conv3b=(64, 64),
             dec_conv2a=(96, 48), dec_conv2b=(48, 32), dec_conv1a=(41, 32), dec_conv1b=(32, 16))
HEADS = {"base": dict(dec_conv0=(16, 3)),
         "kpn": dict(kernel_conv4=(96, 25), kernel_conv3=(96, 34), kernel_conv2=(64, 34), kernel_conv1=(32, 34), kernel_conv0=(16, 34))}
SEED = dict(enc_conv1a=(6, 32), enc_conv1b=(32, 32), enc_conv2=(32, 43), enc_conv3=(43, 57), enc_conv4=(57, 76), enc_conv5=(76, 101),
            bottleneck=(101, 101), dec_conv5a=(202, 76), dec_conv5b=(76, 76), dec_conv4a=(152, 57), dec_conv4b=(57, 57), dec_conv3a=(114, 43),
            dec_conv3b=(43, 43), dec_conv2a=(86, 32), dec_conv2b=(32, 32), dec_conv1a=(64, 128), dec_conv1b=(128, 64), out_conv=(64, 3))

DEMODULATION = 0.05  # as in src/shared_constants.rs


def pu(x):
    x = x.clamp_min(0)
    power = 1.64593172 * x.clamp_min(1e-9) ** 4.31384981e-01 - 2.94139609e-03
    logarithm = 1.92653254e-01 * torch.log(x + 6.26026094e-03) + 9.98620152e-01
    return torch.where(x <= 1.57945760e-06, 1.41283765e03 * x, torch.where(x <= 3.22087631e-02, power, logarithm)) / 3.13511904


def pu_inverse(t):
    t = t.clamp_min(0) * 3.13511904
    power = ((t + 2.94139609e-03) / 1.64593172).clamp_min(1e-12) ** (1 / 4.31384981e-01)
    logarithm = torch.exp((t.clamp_max(14.0) - 9.98620152e-01) / 1.92653254e-01) - 6.26026094e-03
    return torch.where(t <= 2.23151711e-03, t / 1.41283765e03, torch.where(t <= 3.70974749e-01, power, logarithm))


def up(t):
    return t.repeat_interleave(2, -1).repeat_interleave(2, -2)


class KernelFilter(torch.autograd.Function):
    """As glsl/net/kernel_filter.comp: weights are the softmax of the logits over those taps that lie in the picture, those of the
    coarser level times a spline."""

    @staticmethod
    def spline(height, width, device):
        """Quadratic B-spline of the 3x3 coarser pixels' distances, (1, 9, height, width)."""
        even = torch.tensor([9 / 32, 22 / 32, 1 / 32], device=device)
        along = torch.stack([even, even.flip(0)])  # by the pixel's parity
        both = along[:, None, :, None] * along[None, :, None, :]
        return both.permute(2, 3, 0, 1).reshape(1, 9, 2, 2).repeat(1, 1, height // 2, width // 2)

    @staticmethod
    def taps(height, width, fine, coarse):
        fine = F.pad(fine, (2, 2, 2, 2))
        for j in range(25):
            yield fine[:, :, j // 5 : j // 5 + height, j % 5 : j % 5 + width]
        if coarse is not None:
            coarse = F.pad(coarse, (1, 1, 1, 1))
            for j in range(9):
                yield up(coarse[:, :, j // 3 : j // 3 + height // 2, j % 3 : j % 3 + width // 2])

    @staticmethod
    def forward(ctx, logits, fine, coarse):
        batch, count, height, width = logits.shape
        weights = (logits - logits.amax(1, keepdim=True)).exp_().contiguous()
        ones = [torch.ones_like(t[:1, :1]) if t is not None else None for t in (fine, coarse)]
        for j, inside in enumerate(KernelFilter.taps(height, width, *ones)):
            weights[:, j : j + 1] *= inside
        if coarse is not None:
            weights[:, 25:] *= KernelFilter.spline(height, width, weights.device)
        weights /= weights.sum(1, keepdim=True)
        out = torch.zeros_like(fine)
        for j, tap in enumerate(KernelFilter.taps(height, width, fine, coarse)):
            out.addcmul_(weights[:, j : j + 1], tap)
        ctx.save_for_backward(weights, fine, coarse, out)
        return out

    @staticmethod
    def backward(ctx, gradient):
        weights, fine, coarse, out = ctx.saved_tensors
        batch, count, height, width = weights.shape
        to_logits = torch.empty_like(weights)
        for j, tap in enumerate(KernelFilter.taps(height, width, fine, coarse)):
            to_logits[:, j] = (gradient * tap).sum(1)
        to_logits -= (gradient * out).sum(1, keepdim=True)
        to_logits *= weights
        to_coarse = None
        if coarse is not None:
            to_coarse = F.pad(torch.zeros_like(coarse), (1, 1, 1, 1))
            for j in range(9):
                part = F.avg_pool2d(gradient * weights[:, 25 + j : 26 + j], 2) * 4
                to_coarse[:, :, j // 3 : j // 3 + height // 2, j % 3 : j % 3 + width // 2] += part
            to_coarse = to_coarse[:, :, 1:-1, 1:-1]
        return to_logits, None, to_coarse


def add_convolutions(network, shapes):
    for name, (cin, cout) in shapes.items():
        conv = torch.nn.Conv2d(cin, cout, 3, padding=1)
        torch.nn.init.kaiming_uniform_(conv.weight, nonlinearity="relu")
        torch.nn.init.zeros_(conv.bias)
        if name.startswith("kernel"):
            conv.weight.data *= 0.1  # all weights alike at first
        setattr(network, name, conv)


class Network(torch.nn.Module):
    metadata = dict(inputs="radiance,albedo,normal", transfer="pu")

    def __init__(self, architecture):
        super().__init__()
        self.architecture = architecture
        add_convolutions(self, {**TRUNK, **HEADS[architecture]})

    def forward(self, radiance, albedo, normal):
        """Exposed radiance, albedo, world-space normal to the transfer of the result."""
        x = torch.cat([pu(radiance), albedo, 0.5 * normal + 0.5], 1).contiguous(memory_format=torch.channels_last)
        conv = lambda name, t: F.relu(getattr(self, name)(t))
        pooled = [conv("enc_conv1", conv("enc_conv0", x))]
        for name in ("enc_conv2", "enc_conv3", "enc_conv4"):
            pooled.append(conv(name, F.max_pool2d(pooled[-1], 2)))
        skips = [x] + [F.max_pool2d(t, 2) for t in pooled[:3]]
        features = [conv("enc_conv5b", conv("enc_conv5a", F.max_pool2d(pooled[3], 2)))]
        for level in (4, 3, 2, 1):
            joined = torch.cat([F.interpolate(features[-1], scale_factor=2), skips[level - 1]], 1)
            features.append(conv(f"dec_conv{level}b", conv(f"dec_conv{level}a", joined)))
        if self.architecture == "base":
            return self.dec_conv0(features[-1])
        # What has no albedo, an emitter or the sky, stays as it is.
        texture = torch.where(albedo.amax(1, keepdim=True) > 0, albedo + DEMODULATION, 1.0)
        levels = [radiance / texture]
        for _ in range(4):
            levels.append(F.avg_pool2d(levels[-1], 2))
        out = None
        for level, feature in zip((4, 3, 2, 1, 0), features):
            logits = getattr(self, f"kernel_conv{level}")(feature)
            out = KernelFilter.apply(logits.contiguous(), levels[level], out)
        return pu(out * texture)

    def loss(self, noisy, target, options):
        """Two parts: of pictures reduced, and relMSE."""
        result = self(noisy[:, :3], noisy[:, 3:6].clamp(0, 1), noisy[:, 6:9])
        return loss_of(result, pu(target)), options.relative_squares * relative_squares(pu_inverse(result), target)


class Seed(torch.nn.Module):
    """The paper's network: radiance, screen-space normal and depth; the transfer is ln(1 + x)."""

    metadata = dict(inputs="radiance,normal_screen.xy,depth", transfer="log1p")
    architecture = "seed"

    def __init__(self):
        super().__init__()
        add_convolutions(self, SEED)

    def forward(self, x):
        conv = lambda name, t: F.leaky_relu(getattr(self, name)(t), 0.1)
        skips = [conv("enc_conv1b", conv("enc_conv1a", x))]
        for name in ("enc_conv2", "enc_conv3", "enc_conv4", "enc_conv5"):
            skips.append(conv(name, F.max_pool2d(skips[-1], 2)))
        x = conv("bottleneck", F.max_pool2d(skips[-1], 2))
        for level in (5, 4, 3, 2, 1):
            joined = torch.cat([F.interpolate(x, scale_factor=2), skips.pop()], 1)
            x = conv(f"dec_conv{level}b", conv(f"dec_conv{level}a", joined))
        return self.out_conv(x)

    def loss(self, noisy, target, options):
        """Two parts: MAE01, and a tenth of the MAE in the transfer's space, so that what is brighter than 1 counts as well. Exact pixels,
        which inference keeps, do not."""
        result = self(noisy[:, :6].contiguous(memory_format=torch.channels_last))
        exposure, inexact = noisy[:, 6:7], noisy[:, 7:8]
        shown = lambda exposed: (exposed / exposure).clamp(0, 1)
        clamped = (shown(torch.expm1(result.clamp(0, 10))) - shown(target)).abs()
        whole = (result - torch.log1p(target)).abs()
        return (inexact * clamped).mean(), 0.1 * (inexact * whole).mean()


def loss_of(result, target):
    error, loss = result - target, 0
    for _ in range(5):
        loss = loss + error.abs().mean()
        error = F.avg_pool2d(error, 2)
    return loss / 5


def relative_squares(result, target):
    """relMSE of radiance; what is wrong by more than 7 times counts no more than that, for single pixels would rule the step."""
    return ((result - target) ** 2 / (target**2 + 0.01)).clamp_max(50).mean()


def load_picture(file):
    """Of scripts/training_pictures.py: channels of two noisy versions, channels of the target."""
    picture = np.load(file)
    return [picture[:9], picture[9:18]], picture[18:]


def load_scene(file):
    """Of `limpid dataset`, by the name of its target: two noisy versions (radiance by ln(1 + exposed), screen-space normal, depth,
    exposure, whether a pixel is inexact) and the target, not exposed."""
    from training_pictures import attribute, channels, exposure

    target = channels(file, ("R", "G", "B"))
    versions = []
    for noisy in (0, 1):
        x = channels(file.replace(".target.", f".noisy-{noisy}."), ("R", "G", "B"), ("Nscreen.X", "Nscreen.Y", "Z"), ("albedo.R", "albedo.G", "albedo.B"))
        gain = exposure(x[:3], 0.5)
        depth = np.where((x[5] > 0) & (x[5] < 1e30), x[5], 0)
        depth = np.where(depth > 0, depth / depth.max(), 1)
        inexact = x[6:].max(0) > 0
        if attribute(file, "aa") == "true":  # black pixels' samples may have missed what neighbours see
            around = F.max_pool2d(torch.from_numpy(inexact[None].astype(np.float32)), 3, 1, 1)[0].numpy() > 0
            inexact |= around & (x[:3].max(0) == 0)
        rest = np.full_like(depth, gain), inexact
        versions.append(np.concatenate([np.log1p(x[:3] * gain), x[3:5], depth[None], np.stack(rest)]).astype(np.float32))
    return versions, target


def picture_crop(rng, noisy, target):
    noisy = noisy.clone()
    if rng.random() < 0.5:
        # Axes of the world are a convention: any turned or mirrored normals belong to some picture, mirrored or not.
        turn = torch.from_numpy(np.linalg.qr(np.random.default_rng(rng.randrange(1 << 30)).normal(size=(3, 3)))[0].astype(np.float32))
        side = noisy.shape[1]
        noisy[6:9] = (turn @ noisy[6:9].reshape(3, -1)).reshape(3, side, side).clamp(-1, 1)
        if rng.random() < 0.5:
            noisy, target = noisy.flip(2), target.flip(2)
        if rng.random() < 0.5:
            noisy, target = noisy.transpose(1, 2), target.transpose(1, 2)
    if rng.random() < 0.2:
        gain = math.exp(rng.gauss(0, 1))  # exposures are estimates
        noisy, target = noisy.clone(), target * gain
        noisy[:3] *= gain
    return noisy, target


def scene_crop(rng, noisy, target):
    """One of eight orientations, as glsl/lib/crop.glsl has them."""
    noisy, target = noisy.clone(), target * noisy[6, 0, 0]
    for axis, normal in ((2, 3), (1, 4)):
        if rng.random() < 0.5:
            noisy, target = noisy.flip(axis), target.flip(axis)
            noisy[normal] *= -1
    if rng.random() < 0.5:
        noisy, target = noisy.transpose(1, 2).clone(), target.transpose(1, 2)
        noisy[3:5] = -noisy[3:5].flip(0)
    return noisy, target


def crops(rng, pool, count, side, turned):
    inputs, targets = [], []
    for _ in range(count):
        versions, target = rng.choice(pool)
        _, height, width = target.shape
        y, x = rng.randrange(height - side + 1), rng.randrange(width - side + 1)
        cut = lambda t: torch.from_numpy(t[:, y : y + side, x : x + side].astype(np.float32))
        noisy, target = turned(rng, cut(rng.choice(versions)), cut(target))
        inputs.append(noisy)
        targets.append(target)
    return torch.stack(inputs), torch.stack(targets)


def save(network, path, steps, options):
    metadata = dict(architecture=network.architecture, **network.metadata, trainer=f"scripts/pytorch_train.py, PyTorch {torch.__version__}",
                    command=" ".join(os.path.basename(word) for word in sys.argv), steps=str(steps))
    tensors = {name: tensor.contiguous() for name, tensor in network.state_dict().items()}
    save_file(tensors, path + ".part", metadata)
    os.rename(path + ".part", path)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pool", required=True)
    parser.add_argument("--architecture", choices=[*HEADS, "seed"], default="kpn")
    parser.add_argument("--init", help="weights to go on from; tensors that are not in it begin at random")
    parser.add_argument("--out", required=True)
    parser.add_argument("--minutes", type=float, required=True, help="by the clock")
    parser.add_argument("--learning-rate", type=float, default=1e-3)
    parser.add_argument("--relative-squares", type=float, default=0.1, help="share of relMSE in the loss of `base` and `kpn`")
    parser.add_argument("--batch", type=int, default=8, help="crops of 128x128 a step; a quarter of the steps has a quarter as many of 256x256")
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    torch.manual_seed(options.seed)
    rng = random.Random(options.seed)
    if options.architecture == "seed":
        network, pattern, load, turned = Seed(), "*.target.exr", load_scene, scene_crop
    else:
        network, pattern, load, turned = Network(options.architecture), "?????.npy", load_picture, picture_crop
    if options.init:
        known = {name: t for name, t in load_file(options.init).items() if name in network.state_dict()}
        network.load_state_dict(known, strict=False)
    network = network.to(memory_format=torch.channels_last)
    optimiser = torch.optim.Adam(network.parameters(), lr=options.learning_rate, betas=(0.9, 0.99), eps=1e-10)
    # What is saved is a mean over some hundred steps.
    average = torch.optim.swa_utils.AveragedModel(network, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(0.995))
    pool, loaded, begin, steps, losses = [], set(), time.time(), 0, []
    while (progress := (time.time() - begin) / (60 * options.minutes)) < 1:
        if steps % 100 == 0:  # the pool may grow meanwhile
            files = sorted(glob.glob(os.path.join(options.pool, pattern)))
            new = [file for file in files if file not in loaded]
            loaded.update(new)
            pool += [load(file) for file in new]
        rate = min((steps + 1) / 50, 1) * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress)))
        for group in optimiser.param_groups:
            group["lr"] = options.learning_rate * rate
        noisy, target = crops(rng, pool, *((options.batch // 4, 256) if rng.random() < 0.25 else (options.batch, 128)), turned)
        loss, more = network.loss(noisy, target, options)
        optimiser.zero_grad()
        (loss + more).backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 0.1)
        optimiser.step()
        steps += 1
        average.update_parameters(network)
        losses.append((loss.item(), more.item()))
        if steps % 100 == 0:
            print(json.dumps(dict(step=steps, loss=[round(float(x), 5) for x in np.mean(losses[-100:], 0)], seconds=round(time.time() - begin), pictures=len(pool))), flush=True)
        if steps % 300 == 0:
            save(average.module, options.out, steps, options)
    save(average.module, options.out, steps, options)


if __name__ == "__main__":
    main()
