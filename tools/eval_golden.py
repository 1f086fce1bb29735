#!/usr/bin/env python3
"""Golden values for the tests of crates/eval, computed independently of it.

Needs numpy, scipy, scikit-image, Pillow, safetensors and OpenEXR (pip install in a virtual environment).

    eval_golden.py ssim                           -> crates/eval/tests/golden/ssim.json
    eval_golden.py row PREDICTIONS --lpips-golden lpips_golden.json --lpips-images DIR
                                                  -> crates/eval/tests/golden/row.json

`row` recomputes what `lumi score PREDICTIONS assets/demo --protocol multi-view` reports for its object. PREDICTIONS
were saved by `lumi eval assets/demo --protocol multi-view --out DIR --save-images` and are committed in
crates/eval/tests/golden/predictions. PSNR is numpy, SSIM is scikit-image's, LPIPS is AlexNet written out in numpy,
which is first held against published values of the reference implementation (--lpips-golden).
"""

import argparse
import json
from pathlib import Path

import numpy as np
from PIL import Image
from safetensors.numpy import load_file
from skimage.metrics import structural_similarity

ROOT = Path(__file__).resolve().parent.parent
GOLDEN = ROOT / "crates/eval/tests/golden"


# --- colour -----------------------------------------------------------------------------------------------------


def encode(v):
    v = np.clip(v, 0, 1)
    return np.where(v <= 0.0031308, 12.92 * v, 1.055 * np.power(v, 1 / 2.4) - 0.055)


def decode(v):
    v = np.clip(v, 0, 1)
    return np.where(v <= 0.04045, v / 12.92, np.power((v + 0.055) / 1.055, 2.4))


# --- SSIM -------------------------------------------------------------------------------------------------------


def pattern(width, height, k):
    """A picture that both languages can make exactly: whole numbers from 0 to 255."""
    x, y, c = np.meshgrid(np.arange(width), np.arange(height), np.arange(3), indexing="xy")
    return ((x * 7 + y * 13 + c * 29 + k * ((x * y) % 11) * 5 + k * x * x) % 256) / 255.0


def gaussian_ssim(a, b, full=False):
    return structural_similarity(
        a, b, data_range=1, channel_axis=-1, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, full=full
    )


def ssim():
    cases = []
    for width, height, ka, kb in [(11, 11, 0, 1), (32, 32, 0, 1), (37, 23, 1, 2), (64, 48, 2, 3), (128, 128, 1, 1)]:
        a, b = pattern(width, height, ka), pattern(width, height, kb)
        if ka == kb:  # almost alike
            b = np.clip(b + 4 / 255 * ((np.arange(width)[None, :, None] % 3) - 1), 0, 1)
            b = np.round(b * 255) / 255
        mean, full = gaussian_ssim(a, b, full=True)
        cases.append({
            "width": width, "height": height, "a": ka, "b": kb,
            "gaussian": float(mean),
            "gaussian_map_mean": float(full.mean()),
            "uniform": float(structural_similarity(a, b, data_range=1, channel_axis=-1)),
        })
    write("ssim.json", cases)


# --- LPIPS ------------------------------------------------------------------------------------------------------


class Lpips:
    """AlexNet LPIPS v0.1 in numpy; images are [h, w, 3] in [0, 1]."""

    layers = [("features.0", 4, 2), "tap", "pool", ("features.3", 1, 2), "tap", "pool", ("features.6", 1, 1), "tap",
              ("features.8", 1, 1), "tap", ("features.10", 1, 1), "tap"]

    def __init__(self, path):
        self.w = {k: v.astype(np.float32) for k, v in load_file(path).items()}

    def features(self, image):
        x = (2 * image - 1).astype(np.float32)
        x = (x - np.float32([-0.030, -0.088, -0.188])) / np.float32([0.458, 0.448, 0.450])
        taps = []
        for layer in self.layers:
            if layer == "tap":
                taps.append(x)
            elif layer == "pool":
                h, w = (x.shape[0] - 3) // 2 + 1, (x.shape[1] - 3) // 2 + 1
                parts = [x[i:i + 2 * h - 1:2, j:j + 2 * w - 1:2] for i in range(3) for j in range(3)]
                x = np.max(parts, axis=0)
            else:
                name, stride, pad = layer
                x = np.maximum(self.conv(x, name, stride, pad), 0)
        return taps

    def conv(self, x, name, stride, pad):
        weight, bias = self.w[name + ".weight"], self.w[name + ".bias"]
        k = weight.shape[2]
        x = np.pad(x, ((pad, pad), (pad, pad), (0, 0)))
        windows = np.lib.stride_tricks.sliding_window_view(x, (k, k), axis=(0, 1))[::stride, ::stride]
        return np.einsum("hwcij,ocij->hwo", windows, weight, optimize=True) + bias

    def __call__(self, a, b):
        total = 0.0
        for i, (fa, fb) in enumerate(zip(self.features(a), self.features(b))):
            unit = lambda f: f / (np.sqrt((f * f).sum(-1, keepdims=True)) + 1e-10)
            weights = self.w[f"lin{i}.model.1.weight"].reshape(-1)
            total += float((((unit(fa) - unit(fb)) ** 2) * weights).sum(-1).mean())
        return total

    def check(self, golden, images):
        known = json.loads(Path(golden).read_text())["values"]["alexnet_fp16weights"]
        x, y = np.meshgrid(np.arange(64), np.arange(64))
        gradient = np.stack([x / 63, y / 63, (x + y) / 126], -1)
        checker = np.repeat(((x // 8 + y // 8) % 2)[..., None], 3, -1).astype(float)
        half = np.full((64, 64, 3), 0.5)
        load = lambda n: np.asarray(Image.open(Path(images) / f"ex_{n}.png").convert("RGB")) / 255.0
        found = {
            "gradient_vs_checker": self(gradient, checker),
            "zeros_vs_ones": self(half, half + 0.5),
            "ref_p0": self(load("ref"), load("p0")),
            "ref_p1": self(load("ref"), load("p1")),
        }
        for name, value in found.items():
            print(f"LPIPS {name}: {value:.6f}, published {known[name]:.6f}")
            assert abs(value - known[name]) < 1e-4, name


# --- one object's row -------------------------------------------------------------------------------------------


def exr(path):
    import OpenEXR

    with OpenEXR.File(str(path)) as file:
        channels = file.channels()
        return np.asarray(channels["RGBA"].pixels, dtype=np.float64)


def truth(folder, view, lighting, side):
    """sRGB(clip(sum of gain * straight)) * A + (1 - A), after a box average of premultiplied colour and alpha."""
    total = None
    for light, gain in lighting.items():
        image = exr(folder / f"{view}_{light}.exr")
        k = image.shape[0] // side
        image = image.reshape(side, k, side, k, 4).mean((1, 3))
        total = image[..., :3] * gain if total is None else total + image[..., :3] * gain
        alpha = image[..., 3:]
    straight = np.divide(total, alpha, out=np.zeros_like(total), where=alpha > 0)
    return encode(straight) * alpha + (1 - alpha), alpha[..., 0]


def scale(pairs, scalar):
    """Least squares in linear colour, weighted by the truth's alpha."""
    pt = sum((a[..., None] * decode(p) * decode(t)).sum((0, 1)) for p, t, a in pairs)
    pp = sum((a[..., None] * decode(p) ** 2).sum((0, 1)) for p, t, a in pairs)
    return np.full(3, pt.sum() / pp.sum()) if scalar else pt / pp


def scaled(p, a, s):
    a = a[..., None]
    return a * encode(s * decode(p)) + (1 - a) * p


def psnr(error):
    return float(-10 * np.log10(max(np.mean(error ** 2), 1e-10)))


def metrics(pairs, lpips, object_only):
    rows = []
    for p, t, a in pairs:
        inside = a > 0.5
        keep = inside if object_only else np.ones_like(inside)
        masked = np.where(keep[..., None], p, t)
        mean, full = gaussian_ssim(masked, t, full=True)
        rows.append({
            "psnr": psnr((p - t)[keep]),
            "psnr_linear": psnr((decode(p) - decode(t))[keep]),
            "ssim": float(full[keep].mean() if object_only else mean),
            "lpips": lpips(masked, t),
        })
    return {k: float(np.mean([r[k] for r in rows])) for k in rows[0]}


def row(predictions, lpips):
    data = ROOT / "assets/demo"
    (name, cases), = json.loads((data / "manifest.json").read_text())["objects"].items()
    views = cases["inputs"][::2]
    found, spreads = {}, []
    for target, lighting in cases["targets"].items():
        pairs = []
        for view in views:
            p = np.asarray(Image.open(predictions / name / target / f"{view}.png").convert("RGB")) / 255.0
            pairs.append((p, *truth(data / name, view, lighting, p.shape[0])))
        variants = {"raw": pairs}
        for suffix, scalar in [("", False), ("_scalar", True)]:
            variants["ilr" + suffix] = [(scaled(p, a, scale([(p, t, a)], scalar)), t, a) for p, t, a in pairs]
            s = scale(pairs, scalar)
            variants["slr" + suffix] = [(scaled(p, a, s), t, a) for p, t, a in pairs]
        found[target] = {k: metrics(v, lpips, False) for k, v in variants.items()}
        found[target]["object_only"] = {k: metrics(v, lpips, True) for k, v in variants.items()}
        logs = np.log([scale([pair], True)[0] for pair in pairs])
        spreads.append(float(logs.std()))

    def mean(items):
        first = items[0]
        if isinstance(first, dict):
            return {k: mean([i[k] for i in items]) for k in first}
        return float(np.mean(items))

    write("row.json", {"object": name, "spread": float(np.mean(spreads)), **mean(list(found.values()))})


def write(name, value):
    GOLDEN.mkdir(parents=True, exist_ok=True)
    path = GOLDEN / name
    path.write_text(json.dumps(value, indent=1) + "\n")
    print("wrote", path)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("ssim")
    r = commands.add_parser("row")
    r.add_argument("predictions", type=Path)
    r.add_argument("--lpips-golden", required=True)
    r.add_argument("--lpips-images", required=True)
    args = parser.parse_args()
    if args.command == "ssim":
        ssim()
    else:
        lpips = Lpips(ROOT / "assets/lpips/alexnet.fp16.safetensors")
        lpips.check(args.lpips_golden, args.lpips_images)
        row(args.predictions, lpips)


if __name__ == "__main__":
    main()
