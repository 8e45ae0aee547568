#!/usr/bin/env python3
"""Pictures for scripts/pytorch_train.py, rendered by limpid: N.npy, float16, [21][height][width].

Two noisy versions of 9 channels (radiance, albedo, world-space normal) and the reference's radiance; radiance is multiplied by
the exposure of the reference. A third of the scenes each are members of `spheres:N`, of `rooms:N` (N < 90,000: no held-out
one) and objects of all materials under a sky, which this script writes as Mitsuba XML.

    scripts/training_pictures.py --limpid target/release/limpid --out DIR --from 0 --to 600
"""
import argparse
import math
import os
import random
import subprocess
import tempfile

import numpy as np
import OpenEXR


def rgb(rng, low, high):
    return ",".join(f"{rng.uniform(low, high):.3f}" for _ in range(3))


def material(rng, smooth=True):
    kind = rng.choices(["diffuse", "checker", "plastic", "rough", "mirror", "glass"], [6, 3, 2, 2, 1 if smooth else 0, 1 if smooth else 0])[0]
    if kind == "diffuse":
        return f'<bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="{rgb(rng, 0.03, 0.9)}"/></bsdf></bsdf>'
    checker = (f'<texture type="checkerboard" name="NAME"><rgb name="color0" value="{rgb(rng, 0.03, 0.9)}"/><rgb name="color1" value="{rgb(rng, 0.03, 0.9)}"/>'
               f'<transform name="to_uv"><scale x="{rng.randint(2, 12)}" y="{rng.randint(2, 12)}"/></transform></texture>')
    if kind == "checker":
        return f'<bsdf type="twosided"><bsdf type="diffuse">{checker.replace("NAME", "reflectance")}</bsdf></bsdf>'
    if kind == "plastic":
        inside = checker.replace("NAME", "diffuse_reflectance") if rng.random() < 0.3 else f'<rgb name="diffuse_reflectance" value="{rgb(rng, 0.03, 0.9)}"/>'
        return f'<bsdf type="twosided"><bsdf type="plastic">{inside}</bsdf></bsdf>'
    metal = rng.choice(["Au", "Cu", "Al", "Ag", "Cr"])
    if kind == "rough":
        return f'<bsdf type="twosided"><bsdf type="roughconductor"><string name="material" value="{metal}"/><string name="distribution" value="ggx"/><float name="alpha" value="{rng.uniform(0.1, 0.5):.3f}"/></bsdf></bsdf>'
    if kind == "mirror":
        return f'<bsdf type="conductor"><string name="material" value="{metal}"/></bsdf>'
    return '<bsdf type="dielectric"/>'


def transform(rng, scale, place):
    turns = "".join(f'<rotate {axis}="1" angle="{rng.uniform(0, 360):.1f}"/>' for axis in "xy")
    sizes = " ".join(f'{axis}="{scale * rng.uniform(0.5, 1.5):.3f}"' for axis in "xyz")
    at = " ".join(f'{axis}="{v:.3f}"' for axis, v in zip("xyz", place))
    return f'<transform name="to_world"><scale {sizes}/>{turns}<translate {at}/></transform>'


def objects(rng, size):
    """A scene of objects on a ground or in the air, as XML."""
    azimuth, height, distance = rng.uniform(0, 2 * math.pi), rng.uniform(0.3, 3.0), rng.uniform(3.0, 7.0)
    origin = (distance * math.cos(azimuth), height, distance * math.sin(azimuth))
    lines = [f'<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="{rng.choice([4, 6, 9])}"/></integrator>',
             f'<sensor type="perspective"><float name="fov" value="{rng.uniform(25, 70):.1f}"/><transform name="to_world"><lookat '
             f'origin="{origin[0]:.3f},{origin[1]:.3f},{origin[2]:.3f}" target="{rng.uniform(-.5, .5):.2f},{rng.uniform(-.3, .5):.2f},{rng.uniform(-.5, .5):.2f}" up="0,1,0"/></transform>'
             f'<film type="hdrfilm"><integer name="width" value="{size}"/><integer name="height" value="{size}"/><rfilter type="box"/></film></sensor>']
    if rng.random() < 0.85:
        lines.append(f'<shape type="rectangle"><transform name="to_world"><scale x="6" y="6"/><rotate x="1" angle="-90"/><translate y="-1"/></transform>{material(rng, False)}</shape>')
    if rng.random() < 0.3:
        lines.append(f'<shape type="rectangle"><transform name="to_world"><scale x="6" y="3"/><rotate y="1" angle="{rng.uniform(0, 360):.1f}"/><translate x="{-2 * math.cos(azimuth):.3f}" z="{-2 * math.sin(azimuth):.3f}"/></transform>{material(rng, False)}</shape>')
    for _ in range(rng.randint(1, 14)):
        place = (rng.uniform(-2, 2), rng.uniform(-0.9, 1.2), rng.uniform(-2, 2))
        scale = rng.uniform(0.1, 0.6)
        if math.dist(place, origin) < 3 * scale + 0.5:
            continue
        if rng.random() < 0.45:
            at = " ".join(f'{axis}="{v:.3f}"' for axis, v in zip("xyz", place))
            lines.append(f'<shape type="sphere"><point name="center" {at}/><float name="radius" value="{scale:.3f}"/>{material(rng)}</shape>')
        else:
            lines.append(f'<shape type="{rng.choice(["cube", "cube", "disk", "rectangle"])}">{transform(rng, scale, place)}{material(rng)}</shape>')
    lit = False
    if rng.random() < 0.75:
        lines.append(f'<emitter type="constant"><rgb name="radiance" value="{rgb(rng, 0.2, 1.5)}"/></emitter>')
        lit = True
    if rng.random() < 0.4:
        lines.append(f'<emitter type="directional"><vector name="direction" x="{rng.uniform(-1, 1):.3f}" y="-1" z="{rng.uniform(-1, 1):.3f}"/><rgb name="irradiance" value="{rgb(rng, 0.5, 4)}"/></emitter>')
    if not lit or rng.random() < 0.5:
        for _ in range(rng.randint(1, 2)):
            place = (rng.uniform(-2, 2), rng.uniform(1.8, 3), rng.uniform(-2, 2))
            light = f'<emitter type="area"><rgb name="radiance" value="{rgb(rng, 2, 20)}"/></emitter>'
            at = " ".join(f'{axis}="{v:.3f}"' for axis, v in zip("xyz", place))
            if rng.random() < 0.5:
                lines.append(f'<shape type="sphere"><point name="center" {at}/><float name="radius" value="{rng.uniform(0.1, 0.4):.3f}"/>{light}</shape>')
            else:
                lines.append(f'<shape type="rectangle"><transform name="to_world"><scale x="{rng.uniform(0.2, 0.8):.3f}" y="{rng.uniform(0.2, 0.8):.3f}"/><rotate x="1" angle="90"/><translate {at}/></transform>{light}</shape>')
    return "\n".join(lines + ["</scene>"])


def channels(path, *groups):
    found = OpenEXR.File(path, separate_channels=True).channels()
    return np.stack([np.asarray(found[name].pixels, dtype=np.float32) for group in groups for name in group])


def attribute(path, name):
    return OpenEXR.File(path, header_only=True).header().get(name)


def exposure(radiance, key=0.18):
    """What limpid's transfer `pu` multiplies radiance with (glsl/net/frame_bins.comp); `log1p` with a key of 0.5."""
    luminance = np.tensordot(np.array([0.212671, 0.715160, 0.072169], np.float32), np.maximum(radiance, 0), 1)
    height, width = luminance.shape
    bins = luminance[: height // 16 * 16, : width // 16 * 16].reshape(height // 16, 16, width // 16, 16).mean((1, 3))
    bins = bins[bins > 1e-8]
    return np.float32(key / 2 ** np.log2(bins).mean()) if bins.size else np.float32(1)


def make(limpid, index, out, folder):
    rng = random.Random(f"limpid {index}")
    size = rng.choice([256, 320, 384, 512, 640])
    kind = ("spheres", "rooms", "objects")[index % 3]
    scene = f"{kind}:{rng.randrange(90000)}"
    if kind == "objects":
        scene = os.path.join(folder, "scene.xml")
        with open(scene, "w") as file:
            file.write(objects(rng, size))
    aa = ["--aa"] if rng.random() < 0.75 else []

    def render(spp, estimator, sampler, *groups):
        path = os.path.join(folder, "picture.exr")
        command = [limpid, "render", scene, "--size", f"{size}x{size}", "--spp", str(spp), "--estimator", estimator, "--sampler", sampler,
                   "--seed", str(rng.randrange(1 << 30)), "-o", path, *aa]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        return channels(path, *groups)

    groups = (("R", "G", "B"), ("albedo.R", "albedo.G", "albedo.B"), ("N.X", "N.Y", "N.Z"))
    # Paths rarely meet small lights, and never points: light sampling mostly, but in `spheres`.
    found = "cosine" if kind == "spheres" or (kind == "rooms" and rng.random() < 0.25) else "nee"
    versions = [render(4 << rng.randrange(5), "nee", rng.choice(["pcg", "sobol"]), *groups), render(4 << rng.randrange(5), found, "pcg", *groups)]
    reference = render(256 if kind == "objects" else 128, "nee", "sobol", groups[0])
    gain = exposure(reference)
    for picture in (*versions, reference):
        picture[:3] *= gain
    np.save(out, np.clip(np.concatenate([*versions, reference]), -65504, 65504).astype(np.float16))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--limpid", default="target/release/limpid")
    parser.add_argument("--out", required=True)
    parser.add_argument("--from", dest="first", type=int, default=0)
    parser.add_argument("--to", type=int, required=True)
    parser.add_argument("--step", type=int, default=1, help="every STEP-th only")
    options = parser.parse_args()
    os.makedirs(options.out, exist_ok=True)
    for index in range(options.first, options.to, options.step):
        out = os.path.join(options.out, f"{index:05d}.npy")
        if not os.path.exists(out):
            with tempfile.TemporaryDirectory() as folder:
                make(options.limpid, index, out + ".part.npy", folder)
            os.rename(out + ".part.npy", out)


if __name__ == "__main__":
    main()
