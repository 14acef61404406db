"""Input and output series for identification, taken from records.

The valve command acts on the legs one computing frame late and is held over a frame. At the
sampling instants this command jumps; its band-limited value there is the mean of both sides,

    u(t[k]) = (c[k-d] + c[k-d-1]) / 2,    d = command_delay of the run

which is exact to (pi f / rate)^2 / 2. A model identified from u to the legs therefore holds neither
the computing frame nor the hold, as a linear plant of `cmf_mj.analysis.linear` does.

Degrees of freedom: any leg signal s (n,) of the loop, commands and velocities alike, is mapped by
the Jacobian of the pose, J^-1 s; leg positions by `legs_to_pose`. The law has the same gains for
all legs and so acts on mapped signals as it acts on legs: a model of a degree of freedom is closed
with the law like a model of a leg, and has its unit, m/s per command.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil

import numpy as np
from numpy.typing import NDArray
from scipy import interpolate, signal

from cmf_mj.analysis.frequency_response import FrequencyResponse, excited_response
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import legs_to_pose
from cmf_mj.machine.leg_motion import leg_motion_to_pose
from cmf_mj.machine.machine import Machine, recorded_machine
from cmf_mj.record.record import Record

Real = NDArray[np.float64]

RATE = 64.0
"""Default sampling rate [Hz], half the facility recorder's, or the least one above it that divides
the record's into whole samples: the legs' modes lie below 15 Hz, and a
model at a rate far above what is excited learns little and suffers much from noise."""

RECORDER = 128.0
"""Sampling rate of measured responses [Hz], the facility recorder's."""

POSITIONS = ("leg_position", "leg_reference")
"""Leg channels that are mapped to a pose; all others by the Jacobian."""

_SHORTEST = 32
"""Least samples behind a decimation."""

_LONGEST = 8
"""Largest decimation in one stage of the anti-alias filter."""


LABELS = ("input_names", "output_names", "input_units", "output_units")
"""Fields that name the signals."""


@dataclass(frozen=True)
class Experiment:
    """One run as input and output series; arrays are read-only."""

    input: Real  #: (N, nu).
    output: Real  #: (N, ny).
    step: float  #: Sampling interval [s].
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    input_units: tuple[str, ...]
    output_units: tuple[str, ...]
    reference: Real | None = None
    """External excitation, (N, nr), free of noise."""
    name: str = ""  #: Of the run.

    def __post_init__(self) -> None:
        """Check shapes and freeze."""
        if not (np.isfinite(self.step) and self.step > 0.0):
            raise InputError(f"step: {self.step} s must be a finite number greater than 0")
        for field in ("input", "output", "reference"):
            entry = getattr(self, field)
            if entry is None and field == "reference":
                continue
            values = np.array(entry, dtype=float)
            values = values[:, None] if values.ndim == 1 else values
            if values.ndim != 2 or values.shape[0] < 2:
                raise InputError(f"{field}: shape is {values.shape}; allowed: (N, k) with N >= 2")
            if not np.isfinite(values).all():
                row = int(np.argmin(np.isfinite(values).all(axis=1)))
                raise InputError(f"{field}: sample {row} is not finite")
            values.setflags(write=False)
            object.__setattr__(self, field, values)
            if values.shape[0] != self.input.shape[0]:
                raise InputError(
                    f"{field}: {values.shape[0]} samples; input: {self.input.shape[0]}"
                )
        for field in ("input", "output"):
            count = getattr(self, field).shape[1]
            for kind in ("names", "units"):
                entry = len(getattr(self, f"{field}_{kind}"))
                if entry != count:
                    raise InputError(f"{field}_{kind}: has {entry} entries; {field} has {count}")

    @property
    def samples(self) -> int:
        """Number of samples N."""
        return int(self.input.shape[0])

    @property
    def rate(self) -> float:
        """Sampling rate [Hz]."""
        return 1.0 / self.step

    def _mapped(self, function: Callable[[Real], Real]) -> "Experiment":
        reference = None if self.reference is None else function(self.reference)
        return replace(
            self, input=function(self.input), output=function(self.output), reference=reference
        )

    def detrended(self) -> "Experiment":
        """Take the mean out of every series."""
        return self._mapped(lambda x: signal.detrend(x, axis=0, type="constant"))

    def between(self, start: float = 0.0, stop: float = float("inf")) -> "Experiment":
        """The samples from `start` to before `stop` [s], counted from the first; at least two."""
        first = max(ceil(start / self.step - 1e-9), 0)
        last = self.samples
        if np.isfinite(stop):
            last = min(ceil(stop / self.step - 1e-9), last)
        if last - first < 2:
            end = self.samples * self.step
            raise InputError(f"start, stop: {start} to {stop} s hold no samples of 0 to {end:.3f}")
        return self._mapped(lambda x: x[first:last])

    def split(self, share: float = 0.5) -> tuple["Experiment", "Experiment"]:
        """Estimation and validation parts: the first `share` of the run, and the rest."""
        if not 0.0 < share < 1.0:
            raise InputError(f"share: {share} must be greater than 0 and less than 1")
        middle = share * self.samples * self.step
        return self.between(0.0, middle), self.between(middle)


def decimated(values: Real, factor: int) -> Real:
    """Series (N, ...) at a `factor` times lower rate, behind a zero-phase anti-alias filter.

    The filter is SciPy's Chebyshev filter of eighth order, forwards and backwards, in stages of at
    most 8; it passes 0.8 of the new Nyquist frequency within 0.1 dB a stage.
    """
    if factor != int(factor) or factor < 1:
        raise InputError(f"factor: {factor} must be a whole number, at least 1")
    if factor > 1 and values.shape[0] < _SHORTEST * factor:
        raise InputError(f"factor: {factor} is too much for {values.shape[0]} samples")
    left = int(factor)
    while left > 1:
        stage = next((q for q in range(_LONGEST, 1, -1) if left % q == 0), left)
        values = np.asarray(signal.decimate(values, stage, axis=0))
        left //= stage
    return values


def _along(legs: Mapping[str, Real], channel: str, axes: Sequence[str], machine: Machine) -> Real:
    """A leg channel (N, n) along the axes, (N, axes)."""
    values = legs[channel]
    names = [*DOFS, *(f"leg_{i + 1}" for i in range(values.shape[1]))]
    chosen = [names.index(check_name("axes", axis, names)) for axis in axes]
    if min(chosen) >= len(DOFS):
        return values[:, [i - len(DOFS) for i in chosen]]
    pose = legs_to_pose(legs[channel if channel in POSITIONS else "leg_position"], machine)
    if channel not in POSITIONS:
        pose = leg_motion_to_pose(pose, values, np.zeros_like(values), machine).velocity
    return np.column_stack([pose, values])[:, chosen]


def experiment(
    record: Record,
    axes: str | Sequence[str],
    *,
    outputs: str | Sequence[str] = "leg_velocity",
    rate: float | None = None,
    detrend: bool = True,
) -> Experiment:
    """Valve command to leg signals along legs or degrees of freedom, decimated, without their mean.

    The record has `valve_command`, `leg_reference`, `leg_position` and the outputs. `axes` are one
    or several of surge, sway, heave, roll, pitch, yaw, leg_1 and so on; `outputs` are channels,
    each taken along every axis; `rate` [Hz] divides the record's; without `detrend` the mean stays.
    The command reaches the valve after the run's command delay, a frame where the record has none.

    Inputs are `<axis>_command` as fractions of full command (rotations: times rad/m), outputs
    `<axis>_velocity` and so on in SI, the reference is the leg reference along the axes. Raises
    `InputError` for a channel, axis or rate the record does not have.
    """
    names = [axes] if isinstance(axes, str) else list(axes)
    channels = [outputs] if isinstance(outputs, str) else list(outputs)
    rate = _nearest(record, RATE) if rate is None else rate
    factor = round(record.rate / rate)
    if factor < 1 or abs(record.rate / rate - factor) > 1e-9:
        raise InputError(f"rate: {rate} Hz; the record's {record.rate} Hz must be a multiple of it")
    needed = dict.fromkeys(("valve_command", "leg_reference", "leg_position", *channels))
    legs = {channel: record[channel] for channel in needed}
    frames = int(record.metadata.get("command_delay", 1))
    machine = recorded_machine(record.metadata)
    samples = record.rate / machine.rate
    legs["valve_command"] = _at_valve(legs["valve_command"], frames, samples)
    legs = {channel: decimated(values, factor) for channel, values in legs.items()}
    along = {channel: _along(legs, channel, names, machine) for channel in needed}
    measured = Experiment(
        input=along["valve_command"],
        output=np.column_stack([along[channel] for channel in channels]),
        step=factor / record.rate,
        input_names=tuple(f"{axis}_command" for axis in names),
        output_names=tuple(
            f"{axis}_{channel.removeprefix('leg_')}" for channel in channels for axis in names
        ),
        input_units=tuple(_unit(axis, "1") for axis in names),
        output_units=tuple(
            _unit(axis, record.units[channel]) for channel in channels for axis in names
        ),
        reference=along["leg_reference"],
        name=record.signal.kind,
    )
    return measured.detrended() if detrend else measured


def _nearest(record: Record, rate: float) -> float:
    """The rate, or the least above it that is a whole part of a record's; at most the record's."""
    return record.rate / max(1, int(record.rate // rate))


def _at_valve(command: Real, frames: int, samples: float) -> Real:
    """Band-limited value of the delayed, zero-order-hold command at the sampling instants.

    A control frame has so many `samples`.
    """
    place = np.arange(command.shape[0], dtype=float)
    late = np.clip(place - (frames + 0.5) * samples, 0.0, None)
    return np.asarray(interpolate.make_interp_spline(place, command, k=3, axis=0)(late))


def _unit(axis: str, unit: str) -> str:
    """Unit of a leg signal along an axis: times rad/m where the axis is a rotation."""
    turned = {"1": "rad/m", "m": "rad", "m/s": "rad/s", "m/s^2": "rad/s^2"}
    return turned.get(unit, f"{unit} rad/m") if axis in DOFS[3:] else unit


def plant_response(record: Record, axis: str) -> FrequencyResponse:
    """Response from the command at the valve to leg velocity along a leg or degree of freedom.

    The record is of a chirp, noise or multisine along the axis, surge to yaw or leg_1 and so on.
    Lines lie in the band of the excitation, in SI per full command; the coherence is the lesser of
    reference to input and reference to output. Raises `InputError` without excitation.
    """
    series = experiment(record, axis, rate=_nearest(record, RECORDER))
    if series.reference is None or np.ptp(series.reference[:, 0]) < 1e-9:
        raise InputError(f"axis: the record holds no demand in {axis}")
    to_input, to_output = (
        excited_response(series.reference[:, 0], values[:, 0], series.rate, record.signal)
        for values in (series.input, series.output)
    )
    response = to_output.response / to_input.response
    shares = [each.radius / np.abs(each.response) for each in (to_output, to_input)]
    coherence = np.minimum(to_input.coherence, to_output.coherence)
    bound = (shares[0] + shares[1]) * np.abs(response)
    names = {"inputs": list(series.input_names), "outputs": list(series.output_names)}
    return FrequencyResponse(response, 2.0 * np.pi * to_input.frequency, coherence, bound, **names)
