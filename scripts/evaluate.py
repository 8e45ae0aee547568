"""The table of scripts/evaluate from the JSON that it left in a directory: mean and worst error of noisy and reconstructed
frames against the mean of two reference halves, and the noise of that reference.

The error against the mean of the halves follows from the errors against each: (a - (r + s) / 2)^2 is the mean of (a - r)^2
and (a - s)^2, less (r - s)^2 / 4. MAE01 has no such identity: the mean of both is given, which is a little too large.
The reference's own noise is half (MAE01) and a quarter (relMSE) of the difference between its halves."""

import json
import sys
from pathlib import Path


def figures(path, part):
    value = json.loads(path.read_text())
    return value["noisy"]["all"] if part == "noisy" else value[part]


def main():
    out, first, last = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    frames = range(first, last + 1)
    rows = {}
    for part in ("noisy", "all", "surface"):
        for key in ("mae01", "relmse", "psnr", "ssim", "flip"):
            both = [[figures(out / f"{n}.compare{half}.json", part)[key] for half in (1, 2)] for n in frames]
            values = [sum(pair) / 2 for pair in both]
            if key == "relmse":
                halves = [figures(out / f"{n}.noise.json", "surface" if part == "surface" else "all")[key] for n in frames]
                values = [v - h / 4 for v, h in zip(values, halves)]
            worst = min(values) if key in ("psnr", "ssim") else max(values)
            rows[part, key] = (sum(values) / len(values), worst)
    noise = {key: [figures(out / f"{n}.noise.json", "all")[key] for n in frames] for key in ("mae01", "relmse")}
    print(f"{'':24}{'mean':>12}{'worst':>12}")
    for (part, key), (mean, worst) in rows.items():
        name = {"noisy": "noisy", "all": "reconstructed", "surface": "  surface only"}[part]
        print(f"{name + ' ' + key:24}{mean:12.6f}{worst:12.6f}")
    for key, share in (("mae01", 2), ("relmse", 4)):
        values = noise[key]
        print(f"{'reference noise ' + key:24}{sum(values) / len(values) / share:12.6f}{max(values) / share:12.6f}")
    print(f"noisy / reconstructed relMSE: {rows['noisy', 'relmse'][0] / rows['all', 'relmse'][0]:.1f}")


if __name__ == "__main__":
    main()
