"""Generated scenes: their spelling, their sameness, and what every family promises."""

import hashlib
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from isacbench import load_scenario
from isacbench.bench.suites.scenario_digest import scenario_digest
from isacbench.model.scenes import objects as outlines
from isacbench.model.scenes.generators import SQUARE, scene_table
from isacbench.model.scenes.raw_uniforms import raw_uniforms
from isacbench.model.scenes.scene_families import FAMILIES, StreetParameters, family_specs, scenario_variants
from tests.conftest import refusal

SEEDS = range(12)
scene = cache(load_scenario)
STREETS = [name for name, family in FAMILIES.items() if issubclass(family.parameters, StreetParameters)]
"""Families of scenes before the paper's radio."""


def philox(key, n):
    """Philox 4x64-10 word by word, after Salmon and others (2011)."""
    mask, words = 2**64 - 1, []
    for count in range(1, -(-n // 4) + 1):
        counter, keys = [count, 0, 0, 0], [key & mask, key >> 64]
        for _ in range(10):
            first, second = counter[0] * 0xD2E7470EE14C6C93, counter[2] * 0xCA5A826395121157
            counter = [
                (second >> 64) ^ counter[1] ^ keys[0],
                second & mask,
                (first >> 64) ^ counter[3] ^ keys[1],
                first & mask,
            ]
            keys = [(keys[0] + 0x9E3779B97F4A7C15) & mask, (keys[1] + 0xBB67AE8584CAA73B) & mask]
        words += counter
    return words[:n]


@given(st.text(max_size=20), st.integers(1, 30))
def test_uniforms_are_the_words_of_philox(text, n):
    key = int.from_bytes(hashlib.sha256(text.encode("utf-8", "surrogatepass")).digest()[:16], "little")
    expected = [(word >> 11) / 2**53 for word in philox(key, n)]
    assert raw_uniforms(text, n).tolist() == expected


GOLDEN = {
    "street": "b471824d24573d64",
    "town": "2257f00136c9499e",
    "facade": "86d5c156ef32f138",
    "crowd": "77abde451ba741fb",
    "weak": "bab9737606bc8635",
    "sparse": "012b5bf3e300efdf",
    "traffic": "1d7fd973b18f634e",
    "crossing": "fcb75409c9e620dc",
}
RADIO = ("frame=paper", "coherent_phase=true", "gain_error_db=0.5", "phase_error_deg=5")


@pytest.mark.parametrize("family", STREETS)
def test_a_scene_is_the_same_as_years_ago_whatever_the_radio(family):
    plain, other = scene(f"{family}[seed=7]"), load_scenario(f"{family}[seed=7,{','.join(RADIO)}]")
    assert scenario_digest(plain) == GOLDEN[family]
    for name in ("xyz", "velocity", "amplitude"):
        assert np.array_equal(getattr(plain.scatterers, name), getattr(other.scatterers, name)), name


def test_the_digest_of_a_scene_holds_its_radio():
    digests = {scenario_digest(load_scenario(f"sparse[seed=7,{radio}]")) for radio in RADIO}
    assert len(digests | {GOLDEN["sparse"]}) == 1 + len(RADIO)


@pytest.mark.parametrize("family", STREETS)
def test_region_and_speeds_hold_every_scatterer_and_numbers_have_six_decimals(family):
    drawn = [scene(f"{family}[seed={seed},visible=all]") for seed in SEEDS[:6]]
    for scenario in drawn:
        region = {name: list(getattr(scenario.region, name)) for name in SQUARE["region"]}
        assert region == SQUARE["region"]
        assert scenario.region.contains(scenario.scatterers.xyz, 0.0).all()
        low, high = scenario.region.speed_mps
        assert ((scenario.scatterers.velocity >= low) & (scenario.scatterers.velocity <= high)).all()
        assert scenario.family == family
        for values in (scenario.scatterers.xyz, scenario.scatterers.velocity):
            assert np.array_equal(values, values.round(6))
    assert len({scenario_digest(scenario) for scenario in drawn}) == len(drawn)


def objects(name):
    """Entries of a scene, and their outlines in place."""
    (spec,) = family_specs(name)
    table = scene_table(spec)
    scatterers = scene(name).scatterers
    ends = np.cumsum([n_points(entry) for entry in table["objects"]])
    assert ends[-1] == len(scatterers)
    return table["objects"], np.split(scatterers.xyz, ends[:-1])


def n_points(entry):
    lengths = ("size_m", "length_m", "height_m", "spacing_m")
    sizes = {key: value for key, value in entry.items() if key.endswith(lengths)}
    return 1 if entry["kind"] == "point" else len(getattr(outlines, entry["kind"])(**sizes))


@pytest.mark.parametrize("family", [name for name in STREETS if name != "sparse"])
def test_objects_do_not_intersect(family):
    """Seen from above, the convex hulls of any two objects are apart by some direction."""
    directions = np.radians(np.arange(0, 180, 0.1))
    axes = np.stack([np.cos(directions), np.sin(directions)])
    for seed in (0, 1, 2):
        _, placed = objects(f"{family}[seed={seed},visible=all]")
        shadows = [points[:, :2] @ axes for points in placed]
        lower, upper = (np.array([of(shadow, axis=0) for shadow in shadows]) for of in (np.min, np.max))
        for index in range(1, len(placed)):
            gap = np.maximum(lower[index] - upper[:index], lower[:index] - upper[index])
            assert (gap.max(axis=1) > 0.2).all(), (seed, index)


@pytest.mark.parametrize("family", ["town", "facade", "weak", "traffic", "crossing"])
def test_surfaces_are_sampled_every_half_metre_within_a_fifth(family):
    n_rims = {"vehicle": 16, "lorry": 24}
    for seed in SEEDS[:6]:
        entries, placed = objects(f"{family}[seed={seed},visible=all]")
        for entry, points in zip(entries, placed, strict=True):
            if entry["kind"] in ("pedestrian", "cyclist"):
                continue
            surface = points[: len(points) - n_rims.get(entry["kind"], 0)]
            distance = cKDTree(surface).query(surface, 2)[0][:, 1]
            assert distance.min() >= 0.4 - 1e-5, (seed, entry)
            assert distance.max() <= 0.6 + 1e-5, (seed, entry)


@pytest.mark.parametrize("frame", ["panel", "paper"])
def test_lone_scatterers_are_a_rayleigh_cell_apart_in_one_coordinate(frame):
    for seed, changed in [*((seed, "") for seed in SEEDS), (0, ",scatterers=200")]:
        scenario = load_scenario(f"sparse[seed={seed},frame={frame}{changed}]")
        offset_m = scenario.scatterers.xyz - scenario.base_station_m
        u, w = scenario.frame.direction_cosines(offset_m)
        range_m = np.linalg.norm(offset_m, axis=1)
        cells = np.column_stack([range_m / 0.30499, scenario.scatterers.velocity / 1.8352, 8 * u, 8 * w])
        assert len(cells) == 200 if changed else 1 <= len(cells) <= 20, seed
        for index, cell in enumerate(cells):
            assert (np.abs(cells[:index] - cell).max(axis=1, initial=0) > 0.999).all(), seed


def test_speeds_differ_within_walkers_vehicles_lorries_and_cyclists():
    movers = {"crowd": "pedestrian", "town": "vehicle", "traffic": "lorry", "crossing": "cyclist"}
    for family, kind in movers.items():
        name = f"{family}[seed=2,visible=all]"
        entries, placed = objects(name)
        speeds = np.split(scene(name).scatterers.velocity, np.cumsum([*map(len, placed)])[:-1])
        spreads = [np.ptp(part) for part, entry in zip(speeds, entries, strict=True) if entry["kind"] == kind]
        assert max(spreads) > 1.0


def test_weak_objects_span_most_of_40_db():
    amplitudes = np.concatenate([load_scenario(f"weak[seed={seed}]").scatterers.amplitude for seed in SEEDS])
    spread_db = 20 * np.log10(amplitudes.max() / amplitudes.min())
    assert 35 < spread_db <= 40


NAMES = {
    "town[density=high,seed=7]": ["town[seed=7,density=high]"],
    "town[seed=7,density=medium,frame=panel]": ["town[seed=7]"],
    "crowd[seed=2:4]": ["crowd[seed=2]", "crowd[seed=3]", "crowd[seed=4]"],
    "sparse[seed=[1,5],frame=paper]": ["sparse[seed=1,frame=paper]", "sparse[seed=5,frame=paper]"],
    "street": ["street"],
}


@pytest.mark.parametrize(("text", "names"), NAMES.items())
def test_a_scene_has_one_canonical_name(text, names):
    assert scenario_variants(text) == names
    for name in names:
        assert load_scenario(name).name == name


MISTAKES = {
    "twon[seed=7]": "unknown family 'twon'; did you mean 'town'?",
    "town[seed=7,densty=high]": "town has no parameter 'densty'; did you mean 'density'?",
    "town[seed=7,density=huge]": "density = 'huge'",
    "town[seed=0:1000000]": "allowed are at most 1000 scenes",
    "town[seed=[0:600,700:1300]]": "allowed are at most 1000 scenes",
    "town[seed=5:1]": "seed=5:1: allowed is a range first:last",
    "town[seed=０:３]": "allowed is a range first:last",
    "town[seed=1_0]": "seed = '1_0'",
    "town[seed=-1]": "seed = -1",
    "town[seed=1.5]": "seed = 1.5",
    "town[density=high]": "a family needs a seed",
    "town": "is a family of scenes; give a seed, such as town[seed=7]",
    "town[seed=7": "expected",
    "town[seed=[7,7]]": "twice",
    "crowd[seed=1,pedestrians=500]": "no room for more than",
    "sparse[seed=1,scatterers=201]": "scatterers = 201",
}


@pytest.mark.parametrize(("text", "message"), MISTAKES.items())
def test_a_mistake_in_the_name_of_a_scene_is_told_in_one_line(text, message):
    assert message in refusal(lambda: [load_scenario(name) for name in scenario_variants(text)])


def test_one_scenario_is_no_range():
    assert "names 3 scenes" in refusal(load_scenario, "town[seed=0:2]")
