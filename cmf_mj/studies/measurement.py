"""A measuring session on a plant, and recordings, in the field's measures.

Each measure is one or more runs of the closed loop and one function of `metrics`. Everything is
taken from DCL leg demand to leg sensors, mapped to the degree of freedom; host and DCU are outside.
Accelerations are those of the platform centroid, from the leg sensors through the Jacobian.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, cast, get_args

import numpy as np
from numpy.typing import NDArray

from cmf_mj import signals
from cmf_mj.analysis import metrics
from cmf_mj.analysis.frequency_response import (
    FrequencyResponse,
    bandwidths,
    frequency_response,
    rounds_response,
)
from cmf_mj.analysis.measurable import CLEAR, EXCITED_SHARE, demand_share, dof_history
from cmf_mj.analysis.measures import Measures, joined, step_metrics
from cmf_mj.analysis.metrics import correlation_delay
from cmf_mj.analysis.spectra import Estimator
from cmf_mj.core import units
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.threads import on_threads
from cmf_mj.machine.geometry import DOFS, by_kind
from cmf_mj.machine.kinematics import legs_to_pose
from cmf_mj.machine.leg_motion import leg_motion_to_pose
from cmf_mj.machine.machine import Machine, recorded_machine
from cmf_mj.machine.models import CMF
from cmf_mj.plant.plant import Plant
from cmf_mj.record.reader import read_recording
from cmf_mj.record.record import Record
from cmf_mj.signals import composite
from cmf_mj.signals.peaks import check_limits
from cmf_mj.signals.signal import Command
from cmf_mj.studies.case import Case, Qualities, dof_amplitude, qualities

HALF_HERTZ = 0.5  #: Frequency of the half-hertz noise [Hz].

SLOW = 0.01  #: Frequency of the hysteresis run [Hz].

CROSSTALK = 1.0  #: Frequency of the crosstalk runs [Hz].


class Described(NamedTuple):
    """One point of the describing function."""

    frequency_hz: float
    amplitude: float  #: Of the demand [m or rad].
    gain_db: float
    phase_deg: float


class Threshold(NamedTuple):
    """One point of the dynamic threshold."""

    acceleration: float  #: Size of the acceleration step [m/s^2 or rad/s^2].
    time: float  #: To 63 % of it [s]; NaN if never.


@dataclass(frozen=True)
class Measurement:
    """All measures of one law on one plant in one degree of freedom."""

    case: Case
    response: FrequencyResponse
    measures: Measures  #: Of the sweep and the step; NaN where the step rings on.
    second_order: metrics.SecondOrder | None
    """Fitted to the response; None where the step rings on."""
    transport_delay: float  #: Of the sweep, by cross-correlation [s].
    describing_function: tuple[Described, ...]
    half_hertz_noise: tuple[tuple[float, metrics.MotionNoise], ...]
    """Demand amplitude [m or rad] and its noise."""
    hysteresis: float  #: Loop width over peak-to-peak, fraction.
    threshold: tuple[Threshold, ...]
    crosstalk: NDArray[np.float64]
    """Accelerations over the driven one at 1 Hz, (6, 6), a row a driven degree of freedom; rad/s^2
    per m/s^2 or the reverse across kinds."""
    qualities: Qualities  #: What compares laws.

    def summary(self) -> dict[str, Any]:
        """Everything but the response curve, by name."""
        case = self.case
        return {
            "plant": case.plant,
            "cab": case.cab_name,
            "hydraulics": case.hydraulics.name,
            "law": case.law.name,
            "dof": case.dof,
            "amplitude": case.size,
            "measures": self.measures,
            "qualities": self.qualities,
            "second_order": self.second_order,
            "transport_delay": self.transport_delay,
            "describing_function": self.describing_function,
            "half_hertz_noise": [
                {"amplitude": size, **noise._asdict()} for size, noise in self.half_hertz_noise
            ],
            "hysteresis": self.hysteresis,
            "dynamic_threshold": self.threshold,
            "crosstalk": {
                driven: dict(zip(DOFS, row, strict=True))
                for driven, row in zip(DOFS, self.crosstalk, strict=True)
            },
        }


def dof_accelerations(record: Record) -> NDArray[np.float64]:
    """Acceleration of the platform pose from the leg sensors, (N, 6) [m/s^2, rad/s^2]."""
    machine = recorded_machine(record.metadata)
    pose = legs_to_pose(record["leg_position"], machine)
    legs = (record["leg_velocity"], record["leg_acceleration"])
    return leg_motion_to_pose(pose, *legs, machine).acceleration


def session_commands(
    dof: str, amplitude: float | None = None, machine: str | Machine = CMF
) -> list[Command]:
    """The five rounds of seven sines of Table 2-3, within a machine's operational limits.

    `amplitude` of each sine [m or rad] defaults to the report's 0.33 in or 0.2 deg.
    """
    size = dof_amplitude(dof) if amplitude is None else amplitude
    numbers = range(1, len(composite.ROUNDS) + 1)
    commands = [composite.seven_sines(dof, size, number) for number in numbers]
    for command in commands:
        check_limits(command, machine=machine)
    return commands


def facility_session(case: Case) -> list[Record]:
    """The facility's frequency-response session: five rounds of seven sines, at 128 Hz."""
    return on_threads(case.run, session_commands(case.dof, case.size, case.on))


def _whole_cycles(record: Record, frequency: float, cycles: int) -> slice:
    """The last samples before the fade-out that make up whole cycles."""
    fade = round(1.0 * record.rate)
    count = round(cycles * record.rate / frequency)
    end = record.time.size - fade
    return slice(end - count, end)


def _demand_and_position(
    record: Record, dof: str, part: slice = slice(None)
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    demand, position = (
        dof_history(record, name, dof) for name in ("leg_reference", "leg_position")
    )
    return demand[part], position[part]


def measure(
    case: Case,
    *,
    frequencies: Sequence[float] = (0.5, 1.0, 2.0, 3.0, 4.0, 6.0),
    shares: Sequence[float] = (0.25, 1.0, 4.0),
) -> Measurement:
    """Run a whole measuring session.

    `frequencies` of the describing function are in Hz; `shares` are its amplitudes, and those of
    the half-hertz noise, over that of the sweep.
    """
    plant = case.build()
    sizes = [share * case.size for share in shares]
    sweep, step = case.sweep_and_step(plant)
    response = frequency_response(sweep)
    measures = joined(bandwidths(response), step_metrics(step))
    fitted = metrics.fit_second_order if measures.stable else lambda *_: None
    points, swept = product(frequencies, sizes), (case.dof, case.size, measures.phase_bandwidth_hz)
    return Measurement(
        case=case,
        response=response,
        measures=measures,
        second_order=fitted(response.frequency, response.response),
        transport_delay=correlation_delay(*_demand_and_position(sweep, case.dof), sweep.rate),
        describing_function=tuple(_describe(case, plant, *point) for point in points),
        half_hertz_noise=tuple((size, _half_hertz_noise(case, plant, size)) for size in sizes),
        hysteresis=_hysteresis(case, plant),
        threshold=tuple(_thresholds(case, plant)),
        crosstalk=np.array([_crosstalk(case, plant, driven) for driven in DOFS]),
        qualities=qualities(plant, case.law, [swept])[0],
    )


def _describe(case: Case, plant: Plant, frequency: float, size: float) -> Described:
    """A point of the describing function, from a sine."""
    command = signals.sine(case.dof, size, frequency, cycles=4.0 + 4.0 * frequency)
    record = case.run(command, plant)
    part = _whole_cycles(record, frequency, max(1, int(2.0 * frequency)))
    demand, position = _demand_and_position(record, case.dof, part)
    value = metrics.describing_function(demand, position, record.rate, frequency)
    gain, phase = 20.0 * np.log10(abs(value)), np.degrees(np.angle(value))
    return Described(frequency, size, float(gain), float(phase))


def _half_hertz_noise(case: Case, plant: Plant, size: float) -> metrics.MotionNoise:
    record = case.run(signals.sine(case.dof, size, HALF_HERTZ, cycles=8.0), plant)
    part = _whole_cycles(record, HALF_HERTZ, 4)
    moved = dof_accelerations(record)[part, DOFS.index(case.dof)]
    return metrics.acceleration_noise(moved, record.rate, HALF_HERTZ)


def _hysteresis(case: Case, plant: Plant) -> float:
    record = case.run(signals.sine(case.dof, case.size, SLOW, cycles=2.0), plant)
    part = _whole_cycles(record, SLOW, 1)
    return metrics.hysteresis(*_demand_and_position(record, case.dof, part), record.rate, SLOW)


def _thresholds(case: Case, plant: Plant) -> Iterator[Threshold]:
    unit = by_kind(case.dof, 1.0, units.DEGREE * 5.0)
    for size in (0.05 * unit, 0.1 * unit, 0.5 * unit):
        command = composite.acceleration_step(case.dof, size, hold=0.5)
        record = case.run(command, plant, rate=512)
        reached = dof_accelerations(record)[:, DOFS.index(case.dof)]
        yield Threshold(size, metrics.dynamic_threshold(reached, record.rate, size, 1.0))


def _crosstalk(case: Case, plant: Plant, driven: str) -> NDArray[np.float64]:
    """Accelerations in all degrees of freedom while one is driven, (6,)."""
    size = case.size / dof_amplitude(case.dof) * dof_amplitude(driven)
    record = case.run(signals.sine(driven, size, CROSSTALK, cycles=10.0), plant)
    moved = dof_accelerations(record)[_whole_cycles(record, CROSSTALK, 6)]
    return metrics.acceleration_crosstalk(moved, DOFS.index(driven))


class RecordingMeasures(NamedTuple):
    """The response of a degree of freedom in one recording or several rounds."""

    files: tuple[Path, ...]
    dof: str
    estimator: str
    response: FrequencyResponse  #: At the lines that are read.
    left_out: int  #: Lines that are not, since they were not excited or do not cohere.
    second_order: metrics.SecondOrder

    def summary(self) -> dict[str, Any]:
        """Files, settings and measures."""
        return {
            "files": [str(path) for path in self.files],
            "dof": self.dof,
            "estimator": self.estimator,
            "bandwidths": bandwidths(self.response),
            "second_order": self.second_order,
            "coherence_least": float(self.response.coherence.min()),
            "lines_left_out": self.left_out,
        }


def measure_recordings(files: Sequence[Path], dof: str, estimator: str) -> RecordingMeasures:
    """Measure the response in recordings; several, or one of single sines, are rounds of one.

    The estimator of rounds is `h1` or `report`, as in `rounds_response`. Lines are read that the
    demand excites, by its band or else by `EXCITED_SHARE`, with a coherence of at least `CLEAR`.
    """
    chosen = cast("Estimator", check_name("estimator", estimator, get_args(Estimator)))
    records = [read_recording(path) for path in files]
    if len(records) > 1 or records[0].signal.dwells:
        response = rounds_response(records, dof, estimator=chosen)
    else:
        response = frequency_response(records[0], dof, estimator=chosen)
    read = response.coherence >= CLEAR
    if records[0].signal.band is None:  # else the lines lie within it
        demand = np.concatenate([dof_history(record, "leg_reference", dof) for record in records])
        share = demand_share(demand - demand[0], records[0].rate, response.frequency)
        read &= share > EXCITED_SHARE
    if not read.any():
        raise InputError(f"dof: no line of the demand in {dof} has a coherence of {CLEAR:g}")
    left_out = int(np.count_nonzero(~read))
    response = response.at(read)
    fit = metrics.fit_second_order(response.frequency, response.response)
    return RecordingMeasures(tuple(files), dof, estimator, response, left_out, fit)
