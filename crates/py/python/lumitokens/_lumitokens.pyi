"""Types of the extension module; what each part does is said in its docstring."""

from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Final, Literal, Protocol, TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import disjoint_base

class _DLPack(Protocol):
    def __dlpack__(self, *, stream: Any = ...) -> Any: ...
    def __dlpack_device__(self) -> tuple[Any, int]: ...

_Array: TypeAlias = ArrayLike | _DLPack
_Float32: TypeAlias = NDArray[np.float32]
_Path: TypeAlias = str | PathLike[str]
_Vector: TypeAlias = Sequence[float]
_Channels: TypeAlias = float | Sequence[float]
_Lights: TypeAlias = Light | str | Iterable[Light | str]
_Rules: TypeAlias = Literal["paper", "stanford-orb", "objects-with-lighting"]
_Lpips: TypeAlias = Literal["alex", "vgg"]

__all__ = [
    "Area",
    "Camera",
    "Environment",
    "Light",
    "Model",
    "Point",
    "Report",
    "Scene",
    "SceneTokens",
    "Spot",
    "Studio",
    "Sun",
    "VERSION",
    "View",
    "compare",
    "demo_evaluation",
    "demo_scene",
    "evaluate",
    "formats",
    "load",
    "open_scene",
    "read_display",
    "read_linear",
    "run_program",
    "score",
    "studio",
    "to_display",
    "write_exr",
    "write_png",
]

VERSION: Final[str]

@final
class Camera:
    def __new__(
        cls,
        pose: _Array,
        *,
        fx: float,
        fy: float,
        cx: float,
        cy: float,
        width: int,
        height: int,
        convention: Literal["opencv", "opengl"] = "opencv",
    ) -> Camera: ...
    @staticmethod
    def look_at(
        eye: _Vector,
        target: _Vector = (0.0, 0.0, 0.0),
        *,
        fov: float = 50.0,
        width: int = 256,
        height: int | None = None,
    ) -> Camera: ...
    def resized(self, width: int, height: int) -> Camera: ...
    @property
    def pose(self) -> _Float32: ...
    @property
    def intrinsics(self) -> _Float32: ...
    @property
    def centre(self) -> list[float]: ...
    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...

@disjoint_base
class Light:
    @property
    def kind(self) -> str: ...
    def scaled(self, gain: _Channels) -> Light: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...

@final
class Point(Light):
    def __new__(
        cls,
        position: _Vector,
        power: float = 1000.0,
        color: _Vector = (1.0, 1.0, 1.0),
        radius: float = 0.05,
    ) -> Point: ...
    @property
    def position(self) -> list[float]: ...
    @property
    def power(self) -> float: ...
    @property
    def color(self) -> list[float]: ...
    @property
    def radius(self) -> float: ...

@final
class Area(Light):
    def __new__(
        cls,
        position: _Vector,
        target: _Vector = (0.0, 0.0, 0.0),
        size: float = 1.0,
        power: float = 1000.0,
        color: _Vector = (1.0, 1.0, 1.0),
    ) -> Area: ...
    @property
    def position(self) -> list[float]: ...
    @property
    def direction(self) -> list[float]: ...
    @property
    def size(self) -> float: ...
    @property
    def power(self) -> float: ...
    @property
    def color(self) -> list[float]: ...

@final
class Spot(Light):
    def __new__(
        cls,
        position: _Vector,
        target: _Vector = (0.0, 0.0, 0.0),
        angle: float = 45.0,
        blend: float = 0.15,
        power: float = 1000.0,
        color: _Vector = (1.0, 1.0, 1.0),
        radius: float = 0.05,
    ) -> Spot: ...
    @property
    def position(self) -> list[float]: ...
    @property
    def direction(self) -> list[float]: ...
    @property
    def angle(self) -> float: ...
    @property
    def blend(self) -> float: ...
    @property
    def power(self) -> float: ...
    @property
    def color(self) -> list[float]: ...
    @property
    def radius(self) -> float: ...

@final
class Sun(Light):
    def __new__(
        cls,
        toward: _Vector,
        strength: float = 1.0,
        angle: float = 0.526,
        color: _Vector = (1.0, 1.0, 1.0),
    ) -> Sun: ...
    @property
    def toward(self) -> list[float]: ...
    @property
    def strength(self) -> float: ...
    @property
    def angle(self) -> float: ...
    @property
    def color(self) -> list[float]: ...

@final
class Environment(Light):
    def __new__(
        cls,
        map: _Path | _Array,
        rotate: float = 0.0,
        strength: _Channels = 1.0,
    ) -> Environment: ...
    @property
    def map(self) -> _Float32: ...
    @property
    def rotation(self) -> _Float32: ...
    @property
    def strength(self) -> list[float]: ...

@final
class View:
    @property
    def name(self) -> str: ...
    @property
    def role(self) -> Literal["input", "target"]: ...
    @property
    def camera(self) -> Camera: ...
    @property
    def image(self) -> _Float32 | None: ...
    @property
    def alpha(self) -> _Float32 | None: ...
    @property
    def radiance(self) -> dict[str, _Float32]: ...

@final
class Scene:
    @staticmethod
    def from_arrays(
        images: _Array | Iterable[_Array],
        cameras: Camera | Iterable[Camera],
        *,
        center: _Vector = (0.0, 0.0, 0.0),
        radius: float = 1.0,
        name: str = "arrays",
    ) -> Scene: ...
    def under(self, lighting: Mapping[str, float]) -> Scene: ...
    def cameras(self, which: Literal["targets", "inputs", "all"], *, side: int) -> list[Camera]: ...
    def orbit(self, count: int = 24, *, side: int) -> list[Camera]: ...
    def write(
        self,
        folder: _Path,
        format: Literal["transforms", "interchange", "authors"] = "transforms",
        *,
        overwrite: bool = False,
    ) -> None: ...
    def check(self) -> dict[str, Any]: ...
    @property
    def name(self) -> str: ...
    @property
    def path(self) -> Path | None: ...
    @property
    def views(self) -> list[View]: ...
    @property
    def lights(self) -> dict[str, Light]: ...
    @property
    def center(self) -> list[float]: ...
    @property
    def radius(self) -> float: ...
    @property
    def warnings(self) -> list[str]: ...

@final
class SceneTokens:
    @property
    def side(self) -> int: ...
    @property
    def patch(self) -> int: ...
    @property
    def history(self) -> list[str]: ...
    @property
    def illumination(self) -> list[float]: ...
    @property
    def model(self) -> str: ...
    def scaled(self, factor: _Channels) -> SceneTokens: ...

@final
class Model:
    def encode(
        self,
        scene: Scene,
        *,
        inputs: int | None = None,
        source: Mapping[str, float] | None = None,
        captured_light: Literal["known"] | _Lights | None = "known",
        detail: int | None = None,
        refine: int = 0,
    ) -> SceneTokens: ...
    def edit(
        self,
        tokens: SceneTokens,
        *,
        set: _Lights | None = None,
        remove: _Lights | None = None,
        add: _Lights | None = None,
        scale: float | None = None,
        chained: bool = False,
    ) -> SceneTokens: ...
    def render(
        self,
        tokens: SceneTokens,
        cameras: Camera | Iterable[Camera],
        *,
        display: bool = False,
    ) -> _Float32: ...
    def light_groups(self, tokens: SceneTokens) -> dict[str, SceneTokens]: ...
    def save_tokens(self, tokens: SceneTokens, path: _Path) -> None: ...
    def load_tokens(self, path: _Path) -> SceneTokens: ...
    def token_values(self, tokens: SceneTokens) -> _Float32: ...
    def with_token_values(self, tokens: SceneTokens, values: _Array) -> SceneTokens: ...
    @property
    def resolution(self) -> int: ...
    @property
    def fingerprint(self) -> str: ...
    @property
    def origin(self) -> str: ...
    @property
    def modes(self) -> list[str]: ...
    @property
    def makes_radiance(self) -> bool: ...

@final
class Report:
    def to_dict(self) -> dict[str, Any]: ...
    def markdown(self) -> str: ...
    def grid(self) -> _Float32 | None: ...
    def __getitem__(self, key: str, /) -> Any: ...

@final
class Studio:
    @property
    def url(self) -> str: ...
    def close(self) -> None: ...
    def wait(self) -> None: ...
    def __enter__(self) -> Studio: ...
    def __exit__(self, *_args: object) -> None: ...

def load(
    path: _Path | None = None,
    *,
    device: str = "cpu",
    precision: Literal["bf16", "f32"] = "bf16",
) -> Model: ...
def open_scene(path: _Path, *, full_size: bool = False) -> Scene: ...
def demo_scene() -> Scene: ...
def demo_evaluation(folder: _Path) -> Path: ...
def formats() -> dict[str, str]: ...
def to_display(image: _Array) -> _Float32: ...
def read_linear(path: _Path) -> _Float32: ...
def read_display(path: _Path) -> _Float32: ...
def write_png(path: _Path, image: _Array) -> None: ...
def write_exr(path: _Path, image: _Array) -> None: ...
def score(
    predictions: _Path | Mapping[str, _Path],
    truth: _Path,
    *,
    protocol: Literal["novel-view", "multi-view"] = "novel-view",
    rules: _Rules = "paper",
    lpips: _Lpips | None = None,
    lpips_weights: _Path | None = None,
    only: Sequence[str] = (),
    skip: Sequence[str] = (),
) -> Report: ...
def evaluate(
    model: Model,
    data: _Path,
    *,
    protocol: Literal["novel-view", "multi-view", "progressive"] = "novel-view",
    rules: _Rules = "paper",
    lpips: _Lpips | None = None,
    lpips_weights: _Path | None = None,
    only: Sequence[str] = (),
    skip: Sequence[str] = (),
    inputs: int | None = None,
    captured_light: bool = False,
    out: _Path | None = None,
) -> Report: ...
def compare(
    predictions: _Array,
    truth: _Array,
    alpha: _Array | None = None,
    *,
    rules: _Rules = "paper",
    lpips: _Lpips | None = None,
    lpips_weights: _Path | None = None,
) -> dict[str, Any]: ...
def studio(
    scene: Scene | _Path | None = None,
    *,
    model: Model | None = None,
    inputs: int = 8,
    port: int = 7788,
    maps: _Path | None = None,
    data: _Path | None = None,
) -> Studio: ...
def run_program(args: Sequence[str]) -> int: ...
