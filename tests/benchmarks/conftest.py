"""Two scenes, and how ratios are measured; all on one thread."""

from collections.abc import Callable
from statistics import median
from time import perf_counter
from typing import NamedTuple

import pytest

from isacbench.dsp.rangedoppler import GatedMap
from isacbench.model.echo import Simulator
from isacbench.model.observation import Observation
from isacbench.model.scenes.scenario import load_scenario
from tests.algorithms.scenes import crowd


class Scene(NamedTuple):
    """A simulator, and an observation by it with its map."""

    simulator: Simulator
    observation: Observation
    gated: GatedMap


@pytest.fixture(scope="session", params=["small", "full"])
def scene(request):
    """A crowd on a small grid before a small array, and the paper's street at full size, 10 dB."""
    simulator = Simulator(crowd(120) if request.param == "small" else load_scenario("street"))
    observation = simulator.observe(10.0)
    return Scene(simulator, observation, GatedMap(observation.cells, observation.gate))


@pytest.fixture
def against(benchmark, capsys) -> Callable:
    """Return a function that times a stage against others in turns, and says how much longer they take.

    What is told, and kept as ``extra_info``, is the median over the rounds of
    the ratios within a round: a machine that slows down slows down both.
    """

    def measure(stage, others, rounds):
        spent_s = {name: [] for name in ("here", *others)}

        def timed(name, function):
            start = perf_counter()
            value = function()
            spent_s[name].append(perf_counter() - start)
            return value

        def run_others():
            for name, other in others.items():
                timed(name, other)

        found = benchmark.pedantic(timed, ("here", stage), setup=run_others, rounds=rounds, warmup_rounds=1)
        own_s = spent_s.pop("here")
        for name, times_s in spent_s.items():
            ratio = median(other / own for other, own in zip(times_s[1:], own_s[1:], strict=True))
            benchmark.extra_info[name] = ratio
            with capsys.disabled():
                print(
                    f"\n{benchmark.name}: {name} takes {ratio:.1f} times as long"
                    f" ({1e3 * median(times_s[1:]):.1f} ms, here {1e3 * median(own_s[1:]):.2f} ms)"
                )
        return found

    return measure
