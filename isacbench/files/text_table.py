"""Numbers in text files: read exactly, and refused with the place of the first fault."""

from __future__ import annotations

import csv
import io
import re
from itertools import takewhile
from typing import TYPE_CHECKING, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from isacbench.errors import InputError
from isacbench.files.checked_files import CLOUD_BYTES, read_text
from isacbench.files.escaping import quoted, shortened
from isacbench.number_text import is_number

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

Floats = NDArray[np.float64]

BLANKS = r"\s+"
"""Separator of fields: any white space."""

CHUNK_ROWS = 2**16
"""Rows that are held as texts at once: a text takes ten times the memory of its number."""

_BLANK = re.compile(r"\s*$")
_BLANK_OR_COMMENT = re.compile(r"\s*($|#|//)")
_COMMENT_BELOW = re.compile(r"\n([^\S\n]*(?:#|//).*)")
_SWAPPED = str.maketrans(",.", ".,")
_DECIMAL_MARK = re.compile(r"\.|\d,\d")
_NO_THOUSANDS = re.compile(r"\b0+,|\d{4},|,(?!\d{3}(?!\d))")
"""Marks of a number whose comma cannot set thousands apart."""


class TextTable(NamedTuple):
    """Rows of a text file, not yet told apart into fields.

    Attributes
    ----------
    lines : list of str
        One a row.
    numbers : list of int
        Numbers of the rows in the file, from 1.
    delimiter : str
        Separator of fields, as pandas takes it.
    """

    lines: list[str]
    numbers: list[int]
    delimiter: str


def split_text(text: str, first_number: int = 1, is_left_out: re.Pattern[str] = _BLANK) -> TextTable:
    """Find the rows of a text with lines of any ends.

    Parameters
    ----------
    text : str
    first_number : int
        Number of its first line.
    is_left_out : re.Pattern
        Matches the lines that are no rows; by default, blank ones.

    Returns
    -------
    TextTable
        Its delimiter is that of its first row.
    """
    lines = re.sub("\r\n?", "\n", text).split("\n")
    numbers = [number for number, line in enumerate(lines, first_number) if not is_left_out.match(line)]
    rows = [lines[number - first_number] for number in numbers]
    return TextTable(rows, numbers, delimiter_of(rows[0] if rows else ""))


def read_text_rows(path: Path) -> tuple[TextTable, list[str]]:
    """Read the lines of a UTF-8 text file that are neither blank nor a comment.

    Excel's first line ``sep=;`` is left out, and so is CloudCompare's line with the number of rows.

    Parameters
    ----------
    path : Path

    Returns
    -------
    table : TextTable
    comments : list of str
        Lines that start with # or // before the first row, without these marks.

    Raises
    ------
    InputError
        If the file cannot be read, is too large or is not text, or if a
        comment below the first row has as many fields as a row.
    """
    text = re.sub("\r\n?", "\n", read_text(path, CLOUD_BYTES))
    text = re.sub(r'(?i)\A"?sep=."?\n', "\n", text)
    table = split_text(text, is_left_out=_BLANK_OR_COMMENT)
    is_counted = len(table.lines) > 1 and table.lines[0].strip() == str(len(table.lines) - 1)
    if is_counted and re.match(r"\s*[-+.\d]", table.lines[1]):  # else a header
        table = TextTable(table.lines[1:], table.numbers[1:], delimiter_of(table.lines[1]))
    above = [*takewhile(_BLANK_OR_COMMENT.match, io.StringIO(text))]
    _require_no_rows_as_comments(path, table, text, sum(map(len, above)))
    return table, [line.strip("#/ \t\n") for line in above]


def _require_no_rows_as_comments(path: Path, table: TextTable, text: str, start: int) -> None:
    """Refuse lines from a place in the text on that may be comments or rows, such as ``#N/A,5,6``."""
    sizes = [len(fields_of(path, line, table.delimiter)) for line in table.lines[:2]]
    sizes += [size + 1 for size in sizes if len(sizes) == 1]  # A header may leave out the names of rows.
    for comment in _COMMENT_BELOW.finditer(text, start):
        n_fields = len(fields_of(path, comment[1], table.delimiter))
        if n_fields > 1 and n_fields in sizes:
            number = text.count("\n", 0, comment.start(1)) + 1
            raise InputError(
                f"{path}: row {number}: may be a comment or a row; a row takes no # or // in front"
            )


def delimiter_of(line: str) -> str:
    """Find the separator of the fields of a line.

    Parameters
    ----------
    line : str

    Returns
    -------
    str
        The first of semicolon, tab and comma that it has outside quotes, or
        `BLANKS`. A tab at the ends of the line or beside another mark does not count.
    """
    plain = re.sub(r"\s*([,;])\s*", r"\1", re.sub('"[^"]*"', '""', line).strip())
    return next((mark for mark in ";\t," if mark in plain), BLANKS)


def fields_of(path: Path, line: str, delimiter: str) -> list[str]:
    """Split one line.

    Parameters
    ----------
    path : Path
        File to name in messages.
    line : str
        Not blank.
    delimiter : str

    Returns
    -------
    list of str
    """
    is_blank = delimiter == BLANKS
    rows = csv.reader(
        [line.strip() if is_blank else line], delimiter=" " if is_blank else delimiter, skipinitialspace=True
    )
    try:
        return [field.strip() for field in next(rows)]
    except csv.Error as error:
        raise InputError(f"{path}: cannot be read as csv: {error}") from error


def parse_numbers(path: Path, table: TextTable, columns: Sequence[str], wanted: Sequence[int]) -> Floats:
    """Turn rows of fields into numbers.

    Parameters
    ----------
    path : Path
        File to name in messages.
    table : TextTable
        Unless it is separated by commas, its numbers may have decimal commas.
    columns : sequence of str
        Names of all columns.
    wanted : sequence of int
        Columns that are numbers; others are ignored.

    Returns
    -------
    ndarray of float64, shape (n, len(wanted))
        Finite values, each the double nearest to its text.

    Raises
    ------
    InputError
        On a row with too few or too many fields, a field that is no number,
        or one that is not finite; and if all commas may set thousands apart,
        where no semicolons say that they are decimal.
    """
    mark: re.Match[str] | None = None
    is_decimal = table.delimiter == ";"
    values = np.empty((len(table.lines), len(wanted)))
    at = 0
    for chunk in _chunks(path, table, columns):
        is_short = (chunk[:, -1] == "") & (table.delimiter == BLANKS)  # which pandas fills up
        if is_short.any():
            row = int(is_short.argmax())
            n_fields = int((chunk[row] != "").sum())
            _refuse_count(path, table.numbers[at + row], n_fields, columns)
        fields = chunk[:, wanted]
        texts = fields.ravel().tolist()
        joined = "\n".join(texts)
        mark = mark or (_DECIMAL_MARK.search(joined) if table.delimiter != "," else None)
        if mark and "," in mark[0]:
            is_decimal = is_decimal or bool(_NO_THOUSANDS.search(joined))
            texts = [text.translate(_SWAPPED) for text in texts]
        numbers = values[at : at + len(chunk)]
        try:
            if "_" in joined or not joined.isascii():  # as `is_number`, for all at once
                raise ValueError
            numbers[:] = np.reshape(np.array(texts, dtype=np.float64), numbers.shape)
        except ValueError:
            row, column = divmod(next(k for k, text in enumerate(texts) if not is_number(text)), len(wanted))
            raise InputError(
                f"{path}: row {table.numbers[at + row]}: column {columns[wanted[column]]} is "
                f"{quoted(fields[row, column].strip(' '))}; expected a number"
            ) from None
        check_finite(path, numbers, [columns[k] for k in wanted], table.numbers[at : at + len(chunk)])
        at += len(chunk)
    if mark and "," in mark[0] and not is_decimal:
        raise InputError(f"{path}: commas may be decimal or set thousands apart; allowed are decimal points")
    if at < len(table.lines):
        raise InputError(f"{path}: has a line break within quotes; allowed is one line a row")
    return values


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


def _chunks(path: Path, table: TextTable, columns: Sequence[str]) -> Iterator[NDArray[np.object_]]:
    """Texts (rows, fields) of some rows at a time."""
    import pandas as pd  # which takes longer to load than all that other formats need

    if not table.lines:
        return
    found = fields_of(path, table.lines[0], table.delimiter)
    if len(found) > len(columns):
        _refuse_count(path, table.numbers[0], len(found), columns)
    try:
        # As texts: float_precision="round_trip" is needed up to pandas 3.0 and warned of from 3.1 on, and
        # columns of True are read as 1.
        with pd.read_csv(
            io.StringIO("\n".join(table.lines)),
            sep=table.delimiter,
            header=None,
            names=range(len(columns)),
            index_col=False,
            dtype=object,
            na_filter=False,
            skipinitialspace=True,
            chunksize=CHUNK_ROWS,
        ) as chunks:
            yield from (chunk.to_numpy() for chunk in chunks)
    except pd.errors.ParserError as error:
        if long := re.search(r"in line (\d+), saw (\d+)", str(error)):
            _refuse_count(path, table.numbers[int(long[1]) - 1], long[2], columns)
        raise InputError(f"{path}: cannot be read as csv: {shortened(str(error).strip())}") from error


def _refuse_count(path: Path, row: int, n_fields: int | str, columns: Sequence[str]) -> NoReturn:
    """Refuse a row that is too long or too short."""
    raise InputError(
        f"{path}: row {row}: {n_fields} fields instead of {len(columns)} ({shortened(', '.join(columns))})"
    )
