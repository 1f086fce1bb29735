"""Relights the bundled scene: a lamp, a second one from the other side, and each of them alone.

    python relight.py OUT
"""

import sys
from pathlib import Path

import lumitokens as lt

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out/python")
out.mkdir(parents=True, exist_ok=True)

model = lt.load()
scene = lt.demo_scene()
tokens = model.encode(scene)
cameras = scene.cameras("targets", side=tokens.side)[:4]

warm = lt.Point((1, -2, 3), power=800, color=(1.0, 0.7, 0.4))
cool = lt.Area((-3, 1, 2), size=2, power=400, color=(0.4, 0.6, 1.0))
lit = model.edit(tokens, set=[warm])
lit = model.edit(lit, add=[cool])

# Linear radiance with alpha, premultiplied: what a compositor wants.
radiance = model.render(lit, cameras)
for i, image in enumerate(radiance):
    lt.write_exr(out / f"view{i}.exr", image)
    lt.write_png(out / f"view{i}.png", lt.to_display(image))

# Light groups: one layer per light, whose sum is the whole, so that light can be mixed afterwards.
for name, alone in model.light_groups(lit).items():
    layer = model.render(alone, cameras[0])
    lt.write_exr(out / f"layer-{name}.exr", layer)
    print(f"{name:8} mean radiance {layer[..., :3].mean():.4f}")

model.save_tokens(lit, out / "lit.tokens")
print(f"{len(radiance)} views of {tokens.side} px in {out}")
