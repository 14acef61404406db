"""Rows of like parameters as one array with named fields.

Compiled functions take every array of an argument apart into its seven words, so an argument of
forty arrays costs more to hand over than to use. One record array a kind costs one.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np


def table(kind: type[NamedTuple], rows: Iterable[Any]) -> np.recarray:
    """Rows, each a `kind` or a sequence of them, as a record array with the fields of `kind`.

    `table(Cylinder, cylinders)[2]` reads like one `Cylinder`, `table(...).cap_area` is an array.
    """
    dtype = np.dtype([(name, np.float64) for name in kind._fields])
    values = [
        [tuple(part) for part in row] if isinstance(row, list) else tuple(row) for row in rows
    ]
    return np.array(values, dtype=dtype).view(np.recarray)
