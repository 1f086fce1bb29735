"""Relight 3D captures in latent token space.

    import lumitokens as lt

    model = lt.load()
    scene = lt.demo_scene()                   # or lt.open_scene("capture")
    tokens = model.encode(scene)
    lit = model.edit(tokens, set=[lt.Point((3, -2, 2), power=1000)])
    images = model.render(lit, scene.orbit(8, side=tokens.side))

Conventions: the world is right-handed with z up; cameras have OpenCV's axes (x right, y down, z forward) and camera-to-world
poses; lights are in Blender's units (watts, radiance for environments). Images are float32 arrays, height × width × channels.
Radiance is linear Rec. 709 and premultiplied by alpha; `to_display` makes sRGB over white of it.

Arrays go in as NumPy's own or as anything with `__dlpack__` in CPU memory (torch, jax), without a copy where they are contiguous
float32 already. Work on the model leaves the interpreter free and ends on Ctrl-C.
"""

from ._errors import (
    FileError,
    FormatError,
    InputError,
    LumiError,
    LumiWarning,
    ModelError,
    UnsupportedError,
)
from ._lumitokens import (
    VERSION as __version__,
    Area,
    Camera,
    Environment,
    Light,
    Model,
    Point,
    Report,
    Scene,
    SceneTokens,
    Spot,
    Studio,
    Sun,
    View,
    compare,
    demo_evaluation,
    demo_scene,
    evaluate,
    formats,
    load,
    open_scene,
    read_display,
    read_linear,
    score,
    studio,
    to_display,
    write_exr,
    write_png,
)

__all__ = [
    "Area",
    "Camera",
    "Environment",
    "FileError",
    "FormatError",
    "InputError",
    "Light",
    "LumiError",
    "LumiWarning",
    "Model",
    "ModelError",
    "Point",
    "Report",
    "Scene",
    "SceneTokens",
    "Spot",
    "Studio",
    "Sun",
    "UnsupportedError",
    "View",
    "__version__",
    "compare",
    "demo_evaluation",
    "demo_scene",
    "evaluate",
    "formats",
    "load",
    "open_scene",
    "read_display",
    "read_linear",
    "score",
    "studio",
    "to_display",
    "write_exr",
    "write_png",
]
