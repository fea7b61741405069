import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from isacbench.report.drawing.label_layout import place_labels

places = st.tuples(st.integers(-9, 9), st.integers(-9, 9))
labels = st.lists(
    st.tuples(
        places, st.tuples(st.integers(1, 5), st.integers(1, 5)), st.lists(places, min_size=1, max_size=6)
    ),
    min_size=1,
    max_size=6,
)
boxes = st.lists(st.tuples(places, st.tuples(st.integers(1, 5), st.integers(1, 5))), max_size=3)


def corners(centre, size):
    return *np.subtract(centre, np.divide(size, 2)), *np.add(centre, np.divide(size, 2))


def covers(a, b):
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


@given(labels, boxes)
def test_labels_cover_nothing_and_have_the_first_place_that_is_free(labels, taken):
    anchors, sizes, offsets = zip(*labels, strict=True)
    occupied = [corners(centre, size) for centre, size in taken]
    for anchor, size, places, found in zip(
        anchors, sizes, offsets, place_labels(anchors, sizes, offsets, occupied), strict=True
    ):
        free = [
            place
            for place in places
            if not any(covers(corners(np.add(anchor, place), size), box) for box in occupied)
        ]
        assert (found is None) == (not free)
        if free:
            assert tuple(found) == free[0]
            occupied.append(corners(np.add(anchor, found), size))
