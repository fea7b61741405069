"""Places of exceptions: the innermost line of a plugin's own code."""

from __future__ import annotations

import sys
import traceback
from pathlib import Path

LIBRARIES = frozenset({"isacbench", "numpy", "scipy", "threadpoolctl"}) | sys.stdlib_module_names - {
    "__main__"
}
"""Packages that call a plugin, or that a plugin calls."""


def error_place(error: BaseException, module: str = "") -> str:
    """Find where the code of a plugin has raised an exception.

    Parameters
    ----------
    error : BaseException
    module : str
        The plugin's module, if it is known.

    Returns
    -------
    str
        File, line and function of the innermost frame of the plugin's own package, else
        of any code but `LIBRARIES`; empty if there is none.
    """
    own = others = ""
    # By the names of modules: a plugin's file may lie in any folder, one called numpy as well.
    for frame, line in traceback.walk_tb(error.__traceback__):
        package = str(frame.f_globals.get("__name__", "")).partition(".")[0]
        place = f"{Path(frame.f_code.co_filename).name}, line {line}, in {frame.f_code.co_name}"
        if package == module.partition(".")[0]:
            own = place
        elif package not in LIBRARIES:
            others = place
    return own or others
