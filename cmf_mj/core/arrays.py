"""Arrays that nobody can write to."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def frozen(values: ArrayLike) -> NDArray[np.float64]:
    """The array itself where it owns its values and is read-only already, else a read-only copy.

    So what makes an array freezes it and hands it over, and long histories are not held twice.
    """
    array = np.asarray(values)
    if array.flags.writeable or not array.flags.owndata:
        array = np.array(array)
        array.setflags(write=False)
    return array
