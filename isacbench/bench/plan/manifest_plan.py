"""The plan of a run as the manifest keeps it: rows find their places in it without plugins."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from isacbench.bench.kinds.scenes import Entry
from isacbench.bench.plan.run_plan import Plan
from isacbench.bench.suites.scenario_digest import canonical_json

if TYPE_CHECKING:
    from collections.abc import Mapping

ENTRIES = "contestants"
"""Key of a scene's entries in a manifest, as version 0.1 wrote it."""


def outline(plan: Plan) -> list[dict[str, Any]]:
    """Describe the scenes of a plan in terms of JSON.

    Parameters
    ----------
    plan : Plan

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

    Parameters
    ----------
    manifest : mapping of str to Any

    Returns
    -------
    Plan
        Its scenes have name, content, SNRs and entries without plugins: enough to find the places
        of rows, and not to observe.

    Raises
    ------
    KeyError
        If the manifest is older than outlines.
    """
    entries = [
        Entry(entry["name"], canonical_json(entry["params"]), None) for entry in manifest["estimators"]
    ]
    scenes: list[Any] = [
        SimpleNamespace(**{**scene, "entries": [entries[index] for index in scene[ENTRIES]]})
        for scene in manifest["scenes"]
    ]
    return Plan(scenes, manifest["suite"]["trials"])
