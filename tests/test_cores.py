"""Imaging keeps linear algebra on one thread; what the caller computes besides has his own number."""

import dataclasses
import functools
import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pkgutil import resolve_name
from types import SimpleNamespace

import cloudpickle
import pytest
import threadpoolctl
from isacbench_algorithms.music2d import Music2d

from isacbench import cores
from isacbench.checking.scenes import RESOLVED, observed
from isacbench.cores import one_blas_thread
from isacbench.cubes.frame import observe_cube
from isacbench.link.sensing.observing import observe
from isacbench.model.echo import resource_grid
from isacbench.model.observation import Observation
from isacbench.plugins.registry import estimator_names, get_estimator, sees_truth
from isacbench.plugins.scoring import score

SHOT = observed(RESOLVED, 20.0)
SCENE = SHOT.scenario


def threads():
    """Numbers of threads of the libraries of linear algebra, by their paths."""
    found = threadpoolctl.ThreadpoolController().select(user_api="blas").lib_controllers
    return {library.filepath: library.num_threads for library in found}


@pytest.fixture(params=[2])
def callers(request):
    """Numbers of threads that a caller has chosen."""
    with threadpoolctl.threadpool_limits(request.param):
        chosen = threads()
        assert request.param in chosen.values()
        yield chosen


def calling(function, *args):
    """Call a function in this thread."""
    return function(*args)


def assert_one(seen):
    assert seen
    assert {number for numbers in seen for number in numbers.values()} == {1}


class Watched(Observation):
    """Observation that notes the threads of whoever reads it."""

    def __getattribute__(self, name):
        if name in ("cells", "region"):
            vars(self).setdefault("seen", []).append(threads())
        return super().__getattribute__(name)


def watched(**changes):
    observation = SHOT.fresh_observation()
    names = [field.name for field in dataclasses.fields(Observation)]
    made = Watched(**{**{name: getattr(observation, name) for name in names}, **changes})
    vars(made)["seen"] = []
    return made


@pytest.mark.parametrize("name", estimator_names())
def test_an_estimator_images_on_one_thread_and_its_caller_goes_on_with_his_own(name, callers):
    plain, observation = get_estimator(name), watched()
    truth = (SCENE.truth,) if sees_truth(name) else ()
    assert len(type(plain)().estimate(observation, *truth)) or name == "empty"
    assert_one(observation.seen)
    assert threads() == callers
    if hasattr(plain, "diagnose"):
        observation = watched()
        plain.diagnose(observation)
        assert_one(observation.seen)
        assert threads() == callers


def other_estimate(self, observation):
    return threads()


@functools.wraps(other_estimate)
def wrapped_estimate(self, observation):
    return other_estimate(self, observation)


class Mixin:
    estimate = other_estimate


KINDS = {
    "own": lambda: type("Own", (Music2d,), {"estimate": other_estimate}),
    "own in a wrapper": lambda: type("Own", (Music2d,), {"estimate": wrapped_estimate}),
    "mixed in, in a wrapper": lambda: type(
        "Mixed", (type("Mixin", (), {"estimate": wrapped_estimate}), Music2d), {}
    ),
    "mixed in": lambda: type("Mixed", (Mixin, Music2d), {}),
    "inherited": lambda: type("Child", (type("Own", (Music2d,), {"estimate": other_estimate}),), {}),
}


@pytest.mark.parametrize("kind", KINDS)
def test_whatever_estimates_below_the_base_class_is_limited(kind, callers):
    assert_one([KINDS[kind]()().estimate(SHOT.fresh_observation())])
    assert threads() == callers


def test_an_estimate_without_self_stays_as_it_is():
    made = type("Static", (Music2d,), {"estimate": staticmethod(len)})()
    assert made.estimate([1, 2]) == 2


@pytest.mark.parametrize("callers", [2, 3], indirect=True)
def test_after_an_exception_the_caller_has_his_threads_back(callers):
    observation = watched(system=None)
    with pytest.raises(AttributeError):
        Music2d().estimate(observation)
    assert_one(observation.seen)
    assert threads() == callers


def cube_cells():
    grid = resource_grid(SCENE, SCENE.array.positions)
    return observe_cube(grid.reshape(*grid.shape[:2], *SCENE.array.shape), SCENE).cells


@pytest.mark.parametrize(
    ("inside", "call"),
    [
        ("isacbench.model.echo.clean_echo", lambda: observe(dataclasses.replace(SCENE, name="new"), 10.0)),
        (
            "isacbench.link.sensing.link_observation.weighted_echo",
            lambda: observe(SCENE, 10.0, sensing="prs"),
        ),
        ("isacbench.dsp.partial_dft.transform_block", cube_cells),
        ("isacbench.metrics.paper.deviation_scores", lambda: score(SCENE.truth, SCENE.truth)),
    ],
)
def test_observations_and_scores_are_made_on_one_thread(inside, call, callers, monkeypatch):
    plain, seen = resolve_name(inside), []

    def noting(*args):
        seen.append(threads())
        return plain(*args)

    monkeypatch.setattr(inside, noting)
    call()
    assert_one(seen)
    assert threads() == callers


@pytest.fixture
def other():
    """Run functions in a thread that lives until the end, one after the other."""
    with ThreadPoolExecutor(1) as executor:
        yield lambda function, *args: executor.submit(function, *args).result(60)


def test_of_threads_that_overlap_the_last_to_leave_restores_what_the_first_found(callers, other):
    limit, seen = one_blas_thread(), []
    for first, last in ((other, calling), (calling, other)):
        first(limit.__enter__)
        seen.append(threads())
        last(limit.__enter__)
        first(limit.__exit__)
        seen.append(threads())
        last(limit.__exit__)
        assert threads() == callers
    assert_one(seen)


def test_a_thread_limits_although_another_one_has_chosen_a_number_and_may_choose_again(callers, other):
    assert_one([other(one_blas_thread()(threads))])
    assert threads() == callers
    threadpoolctl.threadpool_limits(3)
    assert 3 in threads().values()
    assert_one([other(one_blas_thread()(threads))])
    assert 3 in threads().values()
    threadpoolctl.threadpool_limits(2)
    assert threads() == callers


def test_inner_limits_leave_the_outer_one_and_undo_no_other_number_but_the_caller_s(callers):
    seen = []
    with one_blas_thread():
        with pytest.raises(ZeroDivisionError), one_blas_thread():
            raise ZeroDivisionError
        seen.append(threads())
        threadpoolctl.threadpool_limits(3)  # as a plugin may, for good
        with one_blas_thread():
            seen.append(threads())
    assert_one(seen)
    assert threads() == callers


def test_a_decorated_function_is_sent_by_its_code():
    @one_blas_thread()
    def answer():
        return set(threads().values())

    assert cloudpickle.loads(cloudpickle.dumps(answer))() == {1}


class Library:
    """A library whose threads are counted for the process, or with OpenMP for each thread."""

    def __init__(self, internal_api, user_api, threading_layer=None):
        self.filepath = self.internal_api = internal_api
        self.user_api, self.threading_layer = user_api, threading_layer
        self._of_process, self._of_thread = {}, threading.local()

    @property
    def _numbers(self):
        is_of_thread = "openmp" in (self.user_api, self.threading_layer)
        return vars(self._of_thread) if is_of_thread else self._of_process

    @property
    def num_threads(self):
        return self._numbers.get("n", 4)

    def set_num_threads(self, n):
        self._numbers["n"] = n


@pytest.fixture
def loaded(monkeypatch):
    """Libraries that are loaded in place of the real ones."""
    libraries = []
    monkeypatch.setattr(
        threadpoolctl, "ThreadpoolController", lambda: SimpleNamespace(lib_controllers=[*libraries])
    )
    cores._libraries.cache_clear()
    yield libraries
    cores._libraries.cache_clear()


def test_a_library_that_an_import_brings_later_is_limited_from_the_next_call_on(loaded, monkeypatch):
    early, late = Library("openblas", "blas", "pthreads"), Library("mkl", "blas")
    loaded.append(early)
    with one_blas_thread():
        loaded.append(late)
        monkeypatch.setitem(sys.modules, "brings_late", None)
        with one_blas_thread():
            assert (early.num_threads, late.num_threads) == (1, 1)
    assert (early.num_threads, late.num_threads) == (4, 4)


@pytest.mark.parametrize("library", [Library("libgomp", "openmp"), Library("openblas", "blas", "openmp")])
def test_openmp_has_its_number_back_in_each_thread(library, loaded, other):
    loaded.append(library)
    limit = one_blas_thread()
    numbers = []
    for act in (limit.__enter__, limit.__exit__):
        for run in (other, calling):
            run(act)
            numbers.append((other(lambda: library.num_threads), library.num_threads))
    assert numbers == [(1, 4), (1, 1), (4, 1), (4, 4)]


PROGRAM = """
import sys
from isacbench.cores import one_blas_thread
from threadpoolctl import threadpool_info

def threads():
    return sorted({one["num_threads"] for one in threadpool_info()})

found = ["scipy.linalg" in sys.modules]
with one_blas_thread():
    import scipy.linalg
    found.append(threads())
print([*found, threads()])
"""


def test_the_library_of_scipy_is_limited_before_it_is_used():
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "2"}
    program = [sys.executable, "-c", PROGRAM]
    done = subprocess.run(program, env=environment, capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == "[False, [1], [2]]\n"
