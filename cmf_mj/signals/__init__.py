"""Excitations: demands of one degree of freedom or of several."""

from cmf_mj.signals.single import (
    Command,
    check_bounded,
    check_not_negative,
    check_positive,
    chirp,
    line_weights,
    multisine,
    noise,
    odd_orders,
    pulse,
    raised_cosine,
    random_phase_sum,
    repeat,
    sine,
    step,
)

__all__ = [
    "Command",
    "check_bounded",
    "check_not_negative",
    "check_positive",
    "chirp",
    "line_weights",
    "multisine",
    "noise",
    "odd_orders",
    "pulse",
    "raised_cosine",
    "random_phase_sum",
    "repeat",
    "sine",
    "step",
]
