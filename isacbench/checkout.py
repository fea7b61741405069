"""One version in a checkout: its folders are imported with the isacbench beside them, and no copies."""

from __future__ import annotations

import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = {"isacbench_algorithms": ROOT / "algorithms", "isacbench_scenarios": ROOT / "scenarios"}
"""Packages by name, and the folders that a checkout has them in."""


class CheckoutFinder(MetaPathFinder):
    """Finder of the packages in the folders of a checkout."""

    def find_spec(self, fullname: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """Find one of the packages; others are left to others."""
        folder = FOLDERS.get(fullname)
        if folder is None:
            return None
        return spec_from_file_location(
            fullname, folder / "__init__.py", submodule_search_locations=[str(folder)]
        )


def keep_to_checkout() -> None:
    """Import the other packages from the checkout that this module is in, if it is in one.

    One that has been imported from elsewhere is an ImportError.
    """
    if not all((folder / "__init__.py").is_file() for folder in FOLDERS.values()):
        return
    for name, folder in FOLDERS.items():
        loaded = Path(getattr(sys.modules.get(name), "__file__", None) or folder / "__init__.py").parent
        if loaded.resolve() != folder:
            raise ImportError(
                f"two versions of isacbench: {name} comes from {loaded} and isacbench from {ROOT}; import "
                "isacbench first, work outside of the checkout, or install it with pip install -e"
            )
    if not any(isinstance(finder, CheckoutFinder) for finder in sys.meta_path):
        sys.meta_path.insert(0, CheckoutFinder())
