"""Content of a scenario as JSON and as a table, and the digest that identifies it."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.model.array import PAPER_ORDER, VirtualArray
from isacbench.model.cloud_files.tables import POINT_COLUMNS
from isacbench.model.frame import HALF_WAVELENGTHS, PaperFrame, get_frame
from isacbench.model.link_budget import LinkBudget
from isacbench.model.numerology import Prs, System
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers, Scenario, no_input_warnings

if TYPE_CHECKING:
    import pandas as pd

SIGNIFICANT = 10
"""Significant digits of a number in a digest: random places depend on sines, whose last digits vary."""

OPTIONS = {
    **{"radius_m": 1.0, "gain_error_db": 0.0, "phase_error_deg": 0.0},
    **{"budget": None, "family": "", "family_version": 0},
}
"""Fields of a scenario, beside its parts, with the values at which its description leaves them out."""

LEFT_OUT = {
    **{**OPTIONS, "ascending": PAPER_ORDER, "mimo": "ideal", "leakage_db": None},
    **{"noise": "receiver", "prs": Prs(), "spacing_wavelengths": HALF_WAVELENGTHS},
}
"""Fields of scenarios and their parts that descriptions leave out at these values. A field that is
added is listed with the value for the behaviour before it: digests of older scenarios stay as they are."""

OBJECTS = "objects"
"""Field of scatterers, and column of the truth, that names their objects."""

DIGITS = 16
"""Hexadecimal digits of a digest: 64 bits distinguish far more contents than are ever stored."""


def canonical_json(content: Any) -> str:
    """Write content as JSON with sorted keys and without spaces: equal contents give equal texts."""
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)


def digest(content: Any) -> str:
    """Short SHA-256 digest of content in terms of JSON.

    Examples
    --------
    >>> digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1})
    True
    """
    return hashlib.sha256(canonical_json(content).encode()).hexdigest()[:DIGITS]


@lru_cache(maxsize=64)
def scenario_digest(scenario: Scenario) -> str:
    """Digest of everything that determines the observations of a scenario; its name seeds the noise.

    Equal names, radios, regions and scatterers give equal digests, however the scenario was written.
    """
    scatterers = scenario.scatterers
    names = [field.name for field in dataclasses.fields(scatterers) if field.name != OBJECTS]
    arrays = {name: getattr(scatterers, name).tolist() for name in names}
    content = {"name": scenario.name, "radio": describe_scenario(scenario), "scatterers": arrays}
    return digest(_rounded(content))


def describe_scenario(scenario: Scenario) -> dict[str, Any]:
    """Describe a scenario in terms of JSON, without its scatterers, which the truth holds."""
    frame = "paper" if isinstance(scenario.frame, PaperFrame) else "panel"
    parts = {name: getattr(scenario, name) for name in ("system", "array", "region")}
    return {
        **{name: described_fields(part) for name, part in parts.items()},
        "frame": {"name": frame, **described_fields(scenario.frame)},
        "base_station_m": scenario.base_station_m.tolist(),
        **{name: value for name, value in described_fields(scenario).items() if name in OPTIONS},
    }


def described_fields(part: Any) -> dict[str, Any]:
    """Collect the fields of a scenario or a part of it, but those that have their value of `LEFT_OUT`."""
    values = {field.name: getattr(part, field.name) for field in dataclasses.fields(part)}
    return {
        name: dataclasses.asdict(value) if isinstance(value, (Prs, LinkBudget)) else value
        for name, value in values.items()
        if name not in LEFT_OUT or value != LEFT_OUT[name]
    }


def restore_scenario(name: str, described: Mapping[str, Any], truth: pd.DataFrame) -> Scenario:
    """Build a scenario from its description and its rows of the truth, without warnings."""
    options = {name: described[name] for name in OPTIONS if name in described}
    system = dict(described["system"])
    if "prs" in system:
        system["prs"] = Prs(**system["prs"])
    if "budget" in options:
        options["budget"] = LinkBudget(**options["budget"])
    with no_input_warnings():
        return Scenario(
            name=name,
            system=System(**system),
            array=VirtualArray(**_tupled(described["array"])),
            frame=get_frame(**_tupled(described["frame"])),
            base_station_m=np.array(described["base_station_m"]),
            region=Region(**_tupled(described["region"])),
            **options,
            scatterers=restore_scatterers(truth),
        )


def restore_scatterers(table: pd.DataFrame) -> Scatterers:
    """Build scatterers from rows of the truth, or of the draws of a trial, which have phases."""
    points = table[POINT_COLUMNS].to_numpy(dtype=np.float64)
    return Scatterers(
        xyz=points[:, :3],
        velocity=points[:, 3],
        amplitude=np.sqrt(points[:, 4]),
        phase_rad=np.asarray(table.get("phase_rad", 0.0), dtype=np.float64),
        objects=tuple(table[OBJECTS]) if OBJECTS in table and all(table[OBJECTS]) else (),
    )


def truth_table(scenario: Scenario) -> pd.DataFrame:
    """Tabulate the scatterers of a scenario: scenario, x, y, z in m, v in m/s, power, and object.

    The object is an empty text where objects are not known.
    """
    table = scenario.truth.to_dataframe()
    table.insert(0, "scenario", scenario.name)
    table[OBJECTS] = scenario.scatterers.objects or ""
    return table


def _rounded(content: Any) -> Any:
    """Copy with floats rounded to so few digits that they do not depend on the machine."""
    if isinstance(content, float):
        return float(f"{content:.{SIGNIFICANT}g}") + 0.0
    if isinstance(content, dict):
        return {key: _rounded(value) for key, value in content.items()}
    return [_rounded(value) for value in content] if isinstance(content, (list, tuple)) else content


def _tupled(fields: Mapping[str, Any]) -> dict[str, Any]:
    return {name: tuple(one) if isinstance(one, list) else one for name, one in fields.items()}
