"""The command line: parses, calls, prints. Everything heavy is imported inside the commands.

Importing the package registers the commands, in the order of ``isacbench --help``.
"""

from __future__ import annotations

from isacbench.cli import running, results, plugins, images, waveform, stress  # isort: skip
from isacbench.cli.app import app, main

__all__ = ["app", "images", "main", "plugins", "results", "running", "stress", "waveform"]
