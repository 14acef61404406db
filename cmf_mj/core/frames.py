"""Rows, columns and groups of data frames, which are tables of pyarrow."""

from collections.abc import Iterator
from functools import reduce
from operator import and_
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

_ROW, _ROWS = "row of the table", "row of the table_list"


def column(table: pa.Table, name: str) -> NDArray[np.float64]:
    """A column as floats, NaN where it is empty."""
    return np.array(table[name].cast(pa.float64()).to_numpy(zero_copy_only=False))


def where(table: pa.Table, **equal: Any) -> pa.Table:
    """Rows that have these values."""
    return table.filter(reduce(and_, (pc.field(name) == value for name, value in equal.items())))


def groups(table: pa.Table, *names: str) -> Iterator[tuple[tuple[Any, ...], pa.Table]]:
    """Rows that are alike in some columns, in the order of their first: values, and the rows.

    >>> table = pa.table({"law": ["b", "a", "b"], "damping": [0.1, 0.2, 0.3]})
    >>> [(*law, column(rows, "damping").tolist()) for law, rows in groups(table, "law")]
    [('b', [0.1, 0.3]), ('a', [0.2])]
    """
    numbered = table.append_column(_ROW, pa.array(np.arange(table.num_rows)))
    alike = numbered.group_by(names, use_threads=False).aggregate([(_ROW, "list")]).to_pylist()
    for one in sorted(alike, key=lambda one: one[_ROWS][0]):
        yield tuple(one[name] for name in names), table.take(one[_ROWS])
