#!/usr/bin/env python3
"""Error and time of limpid and of Mitsuba 3 on the same scene file, cores and reference: 1 / (relMSE x time).

  python3 -m pip install mitsuba
  scripts/mitsuba_error.py [SCENE] [--limpid target/release/limpid] [--size 256x256] [--spp 16,64] [--runs 8] [--variant llvm_ad_rgb]

Every sample has a camera ray of its own (--aa). Mitsuba runs its `path` integrator with each of its samplers, timed after its own
compilation; its llvm variants need an LLVM library of version 16 or later (Debian: libllvm19), named by DRJIT_LIBLLVM_PATH. limpid's
times are device times of `limpid bench error`, taken before and after Mitsuba's. Medians; relMSE is the mean over the runs of the
product of the relative differences to limpid's two reference halves."""

import argparse
import json
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

from mitsuba_agreement import load_rgb

SAMPLERS = ["independent", "stratified", "multijitter", "orthogonal", "ldsampler"]
TECHNIQUES = "nee+sobol,nee+pcg"


def limpid_runs(args, directory):
    """Points of `limpid bench error`, by (technique, spp); the reference stays in `directory`."""
    command = [args.limpid, "bench", "error", args.scene, "-o", str(directory), "--aa", "--no-denoise", "--json"]
    command += ["--size", args.size, "--spp", args.spp, "--runs", str(args.runs), "--only", TECHNIQUES]
    command += ["--reference-spp", str(args.reference_spp)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    runs = [json.loads(line) for line in (directory / "runs.jsonl").read_text().splitlines()]
    points = {}
    for run in runs:
        key = (f"limpid {run['estimator']}+{run['sampler']}", run["spp"])
        points.setdefault(key, []).append((run["noisy"]["relmse"], run["noisy"]["device_ms"] * 1e-3))
    return points


def mitsuba_runs(args, file, halves):
    import drjit as dr
    import mitsuba as mi
    import numpy as np

    mi.set_variant(args.variant)
    a, b = (load_rgb(mi, half) for half in halves)
    points = {}
    width, height = (int(side) for side in args.size.split("x"))
    for sampler in SAMPLERS:
        text = file.read_text().replace('type="independent"', f'type="{sampler}"')
        scene = mi.load_string(text, width=width, height=height)
        for spp in (int(n) for n in args.spp.split(",")):
            runs = []
            for seed in range(args.runs + 1):
                begin = time.perf_counter()
                image = mi.render(scene, spp=spp, seed=seed)
                dr.eval(image)
                dr.sync_thread()
                seconds = time.perf_counter() - begin
                x = np.array(image, dtype=np.float64)[..., :3]
                relmse = np.mean((x - a) * (x - b) / (((a + b) / 2) ** 2 + 0.01))
                runs.append((relmse, seconds))
            points[(f"Mitsuba {sampler}", spp)] = runs[1:]
    return points


def row(name, spp, runs):
    relmse = statistics.mean(r for r, _ in runs)
    seconds = statistics.median(t for _, t in runs)
    spread = f"{min(t for _, t in runs):.3f} to {max(t for _, t in runs):.3f}"
    return {"name": name, "spp": spp, "relmse": relmse, "seconds": seconds, "spread": spread, "cost": relmse * seconds}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="?", default="spheres")
    parser.add_argument("--limpid", default="target/release/limpid")
    parser.add_argument("--size", default="256x256")
    parser.add_argument("--spp", default="16,64")
    parser.add_argument("--runs", type=int, default=8)
    parser.add_argument("--reference-spp", type=int, default=4096)
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--work", type=Path, help="keep the reference here")
    args = parser.parse_args()

    with tempfile.TemporaryDirectory() as temporary:
        work = args.work or Path(temporary)
        work.mkdir(parents=True, exist_ok=True)
        file = Path(args.scene)
        if not file.exists():
            file = work / "scene.xml"
            subprocess.run([args.limpid, "scene", args.scene, "-o", str(file)], check=True)
        reference = work / "reference"
        # Runs anew, whatever an earlier one left; the reference is kept.
        (reference / "runs.jsonl").unlink(missing_ok=True)
        before = limpid_runs(args, reference)
        halves = sorted(reference.glob("reference*.exr"))
        peers = mitsuba_runs(args, file, halves)
        (reference / "runs.jsonl").unlink(missing_ok=True)
        after = limpid_runs(args, reference)

    ours = {key: before[key] + after[key] for key in before}
    rows = [row(name, spp, runs) for (name, spp), runs in {**ours, **peers}.items()]
    print("| renderer, sampler | spp | relMSE | seconds, median (range) | relMSE x seconds | relative to limpid nee+sobol |")
    print("| --- | --- | --- | --- | --- | --- |")
    for spp in sorted({r["spp"] for r in rows}):
        same = sorted((r for r in rows if r["spp"] == spp), key=lambda r: r["cost"])
        best = next(r for r in same if r["name"] == "limpid nee+sobol")
        for r in same:
            print(
                f"| {r['name']} | {spp} | {r['relmse']:.5f} | {r['seconds']:.3f} ({r['spread']}) "
                f"| {r['cost']:.6f} | {r['cost'] / best['cost']:.2f}x |"
            )


if __name__ == "__main__":
    main()
