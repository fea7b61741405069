"""Imports of the process server: the built-in plugins, so that a fresh worker has them at once."""

from __future__ import annotations

from contextlib import suppress

from isacbench.errors import InputError
from isacbench.plugins.discovery import entries

with suppress(InputError):  # told by whoever asks for a plugin
    for entry in (*entries("estimator").values(), *entries("detector").values()):
        if entry.package == "isacbench":
            entry.load()
