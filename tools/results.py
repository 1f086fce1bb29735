#!/usr/bin/env python3
"""Reruns every protocol with the bundled model and puts the tables and pictures into docs/results.md.

    tools/results.py ../shared/data/cycles [--lumi target/release/lumi] [--out out/results]

Text outside the marked blocks is written by hand and stays. A block

    <!-- table: PROTOCOL/report.md: HEADING -->
    ...
    <!-- end -->

is replaced by the table below that heading. Objects that are finished in --out are not evaluated again, so an
interrupted run goes on. Scenes and objects with many views are generated there first, out of the models beside the data.
Python's standard library is enough.
"""

import argparse
import re
import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "docs/results.md"
PICTURES = ROOT / "docs/images/results"
# `spot` is in the demo, so it is left out of the scores.
SKIP = ["--skip", "spot"]
RUNS = {
    "multi-view": ["--protocol", "multi-view", *SKIP],
    "novel-view": ["--protocol", "novel-view", *SKIP],
    "novel-view-told": ["--protocol", "novel-view", "--captured-light", *SKIP],
    "progressive": ["--protocol", "progressive", *SKIP],
    "light": ["--protocol", "light", *SKIP],
    "runtime": ["--protocol", "runtime", *SKIP],
    "runtime-small": ["--protocol", "runtime", "--preset", "small", "--repeats", "1", *SKIP],
}
# Generated data: the config's name, and with what each evaluation is called.
GENERATED = {"scenes": "eval64-scenes", "views": "eval64-views"}
INPUTS = [4, 8, 16, 32]
ON_GENERATED = {
    "scenes": ("scenes", ["--protocol", "novel-view"]),
    **{f"views-{n}": ("views", ["--protocol", "novel-view", "--inputs", str(n)]) for n in INPUTS},
}
COPIED = ["novel-view/grid.png", "novel-view/light-sweep.png", "novel-view/tone-spread.png",
          "progressive/chain-replace.png", "progressive/chain-add.png"]


def table(report, heading):
    """The table below a heading; the first one for an empty heading."""
    text = report.read_text()
    if heading:
        start = re.search(rf"^## {re.escape(heading)}.*$", text, re.M)
        if not start:
            raise SystemExit(f"{report}: expected a heading `{heading}`")
        text = text[start.end():]
    lines = []
    for line in text.splitlines():
        if line.startswith("|"):
            lines.append(line)
        elif lines:
            break
    return "\n".join(lines)


def by_inputs(out):
    """The first rows of the reports for each number of inputs, as one report."""
    rows = ["| inputs | whole images, SLR PSNR ↑ | SSIM ↑ | LPIPS ↓ | object only, SLR PSNR ↑ | SSIM ↑ | LPIPS ↓ |",
            "|---|---|---|---|---|---|---|"]
    for n in INPUTS:
        report = out / f"views-{n}/report.md"
        ours = [table(report, heading).splitlines()[2].strip("| ").split(" | ")[4:]
                for heading in ("Whole images", "Object only")]
        rows.append("| " + " | ".join([str(n), *ours[0], *ours[1]]) + " |")
    (out / "views").mkdir(exist_ok=True)
    (out / "views/report.md").write_text("\n".join(rows) + "\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", help="the folder with manifest.json and the objects")
    parser.add_argument("--lumi", default=str(ROOT / "target/release/lumi"))
    parser.add_argument("--out", type=Path, default=ROOT / "out/results")
    args = parser.parse_args()

    def lumi(*words):
        command = [args.lumi, *map(str, words)]
        print("+", " ".join(command), flush=True)
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)

    data = Path(args.data)
    for name, options in RUNS.items():
        lumi("eval", data, *options, "--out", args.out / name)
    for name, config in GENERATED.items():
        lumi("dataset", "generate", ROOT / f"configs/data/{config}.toml", "--out", args.out / "data" / name,
             "--models", data.parent / "eval_models", "--hdri", data / "hdri")
    for name, (generated, options) in ON_GENERATED.items():
        lumi("eval", args.out / "data" / generated, *options, "--out", args.out / name)
    by_inputs(args.out)
    PICTURES.mkdir(parents=True, exist_ok=True)
    for picture in COPIED:
        shutil.copy(args.out / picture, PICTURES / picture.replace("/", "-"))

    def replaced(block):
        report, heading = block.group(1), block.group(2).strip()
        return f"{block.group(0).splitlines()[0]}\n{table(args.out / report, heading)}\n<!-- end -->"

    text = RESULTS.read_text()
    text = re.sub(r"<!-- table: (\S+?):(.*?) -->\n.*?<!-- end -->", replaced, text, flags=re.S)
    RESULTS.write_text(text)
    print("wrote", RESULTS)


if __name__ == "__main__":
    main()
