"""The package and the program are one: the same files, to the byte."""

import json

import numpy as np

import lumitokens as lt


def test_relighting_gives_the_files_of_the_command_line(lumi, model, scene, tokens, tmp_path):
    out, saved = tmp_path / "out", tmp_path / "cli.tokens"
    lights = ["point:1,-2,3,power=800,color=1,0.7,0.4", "area:-3,0.5,2,size=2,power=400"]
    env = f"env:{scene.path / 'env1.map.exr'},rotate=40,strength=0.5"
    lumi("relight", scene.path, "--set", env, lights[0], "--add", lights[1], "--scale", 0.5,
         "--exr", "--save-tokens", saved, "--out", out)

    point = lt.Point((1, -2, 3), power=800, color=(1, 0.7, 0.4))
    area = lt.Area((-3, 0.5, 2), size=2, power=400)
    sky = lt.Environment(scene.path / "env1.map.exr", rotate=40, strength=0.5)
    lit = model.edit(tokens, set=[sky, point])
    lit = model.edit(lit, add=area, scale=0.5)
    ours = tmp_path / "ours.tokens"
    model.save_tokens(lit, ours)
    # Every number in single precision.
    assert ours.read_bytes() == saved.read_bytes()

    views = [view.name for view in scene.views if view.role == "target"]
    cameras = scene.cameras("targets", side=lit.side)
    radiance = model.render(lit, cameras)
    assert len(views) == len(radiance) == 8
    for name, image, one in zip(views, radiance, cameras):
        lt.write_exr(tmp_path / "ours.exr", image)
        assert (tmp_path / "ours.exr").read_bytes() == (out / "views" / f"{name}.exr").read_bytes()
        lt.write_png(tmp_path / "ours.png", lt.to_display(image))
        assert (tmp_path / "ours.png").read_bytes() == (out / "views" / f"{name}.png").read_bytes()
        assert np.array_equal(model.render(lit, one), image)
    shown = model.render(lit, cameras, display=True)
    assert np.array_equal(shown, lt.to_display(radiance))

    # Text is read as the command line reads it.
    again = model.edit(model.edit(tokens, set=[env, lights[0]]), add=lights[1]).scaled(0.5)
    assert np.array_equal(model.token_values(again), model.token_values(lit))
    assert np.array_equal(model.render(model.load_tokens(saved), cameras[0]), radiance[0])


def test_scores_are_those_of_the_command_line(lumi, model, evaluation, tmp_path):
    report, out = tmp_path / "eval.json", tmp_path / "eval"
    lumi("eval", evaluation, "--protocol", "multi-view", "--save-images", "--out", out, "--json", report)
    evaluated = lt.evaluate(model, evaluation, protocol="multi-view")
    assert evaluated.to_dict() == json.loads(report.read_text())
    assert evaluated["slr"]["psnr"] > 15

    predictions, scored = out / "predictions", tmp_path / "scored"
    lumi("score", evaluation, "--method", f"ours={predictions}", "--protocol", "multi-view", "--out", scored)
    found = lt.score({"ours": predictions}, evaluation, protocol="multi-view")
    assert found.to_dict() == json.loads((scored / "report.json").read_text())
    assert found.markdown() == (scored / "report.md").read_text()
    lt.write_png(tmp_path / "grid.png", found.grid())
    assert (tmp_path / "grid.png").read_bytes() == (scored / "grid.png").read_bytes()
    single = lt.score(predictions, evaluation, protocol="multi-view")
    assert single.to_dict() == found["methods"][0]["report"]


def test_the_program_is_the_program(lumi):
    assert lumi("--version").stdout.strip() == f"lumi {lt.__version__}"
    assert "Usage: lumi" in lumi("--help").stdout
    assert "lumi score" in lumi("score", status=2).stderr
    assert "error: " in lumi("relight", "nowhere", "--out", "x", status=1).stderr
