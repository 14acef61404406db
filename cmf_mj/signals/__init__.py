"""Signals: demands of one degree of freedom or of several, as commands at the control rate."""

from cmf_mj.signals.composite import (
    acceleration_step,
    faded_sines,
    orthogonal_multisines,
    seven_sines,
    stepped_sines,
    waypoints,
)
from cmf_mj.signals.signal import Command, check_positive
from cmf_mj.signals.single import chirp, multisine, noise, pulse, sine, step

__all__ = [
    "Command",
    "acceleration_step",
    "check_positive",
    "chirp",
    "faded_sines",
    "multisine",
    "noise",
    "orthogonal_multisines",
    "pulse",
    "seven_sines",
    "sine",
    "step",
    "stepped_sines",
    "waypoints",
]
