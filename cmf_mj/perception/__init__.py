"""Perception: semicircular canals and otoliths, cueing errors and thresholds."""

from cmf_mj.perception.error import (
    QUANTITIES,
    CueingError,
    Oscillation,
    cueing_error,
    oscillation,
    tilt_thresholds,
)
from cmf_mj.perception.models import (
    Sensed,
    canal_response,
    otolith_response,
    sense,
    state_space,
)
from cmf_mj.perception.settings import Canals, Otoliths, Senses, Thresholds, load_senses

__all__ = [
    "QUANTITIES",
    "Canals",
    "CueingError",
    "Oscillation",
    "Otoliths",
    "Sensed",
    "Senses",
    "Thresholds",
    "canal_response",
    "cueing_error",
    "load_senses",
    "oscillation",
    "otolith_response",
    "sense",
    "state_space",
    "tilt_thresholds",
]
