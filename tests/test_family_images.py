"""Images of small scenes of all families, frames and phases are those that are committed."""

import pytest

from tests.conftest import slow_but
from tests.family_images import CASES, QUICK, committed_rows, rows_of


@pytest.mark.parametrize(("name", "snr_db"), slow_but(QUICK, CASES))
def test_images_of_a_family_are_the_committed_ones(name, snr_db):
    committed = committed_rows()
    for key, scores in rows_of(name, snr_db):
        assert scores == pytest.approx(committed[key], rel=1e-5, abs=1e-6), key
