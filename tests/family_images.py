"""Small scenes of all families, frames and phases, and the committed scores of their images.

``python -m tests.family_images`` writes the scores anew, after a change that is meant to move them.
``python -m tests.family_images FILE`` writes the clouds of some, or compares them with those of an earlier
call, as with another BLAS kernel: numbers may differ by `INVARIANCE`.
"""

import csv
import pickle
import sys
import warnings
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

from threadpoolctl import threadpool_limits

from isacbench.bench.cells.images import raw_cloud
from isacbench.checking.image_checks import INVARIANCE, cloud_difference
from isacbench.errors import InputWarning
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator
from isacbench.model.frame import get_frame
from isacbench.model.scenes.scenario import load_scenario
from isacbench.plugins.registry import build_estimator, estimator_names
from isacbench.plugins.scoring import score

PATH = Path(__file__).parents[1] / "results" / "reference" / "families.csv"
FAMILIES = "street", "town", "facade", "crowd", "weak", "traffic", "crossing", "sparse"
SCENES = [
    f"{family} {frame} {phase}"
    for family, frame, phase in product(FAMILIES, ("panel", "paper"), ("carrier", "zero"))
]
SEED, SNRS_DB = 7, (40.0, 10.0, -20.0)
CASES = [*product(SCENES, SNRS_DB)]
# Each family in both frames and with both phases, but not in all four combinations: in one at the highest
# SNR, and in the other at one of the others.
FEW = [name for number, name in enumerate(SCENES) if (number % 4 in (1, 2)) == (number // 4 % 2 == 0)]
QUICK = [(name, SNRS_DB[(0, 1, 2, 0)[n % 4]]) for n, name in enumerate(FEW)]
DIGITS = 8
SCORES = [
    *("n_estimated", "hausdorff_xy_m", "hausdorff_xz_m", "hausdorff_yz_m", "velocity_nmse"),
    *("gospa_m", "precision", "recall"),
]


def small_scene(name):
    """Scenario of a family with 256 subcarriers, 32 symbols and 8 x 8 elements."""
    family, frame, phase = name.split()
    scenario = load_scenario(f"{family}[seed={SEED}]")
    system = replace(scenario.system, n_subcarriers=256, n_symbols=32, coherent_phase=phase == "carrier")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)  # of scatterers that the paper's frame does not see
        return replace(
            scenario, system=system, array=VirtualArray((1, 1), (8, 8), 1, 1), frame=get_frame(frame)
        )


def clouds_of(scenario, snr_db):
    """Images of a scene at an SNR, by estimator."""
    seen = Simulator(scenario).observe(snr_db)
    with threadpool_limits(1):
        return {
            estimator: raw_cloud(build_estimator(estimator), seen, scenario.truth)
            for estimator in estimator_names()
            if estimator != "empty"
        }


def rows_of(name, snr_db):
    """Rows of a scene at an SNR, one an estimator: (scene, SNR, estimator) and the scores."""
    scenario = small_scene(name)
    for estimator, cloud in clouds_of(scenario, snr_db).items():
        bin_mps = scenario.system.velocity_bin_mps
        scores = score(scenario.truth, cloud, region=scenario.region, velocity_bin_mps=bin_mps)
        yield (name, f"{snr_db:g}", estimator), [float(f"{scores[one]:.{DIGITS}g}") for one in SCORES]


def keep_or_compare(path):
    """Write clouds of each family to a file, or hold them against those that are in it."""
    clouds = {case: clouds_of(small_scene(case[0]), case[1]) for case in QUICK}
    if not path.exists():
        path.write_bytes(pickle.dumps(clouds))
    for case, known in pickle.loads(path.read_bytes()).items():
        for estimator, cloud in known.items():
            difference = cloud_difference(small_scene(case[0]), cloud, clouds[case][estimator])
            assert difference <= INVARIANCE, f"{case}, {estimator}: they differ by {difference}"


@cache
def committed_rows():
    """Committed scores by scene, SNR and estimator."""
    with PATH.open(newline="") as file:
        return {tuple(row[:3]): [float(value) for value in row[3:]] for row in list(csv.reader(file))[1:]}


def write_scores():
    """Commit the scores anew."""
    with PATH.open("w", newline="") as table:
        writer = csv.writer(table, lineterminator="\n")
        writer.writerow(["scene", "snr_db", "estimator", *SCORES])
        for case in CASES:
            writer.writerows(
                [*key, *(f"{value:g}" if value == int(value) else repr(value) for value in values)]
                for key, values in rows_of(*case)
            )


if __name__ == "__main__":
    keep_or_compare(Path(sys.argv[1])) if sys.argv[1:] else write_scores()
