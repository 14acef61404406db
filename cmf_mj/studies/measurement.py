"""What is measured of one record, and of recordings, in the field's measures.

`MEASURES` are functions of a record that know its excitation: each is one function of `metrics` at
what the excitation says. Everything is taken from DCL leg demand to leg sensors, mapped to the
degree of freedom; host and DCU are outside. Accelerations are those of the platform centroid.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, cast, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from cmf_mj.analysis import metrics
from cmf_mj.analysis.frequency_response import (
    FrequencyResponse,
    bandwidths,
    frequency_response,
    matrix_frequency_response,
    rounds_response,
)
from cmf_mj.analysis.measurable import EXCITED_SHARE, LEAST_COHERENCE, demand_share, dof_history
from cmf_mj.analysis.spectra import Estimator
from cmf_mj.analysis.step_response import step_metrics
from cmf_mj.core import units
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.machine.geometry import DOFS, by_kind
from cmf_mj.machine.kinematics import legs_to_pose
from cmf_mj.machine.machine import load_machine, recorded_machine
from cmf_mj.machine.models import CMF
from cmf_mj.record.columns import load_columns, read_mapped
from cmf_mj.record.record import Record
from cmf_mj.signals import composite
from cmf_mj.signals.signal import Dwell

Array = NDArray[np.float64]
Lines = NDArray[np.int64]
Values = dict[str, float]  #: Measures by name, which ends in their unit.
Measure = Callable[[Record], Values]

SIGNATURE_CHANNELS = ("leg_position", "valve_command", "cap_pressure", "rod_pressure")
"""Channels of a signature, where they are recorded."""
_BANDS = np.geomspace(0.03, 30.0, 15)  #: Of a signature's lines [Hz].
_DRIVEN = 1e-3  #: Amplitude of a line over the largest from which on it is driven.
CROSSTALK_FREQUENCY = 1.0  #: [Hz].
SMOOTH = 10.0  #: Frequency below which positions are differentiated to accelerations [Hz].


def demand_and_position(record: Record, dof: str, part: slice = slice(None)) -> tuple[Array, Array]:
    """Demand and motion along a degree of freedom, of some samples."""
    demand, position = (
        dof_history(record, name, dof) for name in ("leg_reference", "leg_position")
    )
    return demand[part], position[part]


def accelerations(record: Record) -> Array:
    """Acceleration of the platform below `SMOOTH`, (N, 6) [m/s^2, rad/s^2], from leg positions.

    Any recording has them: low-passed without phase, -6 dB at `SMOOTH`, they are differentiated
    twice, with the gain (sin wT / wT)^2 of central differences: 0.92 at 10 Hz of 128 Hz. Second
    derivatives of Euler angles are angular accelerations where the angles are small.
    """
    machine = recorded_machine(record.metadata)
    top = min(SMOOTH, 0.4 * record.rate)
    sections = butter(4, top, fs=record.rate, output="sos")
    pose = sosfiltfilt(sections, legs_to_pose(record["leg_position"], machine), axis=0)
    return np.asarray(np.gradient(np.gradient(pose, axis=0), axis=0) * record.rate**2)


def driven_responses(record: Record) -> tuple[dict[str, FrequencyResponse], dict[str, float]]:
    """Response along each degree of freedom driven; of six at once the crosstalk at 1 Hz [%]."""
    command = record.excitation
    if not isinstance(command, composite.OrthogonalMultisines):
        return {command.axis: frequency_response(record)}, {}
    matrix = matrix_frequency_response(record)
    lines, response = np.asarray(matrix.omega) / (2.0 * np.pi), np.asarray(matrix.frdata)
    responses, crosstalk = {}, {}
    for i, dof in enumerate(DOFS):
        diagonal = response[i, i]
        known = np.isfinite(diagonal)
        responses[dof] = FrequencyResponse(diagonal[known], matrix.omega[known], known[known])
        distance = np.where(known, np.abs(lines - CROSSTALK_FREQUENCY), np.inf)
        gains = np.abs(response[:, i, int(np.argmin(distance))])
        others = [j for j in range(6) if j != i and j // 3 == i // 3]  # all in m or all in rad
        crosstalk[dof] = 100.0 * float(gains[others].max() / gains[i])
    return responses, crosstalk


def _measure_responses(record: Record) -> Values:
    """-90 deg, -3 dB and peak of what is driven, and crosstalk."""
    values: Values = {}
    responses, crosstalk = driven_responses(record)
    for dof, response in responses.items():
        widths = bandwidths(response)
        values |= {f"{dof} -90 deg [Hz]": widths.phase_hz, f"{dof} -3 dB [Hz]": widths.gain_hz}
        values[f"{dof} peak [dB]"] = widths.peak_db
        if crosstalk:
            values[f"{dof} crosstalk [%]"] = crosstalk[dof]
    return values


def _measure_step(record: Record) -> Values:
    """Overshoot and rise of a step."""
    step, axis = step_metrics(record), record.signal.axis
    overshoot, rise = float(100.0 * step.overshoot), float(step.rise_time)
    return {f"{axis} overshoot [%]": overshoot, f"{axis} rise [s]": rise}


def _at_dwells(measure: Callable[[Record, str, Dwell, slice], Values]) -> Measure:
    """The measure of a record of single sines, by the `measure` of the samples of each dwell."""

    def measure_dwells(record: Record) -> Values:
        rows_per_frame = record.rate / record.signal.rate
        command, values = record.excitation, Values()
        axis, has_sizes = command.axis, len({dwell.amplitude for dwell in command.dwells}) > 1
        for dwell in command.dwells:
            first = int(np.ceil(dwell.start * rows_per_frame))
            part = slice(first, first + round(dwell.cycles * record.rate / dwell.frequency))
            if part.stop > record.time.size:
                sine = f"the sine of {dwell.frequency:g} Hz"
                raise InputError(f"record: ends at {record.time[-1]:g} s, within {sine}")
            size = f" {1e3 * dwell.amplitude:.3g} {by_kind(axis, 'mm', 'mrad')}"
            sine_name = f"{axis} {dwell.frequency:g} Hz{size if has_sizes else ''}"
            for name, value in measure(record, axis, dwell, part).items():
                values[f"{sine_name} {name}"] = float(value)
        return values

    return measure_dwells


def _measure_gain_and_phase(record: Record, dof: str, dwell: Dwell, part: slice) -> Values:
    """Gain and phase of the describing function."""
    demand, position = demand_and_position(record, dof, part)
    value = metrics.describing_function(demand, position, record.rate, dwell.frequency)
    return {"gain [dB]": 20.0 * np.log10(abs(value)), "phase [deg]": np.degrees(np.angle(value))}


def _measure_leg_balance(record: Record, dof: str, dwell: Dwell, part: slice) -> Values:
    """Largest difference of two legs in phase and gain."""
    pairs = zip(record["leg_reference"][part].T, record["leg_position"][part].T, strict=True)
    legs = [metrics.describing_function(*pair, record.rate, dwell.frequency) for pair in pairs]
    return {
        "phase between legs [deg]": np.degrees(np.ptp(np.angle(legs / np.sum(legs)))),
        "gain between legs [dB]": np.ptp(20.0 * np.log10(np.abs(legs))),
    }


def _acceleration_noise(record: Record, dof: str, dwell: Dwell, part: slice) -> metrics.MotionNoise:
    acceleration = accelerations(record)[part, DOFS.index(dof)]
    return metrics.acceleration_noise(acceleration, record.rate, dwell.frequency)


def _measure_noise(record: Record, dof: str, dwell: Dwell, part: slice) -> Values:
    """Acceleration noise in its parts, shares of the fundamental [%]."""
    noise = _acceleration_noise(record, dof, dwell, part)
    shares = ("low_harmonics", "high_harmonics", "stochastic", "peak")
    return {f"{share.replace('_', ' ')} [%]": 100.0 * getattr(noise, share) for share in shares}


def _measure_bump(record: Record, dof: str, dwell: Dwell, part: slice) -> Values:
    """Largest deviation of the acceleration from its fundamental [g, rad/s^2].

    A turn-around shows as a bump where the velocity changes its sign.
    """
    noise = _acceleration_noise(record, dof, dwell, part)
    unit, size = by_kind(dof, ("g", units.STANDARD_GRAVITY), ("rad/s^2", 1.0))
    return {f"bump [{unit}]": noise.peak * noise.fundamental / size}


def _measure_hysteresis(record: Record, dof: str, dwell: Dwell, part: slice) -> Values:
    """Hysteresis [%]."""
    demand, position = demand_and_position(record, dof, part)
    value = metrics.hysteresis(demand, position, record.rate, dwell.frequency)
    return {"hysteresis [%]": 100.0 * value}


def _measure_delay(record: Record) -> Values:
    """Lag of the motion behind the demand [s], by correlation, along all driven axes."""
    values: Values = {}
    for dof in DOFS:
        demand, position = demand_and_position(record, dof)
        if np.ptp(demand) > 1e-6:
            delay = metrics.transient_delay(demand - demand[0], position, record.rate)
            values[f"{dof} delay [s]"] = delay
    return values


def _measure_threshold(record: Record) -> Values:
    """Dynamic threshold of an acceleration step [s]."""
    step = record.signal_as(composite.AccelerationStep)
    acceleration, size = accelerations(record)[:, DOFS.index(step.dof)], step.acceleration
    time = metrics.dynamic_threshold(acceleration, record.rate, size, step.at)
    return {f"{step.dof} {size:.3g} threshold [s]": time}


MEASURES: dict[str, Measure] = {
    "response": _measure_responses,
    "step": _measure_step,
    "describing_function": _at_dwells(_measure_gain_and_phase),
    "leg_balance": _at_dwells(_measure_leg_balance),
    "acceleration_noise": _at_dwells(_measure_noise),
    "bump": _at_dwells(_measure_bump),
    "hysteresis": _at_dwells(_measure_hysteresis),
    "delay": _measure_delay,
    "dynamic_threshold": _measure_threshold,
}
"""What may be measured of one record, each several numbers by name with their unit."""


def signature_lines(demand: Array, rate: float) -> Lines:
    """Lines of a demand (N, n) that a signature has, as multiples of rate / N.

    The strongest of each of 14 bands up to 30 Hz, and twice and three times the strongest of all.
    """
    amplitude = np.abs(np.fft.rfft(demand - demand.mean(axis=0), axis=0)).sum(axis=1)
    amplitude[0] = 0.0
    frequency = np.arange(amplitude.size) * rate / len(demand)
    lines = {int(amplitude.argmax()) * k for k in (1, 2, 3)} - {0}  # 0 of a demand at rest
    for low, high in zip(_BANDS[:-1], _BANDS[1:], strict=True):
        inside = np.flatnonzero((frequency >= low) & (frequency < high))
        if inside.size and amplitude[inside].max() > _DRIVEN * amplitude.max():
            lines.add(int(inside[amplitude[inside].argmax()]))
    return np.array(sorted(line for line in lines if line < amplitude.size))


def signature(record: Record, lines: Lines, channels: Sequence[str] = SIGNATURE_CHANNELS) -> Array:
    """Means, real and imaginary parts at lines, (channels, 1 + 2 lines, legs)."""
    rows = []
    for name in channels:
        spectrum = np.fft.rfft(record[name], axis=0) / len(record.time)
        mean, at_lines = spectrum[:1].real, spectrum[lines]
        rows.append(np.concatenate([mean, 2.0 * at_lines.real, 2.0 * at_lines.imag]))
    return np.array(rows)


class RecordingMeasures(NamedTuple):
    """The response of a degree of freedom in one recording or several rounds."""

    files: tuple[Path, ...]
    dof: str
    response: FrequencyResponse  #: At the lines that are read.
    left_out: int  #: Lines that are not, since they were not excited or do not cohere.


def measure_recordings(
    files: Sequence[Path], dof: str, estimator: str, columns: Path | None = None, machine: str = CMF
) -> RecordingMeasures:
    """Measure the response in recordings; several, or one of single sines, are rounds of one.

    The estimator of rounds is `h1` or `report`, as in `rounds_response`. Lines are read that the
    demand excites, by its band or else by `EXCITED_SHARE`, from `LEAST_COHERENCE` on.
    `columns` maps those of the files; the machine is that of the map or files, else `machine`.
    """
    kind = cast("Estimator", check_name("estimator", estimator, get_args(Estimator)))
    column_map = None if columns is None else load_columns(columns)
    sheet = load_machine((column_map and column_map.machine) or machine)
    records = [read_mapped(path, column_map, sheet) for path in files]
    if len(records) > 1 or records[0].signal.dwells:
        response = rounds_response(records, dof, estimator=kind)
    else:
        response = frequency_response(records[0], dof, estimator=kind)
    clear = response.coherence >= LEAST_COHERENCE
    if records[0].signal.band is None:  # else the lines lie within it
        rounds = [dof_history(record, "leg_reference", dof) for record in records]
        demand = np.concatenate([demand - demand[0] for demand in rounds])
        share = demand_share(demand, records[0].rate, response.frequency)
        clear &= share > EXCITED_SHARE
    if not clear.any():
        least = f"a coherence of {LEAST_COHERENCE:g}"
        raise InputError(f"dof: no line of the demand in {dof} has {least}")
    left_out = int(np.count_nonzero(~clear))
    return RecordingMeasures(tuple(files), dof, response.at(clear), left_out)
