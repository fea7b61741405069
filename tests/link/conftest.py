"""What tests of a link share."""

from contextlib import nullcontext

import pytest

from isacbench.link.waveform import propagation


@pytest.fixture(scope="module", autouse=True)
def threads_as_they_are():
    """Look for no libraries to limit in each received symbol: all tests keep to one thread."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(propagation, "threadpool_limits", lambda limits, user_api: nullcontext())
        yield
