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

from enum import IntEnum
from pathlib import Path
from typing import Annotated, Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core import quantity
from cmf_mj.core.arrays import record_array
from cmf_mj.core.compiled import assign, compiled
from cmf_mj.core.errors import InputError
from cmf_mj.core.quantity import Acceleration, Length, Pressure, Quantity, Speed, Time, positive_in
from cmf_mj.core.settings import Count, Loader, Settings
from cmf_mj.core.units import FRAME


class FaultCode(IntEnum):
    """Faults, in the order in which they count: the conditions, then what others find."""

    NONE = 0
    TRACKING_ERROR = 1
    SENSOR_DISAGREEMENT = 2
    OVER_PRESSURE = 3
    UNDER_PRESSURE = 4
    OVER_SPEED = 5
    OVER_ACCELERATION = 6
    HOST_WATCHDOG = 7
    FRAME_WATCHDOG = 8
    NOT_ARRIVED = 9  #: Found by the operating states.
    HOST_RANGE = 10  #: Found by the DCU.


FAULTS = tuple(code.name.lower() for code in FaultCode)  #: Names of the faults, by code.

NO_LEG = -1  #: Leg of a fault of the whole machine.

QuantityT = TypeVar("QuantityT")


class Check(Settings, Generic[QuantityT]):
    """One condition."""

    enabled: bool = True
    threshold: QuantityT
    persistence: Count  #: Frames of 1/2048 s in a row that make a fault.


class ProtectionSettings(Settings):
    """All conditions."""

    tracking_error: Check[Length]
    sensor_disagreement: Check[Length]
    over_pressure: Check[Pressure]
    under_pressure: Check[Pressure]
    over_speed: Check[Speed]
    over_acceleration: Check[Acceleration]
    host_watchdog: Check[Time]
    frame_watchdog: Check[quantity.Count]
    washout: Annotated[Quantity, positive_in("1/s")]
    """Rate r at which the integrated velocity follows the position; below 1/T."""


CHECKS = tuple(name for name in ProtectionSettings.model_fields if name in FAULTS)
"""Names of the conditions."""


class Protection(NamedTuple):
    """Compiled parameters; arrays (9,) are indexed by fault code."""

    enabled: NDArray[np.bool_]
    threshold: NDArray[np.float64]  #: SI; seconds and frames for the watchdogs.
    persistence: NDArray[np.int64]
    washout: float  #: r T, per frame.
    frame: float  #: T [s].


class Detection(NamedTuple):
    """The latched fault, and the frame before."""

    code: int = FaultCode.NONE.value  #: `FaultCode` of the fault.
    leg: int = NO_LEG  #: Leg from 0, or `NO_LEG`.
    frame: int = -1  #: Frame in which it was detected.
    previous_frame: int = -1  #: Frame before this one; -1 before the first.


class ProtectionState(NamedTuple):
    """State of the detection."""

    counts: NDArray[np.int64]  #: Frames in a row, (9, n), by condition; column 0 for `NO_LEG`.
    estimate: NDArray[np.float64]  #: Integrated velocities z [m], (n,).
    detection: np.recarray[Any, Any]  #: `Detection`, (1,).


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
    if not frame > 0.0:
        raise InputError(f"frame: {frame} s must be greater than 0")
    if not settings.washout.si * frame < 1.0:
        raise InputError(
            f"washout: {settings.washout.si:g} 1/s must be below the control rate, "
            f"{1.0 / frame:g} 1/s"
        )
    checks = [getattr(settings, name) for name in CHECKS]
    return Protection(
        enabled=np.array([False] + [check.enabled for check in checks]),
        threshold=np.array([0.0] + [check.threshold.si for check in checks]),
        persistence=np.array(
            [0] + [max(round(check.persistence * FRAME / frame), 1) for check in checks]
        ),
        washout=settings.washout.si * frame,
        frame=frame,
    )


def protection_state(position: NDArray[np.float64]) -> ProtectionState:
    """State of a machine at rest at the leg positions (n,) [m], no fault."""
    counts = np.zeros((len(FAULTS), position.shape[0]), dtype=np.int64)
    detection = record_array(Detection, [Detection()])
    return ProtectionState(counts, np.array(position, dtype=float), detection)


@compiled
def reset(state, position):  # type: ignore[no-untyped-def]
    """Forget the fault and everything counted, at the present positions (n,) [m]."""
    state.counts[:] = 0
    assign(state.estimate, position)
    state.detection[0].previous_frame = -1
    _write_fault(state, FaultCode.NONE.value, NO_LEG, -1)


@compiled
def _write_fault(state, code, leg, frame):  # type: ignore[no-untyped-def]
    fault = state.detection[0]
    fault.code, fault.leg, fault.frame = code, leg, frame


@compiled
def latch_outside_fault(state, code, frame):  # type: ignore[no-untyped-def]
    """Latch a fault that was found elsewhere, if there is one and no other is latched."""
    if code != FaultCode.NONE.value and state.detection[0].code == FaultCode.NONE.value:
        _write_fault(state, code, NO_LEG, frame)


@compiled
def _check(protection, state, code, leg, value, frame):  # type: ignore[no-untyped-def]
    """Count a condition value > threshold of a leg, or `NO_LEG`, and latch its fault."""
    column = 0 if leg == NO_LEG else leg
    if not protection.enabled[code]:
        return
    if value <= protection.threshold[code]:  # false for NaN
        state.counts[code, column] = 0
        return
    state.counts[code, column] += 1
    persists = state.counts[code, column] >= protection.persistence[code]
    fault, watchdog = state.detection[0], FaultCode.HOST_WATCHDOG.value
    is_first = fault.code == FaultCode.NONE.value or code < watchdog <= fault.code
    is_before = fault.frame == frame and code < fault.code
    if persists and (is_first or is_before):
        _write_fault(state, code, leg, frame)


@compiled
def check_frame(protection, state, frame, reference, feedback, supply_pressure, host_age=0.0):  # type: ignore[no-untyped-def]
    """Check one frame; returns the code of the latched fault, 0 for none.

    A gap in the numbers of control frames is missed frames. `reference` (n,) are limited leg
    demands [m], `host_age` is the time since the last host frame [s], 0 where there is no host.
    """
    for leg in range(reference.shape[0]):
        position, velocity = feedback.position[leg], feedback.velocity[leg]
        disagreement = position - state.estimate[leg]
        state.estimate[leg] += protection.frame * velocity + protection.washout * disagreement
        disagreement = abs(disagreement)
        cap, rod = feedback.cap_pressure[leg], feedback.rod_pressure[leg]
        pressure = cap if cap > rod or np.isnan(cap) else rod
        error = abs(reference[leg] - position)
        acceleration = abs(feedback.acceleration[leg])
        _check(protection, state, FaultCode.TRACKING_ERROR.value, leg, error, frame)
        _check(protection, state, FaultCode.SENSOR_DISAGREEMENT.value, leg, disagreement, frame)
        _check(protection, state, FaultCode.OVER_PRESSURE.value, leg, pressure, frame)
        _check(protection, state, FaultCode.OVER_SPEED.value, leg, abs(velocity), frame)
        _check(protection, state, FaultCode.OVER_ACCELERATION.value, leg, acceleration, frame)
    if not supply_pressure >= protection.threshold[FaultCode.UNDER_PRESSURE.value]:
        _check(protection, state, FaultCode.UNDER_PRESSURE.value, NO_LEG, np.inf, frame)
    else:
        state.counts[FaultCode.UNDER_PRESSURE.value, 0] = 0
    detection = state.detection[0]
    missed = frame - detection.previous_frame - 1 if detection.previous_frame >= 0 else 0
    detection.previous_frame = frame
    _check(protection, state, FaultCode.HOST_WATCHDOG.value, NO_LEG, host_age, frame)
    _check(protection, state, FaultCode.FRAME_WATCHDOG.value, NO_LEG, float(missed), frame)
    return detection.code


def fault_of(code: int, leg: int, frame: int) -> Fault | None:
    """The fault that a detection holds, if there is one."""
    if code == FaultCode.NONE:
        return None
    return Fault(FAULTS[code], None if leg == NO_LEG else int(leg) + 1, int(frame))


def latched_fault(state: ProtectionState) -> Fault | None:
    """The fault of a state, if there is one."""
    detection = state.detection[0]
    return fault_of(detection.code, detection.leg, detection.frame)
