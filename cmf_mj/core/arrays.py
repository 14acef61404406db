"""Arrays that nobody can write to, and how large those of a run may be."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.core.errors import InputError

MEMORY = 4 * 2**30
"""Most that any one part of a run, such as its record, may take [bytes]."""


def check_memory(field: str, part: str, numbers: float) -> None:
    """Refuse a part of a run with too many numbers of 8 bytes, before any of it is made."""
    size = 8.0 * numbers
    if size > MEMORY:
        raise InputError(
            f"{field}: {part} would take {size / 2**30:.3g} GiB; allowed: {MEMORY / 2**30:g} GiB"
        )


def frozen(values: ArrayLike) -> NDArray[np.float64]:
    """The array itself where it owns its values and is read-only already, else a read-only copy.

    So what makes an array freezes it and hands it over, and long histories are not held twice.
    """
    array = np.asarray(values)
    if array.flags.writeable or not array.flags.owndata:
        array = np.array(array)
        array.setflags(write=False)
    return array
