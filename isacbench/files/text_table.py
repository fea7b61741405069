"""Numbers in text files: read exactly, and refused with the place of the first fault."""

from __future__ import annotations

import io
from array import array
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from isacbench.errors import InputError
from isacbench.files.checked_files import CLOUD_BYTES, read_text
from isacbench.files.escaping import quoted, shortened
from isacbench.number_text import is_number

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

Floats = NDArray[np.float64]


class TextLine(NamedTuple):
    """A line of text and its number in the file, from 1."""

    number: int
    text: str


def read_lines(path: Path) -> list[TextLine]:
    """Read the lines of a UTF-8 text file that are not blank.

    Parameters
    ----------
    path : Path

    Returns
    -------
    list of TextLine

    Raises
    ------
    InputError
        If the file cannot be read, is too large or is not text.
    """
    lines = io.StringIO(read_text(path, CLOUD_BYTES), newline=None)
    return [TextLine(number, text) for number, text in enumerate(lines, start=1) if text.strip()]


def parse_rows(
    path: Path, lines: Iterable[TextLine], columns: Sequence[str], delimiter: str | None
) -> Floats:
    """Turn lines of numbers into an array.

    Parameters
    ----------
    path : Path
        File to name in messages.
    lines : iterable of TextLine
        One row each.
    columns : sequence of str
        Names of the columns.
    delimiter : str or None
        Separator of fields; None is any white space.

    Returns
    -------
    ndarray of float64, shape (n, len(columns))
        Finite values, each the double nearest to its text.

    Raises
    ------
    InputError
        On a row with too few or too many fields, a field that is no number,
        or one that is not finite.
    """
    values, numbers = array("d"), array("q")
    for number, text in lines:
        fields = text.split(delimiter)
        if len(fields) != len(columns):
            raise InputError(
                f"{path}: row {number}: {len(fields)} fields instead of {len(columns)} "
                f"({shortened(', '.join(columns))})"
            )
        try:
            if "_" in text or not text.isascii():  # as `is_number`, for all fields at once
                raise ValueError(text)
            values.extend(map(float, fields))
        except ValueError:
            column = next(k for k, field in enumerate(fields) if not is_number(field))
            found = quoted(fields[column].strip())
            raise InputError(
                f"{path}: row {number}: column {columns[column]} is {found}; expected a number"
            ) from None
        numbers.append(number)
    table = np.array(values, dtype=np.float64).reshape(len(numbers), len(columns))
    check_finite(path, table, columns, numbers)
    return table


def check_finite(path: Path, values: Floats, columns: Sequence[str], row_numbers: Sequence[int]) -> None:
    """Refuse an array that holds NaN or infinity.

    Parameters
    ----------
    path : Path
        File to name in messages.
    values : ndarray of float64, shape (n, len(columns))
    columns : sequence of str
    row_numbers : sequence of int
        Numbers of the rows in messages.

    Raises
    ------
    InputError
        Naming file, row and column of the first such value.
    """
    faults = np.argwhere(~np.isfinite(values))
    if faults.size:
        row, column = faults[0]
        value = "NaN" if np.isnan(values[row, column]) else "infinite"
        raise InputError(
            f"{path}: row {row_numbers[row]}: column {columns[column]} is {value}; expected a finite number"
        )


def format_rows(values: Floats, delimiter: str) -> Iterator[str]:
    """Write the rows of an array so that reading them returns the same doubles.

    Parameters
    ----------
    values : ndarray of float64, shape (n, k)
    delimiter : str

    Yields
    ------
    str
        One row.
    """
    return (delimiter.join(map(repr, row)) for row in values.tolist())
