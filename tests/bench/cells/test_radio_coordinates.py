import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.errors import InputError
from isacbench.model.frame import PaperFrame
from isacbench.model.radio_coordinates import (
    draw_place,
    gain_db,
    median_gain_db,
    radio_places,
    rayleigh_cells,
    space_places,
)
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers
from isacbench.model.scenes.scenario import load_scenario


def test_rayleigh_cells_are_the_bins_of_range_and_velocity_and_two_over_the_elements():
    cells = rayleigh_cells(load_scenario("street"))
    np.testing.assert_allclose(cells, [0.30497, 1.83544, 0.125, 0.125], rtol=1e-4)


def test_the_gain_sums_all_resource_and_array_elements_for_one_unit_scatterer(room, put):
    one, three = (put(room, [[70.0, 0.0, 0.0, 0.0]] * n) for n in (1, 3))
    all_elements = 10 * math.log10(255 * 127 * 81)
    assert gain_db(one) == pytest.approx(all_elements)
    # The SNR of a scene counts all of its power, which three scatterers share.
    assert gain_db(three) == pytest.approx(all_elements - 10 * math.log10(3))
    scatterers = dataclasses.replace(three.scatterers, amplitude=np.array([0.1, 2.0, 3.0]))
    unequal = dataclasses.replace(three, scatterers=scatterers)
    assert median_gain_db(three) == gain_db(three)
    assert median_gain_db(unequal) == pytest.approx(all_elements + 10 * math.log10(4 / 13.01))


@given(
    range_m=st.floats(20, 100),
    velocity=st.floats(-15, 15),
    u=st.floats(-0.6, 0.6),
    w=st.floats(0.05, 0.6),
    paper=st.booleans(),
)
def test_places_go_to_space_and_back(room, put, range_m, velocity, u, w, paper):
    frame = PaperFrame() if paper else room.frame
    empty = Region((-200.0, 200.0), (-200.0, 79.0), (-200.0, 40.0), (-15.0, 15.0))
    scenario = put(dataclasses.replace(room, frame=frame, region=empty), [range_m, velocity, u, w])
    found = radio_places(scenario, scenario.scatterers)
    np.testing.assert_allclose(found, [[range_m, velocity, u, w]], atol=1e-9)


@pytest.mark.parametrize("margin_cells", [0.5, 1.0])
def test_every_place_keeps_its_distance_from_the_border_in_all_four(room, margin_cells):
    cells = rayleigh_cells(room)
    for trial in range(20):
        place = draw_place(room, trial, 0, margin_cells)
        assert abs(place[1]) <= 15 - margin_cells * cells[1]
        for index in (0, 2, 3):
            for side in (-margin_cells, margin_cells):
                moved = place.copy()
                moved[index] += side * cells[index]
                assert room.region.contains(space_places(room, moved[None])[0]).all()


def test_places_follow_from_scenario_trial_and_seed_and_know_no_grid(room):
    other = dataclasses.replace(room, name="other")
    calls = [(room, 0, 0), (room, 1, 0), (room, 0, 1), (other, 0, 0)]
    places = [draw_place(*call, 0.5) for call in calls]
    np.testing.assert_array_equal(places[0], draw_place(room, 0, 0, 0.5))
    assert len({tuple(place) for place in places}) == 4
    fractions = np.array([draw_place(room, trial, 0, 0.5) for trial in range(300)]) / rayleigh_cells(room)
    for column in (fractions % 1).T:
        counts = np.histogram(column, bins=5, range=(0, 1))[0]
        assert counts.min() > 30


def test_the_scatterers_of_a_template_do_not_matter(room, put):
    filled = put(room, [[70.0, 3.0, 0.0, 0.0]])
    np.testing.assert_array_equal(draw_place(filled, 0, 0, 0.5), draw_place(room, 0, 0, 0.5))


@pytest.mark.parametrize(
    "region",
    [
        Region((0.0, 5.0), (0.0, 30.0), (0.0, 80.0), (-15.0, 15.0)),
        Region((0.0, 80.0), (0.0, 30.0), (0.0, 80.0), (-1.0, 1.0)),
    ],
)
def test_a_region_without_room_is_refused_with_the_size_of_a_cell(room, region):
    small = dataclasses.replace(room, region=region, scatterers=Scatterers(np.empty((0, 3)), [], []))
    with pytest.raises(InputError, match=r"scenario room: its region is too small: .* 0\.222 in u"):
        draw_place(small, 0, 0, 0.5)
