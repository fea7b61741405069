"""Scenes of a few objects, loaded from a file."""

import pytest

from isacbench import load_scenario

SCENE = """
name = "scene"
{keys}
[system]
coherent_phase = {coherent}
[array]
frame = "panel"
[base_station]
position_m = [20.0, 100.0, 20.0]
[region]
x_m = [0.0, 40.0]
y_m = [0.0, 30.0]
z_m = [0.0, 20.0]
speed_mps = [-25.0, 25.0]
"""


@pytest.fixture
def load_objects(tmp_path):
    """Return a function that loads a scene of some objects, with further keys, from the temporary folder."""

    def build(objects, keys="", coherent="true"):
        path = tmp_path / "scene.toml"
        path.write_text(SCENE.format(keys=keys, coherent=coherent) + objects)
        return load_scenario(path)

    return build
