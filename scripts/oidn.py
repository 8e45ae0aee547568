#!/usr/bin/env python3
"""The same weights through limpid and through Open Image Denoise: the pictures must agree.

  python3 -m pip install pyoidn numpy safetensors
  scripts/oidn.py [--limpid target/release/limpid] [--weights base.safetensors] [--scene spheres:90000] [--size 768x512] [--keep DIR]
  scripts/oidn.py --filter IN.exr OUT.exr

limpid renders a noisy frame (radiance, albedo, world normals) and reconstructs it by `limpid denoise --weights`; Open Image Denoise
filters the same channels (hdr, CPU device) with the same weights. `limpid weights convert` makes them a TZA file, in fp16 as Open
Image Denoise 2 wants it, and back, so that both have the rounded ones. Without --weights they are random: the picture is then no
good one, but as valid. With --filter it is Open Image Denoise alone, with its own weights at its highest quality:
R, G, B of OUT.exr are the radiance of IN.exr filtered, but as it was in pixels that limpid keeps: albedo 0 (lights, nothing), and
not black next to another unless IN.exr says that all rays of a pixel are one.

Prints the mean of |a - b| / (|a| + |b| + 0.01), the measure of Open
Image Denoise's own tests, over the pixels that limpid reconstructs (it keeps the others, whose radiance is exact), and fails above
0.003."""

import argparse
import json
import math
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

LIMIT = 0.003
# Name and channels of limpid's EXR for each of the filter's images.
IMAGES = {
    "color": ["noisy.R", "noisy.G", "noisy.B"],
    "albedo": ["albedo.R", "albedo.G", "albedo.B"],
    "normal": ["N.X", "N.Y", "N.Z"],
}
# The default widths of `base`: convolution, channels in and out.
BASE = [
    ("enc_conv0", 9, 32),
    ("enc_conv1", 32, 32),
    ("enc_conv2", 32, 48),
    ("enc_conv3", 48, 64),
    ("enc_conv4", 64, 80),
    ("enc_conv5a", 80, 96),
    ("enc_conv5b", 96, 96),
    ("dec_conv4a", 96 + 64, 96),
    ("dec_conv4b", 96, 96),
    ("dec_conv3a", 96 + 48, 64),
    ("dec_conv3b", 64, 64),
    ("dec_conv2a", 64 + 32, 48),
    ("dec_conv2b", 48, 32),
    ("dec_conv1a", 32 + 9, 32),
    ("dec_conv1b", 32, 16),
    ("dec_conv0", 16, 3),
]


def random_weights(path, seed=1):
    """Uniform, of He's variance for ReLU; a positive last bias, so that little is cut off at 0."""
    from safetensors.numpy import save_file

    random, tensors = np.random.default_rng(seed), {}
    for name, cin, cout in BASE:
        limit = math.sqrt(6 / (9 * cin))
        tensors[f"{name}.weight"] = random.uniform(-limit, limit, (cout, cin, 3, 3)).astype(np.float32)
        tensors[f"{name}.bias"] = random.uniform(-0.05, 0.05, cout).astype(np.float32)
    tensors["dec_conv0.weight"] *= 0.1
    tensors["dec_conv0.bias"] += 0.3
    metadata = {"architecture": "base", "inputs": "radiance,albedo,normal", "transfer": "pu"}
    save_file(tensors, path, metadata=metadata)


def read_exr(path, names):
    """The same without the attributes."""
    return read_exr_and_attributes(path, names)[0]


def read_exr_and_attributes(path, names):
    """Channels of an uncompressed or ZIP scanline EXR with 32-bit floats, as limpid writes them: (height, width, names); its attributes."""
    import struct
    import zlib

    data, at, attributes = Path(path).read_bytes(), 8, {}
    text = lambda at: (data[at : data.index(0, at)].decode(), data.index(0, at) + 1)
    while data[at]:
        name, at = text(at)
        _, at = text(at)
        size = struct.unpack_from("<i", data, at)[0]
        attributes[name], at = data[at + 4 : at + 4 + size], at + 4 + size
    channels, c = [], attributes["channels"]
    while c[0]:
        end = c.index(0)
        channels.append(c[:end].decode())
        c = c[end + 17 :]
    x0, y0, x1, y1 = struct.unpack("<4i", attributes["dataWindow"])
    width, height, lines = x1 - x0 + 1, y1 - y0 + 1, {0: 1, 2: 1, 3: 16}[attributes["compression"][0]]
    rows, at = [], at + 1
    for offset in struct.unpack_from(f"<{-(-height // lines)}Q", data, at):
        _, size = struct.unpack_from("<ii", data, offset)
        block, count = data[offset + 8 : offset + 8 + size], min(lines, height - len(rows))
        if size < count * width * 4 * len(channels):
            # Deltas of bytes, the even ones before the odd ones.
            coded = np.frombuffer(zlib.decompress(block), np.uint8).astype(np.int64)
            coded[1:] -= 128
            coded = (np.cumsum(coded) & 255).astype(np.uint8)
            half = (len(coded) + 1) // 2
            plain = np.empty_like(coded)
            plain[0::2], plain[1::2] = coded[:half], coded[half:]
            block = plain.tobytes()
        rows.extend(np.frombuffer(block, "<f4").reshape(count, len(channels), width))
    image = np.stack(rows)
    return np.ascontiguousarray(np.stack([image[:, channels.index(name)] for name in names], axis=-1)), attributes


def write_exr(path, pixels):
    """R, G, B of (height, width, 3) as an uncompressed scanline EXR with 32-bit floats."""
    import struct

    height, width, _ = pixels.shape
    channels = b"".join(name + struct.pack("<BiB3xii", 0, 2, 0, 1, 1) for name in (b"B", b"G", b"R")) + b"\0"
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    attributes = [
        (b"channels", b"chlist", channels),
        (b"compression", b"compression", b"\0"),
        (b"dataWindow", b"box2i", box),
        (b"displayWindow", b"box2i", box),
        (b"lineOrder", b"lineOrder", b"\0"),
        (b"pixelAspectRatio", b"float", struct.pack("<f", 1)),
        (b"screenWindowCenter", b"v2f", struct.pack("<2f", 0, 0)),
        (b"screenWindowWidth", b"float", struct.pack("<f", 1)),
    ]
    header = struct.pack("<ii", 20000630, 2)
    header += b"".join(b"\0".join([name, kind, struct.pack("<i", len(v)) + v]) for name, kind, v in attributes) + b"\0"
    row = 8 + width * 12
    offsets = b"".join(struct.pack("<Q", len(header) + 8 * height + row * y) for y in range(height))
    planar = np.ascontiguousarray(pixels[..., ::-1].transpose(0, 2, 1), dtype="<f4")
    rows = b"".join(struct.pack("<ii", y, width * 12) + planar[y].tobytes() for y in range(height))
    Path(path).write_bytes(header + offsets + rows)


def exact_pixels(source):
    """As src/denoise/exact.rs has them."""
    channels, attributes = read_exr_and_attributes(source, ["R", "G", "B", *IMAGES["albedo"]])
    own = channels[..., 3:].sum(axis=-1) == 0
    if attributes.get("aa") == b"false":
        return own
    height, width = own.shape
    padded = np.pad(own, 1, constant_values=True)
    around = np.all([padded[y : y + height, x : x + width] for y in range(3) for x in range(3)], axis=0)
    return own & (around | (channels[..., :3].max(axis=-1) > 0))


def filter_file(source, target):
    """Open Image Denoise by itself."""
    images = {name: read_exr(source, names) for name, names in {**IMAGES, "color": ["R", "G", "B"]}.items()}
    result, exact = filtered(images), exact_pixels(source)
    result[exact] = images["color"][exact]
    write_exr(target, result)


def filtered(images, tza=None):
    """What Open Image Denoise makes of the images, with its own weights or those in the bytes of a TZA file."""
    import ctypes

    import pyoidn

    library = Path(pyoidn.__file__).parent / "oidn" / "lib"
    # pyoidn has no call for a filter's data: by the library that it loads.
    shared = next(iter(sorted(library.glob("libOpenImageDenoise.so*")) + sorted(library.glob("libOpenImageDenoise*.dylib"))))
    result = np.zeros_like(images["color"])
    with pyoidn.Device(pyoidn.OIDN_DEVICE_TYPE_CPU) as device:
        device.commit()
        with pyoidn.Filter(device, pyoidn.OIDN_FILTER_TYPE_RT) as rt:
            for name, pixels in {**images, "output": result}.items():
                rt.set_image(name, pixels, pyoidn.OIDN_FORMAT_FLOAT3)
            rt.set_bool("hdr", True)
            rt.set_quality(pyoidn.OIDN_QUALITY_HIGH)
            if tza:
                set_data = ctypes.CDLL(str(shared)).oidnSetSharedFilterData
                set_data.restype, set_data.argtypes = None, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p, ctypes.c_size_t]
                from pyoidn.capi import oidn_ffi

                handle = int(oidn_ffi.cast("uintptr_t", rt._filter))
                blob = ctypes.create_string_buffer(tza, len(tza))
                set_data(handle, b"weights", blob, len(tza))
            rt.commit()
            rt.execute()
        error = device.get_error()
    if error:
        sys.exit(f"Open Image Denoise: {error}")
    return result


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--limpid", default="target/release/limpid")
    parser.add_argument("--weights")
    parser.add_argument("--scene", default="spheres:90000")
    parser.add_argument("--size", default="768x512")
    parser.add_argument("--spp", default="16")
    parser.add_argument("--keep", help="folder for the pictures")
    parser.add_argument("--filter", nargs=2, metavar=("IN.exr", "OUT.exr"))
    args = parser.parse_args()
    if args.filter:
        return filter_file(*args.filter)
    limpid = lambda *words: subprocess.run([args.limpid, *map(str, words)], check=True, stdout=subprocess.PIPE).stdout
    with tempfile.TemporaryDirectory() as temporary:
        directory = Path(args.keep or temporary)
        directory.mkdir(parents=True, exist_ok=True)
        weights = args.weights
        if not weights:
            weights = directory / "random.safetensors"
            random_weights(weights)
        limpid("render", args.scene, "--size", args.size, "--spp", args.spp, "-o", directory / "noisy.exr")
        limpid("weights", "convert", weights, directory / "weights.tza")
        limpid("weights", "convert", directory / "weights.tza", directory / "rounded.safetensors")
        limpid("denoise", directory / "noisy.exr", "-o", directory / "limpid.exr", "--weights", directory / "rounded.safetensors")
        limpid("denoise", directory / "noisy.exr", "-o", directory / "fp32.exr", "--weights", weights)
        images = {name: read_exr(directory / "limpid.exr", names) for name, names in IMAGES.items()}
        ours = read_exr(directory / "limpid.exr", ["R", "G", "B"])
        unrounded = read_exr(directory / "fp32.exr", ["R", "G", "B"])
        theirs = filtered(images, (directory / "weights.tza").read_bytes())
        if args.keep:
            np.save(directory / "oidn.npy", theirs)
    noisy = images["color"]
    reconstructed = images["albedo"].sum(axis=-1) > 0
    smape = lambda a, b: float((np.abs(a - b) / (np.abs(a) + np.abs(b) + 0.01))[reconstructed].mean())
    report = {
        "scene": args.scene,
        "size": args.size,
        "weights": str(args.weights or "random"),
        "pixels": int(reconstructed.sum()),
        "largest_radiance": float(noisy.max()),
        "pixels_above_1": int((noisy.max(axis=-1) > 1).sum()),
        "output_at_zero": float((ours[reconstructed] == 0).mean()),
        "smape_noisy": smape(ours, noisy),
        "smape_fp32_weights": smape(unrounded, theirs),
        "smape": smape(ours, theirs),
        "largest_difference": float(np.abs(ours - theirs)[reconstructed].max()),
    }
    print(json.dumps(report, indent=2))
    if not report["smape"] <= LIMIT:
        sys.exit(f"the pictures differ: mean SMAPE {report['smape']:.5f}, allowed {LIMIT}")


if __name__ == "__main__":
    main()
