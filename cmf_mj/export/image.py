"""Nested tuples of numbers and arrays as data: a table of slots and one block of all arrays.

A host has the table and the block once for each instance and adds the block's address to the slots
that are `pointers`. Arrays that share memory share it in the block.
"""

from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError
from cmf_mj.export.machine_code import leaves, slot_count

_ALIGNED = 64


class Image(NamedTuple):
    """Numbers and arrays as the loop's machine code reads them."""

    slots: NDArray[np.int64]  #: Table; of an array its place in the block, shape and strides.
    pointers: list[int]  #: Slots that hold places in the block.
    at: dict[str, int]  #: First slot of each number and array by its dotted path.
    block: NDArray[np.uint8]  #: All arrays.


def make_image(value: Any, elsewhere: Collection[str] = ()) -> Image:
    """The image of nested tuples; arrays at the paths `elsewhere` are not in the block."""
    table: list[int] = []
    pointers: list[int] = []
    at: dict[str, int] = {}
    arrays: list[tuple[int, NDArray[Any]]] = []
    for path, leaf in leaves(value):
        at[path] = len(table)
        if isinstance(leaf, np.ndarray):
            if path not in elsewhere:
                pointers.append(len(table))
                arrays.append((len(table), leaf))
            table += [0, *leaf.shape, *leaf.strides]
        elif isinstance(leaf, float | np.floating):
            table.append(int(np.float64(leaf).view(np.int64)))
        else:
            table.append(int(leaf))
        assert len(table) == at[path] + slot_count(leaf)
    block = _block(arrays, table)
    return Image(np.array(table, dtype=np.int64), pointers, at, block)


def _block(arrays: list[tuple[int, NDArray[Any]]], table: list[int]) -> NDArray[np.uint8]:
    """All arrays in one block; writes their places into their slots."""
    block = bytearray()
    begin = end = place = 0
    for slot, array in sorted(arrays, key=lambda pair: (_start(pair[1]), -pair[1].nbytes)):
        if not array.flags.c_contiguous:
            raise InputError(f"image: the array of slot {slot} is not contiguous")
        start = _start(array)
        if start >= end:  # shares no memory with those before
            block += bytes(-len(block) % _ALIGNED)
            begin, end, place = start, start, len(block)
        table[slot] = place + start - begin
        new = array.tobytes()[end - start :]
        block += new
        end += len(new)
    block += bytes(-len(block) % _ALIGNED)
    return np.frombuffer(bytes(block), dtype=np.uint8)


def _start(array: NDArray[Any]) -> int:
    return int(array.__array_interface__["data"][0])
