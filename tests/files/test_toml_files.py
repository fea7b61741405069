"""TOML files: found by name or path, refused in one line that names the worst mistake."""

import re
from typing import Annotated, Literal

import pytest
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from isacbench.errors import InputError, did_you_mean, unknown_name
from isacbench.files.toml_files import builtin_names, describe_mistake, find_toml, read_toml
from tests.conftest import refusal


class Strict(BaseModel):
    """Tables of these tests."""

    model_config = ConfigDict(extra="forbid")


class Disc(Strict):
    shape: Literal["disc"]
    radius: float
    disc: int = 0


class Box(Strict):
    shape: Literal["box"]
    sides: tuple[float, float]


class Drawing(Strict):
    title: str
    shapes: tuple[Annotated[Disc | Box, Field(discriminator="shape")], ...] = ()
    disc: Disc | None = None
    tags: Annotated[tuple[str, ...], Field(min_length=1)] = ("plain",)


def mistake(content):
    """What is said of a drawing that is refused."""
    with pytest.raises(ValidationError) as error:
        Drawing.model_validate(content)
    return describe_mistake(error.value, Drawing)


DISC = {"shape": "disc", "radius": 1.0}


ALLOWED = "allowed are title, shapes, disc, tags"
BOX, A = {"shape": "box"}, {"title": "a"}
MISTAKES = {
    "missing key title": {},
    "title = 3: input should be a valid string": {"title": 3},
    f"unknown key titel: did you mean 'title'? {ALLOWED}": {"titel": "a"},
    f"unknown key zzz: {ALLOWED}": {**A, "zzz": 1},
    "unknown key shapes[0].radios: did you mean 'radius'?": {"title": 3, "shapes": [{**DISC, "radios": 1}]},
    "shapes[0].radius = 'x': ": {**A, "shapes": [{**DISC, "radius": "x"}]},
    "shapes[0].disc = 'x': ": {**A, "shapes": [{**DISC, "disc": "x"}]},
    "missing key shapes[1].sides": {**A, "shapes": [DISC, BOX]},
    "missing key shapes[0].sides[1]": {**A, "shapes": [{**BOX, "sides": [1]}]},
    "missing key shapes[0].shape": {**A, "shapes": [{"radius": 1}]},
    "shapes[0].shape = 'bax': did you mean 'box'? allowed are box, disc": {**A, "shapes": [{"shape": "bax"}]},
    "shapes = {'shape': 'box'}: input should be": {**A, "shapes": BOX},
    "tags = []: list should have at least 1 item": {**A, "tags": []},
    "shapes[0].sides = [1, 2, 3]: list should have at most 2": {**A, "shapes": [{**BOX, "sides": [1, 2, 3]}]},
}


@pytest.mark.parametrize(("message", "content"), MISTAKES.items())
def test_a_mistake_is_described_by_its_key_its_value_and_what_is_allowed(message, content):
    assert mistake(content).startswith(message)


def test_a_file_is_named_in_front_of_its_mistake(tmp_path):
    path = tmp_path / "drawing.toml"
    path.write_text('titel = "a"\n')
    with pytest.raises(InputError, match=f"^{re.escape(str(path))}: unknown key titel"):
        read_toml(path, Drawing)
    path.write_text('title = "a"\n')
    assert read_toml(path, Drawing) == Drawing(title="a")


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"\xff", "not UTF-8 text (byte 0)"), (b"a = \n", "not valid TOML: "), (None, "cannot be read: ")],
)
def test_a_file_that_is_no_toml_is_refused(tmp_path, content, message):
    path = tmp_path / "drawing.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=re.escape(f"{path}: {message}")):
        read_toml(path, Drawing)


def test_built_in_files_are_found_by_name_and_others_by_path(tmp_path):
    path = tmp_path / "own.toml"
    path.touch()
    assert find_toml(path, "scenario") == path
    assert find_toml("street", "scenario").stem == "street"
    assert builtin_names("suites") == sorted(builtin_names("suites"))


def test_what_is_not_found_is_answered_with_what_there_is(tmp_path):
    path = tmp_path / "own.toml"
    assert f"scenario {path}: no such file" in refusal(find_toml, path, "scenario")
    message = r"unknown suite 'quik': .*'quick'\? .*, or the path of a \.toml file"
    assert re.search(message, refusal(find_toml, "quik", "suite", "suites"))


def test_a_name_is_answered_with_the_nearest_one_only_where_one_is_near():
    assert did_you_mean("strete", ["road", "street"]) == "did you mean 'street'? allowed are road, street"
    assert did_you_mean("zzz", ["road", "street"]) == "allowed are road, street"
    assert str(unknown_name("road", "a", [])) == "unknown road 'a': allowed are none"
