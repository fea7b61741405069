"""Rows take sound clouds of estimators, and have a status."""

from typing import get_args

import numpy as np
import pandas as pd
import pytest

from isacbench.bench.cells.images import estimate_cloud
from isacbench.bench.cells.rows import SCORED, CellStatus, failed
from isacbench.model.cloud import PointCloud
from isacbench.model.scenes.scenario import load_scenario


class Returns:
    """Estimator of the cloud that it was given."""

    def __init__(self, cloud):
        self.cloud = cloud

    def estimate(self, observation):
        return self.cloud


def tampered():
    """A cloud whose velocities became NaN after its checks."""
    cloud = PointCloud([[1, 2, 3]], [4])
    object.__setattr__(cloud, "velocity", np.array([np.nan]))
    return cloud


@pytest.mark.parametrize("cloud", [PointCloud([[1, 2, 3]]), tampered()])
def test_a_cloud_without_velocities_is_refused(cloud):
    truth = load_scenario("street").truth
    with pytest.raises(ValueError, match=r"^estimate\(\) must return a finite velocity of each point"):
        estimate_cloud(Returns(cloud), None, truth)


FAILURES = ["error", "timeout", "killed", "skipped"]


def test_every_status_but_those_with_a_score_is_a_failure():
    assert set(get_args(CellStatus)) == {*SCORED, *FAILURES}
    records = pd.DataFrame({"status": [*SCORED, *FAILURES]}, index=[7, 3, 5, 2, 9, 1])
    expected = pd.Series([False, False, True, True, True, True], index=records.index)
    pd.testing.assert_series_equal(failed(records), expected, check_names=False)
