"""The figures of frames that training never sees, as a Markdown table: noisy and by each method.

  scripts/evaluate [FIRST LAST [OUT_DIR]]     (default: frames 90000 to 90015 of the family; PREFIX=rooms: of another)
  scripts/evaluate --suite family|rooms|SPEC... [--aa] [--estimator nee] [--weights NAME=FILE...] [--joint] [--oidn]

Every option's default can be set by the environment: LIMPID, SCENES, SIZE, SPP, ESTIMATOR, SAMPLER, SEED, AA, REFERENCE_SPP, OUT,
WEIGHTS (several, by spaces), JOINT=1, PEERS (a Python with numpy and pyoidn, for --oidn). What was made stays in the folder OUT
and is not made again.

Each frame has two references, by nee and sobol with seeds of their own and the frame's camera mode. MAE01, PSNR, SSIM and FLIP are
against their mean, relMSE is the mean product of the differences to each (`limpid compare --help` has the formulas, of the defects too).
`joint` is a joint bilateral box filter of demodulated radiance (examples/joint_filter.rs) with, for each frame and each figure, the best of
five radii. Open Image Denoise runs at its highest quality on radiance, albedo and normal; pixels of lights and of nothing keep their radiance, as
in limpid."""

import argparse
import json
import os
from pathlib import Path

from suite import ROOT, RELEASE, Suite, add_arguments, markdown, mean, weights_of

FIGURES = {"mae01": "MAE01", "relmse": "relMSE", "psnr": "PSNR", "ssim": "SSIM", "flip": "FLIP"}
HIGHER_IS_BETTER = {"psnr", "ssim"}
DEFECTS = ["fireflies", "black", "non_finite"]
RADII = [3, 7, 10, 15, 31]
FORMAT = {"psnr": "{:.2f}", "ssim": "{:.5f}"}


def arguments():
    env = os.environ.get
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frames", nargs="*", metavar="FIRST LAST [OUT_DIR]")
    add_arguments(parser, "family", "out/evaluate", "512")
    parser.add_argument("--weights", nargs="+", metavar="NAME=FILE", default=env("WEIGHTS", "embedded").split())
    parser.add_argument("--joint", action="store_true", default=env("JOINT", "") not in ("", "0"))
    parser.add_argument("--joint-filter", default=env("JOINT_FILTER", str(RELEASE / "examples/joint_filter")))
    parser.add_argument("--oidn", action="store_true", default="PEERS" in os.environ)
    parser.add_argument("--peers", default=env("PEERS"), help="Python with numpy and pyoidn")
    parser.add_argument("--surface", action="store_true", help="figures over surface pixels only")
    args = parser.parse_args()
    if args.frames:
        if len(args.frames) not in (2, 3):
            parser.error("FIRST and LAST belong together")
        args.suite = [f"{env('PREFIX', 'spheres')}:{args.frames[0]}..{args.frames[1]}"]
        args.out = args.frames[2] if len(args.frames) == 3 else args.out
    if args.oidn and not args.peers:
        parser.error("--oidn needs --peers (or PEERS): a Python with numpy and pyoidn")
    return args


def figures(suite, picture, references):
    """The figures of one picture, by name; none where it has values that are not finite."""
    report = suite.figures(picture, references, "--defects")
    part = report["surface" if suite.args.surface else "all"]
    return {**{key: part[key] if part else None for key in FIGURES}, **report["defects"]}


def best(rows):
    """For each figure the best of several pictures; the defects of the one with the best relMSE."""
    result = dict(min(rows, key=lambda row: row["relmse"]))
    for key in FIGURES:
        result[key] = (max if key in HIGHER_IS_BETTER else min)(row[key] for row in rows)
    return result


def methods(suite):
    """Name of each method, and what makes its figures from a noisy picture and the references."""
    args = suite.args
    result = {"noisy": lambda noisy, references: figures(suite, noisy, references)}
    if args.joint:

        def joint(noisy, references):
            def filtered(radius):
                command = lambda path: suite.run(args.joint_filter, noisy, path, "--radius", radius)
                return suite.made_of(noisy, f"joint{radius}", command)

            return best([figures(suite, filtered(radius), references) for radius in RADII])

        result["joint filter"] = joint
    if args.oidn:

        def oidn(noisy, references):
            command = lambda path: suite.run(args.peers, ROOT / "scripts/oidn.py", "--filter", noisy, path)
            return figures(suite, suite.made_of(noisy, "oidn", command), references)

        result["Open Image Denoise"] = oidn
    for weights in weights_of(args.weights):
        result[weights[0]] = lambda noisy, references, weights=weights: figures(
            suite, suite.denoised(noisy, weights), references
        )
    return result


def column(rows, key, reduce):
    values = [row[key] for row in rows]
    return None if None in values else reduce(values)


def table(found, reduce_of):
    """Rows of the table; `reduce_of(key)` makes one number of all frames'."""
    head = ["method", *FIGURES.values()]
    against = [name for name in ("noisy", "joint filter", "Open Image Denoise") if name in found]
    head[3:3] = [f"relMSE / {name}" for name in against]
    lines = []
    for name, rows in found.items():
        cells = {key: column(rows, key, reduce_of(key)) for key in FIGURES}
        line = [name, *("-" if v is None else FORMAT.get(key, "{:.6f}").format(v) for key, v in cells.items())]
        ratios = []
        for other in against:
            base = column(found[other], "relmse", reduce_of("relmse"))
            ratios.append(f"{cells['relmse'] / base:.4g}" if cells["relmse"] is not None and base else "-")
        line[3:3] = ratios
        lines.append(line)
    return head, lines


def main():
    args = arguments()
    suite = Suite(args)
    found = {name: [] for name in methods(suite)}
    noise = []
    for scene in suite.scenes:
        noisy, references = suite.noisy(scene), suite.references(scene)
        for name, method in methods(suite).items():
            found[name].append(method(noisy, references))
        noise.append(suite.figures(noisy, references, "--defects")["noise"])
    pixels = "surface pixels" if args.surface else "all pixels"
    camera = "a ray in each pixel a sample" if args.aa else "rays through pixel centres"
    print(f"{len(suite.scenes)} frames ({' '.join(args.suite)}), {args.size}, {args.spp} spp {args.estimator}+{args.sampler}, {camera}; {pixels}.")
    noise_line = ", ".join(f"{FIGURES[key]} {mean(n[key] for n in noise):.6f}" for key in ("mae01", "relmse"))
    print(f"References: two halves of {args.reference_spp // 2} spp nee+sobol; their mean has noise of {noise_line}.\n")
    head, lines = table(found, lambda key: mean)
    for line, rows in zip(lines, found.values()):
        line += [str(sum(row[key] for row in rows)) for key in DEFECTS]
    print(markdown(head + ["fireflies", "black", "non-finite"], lines))
    print("\nThe worst frame of each figure:\n")
    print(markdown(*table(found, lambda key: min if key in HIGHER_IS_BETTER else max)))
    settings = {key: value for key, value in vars(args).items() if key not in ("limpid", "peers", "joint_filter")}
    report = {"settings": settings, "scenes": suite.scenes, "methods": found, "noise": noise}
    (Path(args.out) / "table.json").write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
