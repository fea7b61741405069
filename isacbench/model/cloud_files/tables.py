"""Tables of points: the names of their columns, as programs spell them, and csv files.

Csv files are read as pandas, R, NumPy, Excel and CloudCompare write them; what has two meanings is refused.
Numbers are converted exactly: an error names row and column, ``1_0`` is no number, and commas may be decimal.
"""

import csv
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from isacbench.checked_arrays import Floats
from isacbench.errors import InputError
from isacbench.files.checked_files import CLOUD_BYTES, read_text
from isacbench.files.escaping import quoted, shortened
from isacbench.specifications import is_number

POINT_COLUMNS = ["x", "y", "z", "v", "power"]
"""Columns of a cloud in tables and csv files: positions in m, radial velocity in m/s, power."""

_BESIDE_OTHER_V = re.compile(r"(.*[_ ])?(t?u|s)", re.IGNORECASE)
"""Names of a texture or a colour, whose v is no velocity."""

_ALIKE = {
    "v": (
        "velocity|(?<![a-z])vel|doppler|speed|range.?rate|(?<![a-z])vr(?![a-z])|^v([^a-z]|$)",
        "velocity",
        "the name velocity for m/s, positive when approaching, or nothing like it for unknown velocities",
    ),
    "power": (
        "pow|pwr|amplitude|intensity|magnitude|strength|reflect|gain|section|energy|rcs|snr|rssi"
        "|(?<![a-z])(ampl?s?|mags?|p|sigma|dbs?m?)(?![a-z])",
        "power",
        "the name power for powers relative to a unit scatterer, or nothing like it for points of power 1",
    ),
}
"""Names under which other programs store a column, what it is called, and what is allowed."""

BLANKS = " "
"""Separator of fields: any white space."""

NO_ROW_NUMBERS = "rows without their numbers (pandas: index=False, R: row.names=FALSE)"

_COMMENT = re.compile(r"\s*(#|//)")
_SEPARATOR = re.compile(r'(?i)\A"?sep=."?[\r\n]')
_ROW_NAME = re.compile(r'"[^"]*"[\s,;]+[-+.\d]')
"""Begin of a row as R writes it: a name in quotes, then a number."""
_DECIMAL_MARK = re.compile(r"\.|\d,\d")
_SWAPPED = str.maketrans(",.", ".,")
_NO_THOUSANDS = re.compile(r"\b0+,|\d{4},|,(?!\d{3}(?!\d))")
"""Marks of a number whose comma cannot set thousands apart."""


def plain_name(name: str) -> str:
    """Spell the name of a column as isacbench does.

    Examples
    --------
    >>> [plain_name(name) for name in ("X", "velocity", "scalar_v")]
    ['x', 'v', 'v']
    """
    plain = name.strip().lower().removeprefix("scalar_")  # which CloudCompare puts before its scalar fields
    return "v" if plain == "velocity" else plain


def find_columns(path: Path, place: str, names: Sequence[str]) -> dict[str, int]:
    """Find the columns of a cloud among the names that a file has at a place.

    Returns the indices of x, y, z and, if there, v and power, in this order.
    Refuses two columns that may be the same, a v of a texture, and another
    name that may be that of the velocity or the power.
    """
    plain = [plain_name(name) for name in names]
    texture = next(filter(_BESIDE_OTHER_V.fullmatch, names), None)
    faults = [f"{name} is missing" for name in "xyz" if name not in plain]
    faults += [f"{name} appears twice" for name in POINT_COLUMNS if plain.count(name) > 1]
    if texture and any(name.strip().lower() == "v" for name in names):
        faults.append(f"v beside {texture} is of a texture")
    if faults:
        raise InputError(
            f"{path}: {place}: {faults[0]}; a cloud takes x, y, z and, if there, v (or velocity) and power; "
            f"it has {shortened(', '.join(names)) or 'none'}"
        )
    places = {name: plain.index(name) for name in POINT_COLUMNS if name in plain}
    others = [name for name, spelled in zip(names, plain, strict=True) if spelled not in places]
    require_no_other_names(path, places, others)
    return places


def require_no_other_names(path: Path, columns: Collection[str], others: Sequence[str]) -> None:
    """Refuse what may be velocity or power, where no column is named so: all points would get none or 1."""
    for column, (like, name, allowed) in _ALIKE.items():
        similar = ", ".join(filter(re.compile(like, re.IGNORECASE).search, others))
        if column not in columns and similar:
            raise InputError(f"{path}: has no {name}, but {shortened(similar)}; allowed is {allowed}")


def require_finite(path: Path, values: Floats, columns: Sequence[str], row_numbers: Sequence[int]) -> None:
    """Refuse an array (n, len(columns)) that holds NaN or infinity, naming row and column of the first."""
    faults = np.argwhere(~np.isfinite(values))
    if faults.size:
        row, column = faults[0]
        raise InputError(
            f"{path}: row {row_numbers[row]}: column {columns[column]} is {values[row, column]}; "
            "expected a finite number"
        )


@dataclass(frozen=True)
class CsvTable:
    """Rows of a csv file, as texts.

    Attributes
    ----------
    rows : list of list of str
        All of one length.
    numbers : list of int
        Numbers of the rows in the file, from 1.
    delimiter : str
        Separator of fields.
    names : list of str
        Names of the columns, "" for that of row names; none without a header.
    place : str
        Where the names stand, or the first row.
    """

    path: Path
    rows: list[list[str]]
    numbers: Sequence[int]
    delimiter: str
    names: list[str]
    place: str

    def values(self, names: Sequence[str], wanted: Sequence[int]) -> Floats:
        """Numbers (n, len(wanted)) of some columns: finite, each the double nearest to its text.

        Unless commas separate fields, all numbers may have decimal commas. Those that may set thousands apart
        are refused where no semicolons say that they are decimal.
        """
        texts = [row[column] for row in self.rows for column in wanted]
        joined = "\n".join(texts)
        mark = _DECIMAL_MARK.search(joined) if self.delimiter != "," else None
        if has_commas := mark is not None and "," in mark[0]:
            texts = [text.translate(_SWAPPED) for text in texts]
        try:
            if "_" in joined or not joined.isascii():  # as `is_number`, for all at once
                raise ValueError
            values = np.reshape(np.array(texts, dtype=np.float64), (len(self.rows), len(wanted)))
        except ValueError:
            index = next(k for k, text in enumerate(texts) if not is_number(text))
            row, column = divmod(index, len(wanted))
            raise InputError(
                f"{self.path}: row {self.numbers[row]}: column {names[wanted[column]]} is "
                f"{quoted(self.rows[row][wanted[column]])}; expected a number, with a decimal point "
                "(or commas in all, where none separates fields)"
            ) from None
        require_finite(self.path, values, [names[column] for column in wanted], self.numbers)
        if has_commas and self.delimiter != ";" and not _NO_THOUSANDS.search(joined):
            raise InputError(
                f"{self.path}: commas may be decimal or set thousands apart; allowed are decimal points"
            )
        return values


def read_csv_table(path: Path) -> CsvTable:
    """Read the rows of a csv file of UTF-8 text, and the names of its columns.

    Blank lines are no rows, nor are Excel's first line ``sep=;``, comments (# or //) above the first row, one
    of which may name the columns, and CloudCompare's line with the number of rows.
    """
    text = _SEPARATOR.sub("\n", read_text(path, CLOUD_BYTES))
    above, numbered = [], [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    while numbered and _COMMENT.match(numbered[0][1]):
        above.append(numbered.pop(0)[1].strip("#/ \t"))
    if len(numbered) > 1 and numbered[0][1].strip() == str(len(numbered) - 1):
        numbered.pop(0)
    if not numbered:
        raise InputError(f"{path}: is empty; at least the header x,y,z is required")
    (number, first), numbers = numbered[0], [number for number, _ in numbered]
    # A tab beside another mark, or at the ends of a line, separates nothing.
    marks = re.sub(r"\s*([,;])\s*", r"\1", re.sub('"[^"]*"', '""', first).strip())
    delimiter = next((mark for mark in ";\t," if mark in marks), BLANKS)
    names, place = [name.strip() for name in split_rows(path, numbered[:1], delimiter)[0]], f"row {number}"
    if not any(is_number(name.replace(",", ".")) for name in names) or "x" in map(plain_name, names):
        rows = _named_rows(path, numbered[1:], delimiter, len(names))
        if rows and len(rows[0]) > len(names):
            names = ["", *names]
        return CsvTable(path, rows, numbers[1:], delimiter, names, place)
    rows, names = split_rows(path, numbered, delimiter), []
    for line in above:
        if {"x", "y", "z"} <= {*re.findall(r"\w+", line.lower())}:
            names = re.split(r"\s*[;\t,]\s*|\s+", line)
            if len(names) != len(rows[0]):
                raise InputError(
                    f"{path}: the comment {quoted(line)} may name the {len(rows[0])} columns; allowed is a "
                    "header line with a name for each"
                )
    return CsvTable(path, rows, numbers, delimiter, names, place)


def _named_rows(
    path: Path, lines: Sequence[tuple[int, str]], delimiter: str, n_names: int
) -> list[list[str]]:
    """Split the rows below a header, which may leave out the name of a first column with names of rows.

    A number is the name of a row only if it alone is quoted, or if they count two rows or more: else the name
    of another column may be missing.
    """
    if lines and len(split_rows(path, lines[:1], delimiter)[0]) == n_names + 1:
        rows = split_rows(path, lines, delimiter)
        first = [row[0].strip() for row in rows]
        counts = [[str(number + start) for number in range(len(rows))] for start in (0, 1)]
        has_names = _ROW_NAME.match(lines[0][1].strip()) or not is_number(first[0].replace(",", "."))
        if rows[0][-1].strip() and (has_names or (len(rows) > 1 and first in counts)):
            return rows
    return split_rows(path, lines, delimiter, n_names)


def split_rows(
    path: Path, lines: Sequence[tuple[int, str]], delimiter: str, n_fields: int | None = None
) -> list[list[str]]:
    """Split numbered lines into rows of one number of fields, by default that of the first."""
    texts = [" ".join(line.split()) if delimiter == BLANKS else line for _, line in lines]
    try:
        rows = [*csv.reader(texts, delimiter=delimiter, skipinitialspace=True)]
    except csv.Error as error:
        raise InputError(f"{path}: cannot be read as csv: {error}") from error
    wanted = len(rows[0]) if rows and n_fields is None else n_fields
    for (number, _), row in zip(lines, rows, strict=False):
        if len(row) != wanted:
            raise InputError(
                f"{path}: row {number}: {len(row)} fields instead of {wanted}; allowed are as many in all "
                f"rows and in the header, and {NO_ROW_NUMBERS}"
            )
    return rows
