"""What it costs to explain a map by scatterers: those of the cells, and atoms of a pursuit."""

import numpy as np
import pytest
from isacbench_algorithms.nomp4d import Nomp4d

from isacbench.dsp.fitting.atom_fits import fit_atoms, refine_atoms
from isacbench.dsp.fitting.atoms import AtomMap
from isacbench.dsp.fitting.joint_selection import explain_map
from isacbench.dsp.fitting.pursuit import BeamSpace


def test_locate(benchmark, scene):
    assert len(benchmark(scene.located)) > 20


def test_select_jointly(benchmark, scene):
    assert 20 < len(benchmark(scene.selected)) <= len(scene.candidates)


def test_explain_map(benchmark, thin_scene):
    one = thin_scene
    found = benchmark(explain_map, one.chosen, one.gated, one.scenario.system, one.white)
    assert len(found) == 5


def atom_map_of(scene):
    """Map that atoms are fitted to."""
    return AtomMap.from_map(scene.gated, scene.scenario.system, scene.observation.cosine_limits)


def places_of(scene, atom_map):
    """Places of the selected scatterers, as atoms have them."""
    chosen = scene.chosen
    places = np.stack([chosen.range_bin, chosen.doppler_bin, chosen.u, chosen.w], axis=1)
    return places / atom_map.cell_size


def test_atom_map(benchmark, scene):
    assert benchmark(atom_map_of, scene).array_shape == scene.scenario.array.shape


def test_atom_peaks(benchmark, scene):
    space = BeamSpace.from_map(atom_map_of(scene), scene.simulator.gate, scene.observation.cosine_limits)
    level = scene.white * np.log(space.n_independent / 1e-2)
    assert len(benchmark(lambda: space.peaks(space.residual(None), level))[0])


def test_atom_fit(benchmark, scene):
    atom_map = atom_map_of(scene)
    places = places_of(scene, atom_map)
    assert len(benchmark(fit_atoms, atom_map, places).power) == len(places)


@pytest.mark.parametrize("n_steps", [1, 4])
def test_atom_refinement(benchmark, scene, n_steps):
    atom_map = atom_map_of(scene)
    places = places_of(scene, atom_map)
    assert len(benchmark(refine_atoms, atom_map, places, n_steps).power) == len(places)


def test_round_of_matching_pursuit(benchmark, scene):
    assert len(benchmark(Nomp4d(max_rounds=1).estimate, scene.observation))
