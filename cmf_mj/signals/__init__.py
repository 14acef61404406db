"""Signals: demands of one degree of freedom or of several, as commands at the control rate.

`CLASSES` are all signals by kind, from which `signal_of` makes that of a record again.
"""

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import validated
from cmf_mj.signals import composite, single
from cmf_mj.signals.composite import (
    acceleration_step,
    faded_sines,
    orthogonal_multisines,
    seven_sines,
    stepped_sines,
    waypoints,
)
from cmf_mj.signals.signal import Command, PoseTable, Signal, as_plain, check_positive
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

_CLASSES: tuple[type[Signal], ...] = (
    *(single.Step, single.Pulse, single.Sine, single.Chirp, single.Noise, single.Multisine),
    *(composite.SevenSines, composite.SteppedSines, composite.FadedSines),
    *(composite.OrthogonalMultisines, composite.AccelerationStep, composite.Waypoints),
)
CLASSES = {signal.kind_name(): signal for signal in _CLASSES}
"""Signals that a record may name, by kind. Those of scenario files, some with other defaults, are
`ScenarioSignal` of `facility/signal.py`."""


def signal_of(description: Mapping[str, Any]) -> Signal:
    """The signal of a description in a record, a `PoseTable` where that is of no known kind."""
    table = as_plain({"kind": ""} | dict(description))
    signal = CLASSES.get(str(table["kind"]))
    if signal is not None:
        fields = {name: value for name, value in table.items() if name in signal.model_fields}
        with suppress(InputError):
            return validated(signal, fields, "command")
    return validated(PoseTable, table, "command")
