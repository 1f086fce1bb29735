"""What a user of the package meets: arrays, scenes, errors, interruption, the studio."""

import importlib.util
import inspect
import signal
import subprocess
import sys
import threading
import time
import urllib.request
import _thread

import numpy as np
import pytest

import lumitokens as lt


class Capsule:
    """An array that is none of NumPy's, as tensors of other libraries are."""

    def __init__(self, array):
        self.array = array

    def __dlpack__(self, **how):
        return self.array.__dlpack__(**how)

    def __dlpack_device__(self):
        return self.array.__dlpack_device__()


def test_display_encoding_is_the_documented_one():
    image = np.zeros((2, 3, 4), np.float32)
    image[0, 0] = [0.25, 0.5, 2.0, 0.5]
    image[0, 1] = [0.001, 0.2, 0.0, 1.0]
    straight = np.clip(image[..., :3] / np.maximum(image[..., 3:], 1e-9), 0, 1)
    encoded = np.where(straight <= 0.0031308, 12.92 * straight, 1.055 * straight ** (1 / 2.4) - 0.055)
    expected = encoded * image[..., 3:] + 1 - image[..., 3:]
    shown = lt.to_display(image)
    assert shown.dtype == np.float32 and shown.shape == (2, 3, 3)
    assert np.allclose(shown, expected, atol=1e-5)
    assert np.array_equal(lt.to_display(image[None]), shown[None])


def test_arrays_of_other_libraries_and_layouts_are_taken():
    image = np.random.default_rng(0).random((4, 5, 4), np.float32)
    shown = lt.to_display(image)
    assert np.array_equal(lt.to_display(Capsule(image)), shown)
    assert np.array_equal(lt.to_display(np.asfortranarray(image)), shown)
    assert np.array_equal(lt.to_display(image.astype(np.float64)), shown)
    assert np.array_equal(lt.to_display(image.tolist()), shown)
    for wrong in [image[..., :2], image[0], np.zeros((4, 5, 3), np.int32), np.zeros((0, 5, 3))]:
        with pytest.raises(lt.InputError, match="image"):
            lt.to_display(wrong)


def test_image_files_come_back(tmp_path):
    image = np.random.default_rng(1).random((6, 7, 4)).astype(np.float16).astype(np.float32)
    lt.write_exr(tmp_path / "a.exr", image)
    assert np.array_equal(lt.read_linear(tmp_path / "a.exr"), image)
    bytes_ = np.random.default_rng(2).integers(0, 256, (6, 7, 3), dtype=np.uint8)
    lt.write_png(tmp_path / "a.png", bytes_)
    assert np.array_equal(np.rint(lt.read_display(tmp_path / "a.png") * 255), bytes_)


def test_lights_say_what_they_are(model, tokens):
    point = lt.Point((3, -2, 2), color=(1, 0.5, 0.25))
    assert (point.kind, point.power, point.color) == ("point", 1000, [1, 0.5, 0.25])
    assert point.scaled(2).color == [2, 1, 0.5]
    assert point == lt.Point((3, -2, 2), 1000, (1, 0.5, 0.25)) and point != lt.Point((3, -2, 2))
    area = lt.Area((0, 0, 4), size=2)
    assert area.direction == [0, 0, -1] and isinstance(area.scaled((1, 0, 0)), lt.Area)
    spot = lt.Spot((0, -4, 0), angle=30, power=200)
    assert (spot.kind, spot.angle, spot.blend, spot.direction) == ("spot", 30, np.float32(0.15), [0, 1, 0])
    sun = lt.Sun((0, 0, 2), strength=3)
    assert sun.toward == [0, 0, 1] and sun.scaled(2).color == [2, 2, 2]
    for light, text in [(spot, "spot:0,-4,0,angle=30,power=200"), (sun, "sun:0,0,2,strength=3")]:
        ours, theirs = (model.token_values(model.edit(tokens, set=one)) for one in (light, text))
        assert np.array_equal(ours, theirs)
    for wrong in (lambda: lt.Sun((0, 0, 0)), lambda: lt.Spot((1, 2, 3), target=(1, 2, 3))):
        with pytest.raises(lt.InputError, match="target|toward"):
            wrong()
    radiance = np.random.default_rng(3).random((8, 16, 3), np.float32)
    sky = lt.Environment(radiance, rotate=90, strength=(1, 2, 3))
    assert np.array_equal(sky.map, radiance) and sky.strength == [1, 2, 3]
    assert np.allclose(sky.rotation @ [1, 0, 0], [0, 1, 0], atol=1e-6)
    assert np.isfinite(model.token_values(model.edit(tokens, set=sky))).all()
    with pytest.raises(lt.InputError, match="map"):
        lt.Environment(-radiance)


def test_power_is_linear_and_groups_add_up(model, scene, tokens):
    camera = scene.cameras("targets", side=tokens.side)[0]
    one, other = lt.Point((1, -2, 3), power=800), lt.Area((-3, 0, 2), size=2)
    lit = model.edit(tokens, set=one)
    twice = model.render(model.edit(tokens, set=lt.Point((1, -2, 3), power=1600)), camera)
    image = model.render(lit, camera)
    assert image.shape == (tokens.side, tokens.side, 4) and image.dtype == np.float32
    assert np.allclose(twice[..., :3], 2 * image[..., :3], rtol=1e-3, atol=1e-4)
    assert np.array_equal(twice[..., 3], image[..., 3])
    both = model.edit(lit, add=other)
    groups = model.light_groups(both)
    assert list(groups) == ["1-point", "2-area"]
    assert np.array_equal(model.render(groups["1-point"], camera), image)
    assert both.history == ["encode 8 views", "set point", "add area"]
    values = model.token_values(lit)
    same = model.with_token_values(lit, values)
    assert np.array_equal(model.render(same, camera), image)
    with pytest.raises(lt.InputError, match="does not say the lights"):
        model.light_groups(same)


def test_scenes_from_arrays_are_scenes(model, scene, tmp_path):
    lit = scene.under({"env0": 0.55})
    views = [view for view in lit.views if view.role == "input"]
    alpha = np.stack([view.alpha for view in views])[..., None]
    shown = np.stack([view.image for view in views])
    straight = np.divide(shown - (1 - alpha), alpha, out=np.zeros_like(shown), where=alpha > 0)
    cameras = [view.camera for view in views]
    made = lt.Scene.from_arrays(np.concatenate([straight, alpha], axis=-1), cameras,
                                center=scene.center, radius=scene.radius)
    assert [view.role for view in made.views] == ["input"] * len(views)
    assert np.allclose(made.views[0].image, shown[0], atol=1e-5)
    told, plain = model.encode(lit, captured_light=None), model.encode(made)
    assert np.allclose(model.token_values(told), model.token_values(plain), atol=0.05)
    made.write(tmp_path / "capture")
    assert len(lt.open_scene(tmp_path / "capture").views) == len(views)
    with pytest.raises(lt.FormatError, match="empty folder"):
        made.write(tmp_path / "capture")
    with pytest.raises(lt.InputError, match="images"):
        lt.Scene.from_arrays(straight[:2], cameras)
    assert isinstance(scene.check(), dict) and "transforms" in lt.formats()


def test_cameras_convert_and_refuse():
    camera = lt.Camera.look_at((3, 0, 1), fov=40, width=64)
    same = lt.Camera(camera.pose, fx=camera.intrinsics[0, 0], fy=camera.intrinsics[1, 1], cx=32, cy=32,
                     width=64, height=64)
    assert same == camera
    gl = camera.pose @ np.diag([1, -1, -1, 1]).astype(np.float32)
    f = camera.intrinsics[0, 0]
    assert lt.Camera(gl, fx=f, fy=f, cx=32, cy=32, width=64, height=64, convention="opengl") == camera
    with pytest.raises(lt.InputError, match="camera_to_world"):
        lt.Camera(2 * np.eye(4), fx=f, fy=f, cx=32, cy=32, width=64, height=64)


def test_errors_are_of_their_kind(model, scene, tokens, tmp_path):
    empty, foreign = tmp_path / "empty", tmp_path / "foreign.tokens"
    empty.mkdir()
    model.save_tokens(tokens, foreign)
    other = "0" * len(model.fingerprint)
    foreign.write_bytes(foreign.read_bytes().replace(model.fingerprint.encode(), other.encode()))
    for kinds, text, call in [
        ((lt.FileError, OSError), "nowhere", lambda: lt.open_scene(tmp_path / "nowhere")),
        ((lt.FormatError, ValueError), "empty folder", lambda: lt.open_scene(empty)),
        ((lt.InputError, ValueError), "outside the scene", lambda: model.edit(tokens, set=lt.Point((0, 0, 0)))),
        ((lt.InputError, ValueError), "expected a light", lambda: model.edit(tokens, set="lamp:1,2,3")),
        ((lt.InputError, ValueError), "multiples", lambda: model.render(tokens, lt.Camera.look_at((3, 0, 1), width=65))),
        ((lt.InputError, ValueError), "inputs", lambda: model.encode(scene, inputs=40)),
        ((lt.InputError, ValueError), "scale", lambda: model.edit(tokens, scale=-1)),
        ((lt.ModelError,), "", lambda: lt.load(scene.path / "cameras.json")),
        ((lt.UnsupportedError,), "mean nothing", lambda: model.load_tokens(foreign)),
    ]:
        with pytest.raises(kinds[0], match=text) as caught:
            call()
        assert isinstance(caught.value, lt.LumiError) and all(isinstance(caught.value, k) for k in kinds)


def test_others_run_meanwhile_and_ctrl_c_is_answered(model, scene, tokens):
    # Where tests run in the background, Ctrl-C may be ignored.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    cameras = scene.orbit(400, side=tokens.side)
    beats = []
    stop = threading.Event()
    heart = threading.Thread(target=lambda: [beats.append(0) for _ in iter(lambda: stop.wait(0.01), True)])
    heart.start()
    threading.Timer(0.6, _thread.interrupt_main).start()
    begun = time.monotonic()
    try:
        with pytest.raises(KeyboardInterrupt):
            model.render(tokens, cameras)
        assert time.monotonic() - begun < 3
        assert len(beats) > 10
    finally:
        stop.set()
        heart.join()
        signal.signal(signal.SIGINT, before)


def test_the_studio_is_served_and_closed(scene, tmp_path):
    with lt.studio(scene, inputs=2, port=0, data=tmp_path) as studio:
        with urllib.request.urlopen(studio.url, timeout=10) as answer:
            assert answer.status == 200 and b"<html" in answer.read().lower()
    with pytest.raises(OSError):
        urllib.request.urlopen(studio.url, timeout=2)
    assert (tmp_path / "sessions").is_dir()


def test_everything_public_is_described():
    for name in lt.__all__:
        part = getattr(lt, name)
        if not callable(part):
            continue
        assert inspect.getdoc(part), name
        members = vars(part).items() if inspect.isclass(part) else []
        bare = [m for m, v in members if not m.startswith("_") and not inspect.getdoc(v)]
        assert not bare, f"{name}: {bare}"


@pytest.mark.skipif(not importlib.util.find_spec("mypy"), reason="the stubs are checked with mypy")
def test_the_stubs_are_true(tmp_path):
    check = [sys.executable, "-m", "mypy.stubtest", "lumitokens"]
    done = subprocess.run(check, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
