"""Tables in csv files as pandas, R, NumPy, Excel and CloudCompare write them; two meanings are refused.

Numbers are converted exactly: an error names row and column, ``1_0`` is no number, and commas may be decimal.
"""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from isacbench.checked_arrays import Floats
from isacbench.errors import InputError
from isacbench.files.checked_files import CLOUD_BYTES, read_text
from isacbench.files.escaping import quoted
from isacbench.model.cloud_files.columns import plain_name, require_finite
from isacbench.specifications import is_number

BLANKS = " "
"""Separator of fields: any white space."""

NO_ROW_NUMBERS = "rows without their numbers (pandas: index=False, R: row.names=FALSE)"

_COMMENT = re.compile(r"\s*(#|//)")
_SWAPPED = str.maketrans(",.", ".,")


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

        Between semicolons all numbers may have decimal commas.
        """
        texts = [row[column] for row in self.rows for column in wanted]
        joined = "\n".join(texts)
        if self.delimiter == ";" and "," in joined:
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
                "(or a comma, between semicolons)"
            ) from None
        require_finite(self.path, values, [names[column] for column in wanted], self.numbers)
        return values


def read_csv_table(path: Path) -> CsvTable:
    """Read the rows of a csv file of UTF-8 text, and the names of its columns.

    Blank lines are no rows, nor are lines above the first row that are a comment (# or //). One of these may
    name the columns.
    """
    lines = enumerate(read_text(path, CLOUD_BYTES).splitlines(), 1)
    above, numbered = [], [(number, line) for number, line in lines if line.strip()]
    while numbered and _COMMENT.match(numbered[0][1]):
        above.append(numbered.pop(0)[1].strip("#/ \t"))
    if not numbered:
        raise InputError(f"{path}: is empty; at least the header x,y,z is required")
    numbers, texts = zip(*numbered, strict=True)
    delimiter = next((mark for mark in ";\t," if mark in texts[0]), BLANKS)
    rows, place = split_rows(path, texts, numbers, delimiter), f"row {numbers[0]}"
    names = [name.strip() for name in rows[0]]
    if not any(is_number(name.replace(",", ".")) for name in names) or "x" in map(plain_name, names):
        return CsvTable(path, rows[1:], numbers[1:], delimiter, names, place)
    names = []
    for line in above:
        if {"x", "y", "z"} <= {*re.findall(r"\w+", line.lower())}:
            names = re.split(r"\s*[;\t,]\s*|\s+", line)
            if len(names) != len(rows[0]):
                raise InputError(
                    f"{path}: the comment {quoted(line)} may name the {len(rows[0])} columns; allowed is a "
                    "header line with a name for each"
                )
    return CsvTable(path, rows, numbers, delimiter, names, place)


def split_rows(
    path: Path, lines: Sequence[str], numbers: Sequence[int], delimiter: str, n_fields: int | None = None
) -> list[list[str]]:
    """Split lines into rows of one number of fields, by default that of the first."""
    if delimiter == BLANKS:
        lines = [" ".join(line.split()) for line in lines]
    try:
        rows = [*csv.reader(lines, delimiter=delimiter, skipinitialspace=True)]
    except csv.Error as error:
        raise InputError(f"{path}: cannot be read as csv: {error}") from error
    wanted = len(rows[0]) if rows and n_fields is None else n_fields
    for number, row in zip(numbers, rows, strict=False):
        if len(row) != wanted:
            raise InputError(
                f"{path}: row {number}: {len(row)} fields instead of {wanted}; allowed are as many in all "
                f"rows and in the header, and {NO_ROW_NUMBERS}"
            )
    return rows
