"""Lines and limits of the check of image times."""

import json

import pytest

from tests import image_speed

COMMITTED = {"algebra": 0.5, "images": {"street a": [10.0, 8.0]}}


@pytest.fixture
def lines(monkeypatch):
    """Say what is too slow, from estimates' times in y, one a measurement, and a processor's algebra in y."""

    def lines(*estimates_y, algebra_y=0.5):
        times = iter(estimates_y)
        monkeypatch.setattr(image_speed, "algebra_y", lambda: algebra_y)
        monkeypatch.setattr(
            image_speed, "times_y", lambda images: {image: [10.0, next(times)] for image in images}
        )
        return image_speed.too_slow(COMMITTED)

    return lines


def test_an_image_that_is_slow_in_every_measurement_is_named_with_its_ratio_and_the_limit(lines):
    assert lines(13.0, 14.0, 12.0) == ["street a: 1.50 times the committed time; the limit is 1.40"]


def test_an_image_that_is_slow_once_is_measured_again(lines):
    assert lines(13.0, 11.0) == []


def test_slow_algebra_of_another_processor_widens_the_limit_and_fast_algebra_leaves_it(lines):
    assert lines(13.0, algebra_y=0.6) == []
    assert len(lines(13.0, 13.0, 13.0, algebra_y=0.3)) == 1


def test_times_of_all_images_are_committed():
    assert list(json.loads(image_speed.PATH.read_text())["images"]) == image_speed.IMAGES
