"""Command line: parses, calls, prints. Commands import heavy packages themselves.

Importing the package registers the commands, in the order of ``isacbench --help``.
"""

from __future__ import annotations

# isort: off
from isacbench.cli import run_commands, result_commands, plugin_commands, image_commands  # noqa: F401

# isort: on
from isacbench.cli.app import app, main

__all__ = ["app", "main"]
