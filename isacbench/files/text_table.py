"""Numbers in text files: read exactly, and refused with the place of the first fault."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from isacbench.errors import InputError
from isacbench.files.checked_files import CLOUD_BYTES, require_file
from isacbench.files.escaping import quoted, shortened

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

Floats = NDArray[np.float64]


class TextLine(NamedTuple):
    """A line of text and its number in the file, from 1."""

    number: int
    text: str


def read_lines(path: Path) -> Iterator[TextLine]:
    """Read the lines of a UTF-8 text file that are not blank, one after the other.

    Raises
    ------
    InputError
        If the file cannot be read, is too large or is not text.
    """
    require_file(path, CLOUD_BYTES)
    try:
        with path.open(encoding="utf-8-sig") as file:
            for number, text in enumerate(file, start=1):
                if text.strip():
                    yield TextLine(number, text.removesuffix("\n"))
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text (byte {_first_fault(path, error)})") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error


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
        Names of the columns, for messages and their number.
    delimiter : str or None
        What separates fields; None is any white space.

    Returns
    -------
    ndarray of float64, shape (n, len(columns))
        Finite values, each the double nearest to what is written.

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
            values.extend(map(float, fields))
        except ValueError:
            column, field = _first_non_number(columns, fields)
            raise InputError(
                f"{path}: row {number}: column {column} is {quoted(field.strip())}; a number is wanted"
            ) from None
        numbers.append(number)
    table = np.array(values, dtype=np.float64).reshape(len(numbers), len(columns))
    check_finite(path, table, columns, numbers)
    return table


def _first_non_number(columns: Sequence[str], fields: Sequence[str]) -> tuple[str, str]:
    """Name the first field that is no number, and its column."""
    return next(
        (column, field) for column, field in zip(columns, fields, strict=True) if not is_number(field)
    )


def _first_fault(path: Path, error: UnicodeDecodeError) -> int:
    """Byte at which a file is no text any more; the error counts from the piece that was decoded."""
    try:
        path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as whole:
        return whole.start
    return error.start


def is_number(field: str) -> bool:
    """Whether a field of text is a number, NaN and infinity included."""
    try:
        float(field)
    except ValueError:
        return False
    return True


def check_finite(path: Path, values: Floats, columns: Sequence[str], row_numbers: Sequence[int]) -> None:
    """Refuse an array (n, len(columns)) that holds NaN or infinity.

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
            f"{path}: row {row_numbers[row]}: column {columns[column]} is {value}; a finite number is wanted"
        )


def format_rows(values: Floats, delimiter: str) -> Iterator[str]:
    """Write the rows of an array so that reading them returns the same doubles."""
    return (delimiter.join(map(repr, row)) for row in values.tolist())
