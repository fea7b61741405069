"""The examples of docs/cubes.md do what they say."""

import re
from pathlib import Path

from isacbench.cubes import open_cube, read_grid

from .samples import assert_gives

DOCUMENT = Path(__file__).parents[2] / "docs" / "cubes.md"


def test_the_examples_run_and_write_cubes_that_are_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    examples = re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), flags=re.DOTALL)
    names = {}
    for example in examples:
        exec(example, names)
    written = {path.name for path in tmp_path.iterdir()}
    assert written == {"cube.npy", "element-major.npy", "cube.npz", "cube.h5", "cube.zarr", "streamed.zarr"}
    for name in written:
        with open_cube(name) as cube:
            assert_gives(cube, names["echo"])
            if name in ("cube.npz", "cube.h5", "cube.zarr"):
                assert (cube.transmitted == names["transmitted"]).all()
                assert (read_grid(name) == names["transmitted"]).all()
