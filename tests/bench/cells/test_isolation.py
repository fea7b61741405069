"""What code does to its process is undone; what it does to an array is seen."""

import copy
import os
import random
import sys
import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from threadpoolctl import threadpool_info, threadpool_limits

from isacbench.bench.cells.cell import seed_global_generators
from isacbench.bench.cells.task import content_digest
from isacbench.cores import one_blas_thread
from isacbench.model.echo import observe_echo
from isacbench.model.frame import PaperFrame
from isacbench.model.scenes.scenario import load_scenario
from isacbench.process_state import process_state_kept

global_random = np.random.random_sample


def state():
    """Whatever can be compared of a process."""
    return {
        "folder": Path.cwd(),
        "environment": dict(os.environ),
        "errors": np.geterr(),
        "print": np.get_printoptions()["precision"],
        "filters": list(warnings.filters),
        "streams": (sys.stdin, sys.stdout, sys.stderr),
        "random": random.getstate(),
        "threads": [library["num_threads"] for library in threadpool_info()],
    }


def disturb():
    os.chdir("/")
    os.environ.clear()
    os.environ["NEW"] = "1"
    np.seterr(all="raise")
    np.set_printoptions(precision=1)
    warnings.simplefilter("ignore")
    sys.stdout = sys.stderr = None
    sys.stdin = open(os.devnull)  # noqa: PTH123, SIM115
    random.seed(1)
    threadpool_limits(3)


@pytest.mark.parametrize("end", [None, ValueError, KeyboardInterrupt])
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_every_change_of_the_process_is_undone_however_it_ends(end):
    before = state()
    try:
        with process_state_kept(), one_blas_thread():
            disturb()
            if end is not None:
                raise end
    except (ValueError, KeyboardInterrupt):
        pass
    after = state()
    for name, value in before.items():
        assert after[name] == value, name


def test_the_numbers_of_numpy_s_global_generator_go_on_where_they_were():
    seed_global_generators("any")
    expected = [global_random(), global_random()]
    seed_global_generators("any")
    first = global_random()
    with process_state_kept():
        global_random(100)
    assert [first, global_random()] == expected


def test_equal_keys_seed_equal_numbers_and_others_other_ones():
    def numbers(*key):
        seed_global_generators(*key)
        return random.random(), global_random()

    with process_state_kept():
        assert numbers("tiny", 1, 0.5) == numbers("tiny", 1, 0.5)
        assert numbers("tiny", 1, 0.5) != numbers("tiny", 2, 0.5)


shapes = st.tuples(st.integers(1, 4), st.integers(1, 4), st.integers(1, 4))


def cells(shape):
    return np.random.default_rng(7).standard_normal((*shape, 2)).view(np.complex128)[..., 0]


@given(shapes, st.booleans(), st.data())
def test_a_single_bit_changes_the_digest_of_numbers_and_of_masks(shape, is_mask, data):
    array = np.zeros(shape, dtype=bool) if is_mask else cells(shape)
    before = content_digest(array)
    raw = array.view(np.uint8).reshape(-1)
    raw[data.draw(st.integers(0, raw.size - 1))] ^= np.uint8(1 << data.draw(st.integers(0, 7)))
    assert content_digest(array) != before


@given(shapes)
def test_the_digest_is_one_of_values_and_shape_alone(shape):
    array = cells(shape)
    assert content_digest(array.copy()) == content_digest(np.asfortranarray(array)) == content_digest(array)
    assert content_digest(array.reshape(1, *shape)) != content_digest(array)


@pytest.mark.parametrize(
    "change", [np.negative, np.conj, *(partial(np.flip, axis=axis) for axis in range(3))]
)
def test_other_signs_and_another_order_change_the_digest(change):
    array = cells((3, 4, 5))
    assert content_digest(change(array)) != content_digest(array)


@pytest.mark.parametrize(
    ("part", "change"),
    [
        ("system", {"carrier_hz": np.nextafter(70e9, 71e9)}),
        ("system", {"coherent_phase": False}),
        ("array", {"tx_spacing": 2}),
        ("region", {"x_m": (0.0, np.nextafter(10.0, 11.0))}),
        ("frame", {"tilt_deg": 1e-12}),
    ],
)
def test_the_digest_of_an_observation_sees_the_last_digit_of_all_that_is_known(tiny, part, change):
    observation = observe_echo(load_scenario(tiny), 0)
    before = content_digest(observation)
    assert content_digest(observation) == before
    changed = copy.copy(getattr(observation, part))
    for name, value in change.items():
        object.__setattr__(changed, name, value)
    object.__setattr__(observation, part, changed)
    assert content_digest(observation) != before


@pytest.mark.parametrize("other", [PaperFrame(), None])
def test_the_digest_of_an_observation_sees_another_type(tiny, other):
    observation = observe_echo(load_scenario(tiny), 0)
    before = content_digest(observation)
    object.__setattr__(observation, "frame", other)
    assert content_digest(observation) != before
