"""Two scenes, and what the stages of an image pass on, computed when first asked for."""

import math
from dataclasses import replace
from functools import cached_property

import numpy as np
from isacbench_algorithms.music2d import Music2d

from isacbench.dsp.angles.line_subspaces import music_null_spectrum, real_steering, smoothed_covariance
from isacbench.dsp.angles.model_order import noise_edge, noise_order
from isacbench.dsp.angles.peaks import line_peaks
from isacbench.dsp.angles.planar_subspaces import leading_eigenpairs, planar_covariance
from isacbench.dsp.angles.plane_waves import pair_directions
from isacbench.dsp.cell_detection import detect_cells, white_noise
from isacbench.dsp.fitting.atoms import AtomMap
from isacbench.dsp.fitting.joint_selection import select_jointly
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.dsp.scatterers import locate_waves, merge_duplicates
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator
from isacbench.model.frame import get_frame
from isacbench.model.numerology import System
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers, Scenario

SNR_DB = 10.0
MUSIC = Music2d()


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


class Scene:
    """One observation, and what each stage of an image hands to the next."""

    def __init__(self, scenario):
        self.scenario = scenario

    @cached_property
    def thin(self):
        """The same with as few scatterers, far apart, as explain all of a map."""
        region = self.scenario.region
        xyz = region.lower_m + region.size_m * np.linspace(0.1, 0.9, 5)[:, None]
        scatterers = Scatterers(xyz, np.array([0.0, 9.0, -9.0, 4.0, -4.0]), np.ones(5))
        return Scene(replace(self.scenario, name=f"{self.scenario.name}-thin", scatterers=scatterers))

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
        return self.gated.tapered(MUSIC.range_window, MUSIC.doppler_window)

    @cached_property
    def detected(self):
        found = detect_cells(self.seen, MUSIC.cell_detector(), MUSIC.integration, MUSIC.dynamic_range_db)
        assert found.bins[0].size
        return found

    @cached_property
    def white(self):
        return white_noise(self.gated)

    @cached_property
    def min_power(self):
        return -math.log(MUSIC.angle_pfa) * self.detected.floor / self.gated.n_elements

    @cached_property
    def snapshots(self):
        """Snapshots (n, P, Q) of the detected cells."""
        return self.tapered.cells[self.tapered.index(self.detected.bins)]

    @cached_property
    def n_subarray(self):
        return round(MUSIC.subarray_fraction * self.snapshots.shape[1])

    @cached_property
    def covariance(self):
        """Covariances along u."""
        return smoothed_covariance(self.snapshots, self.n_subarray)

    def _subspace(self, covariance):
        values, vectors = np.linalg.eigh(covariance)
        edge = self.detected.floor * noise_edge(self.n_subarray, 2 * self.snapshots.shape[2])
        return vectors[:, :, ::-1], np.minimum(noise_order(values[:, ::-1], edge), MUSIC.max_order)

    def _steering(self, axis):
        cosine = np.linspace(*self.observation.cosine_limits[axis], MUSIC.grid_points)
        return cosine, real_steering(self.n_subarray, cosine)

    @cached_property
    def subspace(self):
        """Eigenvectors along u, and the orders."""
        return self._subspace(self.covariance)

    @cached_property
    def steering(self):
        """Cosines along u, and their steering vectors."""
        return self._steering(0)

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
        (vectors, order), (cosine, towards) = self._subspace(covariance), self._steering(1)
        return line_peaks(-music_null_spectrum(vectors, order, towards), cosine, order)

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
        limits = self.min_power, MUSIC.dynamic_range_db, MUSIC.max_sources
        waves = pair_directions(self.snapshots, self.gated.aperture, self.peaks, self.w_peaks, *limits)
        assert waves.found.any(axis=1).mean() > 0.5
        return waves

    @cached_property
    def waves(self):
        return self.paired()

    def located(self):
        """Candidates that the plane waves are."""
        windows = MUSIC.range_window, MUSIC.doppler_window
        limit_db = MUSIC.local_dynamic_range_db
        located = locate_waves(self.waves, self.tapered, self.detected.bins, windows, limit_db)
        return located.at_home(3.0, 1.0)

    @cached_property
    def candidates(self):
        return merge_duplicates(self.located().scatterers)

    def selected(self):
        """Candidates that explain the map together."""
        limit_db = MUSIC.local_dynamic_range_db
        return select_jointly(self.candidates, self.gated, self.scenario.system, self.min_power, limit_db)

    @cached_property
    def chosen(self):
        return self.selected()

    @cached_property
    def atom_map(self):
        """Map that atoms are fitted to."""
        return self.new_atom_map()

    def new_atom_map(self):
        return AtomMap.from_map(self.gated, self.scenario.system, self.observation.cosine_limits)

    @cached_property
    def places(self):
        """Places of the selected scatterers, as atoms have them."""
        chosen = self.chosen
        places = np.stack([chosen.range_bin, chosen.doppler_bin, chosen.u, chosen.w], axis=1)
        return places / self.atom_map.cell_size
