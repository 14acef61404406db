"""Motion cueing: from the motion of an aircraft's pilot to frames of a host."""

from cmf_mj.cueing.settings import WASHOUTS, ClassicalSettings, WashoutSettings, load_washout
from cmf_mj.cueing.washout import HOST_RATE, Washout

__all__ = [
    "HOST_RATE",
    "WASHOUTS",
    "ClassicalSettings",
    "Washout",
    "WashoutSettings",
    "load_washout",
]
