"""Two scenes, what the stages of an image pass on, and how ratios are measured; all on one thread."""

import math
import resource
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from statistics import median
from time import perf_counter

import numpy as np
import pytest
from isacbench_algorithms.music2d import Music2d

from isacbench.dsp.angles.line_subspaces import music_null_spectrum, real_steering, smoothed_covariance
from isacbench.dsp.angles.model_order import noise_edge, noise_order
from isacbench.dsp.angles.peaks import line_peaks
from isacbench.dsp.angles.planar_subspaces import leading_eigenpairs, planar_covariance
from isacbench.dsp.angles.plane_waves import pair_directions
from isacbench.dsp.cell_detection import detect_cells, white_noise
from isacbench.dsp.fitting.joint_selection import select_jointly
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.dsp.scatterers import locate_waves, merge_duplicates
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator
from isacbench.model.frame import get_frame
from isacbench.model.numerology import System
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers, Scenario
from isacbench.model.scenes.scenario import load_scenario

SNR_DB = 10.0
SCORES = [
    *("hausdorff_xy_m", "hausdorff_xz_m", "hausdorff_yz_m", "density", "velocity_nmse", "deviation"),
    *("chamfer_m", "gospa_m", "time_estimate_s", "precision", "recall", "time_score_s"),
]


def largest_memory_mib():
    """Most memory that this process ever held."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20


def small_scenario():
    """A crowd of 120 in front of an 8 x 8 array, on a grid of 256 x 56."""
    rng = np.random.default_rng(0)
    region = Region((0.0, 20.0), (0.0, 25.0), (0.0, 8.0), (-15.0, 15.0))
    xyz = region.lower_m + region.size_m * rng.random((120, 3))
    return Scenario(
        name="small",
        system=System(n_subcarriers=256, n_symbols=56),
        array=VirtualArray((2, 2), (4, 4), 4, 1),
        frame=get_frame("panel"),
        base_station_m=np.array([10.0, 60.0, 15.0]),
        region=region,
        scatterers=Scatterers(xyz, rng.choice([-10.0, 0.0, 10.0], 120), np.ones(120)),
    )


def thinned_out(scenario):
    """Five scatterers far apart instead of those of a scenario."""
    region = scenario.region
    xyz = region.lower_m + region.size_m * np.linspace(0.1, 0.9, 5)[:, None]
    scatterers = Scatterers(xyz, np.array([0.0, 9.0, -9.0, 4.0, -4.0]), np.ones(5))
    return replace(scenario, name=f"{scenario.name}-thin", scatterers=scatterers)


class Scene:
    """One observation, and what each stage of an image hands to the next, computed when first asked for."""

    def __init__(self, scenario):
        self.scenario = scenario
        self.estimator = Music2d()

    @cached_property
    def simulator(self):
        simulator = Simulator(self.scenario)
        assert np.isfinite(simulator.clean).all()
        return simulator

    @cached_property
    def observation(self):
        return self.simulator.observe(SNR_DB)

    @cached_property
    def gated(self):
        return GatedMap(self.observation.cells, self.observation.gate)

    @cached_property
    def seen(self):
        """Map that cells are detected on."""
        return self.gated.tapered("hann", "hann")

    @cached_property
    def tapered(self):
        """Map that directions are read from."""
        return self.gated.tapered(self.estimator.range_window, self.estimator.doppler_window)

    @cached_property
    def detected(self):
        estimator = self.estimator
        return detect_cells(
            self.seen, estimator.cell_detector(), estimator.integration, estimator.dynamic_range_db
        )

    @cached_property
    def white(self):
        return white_noise(self.gated)

    @cached_property
    def min_power(self):
        return -math.log(self.estimator.angle_pfa) * self.detected.floor / self.gated.n_elements

    @cached_property
    def snapshots(self):
        """Snapshots (n, P, Q) of the detected cells."""
        return self.tapered.cells[self.tapered.index(self.detected.bins)]

    @cached_property
    def n_subarray(self):
        return round(self.estimator.subarray_fraction * self.snapshots.shape[1])

    @cached_property
    def covariance(self):
        """Covariance along u."""
        return smoothed_covariance(self.snapshots, self.n_subarray)

    @cached_property
    def subspace(self):
        """Eigenvectors along u, and the orders."""
        return self._subspace(self.covariance)

    @cached_property
    def steering(self):
        """Cosines along u, and their steering vectors."""
        cosine = np.linspace(*self.observation.cosine_limits[0], self.estimator.grid_points)
        return cosine, real_steering(self.n_subarray, cosine)

    @cached_property
    def null(self):
        """Null spectra along u."""
        return music_null_spectrum(*self.subspace, self.steering[1])

    @cached_property
    def peaks(self):
        """Peaks along u."""
        return line_peaks(-self.null, self.steering[0], self.subspace[1])

    @cached_property
    def w_peaks(self):
        """Peaks along w."""
        covariance = smoothed_covariance(self.snapshots.transpose(0, 2, 1), self.n_subarray)
        vectors, order = self._subspace(covariance)
        cosine = np.linspace(*self.observation.cosine_limits[1], self.estimator.grid_points)
        null = music_null_spectrum(vectors, order, real_steering(self.n_subarray, cosine))
        return line_peaks(-null, cosine, order)

    def _subspace(self, covariance):
        values, vectors = np.linalg.eigh(covariance)
        edge = self.detected.floor * noise_edge(self.n_subarray, 2 * self.snapshots.shape[2])
        return vectors[:, :, ::-1], np.minimum(noise_order(values[:, ::-1], edge), self.estimator.max_order)

    @cached_property
    def subarray(self):
        """Elements of a planar subarray along u and along w."""
        return self.snapshots.shape[1] // 2, self.snapshots.shape[2] // 2

    @cached_property
    def planar_covariance(self):
        return planar_covariance(self.snapshots, self.subarray)

    @cached_property
    def planar_basis(self):
        """Two-dimensional signal subspaces (n, L, M, 2) of planar subarrays."""
        vectors = leading_eigenpairs(self.planar_covariance, 2)[1]
        return vectors.reshape(len(vectors), *self.subarray, 2)

    def paired(self):
        """Plane waves of the detected cells."""
        estimator = self.estimator
        return pair_directions(
            self.snapshots,
            self.gated.aperture,
            self.peaks,
            self.w_peaks,
            self.min_power,
            estimator.dynamic_range_db,
            estimator.max_sources,
        )

    @cached_property
    def waves(self):
        return self.paired()

    def located(self):
        """Candidates that the plane waves are."""
        windows = self.estimator.range_window, self.estimator.doppler_window
        located = locate_waves(
            self.waves,
            self.tapered,
            self.detected.bins,
            windows,
            self.estimator.local_dynamic_range_db,
        )
        return located.at_home(3.0, 1.0)

    @cached_property
    def candidates(self):
        return merge_duplicates(self.located())

    def selected(self):
        """Candidates that explain the map together."""
        limit_db = self.estimator.local_dynamic_range_db
        return select_jointly(self.candidates, self.gated, self.scenario.system, self.min_power, limit_db)

    @cached_property
    def chosen(self):
        return self.selected()


@pytest.fixture(scope="session")
def street():
    """Return the paper's street at full size, 10 dB."""
    return Scene(load_scenario("street"))


@pytest.fixture(scope="session")
def crowd():
    """Return a crowd on a small grid before a small array, 10 dB."""
    return Scene(small_scenario())


@pytest.fixture(params=["crowd", "street"], ids=["small", "full"])
def scene(request):
    """Either scene in turn."""
    return request.getfixturevalue(request.param)


@pytest.fixture
def thin_scene(scene):
    """As few scatterers, at either size, as explain all of a map."""
    return Scene(thinned_out(scene.scenario))


@pytest.fixture(scope="session")
def noise_map():
    """Return noise on a whole range-Doppler map."""
    return np.random.default_rng(0).standard_exponential((224, 2048))


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
