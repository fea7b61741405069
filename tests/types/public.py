"""Types of the public names as a type checker knows them: `mypy` looks at this file, and nothing runs it."""

from collections.abc import Mapping
from typing import assert_type

import pandas as pd

import isacbench
from isacbench.bench.store.run import CellKey
from isacbench.plugins.contracts import Detection, Detector, Estimator, TruthEstimator

scenario = isacbench.load_scenario("street")
observation = isacbench.observe(scenario, snr_db=10)
assert_type(scenario, isacbench.Scenario)
assert_type(observation, isacbench.Observation)
assert_type(isacbench.observe_cube("cube.npy", scenario), isacbench.Observation)

estimator = isacbench.get_estimator("music2d", integration="element")
assert_type(estimator, Estimator)
cloud = estimator.estimate(observation)
assert_type(cloud, isacbench.PointCloud)
assert_type(cloud.to_dataframe(), pd.DataFrame)
assert_type(isacbench.score(scenario.truth, cloud), dict[str, float])

detector = isacbench.get_detector("osca", pfa=1e-4)
assert_type(detector, Detector)
assert_type(detector.detect(abs(observation.cells[..., 0, 0]) ** 2), Detection)

oracle = isacbench.get_estimator("oracle")
if isinstance(oracle, TruthEstimator):
    assert_type(oracle.estimate(observation, scenario.truth), isacbench.PointCloud)

assert_type(isacbench.run("quick", snr_db=[10], progress=True), pd.DataFrame)
stored = isacbench.load_run("results/quick")
assert_type(stored.rows, pd.DataFrame)
assert_type(stored.clouds, Mapping[CellKey, isacbench.PointCloud])
for row in stored.rows.itertuples():
    assert_type(stored.cloud(row), isacbench.PointCloud)
    assert_type(stored.truth(row), isacbench.PointCloud)
for _, series in stored.rows.iterrows():
    assert_type(stored.cloud(series), isacbench.PointCloud)
assert_type(stored.cloud(stored.rows.loc[0]), isacbench.PointCloud)
assert_type(stored.cloud(estimator="music2d", snr_db=10, trial=0), isacbench.PointCloud)
assert_type(stored.scenario("street"), isacbench.Scenario)

assert_type(isacbench.check("mine.py").ok, bool)
assert_type([isacbench.check(plugin).ok for plugin in (estimator, detector, type(estimator))], list[bool])
