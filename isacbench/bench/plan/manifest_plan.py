"""The plan of a run as the manifest keeps it: rows find their places in it without plugins."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

from isacbench.bench.plan.run_plan import Plan
from isacbench.bench.studies.study import Entry

if TYPE_CHECKING:
    from isacbench.bench.studies.study import Scene

ENTRIES = "contestants"
"""Key of a scene's entries in a manifest, as version 0.1 wrote it."""


@dataclass(frozen=True)
class OutlinedScene:
    """A scene that rows can be placed in, but nothing observed of.

    Attributes
    ----------
    name, content : str
    snr_db : sequence of float
    entries : sequence of Entry
        Without plugins.
    """

    name: str
    content: str
    snr_db: Sequence[float]
    entries: Sequence[Entry[None]]


def outline(plan: Plan) -> list[dict[str, Any]]:
    """Describe the scenes of a plan in terms of JSON.

    Returns
    -------
    list of dict
        ``name``, ``content``, ``snr_db`` and ``contestants``, indices into
        the plan's entries.
    """
    index = {(one.name, one.params): number for number, one in enumerate(plan.entries)}
    return [
        {
            "name": scene.name,
            "content": scene.content,
            "snr_db": list(scene.snr_db),
            ENTRIES: [index[one.name, one.params] for one in scene.entries],
        }
        for scene in plan.scenes
    ]


def restore_plan(manifest: Mapping[str, Any]) -> Plan:
    """Build the plan of a run from its manifest.

    Returns
    -------
    Plan
        Of scenes that are good for finding places and naming cells alone.

    Raises
    ------
    KeyError
        If the manifest is older than outlines.
    """
    entries = [
        Entry(entry["name"], json.dumps(entry["params"], sort_keys=True, separators=(",", ":")), None)
        for entry in manifest["estimators"]
    ]
    scenes = [
        OutlinedScene(
            scene["name"],
            scene["content"],
            tuple(scene["snr_db"]),
            tuple(entries[index] for index in scene[ENTRIES]),
        )
        for scene in manifest["scenes"]
    ]
    return Plan(cast("Sequence[Scene]", scenes), manifest["suite"]["trials"])
