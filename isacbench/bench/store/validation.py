"""Checks of the rows of a stored run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, get_args

from isacbench.bench.cells.record import COLUMNS, KINDS, TYPES, CellStatus
from isacbench.errors import InputError
from isacbench.files.escaping import quoted

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd


def require_sound_records(records: pd.DataFrame) -> None:
    """Refuse records whose columns have other types, or a status that this isacbench does not know.

    Parameters
    ----------
    records : DataFrame
        Any of the columns `isacbench.bench.cells.record.COLUMNS`.

    Raises
    ------
    ValueError
        Naming the column.
    """
    records.astype({name: KINDS[TYPES[name]] for name in COLUMNS if name in records})
    if "status" in records:
        statuses = get_args(CellStatus)
        unknown = set(records["status"].unique()) - set(statuses)
        if unknown:
            raise ValueError(f"column status: {quoted(unknown.pop())}; allowed are {', '.join(statuses)}")


def require_described_scenarios(records: pd.DataFrame, manifest: Mapping[str, Any]) -> None:
    """Refuse records of scenarios that the manifest does not describe.

    Parameters
    ----------
    records : DataFrame
    manifest : mapping of str to Any
        With ``suite`` and ``scenarios``.

    Raises
    ------
    InputError
        Naming the scenarios.
    """
    # A study that makes scenes of a scenario names it in a further column, which is empty for a link's user.
    names = records["template" if "template" in records else "scenario"].dropna().unique()
    described = manifest["scenarios"]
    missing = set(names) - {"", *described, *manifest["suite"].get("maps", ())}
    if missing:
        raise InputError(
            f"its rows name the scenarios {quoted(sorted(missing))}, which its manifest does not describe; "
            f"allowed are {quoted(sorted(described))}"
        )
