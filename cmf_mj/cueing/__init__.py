"""Motion cueing: from the motion of an aircraft's pilot to frames of a host."""

from cmf_mj.cueing.envelope import LIMITS, Confined, Excursion, confined, excursion
from cmf_mj.cueing.flight import Cue, Tuned, cue, tune
from cmf_mj.cueing.settings import (
    WASHOUTS,
    ClassicalSettings,
    OptimalSettings,
    WashoutSettings,
    load_washout,
    save_washout,
)
from cmf_mj.cueing.washout import HOST_RATE, Washout

__all__ = [
    "HOST_RATE",
    "LIMITS",
    "WASHOUTS",
    "ClassicalSettings",
    "Confined",
    "Cue",
    "Excursion",
    "OptimalSettings",
    "Tuned",
    "Washout",
    "WashoutSettings",
    "confined",
    "cue",
    "excursion",
    "load_washout",
    "save_washout",
    "tune",
]
