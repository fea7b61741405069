"""Tables as CSV, safe to open in a spreadsheet."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pandas as pd
import pyarrow as pa
from pyarrow import csv

if TYPE_CHECKING:
    from pathlib import Path

FORMULA = r"^[=+\-@\t\r]"
"""First character of a text that a spreadsheet evaluates as a formula."""

GUARD = "'"
"""Mark by which spreadsheets know that a text follows."""


def write_csv_table(table: pd.DataFrame, path: Path) -> None:
    """Write a table as CSV: text in quotes, missing values empty, numbers with all their digits.

    Parameters
    ----------
    table : DataFrame
        Columns of numbers, booleans or text, each of one type.
    path : Path
        Overwritten.

    Raises
    ------
    pyarrow.ArrowInvalid, pyarrow.ArrowTypeError
        If a column mixes types.
    OSError
        If the file cannot be written.
    """
    csv.write_csv(pa.Table.from_pandas(table, preserve_index=False), path)


def without_formulas(table: pd.DataFrame) -> pd.DataFrame:
    """Put an apostrophe before text that a spreadsheet would evaluate as a formula.

    Parameters
    ----------
    table : DataFrame

    Returns
    -------
    DataFrame
        Same rows and columns.

    Examples
    --------
    >>> without_formulas(pd.DataFrame({"scenario": ["street", "=1+1"]}))["scenario"].tolist()
    ['street', "'=1+1"]
    """
    guarded = {}
    for name in table.columns:
        if pd.api.types.infer_dtype(table[name], skipna=True) == "string":
            is_formula = table[name].str.match(FORMULA, na=False)
            guarded[name] = table[name].mask(is_formula, GUARD + table[name])
    return table.assign(**guarded)
