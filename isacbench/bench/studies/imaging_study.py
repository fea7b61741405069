"""The study ``imaging``: every scenario as it is, scored as a cloud. The simplest of all."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from isacbench.bench.cells.radio_coordinates import gain_db
from isacbench.bench.studies.study import ImagedScene, build_estimators, element_snrs_db
from isacbench.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from isacbench.bench.suites.suite import Suite
    from isacbench.model.scene import Scenario


class ImagingStudy:
    """Deviation of the image of every scenario, over SNR."""

    columns: ClassVar[Mapping[str, Any]] = {}

    def scenes(self, suite: Suite, scenarios: Mapping[str, Scenario]) -> list[ImagedScene]:
        """Return the scenarios themselves."""
        entries = build_estimators(suite)
        require_scatterers(scenarios)
        return [
            ImagedScene(suite, scenario, entries, element_snrs_db(suite, gain_db(scenario)))
            for scenario in scenarios.values()
        ]


def require_scatterers(scenarios: Mapping[str, Scenario]) -> None:
    """Refuse scenarios in which nothing can be scored.

    Raises
    ------
    InputError
        Naming the first.
    """
    for name, scenario in scenarios.items():
        if not len(scenario.scatterers):
            raise InputError(f"scenarios: {name!r} has no scatterers, so that nothing can be scored")
