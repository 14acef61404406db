"""Fault detection, once a frame: eight conditions with threshold and persistence, first latched.

    tracking_error       |reference - position|
    sensor_disagreement  |position - z|,  z[k+1] = z[k] + T (velocity + r (position - z[k]))
    over_pressure        larger of cap and rod pressure
    under_pressure       supply pressure, below its threshold
    over_speed           |velocity|
    over_acceleration    |acceleration| without gravity, whatever the law reads
    host_watchdog        time since the last host frame
    frame_watchdog       control frames missed between two calls

A condition that holds for `persistence` frames of 1/2048 s in a row is a fault; NaN holds. Of
several in one frame the first in `FAULTS`, then the lowest leg, is taken; it stays until `reset`,
but a watchdog's gives way to a fault of the machine, which asks for more. So do two that come from
elsewhere: `not_arrived` from the operating states, a raise or return that has not come to its end
in time or a leg without reading, and `host_range` from the DCU, a demand that has left the range
of its host.

Six legs give six degrees of freedom: their positions cannot check one another. So each position
sensor is checked against the integral of its own velocity sensor, washed out at the rate r: a jump
d of the position shows d at once, a velocity error b shows b/r (1 - (1 - r T)^k) after k frames.
What changes slower than r, and faults common to both sensors, this cannot see.
"""

from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from cmf_mj.core.compiled import assign, compiled
from cmf_mj.core.errors import InputError
from cmf_mj.core.quantity import Quantity, positive_in
from cmf_mj.core.settings import Count, Loader, Settings
from cmf_mj.core.units import FRAME

NO_FAULT = 0
_LENGTH, _PRESSURE, _TIME = ("in", "m"), ("psi", "Pa"), ("s",)
_UNITS = {
    "tracking_error": _LENGTH,
    "sensor_disagreement": _LENGTH,
    "over_pressure": _PRESSURE,
    "under_pressure": _PRESSURE,
    "over_speed": ("in/s", "m/s"),
    "over_acceleration": ("g", "in/s/s", "m/s/s"),
    "host_watchdog": _TIME,
    "frame_watchdog": ("1",),
}
CHECKS = tuple(_UNITS)
"""Names of the conditions."""
FAULTS = ("none", *CHECKS, "not_arrived", "host_range")
"""Names of the faults; a code is the place in this tuple."""

_TRACKING, _DISAGREE, _OVER, _UNDER, _SPEED, _ACCELERATION, _HOST, _FRAME = range(1, 9)
NOT_ARRIVED, HOST_RANGE = 9, 10
"""Codes of the faults that operating states and DCU find."""
_MACHINE = -1
"""Leg of a fault that belongs to no leg."""


class Check(Settings):
    """One condition."""

    enabled: bool = True
    threshold: Quantity
    persistence: Count  #: Frames of 1/2048 s in a row that make a fault.


class ProtectionSettings(Settings):
    """All conditions."""

    tracking_error: Check
    sensor_disagreement: Check
    over_pressure: Check
    under_pressure: Check
    over_speed: Check
    over_acceleration: Check
    host_watchdog: Check
    frame_watchdog: Check
    washout: Annotated[Quantity, positive_in("1/s")]
    """Rate r at which the integrated velocity follows the position; below 1/T."""

    @model_validator(mode="after")
    def _in_range(self) -> "ProtectionSettings":
        for name, allowed in _UNITS.items():
            quantity = getattr(self, name).threshold
            least = 0.0 if name == "frame_watchdog" else np.nextafter(0.0, 1.0)
            if quantity.unit not in allowed or quantity.value < least:
                raise InputError(
                    f"{name}.threshold: {quantity.value:g} {quantity.unit} is refused: must be "
                    f"greater than 0 {' or '.join(allowed)}"
                )
        return self


class Protection(NamedTuple):
    """Compiled parameters; arrays (9,) are indexed by fault code."""

    enabled: NDArray[np.bool_]
    threshold: NDArray[np.float64]  #: SI; seconds and frames for the watchdogs.
    persistence: NDArray[np.int64]
    washout: float  #: r T, per frame.
    frame: float  #: T [s].


class ProtectionState(NamedTuple):
    """State of the detection."""

    counts: NDArray[np.int64]
    """Frames in a row of each condition, (9, n); conditions of no leg use column 0."""
    estimate: NDArray[np.float64]  #: Integrated velocities z [m], (n,).
    last: NDArray[np.int64]  #: Frame before, (1,); -1 before the first.
    fault: NDArray[np.int64]  #: Latched code, leg from 0 or -1 for the machine, and frame, (3,).


class Fault(NamedTuple):
    """The latched fault."""

    name: str  #: One of `FAULTS`.
    leg: int | None  #: Leg from 1; none for a fault of the machine.
    frame: int  #: Frame in which it was detected.


load_protection = Loader(
    ProtectionSettings, Path(__file__).with_name("protection.toml"), levels=0, what="protection"
)
"""Loads protection settings: `default`, or a file with the conditions it changes, each whole."""


def make_protection(settings: ProtectionSettings, frame: float = FRAME) -> Protection:
    """Derive the compiled parameters for a control frame [s]."""
    if not settings.washout.si * frame < 1.0:
        raise InputError(
            f"washout: {settings.washout.si:g} 1/s must be below the control rate, "
            f"{1.0 / frame:g} 1/s"
        )
    checks = [getattr(settings, name) for name in CHECKS]
    return Protection(
        np.array([False] + [check.enabled for check in checks]),
        np.array([0.0] + [check.threshold.si for check in checks]),
        np.array([0] + [max(round(check.persistence * FRAME / frame), 1) for check in checks]),
        settings.washout.si * frame,
        frame,
    )


def protection_state(position: NDArray[np.float64]) -> ProtectionState:
    """State of a machine at rest at the leg positions (n,) [m], no fault."""
    legs = position.shape[0]
    return ProtectionState(
        np.zeros((len(FAULTS), legs), dtype=np.int64),
        np.array(position, dtype=float),
        np.array([-1]),
        np.array([NO_FAULT, _MACHINE, -1]),
    )


@compiled
def reset(state, position):  # type: ignore[no-untyped-def]
    """Forget the fault and everything counted, at the present positions (n,) [m]."""
    state.counts[:] = 0
    assign(state.estimate, position)
    state.last[0] = -1
    state.fault[0], state.fault[1], state.fault[2] = NO_FAULT, _MACHINE, -1


@compiled
def latch(state, code, frame):  # type: ignore[no-untyped-def]
    """Latch a fault that was found elsewhere, if there is one and no other is latched."""
    if code != NO_FAULT and state.fault[0] == NO_FAULT:
        state.fault[0], state.fault[1], state.fault[2] = code, _MACHINE, frame


@compiled
def _judge(protection, state, code, leg, column, value, frame):  # type: ignore[no-untyped-def]
    """Count a condition |value| > threshold and latch its fault."""
    if not protection.enabled[code]:
        return
    if value <= protection.threshold[code]:  # false for NaN
        state.counts[code, column] = 0
        return
    state.counts[code, column] += 1
    new = state.counts[code, column] >= protection.persistence[code]
    first = state.fault[0] == NO_FAULT or code < _HOST <= state.fault[0]
    earlier = state.fault[2] == frame and code < state.fault[0]
    if new and (first or earlier):
        state.fault[0], state.fault[1], state.fault[2] = code, leg, frame


@compiled
def protect(protection, state, frame, reference, feedback, supply_pressure, host_age=0.0):  # type: ignore[no-untyped-def]
    """Look at one frame; returns the code of the latched fault, 0 for none.

    A gap in the numbers of control frames is missed frames. `reference` (n,) are limited leg
    demands [m], `host_age` is the time since the last host frame [s], 0 where there is no host.
    """
    for leg in range(reference.shape[0]):
        position, velocity = feedback.position[leg], feedback.velocity[leg]
        apart = position - state.estimate[leg]
        state.estimate[leg] += protection.frame * velocity + protection.washout * apart
        cap, rod = feedback.cap_pressure[leg], feedback.rod_pressure[leg]
        pressure = cap if cap > rod or cap != cap else rod
        error = abs(reference[leg] - position)
        _judge(protection, state, _TRACKING, leg, leg, error, frame)
        _judge(protection, state, _DISAGREE, leg, leg, abs(apart), frame)
        _judge(protection, state, _OVER, leg, leg, pressure, frame)
        _judge(protection, state, _SPEED, leg, leg, abs(velocity), frame)
        _judge(protection, state, _ACCELERATION, leg, leg, abs(feedback.acceleration[leg]), frame)
    if not supply_pressure >= protection.threshold[_UNDER]:
        _judge(protection, state, _UNDER, _MACHINE, 0, np.inf, frame)
    else:
        state.counts[_UNDER, 0] = 0
    missed = frame - state.last[0] - 1 if state.last[0] >= 0 else 0
    state.last[0] = frame
    _judge(protection, state, _HOST, _MACHINE, 0, host_age, frame)
    _judge(protection, state, _FRAME, _MACHINE, 0, float(missed), frame)
    return state.fault[0]


def latched(state: ProtectionState) -> Fault | None:
    """The fault of a state, if there is one."""
    code, leg, frame = (int(value) for value in state.fault)
    if code == NO_FAULT:
        return None
    return Fault(FAULTS[code], None if leg == _MACHINE else leg + 1, frame)
