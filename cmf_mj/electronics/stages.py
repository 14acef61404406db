"""Two stages that sensors and converters share: a low-pass, and rounding to a resolution."""

import numpy as np

from cmf_mj.core import filters
from cmf_mj.core.compiled import compiled


@compiled
def low_pass(sections, state, values, passed):  # type: ignore[no-untyped-def]
    """All legs or axes (n,) through filters (s, 6) of states (n, s, 2); none pass as they are.

    `passed` is overwritten and may be `values` itself.
    """
    for i in range(values.shape[0]):
        passed[i] = values[i]
        if sections.shape[0] > 0:
            passed[i] = filters.filtered(sections, state[i], passed[i])


@compiled
def steps(value, resolution):  # type: ignore[no-untyped-def]
    """The value in whole steps of the resolution; halves go up."""
    return np.floor(value / resolution + 0.5)
