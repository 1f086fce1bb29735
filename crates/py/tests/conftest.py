"""What several tests share: the bundled model and scene, and the program as it was installed beside the package."""

import subprocess
import sysconfig
from pathlib import Path

import pytest

import lumitokens as lt


@pytest.fixture(scope="session", autouse=True)
def data_folder(tmp_path_factory):
    """Keeps the user's own data folder out of it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_DATA_HOME", str(tmp_path_factory.mktemp("data")))
        yield


@pytest.fixture(scope="session")
def lumi():
    """Runs the console script and returns what became of it."""
    script = Path(sysconfig.get_path("scripts")) / "lumi"

    def run(*args, status=0):
        done = subprocess.run([script, *map(str, args)], capture_output=True, text=True, timeout=300)
        assert done.returncode == status, done.stderr
        return done

    return run


@pytest.fixture(scope="session")
def model():
    return lt.load()


@pytest.fixture(scope="session")
def scene(data_folder):
    return lt.demo_scene()


@pytest.fixture(scope="session")
def tokens(model, scene):
    return model.encode(scene)


@pytest.fixture(scope="session")
def evaluation(tmp_path_factory):
    """The bundled evaluation's folder."""
    return lt.demo_evaluation(tmp_path_factory.mktemp("demo") / "evaluation")
