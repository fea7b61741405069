"""The command line: parses, calls, prints. Everything heavy is imported inside the commands.

Importing the package registers the commands, in the order of ``isacbench --help``.
"""

from __future__ import annotations

# isort: off
from isacbench.cli import run_commands, result_commands, plugin_commands
from isacbench.cli import image_commands, waveform_commands, stress_commands

# isort: on
from isacbench.cli.app import app, main

__all__ = [
    "app",
    "image_commands",
    "main",
    "plugin_commands",
    "result_commands",
    "run_commands",
    "stress_commands",
    "waveform_commands",
]
