"""Tables of numbers as people save them: separated by commas, semicolons, tabs or spaces, by any program and on any system."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from av_common.files import MEGABYTE, one_line, read_text, shown

MOST_BYTES = 10 * MEGABYTE    # two hours of azimuths, 100 a second, of 14 bytes
SEPARATORS = ';\t, '


def read_table(path: str | Path, columns: Sequence[str], optional: Sequence[str] = ()) -> NDArray[np.float64]:
    """The numbers (n, len(columns)) in some columns of a table with a header; empty fields of `optional` columns are NaN.

    Capitals, quotes and spaces around names and numbers, empty lines, other columns and their order do not matter. Where commas
    do not separate, they may be decimal.

    Parameters:
        path: the file, in UTF-8, or in UTF-16 with its mark.
        columns: names of the columns.
        optional: those of them that may be empty.

    Raises OSError, or ValueError with the file, the line, its value and what is expected; no line may have more fields than
    the first.
    """
    lines = [(number, line) for number, line in enumerate(read_text(path, MOST_BYTES).splitlines(), 1)
             if line.strip(' \t,;') and not line.lower().startswith('sep=')]
    head = lines[0][1] if lines else ''
    for separator in SEPARATORS:
        names = _fields(head, separator)
        if set(columns) <= {name.casefold() for name in names}:
            break
    else:
        raise ValueError(f'{path}: the first line is {shown(one_line(head))}, expected the columns {" and ".join(columns)}')
    places = [[name.casefold() for name in names].index(column) for column in columns]
    rows = []
    for number, line in lines[1:]:
        fields = _fields(line, separator)
        if any(fields[len(names):]):    # decimal commas between commas
            raise ValueError(f'{path}, line {number}: {shown(one_line(line))} has more fields than the first line')
        values = [fields[place] if place < len(fields) else '' for place in places]
        try:
            rows.append([_number(value, separator, column in optional) for value, column in zip(values, columns, strict=True)])
        except ValueError as error:
            raise ValueError(f'{path}, line {number}: {shown(one_line(line))}, expected numbers in the columns '
                             f'{" and ".join(columns)}') from error
    if not rows:
        raise ValueError(f'{path} has no rows')
    return np.array(rows, float)


def _fields(line: str, separator: str) -> list[str]:
    if separator == ' ':
        return line.split()
    try:
        return [field.strip() for field in next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])]
    except csv.Error:  # a field longer than csv takes
        return [line]


def _number(text: str, separator: str, optional: bool) -> float:
    if not text and optional:
        return math.nan
    return float(text if separator == ',' else text.replace(',', '.'))
