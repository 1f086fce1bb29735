#!/usr/bin/env python3
"""Writes LPIPS weights as `lumi` reads them: half precision, torchvision's and LPIPS' own names.

Needs torch, torchvision, lpips and safetensors.

    tools/lpips_weights.py vgg16 ~/.cache/lumitokens/vgg16.fp16.safetensors
"""

import argparse
from pathlib import Path


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("net", choices=["alexnet", "vgg16"])
    parser.add_argument("out", type=Path)
    args = parser.parse_args()

    import lpips
    import torchvision
    from safetensors.torch import save_file

    trained = getattr(torchvision.models, args.net)(weights="IMAGENET1K_V1").state_dict()
    tensors = {k: v for k, v in trained.items() if k.startswith("features.")}
    linear = lpips.LPIPS(net="alex" if args.net == "alexnet" else "vgg", verbose=False).state_dict()
    for i in range(5):
        tensors[f"lin{i}.model.1.weight"] = linear[f"lin{i}.model.1.weight"]
    args.out.parent.mkdir(parents=True, exist_ok=True)
    save_file({k: v.half().contiguous() for k, v in tensors.items()}, str(args.out))
    print("wrote", args.out)


if __name__ == "__main__":
    main()
