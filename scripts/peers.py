#!/usr/bin/env python3
"""The network on PyTorch and ncnn beside limpid: same weights, same input, same machine, one run.

  python3 -m pip install torch ncnn safetensors numpy
  scripts/peers.py [--limpid target/release/limpid] [--size 768x768] [--batch 8] [--threads 2] [--skip ncnn]

Each peer's output must agree with limpid's to a relative L2 error of 1e-4 (1e-2 where it computes in fp16) before its time counts. Each configuration runs in a
process of its own, since drivers read their switches once. limpid is timed before and after the peers; a ratio is the
peer's median over the mean of both limpid medians. PyTorch runs fp32 on the CPU in both memory layouts; ncnn on the
same Vulkan driver as limpid, with its defaults and without fp16 and, where its Python binding has the option, local memory."""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ENCODER = ["enc_conv2", "enc_conv3", "enc_conv4", "enc_conv5"]
RUNS = 5
TOLERANCE = 1e-4
# ncnn's defaults compute in fp16.
TOLERANCE_FP16 = 1e-2


def timed(run, runs=RUNS):
    run()
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        run()
        times.append((time.perf_counter() - start) * 1e3)
    return {"median": statistics.median(times), "min": min(times), "max": max(times)}


def agreement(output, expected):
    import numpy as np

    output, expected = (np.asarray(v, dtype=np.float64).ravel() for v in (output, expected))
    return float(np.linalg.norm(output - expected) / np.linalg.norm(expected))


def torch_worker(args):
    import torch
    from pytorch_train import Seed
    from safetensors.torch import load_file

    torch.set_num_threads(args.threads)
    values, weights = load_file(args.values), load_file(args.weights)
    layout = torch.channels_last if args.layout == "channels_last" else torch.contiguous_format
    net = Seed()
    net.load_state_dict(weights)
    net = net.to(memory_format=layout)
    if args.task == "net":
        x = values["input"].to(memory_format=layout)
        with torch.inference_mode():
            error = agreement(net(x), values["output"])
            return {"error": error, "ms": timed(lambda: net(x))}
    torch.manual_seed(0)
    shape = (args.batch, values["input"].shape[1], 128, 128)
    x, y = torch.rand(shape).to(memory_format=layout), torch.rand((args.batch, 3, 128, 128))
    optimizer = torch.optim.Adam(net.parameters(), 1e-3, (0.9, 0.99), 1e-7)

    def step():
        optimizer.zero_grad()
        (net(x) - y).abs().mean().backward()
        optimizer.step()

    return {"error": 0.0, "ms": timed(step)}


def ncnn_model(weights, directory):
    """Writes seed.param and seed.bin: ncnn's text graph, and for each convolution a zero tag, weights and bias in fp32."""
    layers, blobs, data = [], set(), []

    def add(kind, name, inputs, outputs, *params):
        layers.append(" ".join([kind, name, str(len(inputs)), str(len(outputs)), *inputs, *outputs, *params]))
        blobs.update(outputs)

    def conv(name, x, linear=False):
        w, b = weights[f"{name}.weight"].numpy(), weights[f"{name}.bias"].numpy()
        activation = [] if linear else ["9=2", "-23310=1,0.1"]
        add("Convolution", name, [x], [name], f"0={w.shape[0]}", "1=3", "4=1", "5=1", f"6={w.size}", *activation)
        data.extend([b"\0\0\0\0", w.astype("<f4").tobytes(), b.astype("<f4").tobytes()])
        return name

    add("Input", "in0", [], ["in0"])
    x, skips = conv("enc_conv1b", conv("enc_conv1a", "in0")), []
    for name in [*ENCODER, "bottleneck"]:
        add("Split", f"split_{name}", [x], [f"{x}_skip", f"{x}_on"])
        skips.append(f"{x}_skip")
        add("Pooling", f"pool_{name}", [f"{x}_on"], [f"pool_{name}"], "0=0", "1=2", "2=2")
        x = conv(name, f"pool_{name}")
    for level in (5, 4, 3, 2, 1):
        add("Interp", f"up{level}", [x], [f"up{level}"], "0=1", "1=2.0", "2=2.0")
        add("Concat", f"cat{level}", [f"up{level}", skips.pop()], [f"cat{level}"], "0=0")
        x = conv(f"dec_conv{level}b", conv(f"dec_conv{level}a", f"cat{level}"))
    conv("out_conv", x, linear=True)
    param = Path(directory, "seed.param")
    param.write_text(f"7767517\n{len(layers)} {len(blobs)}\n" + "\n".join(layers) + "\n")
    Path(directory, "seed.bin").write_bytes(b"".join(data))
    return param


def ncnn_worker(args):
    import ncnn
    import numpy as np
    from safetensors.torch import load_file

    values, weights = load_file(args.values), load_file(args.weights)
    with tempfile.TemporaryDirectory() as directory:
        param = ncnn_model(weights, directory)
        net = ncnn.Net()
        net.opt.use_vulkan_compute = args.layout != "cpu"
        net.opt.num_threads = args.threads
        if args.layout != "default":
            for option in ("use_fp16_packed", "use_fp16_storage", "use_fp16_arithmetic", "use_bf16_packed", "use_bf16_storage",
                           "use_shader_local_memory"):
                # Not every version's Python binding has every option.
                if hasattr(net.opt, option):
                    setattr(net.opt, option, False)
        net.load_param(str(param))
        net.load_model(str(param.with_suffix(".bin")))
    x = ncnn.Mat(np.ascontiguousarray(values["input"][0].numpy()))

    def run():
        extractor = net.create_extractor()
        extractor.input("in0", x)
        return np.array(extractor.extract("out_conv")[1])

    return {"error": agreement(run(), values["output"]), "ms": timed(run, 3)}


def worker(args, peer, layout, task, extra=None):
    env = {**os.environ, **(extra or {})}
    command = [sys.executable, __file__, "--worker", peer, "--layout", layout, "--task", task, "--values", args.values,
               "--weights", args.weights, "--threads", str(args.threads), "--batch", str(args.batch)]
    done = subprocess.run(command, env=env, capture_output=True, text=True)
    if done.returncode != 0:
        print(f"{peer} {layout} {task}: {done.stderr.strip().splitlines()[-1:] or 'failed'}", file=sys.stderr)
        return None
    return json.loads(done.stdout.strip().splitlines()[-1])


def limpid(args, *command):
    done = subprocess.run([args.limpid, "bench", *command, "--weights", args.weights, "--json"], check=True, capture_output=True, text=True)
    return json.loads(done.stdout)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--limpid", default="target/release/limpid")
    parser.add_argument("--weights", default="weights/seed.safetensors")
    parser.add_argument("--size", default="768x768")
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--skip", nargs="*", default=[], choices=["torch", "ncnn", "train"])
    for hidden in ("--worker", "--layout", "--task", "--values"):
        parser.add_argument(hidden, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.worker:
        print(json.dumps({"torch": torch_worker, "ncnn": ncnn_worker}[args.worker](args)))
        return
    with tempfile.TemporaryDirectory() as directory:
        args.values = str(Path(directory, "values.safetensors"))
        net = ("net", "--size", args.size, "--values", args.values)
        rows = []

        def add(name, result):
            if result is None:
                rows.append((name, None, "did not run"))
            elif result["error"] > (TOLERANCE_FP16 if "fp16" in name else TOLERANCE):
                rows.append((name, None, f"output off by {result['error']:.1e}: not timed"))
            else:
                rows.append((name, result["ms"], f"agrees to {result['error']:.1e}"))
            print(f"  {name}: {rows[-1][1:]}", file=sys.stderr)

        before = limpid(args, *net)["rows"][0]
        plain = limpid(args, "net", "--size", args.size, "--plan", "unfused")["rows"][0]
        train_before = limpid(args, "train", "--batch", str(args.batch))["rows"][0] if "train" not in args.skip else None
        if "torch" not in args.skip:
            for layout in ("contiguous", "channels_last"):
                add(f"PyTorch fp32 CPU, {layout}", worker(args, "torch", layout, "net"))
        train = []
        if train_before:
            train = [(layout, worker(args, "torch", layout, "train")) for layout in ("contiguous", "channels_last")]
        if "ncnn" not in args.skip:
            # Mesa's disk cache does not tell vector widths apart.
            for width in ("256", "512"):
                env = {"LP_NATIVE_VECTOR_WIDTH": width, "MESA_SHADER_CACHE_DIR": str(Path(directory, width))}
                for layout in ("default", "plain"):
                    add(f"ncnn Vulkan, {'defaults (fp16)' if layout == 'default' else 'fp32'}, {width} bits", worker(args, "ncnn", layout, "net", env))
            add("ncnn CPU", worker(args, "ncnn", "cpu", "net"))
        after = limpid(args, *net)["rows"][0]
        ours = (before["ms"]["median"] + after["ms"]["median"]) / 2
        print(f"{args.size}, {args.threads} threads; limpid {before['ms']['median']:.0f} and {after['ms']['median']:.0f} ms, "
              f"{before['gflops']:.0f} GFLOP/s; unfused {plain['ms']['median']:.0f} ms ({plain['ms']['median'] / ours:.2f}x)")
        for name, ms, note in rows:
            text = f"{ms['median']:8.0f} ms ({ms['min']:.0f} to {ms['max']:.0f}), {ms['median'] / ours:6.2f}x limpid's time" if ms else ""
            print(f"{name:36}{text} {note}")
        if train_before:
            train_after = limpid(args, "train", "--batch", str(args.batch))["rows"][0]
            ours = (train_before["ms"]["median"] + train_after["ms"]["median"]) / 2
            print(f"training step, batch {args.batch} of 128x128: limpid {train_before['ms']['median']:.0f} and "
                  f"{train_after['ms']['median']:.0f} ms, {train_before['gflops']:.0f} GFLOP/s")
            for layout, result in train:
                if result:
                    print(f"PyTorch, {layout:23}{result['ms']['median']:8.0f} ms, {result['ms']['median'] / ours:6.2f}x limpid's time")


if __name__ == "__main__":
    main()
