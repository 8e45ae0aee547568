"""What scripts/evaluate, scripts/seams and scripts/figures share: pictures and figures of a suite of frames, each made once.

Every file is named after all that decides what is in it, but for the program: empty the folder when that has changed."""

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
RELEASE = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "release"
SUITES = {"family": "spheres:90000..90015", "rooms": "rooms:90000..90015"}


def scenes_of(words):
    """Scene specs of suites, specs, and ranges of specs such as spheres:90000..90003 (the last one included)."""
    scenes = []
    for word in words:
        word = SUITES.get(word, word)
        prefix, _, numbers = word.partition(":")
        first, dots, last = numbers.partition("..")
        if dots:
            scenes += [f"{prefix}:{n}" for n in range(int(first), int(last) + 1)]
        else:
            scenes.append(word)
    return scenes


def add_arguments(parser, scenes, out, reference_spp):
    """The arguments that choose frames; each default can be set by the environment."""
    env = os.environ.get
    parser.add_argument("--limpid", default=env("LIMPID", str(RELEASE / "limpid")))
    parser.add_argument("--suite", nargs="+", metavar="family|rooms|SPEC", default=env("SCENES", scenes).split())
    parser.add_argument("--size", default=env("SIZE", "768x768"))
    parser.add_argument("--spp", type=int, default=int(env("SPP", "16")))
    parser.add_argument("--estimator", default=env("ESTIMATOR", "cosine"))
    parser.add_argument("--sampler", default=env("SAMPLER", "pcg"))
    parser.add_argument("--seed", type=int, default=int(env("SEED", "1")))
    parser.add_argument("--aa", action="store_true", default=env("AA", "") not in ("", "0"), help="references too")
    parser.add_argument("--reference-spp", type=int, default=int(env("REFERENCE_SPP", reference_spp)), help="of both halves")
    parser.add_argument("--out", default=env("OUT", out), help="folder that keeps what was made")


def weights_of(words):
    """(name, file or None) of NAME=FILE, FILE or `embedded`."""
    pairs = []
    for word in words:
        name, equals, file = word.partition("=")
        if not equals:
            name, file = (word, None) if word == "embedded" else (Path(word).stem, word)
        pairs.append((name, file))
    return pairs


def digest(path):
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()[:8]


class Suite:
    def __init__(self, args):
        self.args, self.out = args, Path(args.out)
        self.scenes = scenes_of(args.suite)
        self.out.mkdir(parents=True, exist_ok=True)

    def run(self, *words):
        """Standard output of a command, which must succeed."""
        done = subprocess.run([str(word) for word in words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        if done.returncode:
            tail = done.stderr.strip().splitlines()[-1:] or ["no message"]
            sys.exit(f"{' '.join(map(str, words))}: {tail[0]}")
        return done.stdout

    def make(self, name, command):
        """The file of this name, made by `command(path)` where it is not there yet; never half a file."""
        path = self.out / name
        if not path.exists():
            print(f"  {name}", file=sys.stderr, flush=True)
            with tempfile.TemporaryDirectory(dir=self.out) as temporary:
                part = Path(temporary) / f"part{path.suffix}"
                command(part)
                display = part.with_suffix(".png")
                if display.exists():
                    display.replace(path.with_suffix(".png"))
                part.replace(path)
        return path

    def stem(self, scene):
        name = scene.replace(":", "-")
        if Path(scene).is_file():
            name = f"{Path(scene).stem}-{digest(scene)}"
        return f"{name}.{self.args.size}{'.aa' if self.args.aa else ''}"

    def render(self, scene, name, *flags):
        """A picture of a scene, `name` saying what the flags are."""
        fixed = ["--size", self.args.size, *(["--aa"] if self.args.aa else [])]
        command = lambda path: self.run(self.args.limpid, "render", scene, "-o", path, *fixed, *flags)
        return self.make(f"{self.stem(scene)}.{name}.exr", command)

    def noisy(self, scene):
        a = self.args
        flags = ["--spp", a.spp, "--estimator", a.estimator, "--sampler", a.sampler, "--seed", a.seed]
        return self.render(scene, f"{a.estimator}-{a.sampler}-{a.spp}spp-{a.seed}", *flags)

    def references(self, scene):
        """Two halves with seeds of their own."""
        spp = self.args.reference_spp // 2
        flags = ["--spp", spp, "--estimator", "nee", "--sampler", "sobol", "--seed"]
        return [self.render(scene, f"reference{half}-{spp}spp", *flags, 1000 + half) for half in (1, 2)]

    def made_of(self, picture, name, command):
        return self.make(f"{picture.stem}.{name}.exr", command)

    def denoised(self, picture, weights, *flags, name=""):
        """A picture reconstructed by limpid with the weights (name, file)."""
        label, file = weights
        key = f"{label}-{digest(file)}" if file else f"{label}-{digest(self.args.limpid)}"
        chosen = ["--weights", file] if file else []
        command = lambda path: self.run(self.args.limpid, "denoise", picture, "-o", path, *chosen, *flags)
        return self.made_of(picture, key + name, command)

    def figures(self, picture, references, *flags):
        """What `limpid compare` says of a picture against two references."""
        spp, key = self.args.reference_spp // 2, "".join(str(flag).replace("--", ".") for flag in flags)
        words = [self.args.limpid, "compare", picture, references[0], "--second", references[1], "--json", *flags]
        path = self.make(f"{picture.stem}.{spp}spp{key}.json", lambda path: path.write_text(self.run(*words)))
        return json.loads(path.read_text())


def mean(values):
    values = list(values)
    return sum(values) / len(values)


def markdown(head, rows):
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
