"""Former import paths, of version 0.1: each gives the module at its present path."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

PRESENT = {
    "isacbench.contracts": "isacbench.plugins.contracts",
    "isacbench.stages": "isacbench.instrument.stages",
    "isacbench.remarks": "isacbench.instrument.remarks",
    "isacbench.dsp.cfar_checks": "isacbench.dsp.cfar.map_checks",
    "isacbench.dsp.thresholds": "isacbench.dsp.cfar.factors",
    "isacbench.conformance": "isacbench.checking.contract",
    "isacbench.conformance.scenes": "isacbench.checking.promises.small_scenes",
    "isacbench.stress": "isacbench.checking.stress",
    "isacbench.stress.case": "isacbench.checking.stress.case",
    "isacbench.stress.detecting": "isacbench.checking.stress.case",
    "isacbench.stress.estimating": "isacbench.checking.stress.case",
    "isacbench.stress.families": "isacbench.checking.stress.runs.families",
    "isacbench.stress.imaging": "isacbench.checking.promises.image_promises",
    "isacbench.stress.shots": "isacbench.checking.promises.small_scenes",
    "isacbench.stress.spaces": "isacbench.checking.stress.spaces",
}
"""Present path of a module by the path that CONTRIBUTING named in version 0.1."""


def present_path(module: str) -> str:
    """Look up the present path of a module.

    Parameters
    ----------
    module : str
        Dotted name, of version 0.1 or later.

    Returns
    -------
    str
        The same name where the module has not moved. Modules of a former package
        are those of the present one.

    Examples
    --------
    >>> present_path("isacbench.contracts"), present_path("numpy")
    ('isacbench.plugins.contracts', 'numpy')
    """
    for former in sorted(PRESENT, key=len, reverse=True):
        if f"{module}.".startswith(f"{former}."):
            return PRESENT[former] + module.removeprefix(former)
    return module


class FormerPaths(MetaPathFinder, Loader):
    """Importer of modules by their former paths; there is no second copy of a module."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find the paths of `PRESENT` and those below them.

        Parameters
        ----------
        fullname : str
        path : sequence of str or None
        target : module, optional

        Returns
        -------
        ModuleSpec or None
            None for every other path.
        """
        moved = present_path(fullname) != fullname
        return ModuleSpec(fullname, self, is_package=True) if moved else None

    def exec_module(self, module: ModuleType) -> None:
        """Put the module at the present path in the place of the imported one.

        Parameters
        ----------
        module : module
        """
        sys.modules[module.__name__] = import_module(present_path(module.__name__))
