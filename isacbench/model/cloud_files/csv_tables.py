"""Tables in csv files as pandas, R, NumPy, Excel and CloudCompare write them; two meanings are refused.

pandas splits the rows. Their numbers are converted here, exactly: an error names row and column,
``1_0`` is no number, and commas may be decimal.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from isacbench.checked_arrays import Floats
from isacbench.errors import InputError
from isacbench.files.checked_files import CLOUD_BYTES, read_text
from isacbench.files.escaping import quoted, shortened
from isacbench.model.cloud_files.columns import names_points
from isacbench.specifications import is_number

BLANKS = r"\s+"
"""Separator of fields: any white space."""

NO_ROW_NUMBERS = "rows without their numbers (pandas: index=False, R: row.names=FALSE)"

_COMMENT = re.compile(r"\s*(#|//)")
_BLANK_OR_COMMENT = re.compile(r"\s*($|#|//)")
_SWAPPED = str.maketrans(",.", ".,")
_DECIMAL_MARK = re.compile(r"\.|\d,\d")
_NO_THOUSANDS = re.compile(r"\b0+,|\d{4},|,(?!\d{3}(?!\d))")
"""Marks of a number whose comma cannot set thousands apart."""


@dataclass(frozen=True)
class CsvTable:
    """Rows of a csv file, not yet split into fields.

    Attributes
    ----------
    lines : list of str
        One a row.
    numbers : list of int
        Numbers of the rows in the file, from 1.
    delimiter : str
        Separator of fields, as pandas takes it.
    names : list of str
        Names of the columns, "" for that of row names; none without a header.
    place : str
        Where the names stand, or the first row.
    """

    path: Path
    lines: list[str]
    numbers: list[int]
    delimiter: str
    names: list[str]
    place: str

    def fields(self, row: int) -> list[str]:
        """Split one row."""
        return _fields(self.path, self.lines[row], self.delimiter)

    def values(self, columns: Sequence[str], wanted: Sequence[int]) -> Floats:
        """Numbers (n, len(wanted)) of some of all columns: finite, each the double nearest to its text.

        Unless the table is separated by commas, numbers may have decimal
        commas, but not if all may set thousands apart and no semicolons say
        that they are decimal.
        """
        names = [columns[k] for k in wanted]
        fields = self._fields(columns)[:, wanted]
        texts = fields.ravel().tolist()
        joined = "\n".join(texts)
        mark = _DECIMAL_MARK.search(joined) if self.delimiter != "," else None
        if mark and "," in mark[0]:
            texts = [text.translate(_SWAPPED) for text in texts]
        try:
            if "_" in joined or not joined.isascii():  # as `is_number`, for all at once
                raise ValueError
            values = np.reshape(np.array(texts, dtype=np.float64), fields.shape)
        except ValueError:
            row, column = divmod(next(k for k, text in enumerate(texts) if not is_number(text)), len(wanted))
            raise InputError(
                f"{self.path}: row {self.numbers[row]}: column {names[column]} is "
                f"{quoted(fields[row, column].strip(' '))}; expected a number"
            ) from None
        require_finite(self.path, values, names, self.numbers)
        if mark and "," in mark[0] and self.delimiter != ";" and not _NO_THOUSANDS.search(joined):
            raise InputError(
                f"{self.path}: commas may be decimal or set thousands apart; allowed are decimal points"
            )
        return values

    def _fields(self, columns: Sequence[str]) -> NDArray[np.object_]:
        """Texts (rows, columns)."""
        import pandas as pd  # which takes longer to load than all that other formats need

        if not self.lines:
            return np.empty((0, len(columns)), dtype=object)
        if (n_fields := len(self.fields(0))) > len(columns):
            self._refuse_count(0, n_fields, columns)
        try:
            fields = pd.read_csv(
                io.StringIO("\n".join(self.lines)),
                sep=self.delimiter,
                header=None,
                names=range(len(columns)),
                index_col=False,
                dtype=object,
                na_filter=False,
                skipinitialspace=True,
            ).to_numpy()
        except pd.errors.ParserError as error:
            if long := re.search(r"in line (\d+), saw (\d+)", str(error)):
                self._refuse_count(int(long[1]) - 1, long[2], columns)
            raise InputError(
                f"{self.path}: cannot be read as csv: {shortened(str(error).strip())}"
            ) from error
        if len(fields) < len(self.lines):
            raise InputError(f"{self.path}: has a line break within quotes; allowed is one line a row")
        is_short = (fields[:, -1] == "") & (self.delimiter == BLANKS)  # which pandas fills up
        if is_short.any():
            row = int(is_short.argmax())
            self._refuse_count(row, int((fields[row] != "").sum()), columns)
        return fields

    def _refuse_count(
        self, row: int, n_fields: int | str, columns: Sequence[str], remedy: str = ""
    ) -> NoReturn:
        """Refuse a row that is too long or too short."""
        raise InputError(
            f"{self.path}: row {self.numbers[row]}: {n_fields} fields instead of {len(columns)} "
            f"({shortened(', '.join(columns))}){remedy}"
        )

    def with_row_names(self) -> CsvTable:
        """Add a column of the names of rows, where the rows begin with one that the header does not announce.

        A number is a name only if it is quoted alone, or counts two rows or
        more. Any other is refused, because a name of a column may be missing.
        """
        first = self.fields(0) if self.lines else []
        if len(first) != len(self.names) + 1 or not first[-1]:
            return self
        named = CsvTable(self.path, self.lines, self.numbers, self.delimiter, ["", *self.names], self.place)
        if quotes_first_alone(self.lines[0]) or not is_number(first[0].replace(",", ".")):
            return named
        if len(self.lines) > 1 and counts(first[0], named.values(named.names, [0])[:, 0]):
            return named
        remedy = f"; allowed are a name for each, or {NO_ROW_NUMBERS}"
        self._refuse_count(0, len(first), self.names, remedy)


def read_csv_table(path: Path) -> CsvTable:
    """Read the rows of a csv file of UTF-8 text, and the names of its columns.

    Lines that are blank or a comment (# or //) are no rows, nor are Excel's
    first line ``sep=;`` and CloudCompare's line with the number of rows. A
    comment below the first row with as many fields as a row is refused.
    """
    text = re.sub("\r\n?", "\n", read_text(path, CLOUD_BYTES))
    lines = re.sub(r'(?i)\A"?sep=."?\n', "\n", text).split("\n")
    numbers = [number for number, line in enumerate(lines, 1) if not _BLANK_OR_COMMENT.match(line)]
    rows = [lines[number - 1] for number in numbers]
    if len(rows) > 1 and rows[0].strip() == str(len(rows) - 1) and re.match(r"\s*[-+.\d]", rows[1]):
        rows, numbers = rows[1:], numbers[1:]
    if not rows:
        raise InputError(f"{path}: is empty; at least the header x,y,z is required")
    delimiter = _delimiter_of(rows[0])
    _require_no_rows_as_comments(path, lines, rows, numbers[0], delimiter)
    first, place = _fields(path, rows[0], delimiter), f"row {numbers[0]}"
    if any(is_number(field.replace(",", ".")) for field in first) and not names_points(first):
        names = _commented_names(path, takewhile(_BLANK_OR_COMMENT.match, lines), first)
        return CsvTable(path, rows, numbers, delimiter, names, place)
    return CsvTable(path, rows[1:], numbers[1:], delimiter, first, place).with_row_names()


def require_finite(path: Path, values: Floats, columns: Sequence[str], row_numbers: Sequence[int]) -> None:
    """Refuse an array (n, len(columns)) that holds NaN or infinity, naming row and column of the first."""
    faults = np.argwhere(~np.isfinite(values))
    if faults.size:
        row, column = faults[0]
        value = "NaN" if np.isnan(values[row, column]) else "infinite"
        raise InputError(
            f"{path}: row {row_numbers[row]}: column {columns[column]} is {value}; expected a finite number"
        )


def quotes_first_alone(line: str) -> bool:
    """Tell if a row begins in quotes, and has fields without, as R writes the names of rows."""
    return line.lstrip().startswith('"') and bool(re.search(r"\w", re.sub('"[^"]*"', "", line)))


def counts(first: str, values: Floats) -> bool:
    """Tell if values, the first of them as written, are the numbers of rows, from 0 or 1."""
    return first in ("0", "1") and np.array_equal(values, np.arange(len(values)) + int(first))


def _delimiter_of(line: str) -> str:
    """Find the first of semicolon, tab and comma that a line has outside quotes; else blanks separate fields.

    A tab at the ends of the line or beside another mark does not count.
    """
    plain = re.sub(r"\s*([,;])\s*", r"\1", re.sub('"[^"]*"', '""', line).strip())
    return next((mark for mark in ";\t," if mark in plain), BLANKS)


def _fields(path: Path, line: str, delimiter: str) -> list[str]:
    if delimiter == BLANKS:
        line, delimiter = line.strip(), " "
    try:
        return [
            field.strip() for field in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
        ]
    except csv.Error as error:
        raise InputError(f"{path}: cannot be read as csv: {error}") from error


def _require_no_rows_as_comments(
    path: Path, lines: list[str], rows: list[str], first_number: int, delimiter: str
) -> None:
    """Refuse comments below the first row that may be rows, such as ``#N/A,5,6``."""
    sizes = [len(_fields(path, row, delimiter)) for row in rows[:2]]
    sizes += [size + 1 for size in sizes if len(sizes) == 1]  # A header may leave out the names of rows.
    for number, line in enumerate(lines[first_number:], first_number + 1):
        if _COMMENT.match(line) and 1 < len(_fields(path, line, delimiter)) in sizes:
            raise InputError(
                f"{path}: row {number}: may be a comment or a row; a row takes no # or // in front"
            )


def _commented_names(path: Path, above: Iterator[str], first: list[str]) -> list[str]:
    """Names in a comment above rows without a header, as CloudCompare and NumPy write them."""
    names: list[str] = []
    for line in (comment.strip("#/ \t") for comment in above):
        if {"x", "y", "z"} <= {*re.findall(r"\w+", line.lower())}:
            names = _fields(path, line, _delimiter_of(line))
            if len(names) != len(first) or not names_points(names):
                raise InputError(
                    f"{path}: the comment {quoted(line)} may name the {len(first)} columns; allowed is a "
                    "header line with a name for each"
                )
    return names
