"""Processor times of images, and the committed ones, in a unit that takes longer where images do.

``python -m tests.image_speed`` writes the times anew, after a change that is meant to move them.
``python -m tests.image_speed check`` fails where an image takes more than `LIMIT` times as long.

The unit y is the time to draw a street's noise, taken before and after each image: what slows down the one
slows down the other. But drawing is scalar code and an image mostly linear algebra, which is slower where
vectors are narrower. Limits therefore grow by as much as products and decompositions take longer, in y, than
on the processor of the committed times; they never shrink.
"""

import json
import sys
from functools import cache
from itertools import product
from pathlib import Path
from statistics import median
from time import process_time

import numpy as np

from isacbench import get_estimator, load_scenario, observe, score
from isacbench.cores import one_blas_thread

PATH = Path(__file__).parents[1] / "results" / "reference" / "speed.json"
SCENES = "street", "town[seed=7]"
ESTIMATORS = "music2d", "fft4d", "esprit2d", "music2d_joint", "capon2d", "iaa2d", "omp4d", "nomp4d"
IMAGES = [" ".join(pair) for pair in product(SCENES, ESTIMATORS)]
SNR_DB = 10.0
LIMIT, TRIES = 1.4, 3
TURNS, TURN_S = 3, 0.3

scenario_of = cache(load_scenario)  # what a score keeps of its scenario is computed once


def spent_s(call):
    """Processor time of a call."""
    start_s = process_time()
    call()
    return process_time() - start_s


def unit_s():
    """The unit y: 1.5 million normal draws."""
    draw = np.random.default_rng(1).standard_normal
    return median(spent_s(lambda: draw(2 * 89 * 33 * 256)) for _ in range(3))


@one_blas_thread()
def algebra_y():
    """Time of covariances and small decompositions, in y."""
    draws = np.random.default_rng(2).standard_normal((64, 98, 100))
    algebra = lambda: np.linalg.eigh((draws.swapaxes(1, 2) @ draws)[:, :24, :24])  # noqa: E731
    return median(spent_s(algebra) / unit_s() for _ in range(9))


def round_y(image):
    """Times in y of an observation with its image and score, and of the image alone."""
    scene, estimator = image.split()
    scenario, imager = scenario_of(scene), get_estimator(estimator)
    units_s, marks_s = [unit_s()], [process_time()]
    observation = observe(scenario, SNR_DB)
    marks_s.append(process_time())
    cloud = imager.estimate(observation)
    marks_s.append(process_time())
    score(scenario.truth, cloud, region=scenario.region)
    marks_s.append(process_time())
    units_s.append(unit_s())
    return np.array([marks_s[3] - marks_s[0], marks_s[2] - marks_s[1]]) / np.mean(units_s)


def times_y(images):
    """Medians over rounds of images that take turns: what disturbs for seconds disturbs few rounds of any."""
    rounds = {image: [] for image in images}
    for _ in range(TURNS):
        for image in images:
            start_s = process_time()
            while process_time() - start_s < TURN_S:
                rounds[image].append(round_y(image))
    return {image: np.median(times, axis=0).round(2).tolist() for image, times in rounds.items()}


def too_slow(committed):
    """Lines on the images that are too slow each time they are measured."""
    limit = LIMIT * max(1.0, algebra_y() / committed["algebra"])
    slow = committed["images"]
    for _ in range(TRIES):
        ratios = {image: np.divide(times, slow[image]).max() for image, times in times_y(slow).items()}
        slow = {image: slow[image] for image in slow if ratios[image] > limit}
    return [
        f"{image}: {ratios[image]:.2f} times the committed time; the limit is {limit:.2f}" for image in slow
    ]


if __name__ == "__main__":
    if sys.argv[1:] == ["check"]:
        sys.exit("\n".join(too_slow(json.loads(PATH.read_text()))) or None)
    if sys.argv[1:]:
        sys.exit("usage: python -m tests.image_speed [check]")
    times = {"algebra": round(algebra_y(), 3), "images": times_y(IMAGES)}
    PATH.write_text(json.dumps(times).replace('], "', '],\n"') + "\n")
