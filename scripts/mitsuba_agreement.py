#!/usr/bin/env python3
"""Renders scenes with limpid and with Mitsuba 3 and tests whether both show the same picture. Prints a Markdown row a scene.

    scripts/mitsuba_agreement.py [SCENE.xml ...]      [default: every XML file in tests/scenes]

Needs `mitsuba` and `numpy` (pip install mitsuba numpy) and limpid's binary (--limpid, else the one that cargo built).
Mitsuba's llvm variant is used where it finds an LLVM library newer than 16 (DRJIT_LIBLLVM_PATH names one), else scalar.

Both render with a camera ray a sample (`--aa`), independently seeded runs of each. Three tests:
- pixels: z-test of every pixel and channel over the runs, Sidak-corrected at alpha 0.01, 2e6/pixels samples in all. Welch's t
  with the degrees of freedom of the runs; at least 99.75 % of the values must pass.
- blocks: means of 8x8 pixels over the channels, sigma of the difference at most 0.3 % of the mean (as many samples as that
  takes, up to --spp); at least 99 % of the blocks within 3 sigma.
- mean: over all that is not black, within 0.2 %.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
RUNS = 32
ALPHA = 0.01


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", type=Path)
    parser.add_argument("--limpid", type=Path, help="limpid's binary")
    parser.add_argument("--size", type=int, default=96, help="width and height, pixels [96]")
    parser.add_argument("--spp", type=int, default=16384, help="samples a pixel of the block test at most [16384]")
    parser.add_argument("--seed", type=int, default=1, help="first seed of both renderers [1]")
    args = parser.parse_args()
    if args.size % 8:
        parser.error("--size must be a multiple of 8")
    args.scenes = args.scenes or sorted((ROOT / "tests" / "scenes").glob("*.xml"))
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    args.limpid = args.limpid or target / "release" / "limpid"
    return args


def load_mitsuba():
    import mitsuba as mi

    # A library that does not work aborts the process: asked of another one.
    probe = "import mitsuba as mi; mi.set_variant('llvm_ad_rgb'); mi.render(mi.load_dict(mi.cornell_box()), spp=1).numpy()"
    works = subprocess.run([sys.executable, "-c", probe], capture_output=True).returncode == 0
    mi.set_variant("llvm_ad_rgb" if works else "scalar_rgb")
    return mi


def load_rgb(mi, path):
    """R, G, B of an EXR that may have more channels: (height, width, 3)."""
    bitmap = mi.Bitmap(str(path))
    names = [field.name for field in bitmap.struct_()]
    return np.array(bitmap, dtype=np.float64)[:, :, [names.index(c) for c in "RGB"]]


class Limpid:
    """Runs of one scene, all samples of a run in its mean."""

    def __init__(self, args, scene, folder):
        self.args, self.scene, self.folder = args, scene, folder

    def render(self, mi, spp, seed):
        out = self.folder / "limpid.exr"
        size = f"{self.args.size}x{self.args.size}"
        command = [self.args.limpid, "render", self.scene, "-o", out, "--size", size, "--spp", spp, "--seed", seed]
        command += ["--aa", "--json"]
        report = json.loads(subprocess.run([str(c) for c in command], check=True, capture_output=True).stdout)
        assert report["invalid_samples"] == 0, f"{self.scene}: {report['invalid_samples']} invalid samples"
        return load_rgb(mi, out)


class Mitsuba:
    def __init__(self, mi, args, scene):
        self.scene = mi.load_file(str(scene))
        sensor = mi.traverse(self.scene.sensors()[0])
        sensor["film.size"] = [args.size, args.size]
        sensor.update()
        self.size = args.size

    def render(self, mi, spp, seed):
        image = np.array(mi.render(self.scene, spp=spp, seed=seed), dtype=np.float64)[:, :, :3]
        assert image.shape[:2] == (self.size, self.size), image.shape
        return image


def runs(renderer, mi, spp, first_seed):
    """RUNS independent renders of `spp` samples each: (runs, height, width, 3)."""
    return np.stack([renderer.render(mi, spp, first_seed + i) for i in range(RUNS)])


def student_two_sided(t, freedom):
    """P(|T| > t): Simpson's rule over the density, in the angle that makes the tail finite."""

    def integral(low):
        n = 400
        step = (np.pi / 2 - low) / n
        weights = np.array([1.0] + [4.0, 2.0] * (n // 2 - 1) + [4.0, 1.0])
        return sum(w * np.maximum(np.cos(low + i * step), 0.0) ** (freedom - 1) for i, w in enumerate(weights)) * step / 3

    return integral(np.arctan(t / np.sqrt(freedom))) / integral(np.zeros_like(t))


def pixel_test(ours, theirs):
    """Share of pixel values that pass, and the number that varies or differs at all."""
    n = len(ours)
    va, vb = ours.var(axis=0, ddof=1) / n, theirs.var(axis=0, ddof=1) / n
    difference = np.abs(ours.mean(axis=0) - theirs.mean(axis=0))
    # Mitsuba's own test has such a floor: values that do not vary differ by roundings.
    floor = (1e-5 * (1e-3 + np.abs(theirs.mean(axis=0)))) ** 2
    variance = va + vb + floor
    freedom = variance**2 / ((va + floor / 2) ** 2 + (vb + floor / 2) ** 2) * (n - 1)
    p = student_two_sided(difference / np.sqrt(variance), np.clip(freedom, n - 1, 2 * n - 2))
    limit = 1.0 - (1.0 - ALPHA) ** (1.0 / p.size)
    return float((p >= limit).mean())


def blocks(images):
    n, height, width, _ = images.shape
    return images.reshape(n, height // 8, 8, width // 8, 8, 3).mean(axis=(2, 4, 5))


def block_test(ours, theirs):
    """Share of blocks within 3 sigma, and the largest sigma relative to the block's mean; black blocks must both be black."""
    n = len(ours)
    a, b = blocks(ours), blocks(theirs)
    sigma = np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / n)
    mean = b.mean(axis=0)
    sigma = np.maximum(sigma, 1e-6 * mean)
    inside = np.abs(a.mean(axis=0) - mean) <= 3.0 * sigma
    relative = sigma / np.maximum(mean, 1e-30)
    return float(inside.mean()), float(relative[mean > 0].max())


def compare(mi, args, scene, folder):
    ours, theirs = Limpid(args, scene, folder), Mitsuba(mi, args, scene)
    start = time.time()
    spp = max(1, round(2e6 / args.size**2 / RUNS))
    a, b = runs(ours, mi, spp, args.seed), runs(theirs, mi, spp, args.seed)
    pixels = pixel_test(a, b)
    # The largest sigma of so few runs is itself uncertain by some 15 %: a good third more samples than it asks for.
    spp = int(spp * 1.4 * (block_test(a, b)[1] / 0.003) ** 2) + 1
    spp = max(1, min(spp, args.spp // RUNS))
    a, b = runs(ours, mi, spp, args.seed + RUNS), runs(theirs, mi, spp, args.seed + RUNS)
    inside, sigma = block_test(a, b)
    lit = b.mean(axis=0).max(axis=2) > 0
    mean = a.mean(axis=0)[lit].mean() / b.mean(axis=0)[lit].mean() - 1.0
    passed = pixels >= 0.9975 and inside >= 0.99 and sigma <= 0.003 and abs(mean) <= 0.002
    cells = [f"`{scene.name}`", f"{100 * pixels:.2f} %", f"{100 * inside:.1f} %", f"{100 * sigma:.2f} %"]
    cells += [f"{spp * RUNS}", f"{100 * mean:+.3f} %", f"{time.time() - start:.0f} s", "pass" if passed else "**fails**"]
    print("| " + " | ".join(cells) + " |", flush=True)
    return passed


def main():
    args = arguments()
    mi = load_mitsuba()
    print(f"limpid against Mitsuba {mi.__version__} ({mi.variant()}), {args.size}x{args.size}, {RUNS} runs each\n")
    print("| scene | pixels accepted | blocks within 3 sigma | largest sigma | spp | mean | time | |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as folder:
        passed = [compare(mi, args, scene, Path(folder)) for scene in args.scenes]
    sys.exit(0 if all(passed) else 1)


if __name__ == "__main__":
    main()
