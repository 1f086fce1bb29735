"""Scores folders of pictures that other methods saved, side by side.

    python score.py TRUTH NAME=PREDICTIONS [NAME=PREDICTIONS ...]

TRUTH is a data set that `lumi eval` takes, or a folder of pictures; predictions lie in PREDICTIONS/OBJECT/CASE/VIEW.png.
Without arguments it makes up a method, the input view that is nearest, and scores that on the bundled scene.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np

import lumitokens as lt


def nearest_view(scene: lt.Scene, folder: Path, cases: dict, side: int) -> None:
    """Saves for every held-out view the input photograph whose direction is closest, whatever the light."""
    seen = scene.under(cases["source"])
    inputs = [view for view in seen.views if view.name in cases["inputs"]]
    forward = np.stack([view.camera.pose[:3, 2] for view in inputs])
    views = {view.name: view for view in scene.views}
    for case in cases["targets"]:
        place = folder / "spot" / case
        place.mkdir(parents=True)
        for name in cases["views"]:
            view = inputs[int(np.argmax(forward @ views[name].camera.pose[:3, 2]))]
            # Averages over blocks of pixels.
            step = view.camera.width // side
            small = view.image.reshape(side, step, side, step, 3).mean(axis=(1, 3))
            lt.write_png(place / f"{name}.png", small)


if len(sys.argv) > 2:
    truth = Path(sys.argv[1])
    methods = dict(argument.split("=", 1) for argument in sys.argv[2:])
    print(lt.score(methods, truth))
else:
    with tempfile.TemporaryDirectory() as folder:
        truth = lt.demo_evaluation(Path(folder) / "truth")
        cases = json.loads((truth / "manifest.json").read_text())["objects"]["spot"]
        predictions = Path(folder) / "nearest"
        nearest_view(lt.open_scene(truth / "spot"), predictions, cases, side=64)
        print(lt.score({"nearest view": predictions}, truth))
