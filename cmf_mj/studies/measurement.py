"""A measuring session on a plant: the field's measures of one law in one degree of freedom.

Each measure is one or more runs of the closed loop and one function of `metrics`. Everything is
taken from DCL leg demand to leg sensors, mapped to the degree of freedom; host and DCU are outside.
Accelerations are those of the platform centroid, from the leg sensors through the Jacobian.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj import signals
from cmf_mj.analysis import metrics
from cmf_mj.analysis.delay import correlation_delay
from cmf_mj.analysis.frequency_response import (
    Bandwidths,
    FrequencyResponse,
    bandwidths,
    dof_history,
    frequency_response,
)
from cmf_mj.analysis.step_response import StepMetrics, step_metrics
from cmf_mj.control.law import Law, load_law
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.core.threads import on_threads
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.simulation import simulate
from cmf_mj.machine.dof import by_kind, dof_unit
from cmf_mj.machine.kinematics import DOFS, leg_motion_to_pose, legs_to_pose
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record
from cmf_mj.signals import composite as excitations
from cmf_mj.signals import peaks as limits

RECORD_EVERY = 16
"""Frames between samples of a measuring run: 128 Hz, the facility's recorder."""

HALF_HERTZ = 0.5
"""Frequency of the half-hertz noise [Hz]."""

SLOW = 0.01
"""Frequency of the hysteresis run [Hz]."""

CROSSTALK = 1.0
"""Frequency of the crosstalk runs [Hz]."""


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

    plant: str
    cab: str
    hydraulics: str
    law: str
    dof: str
    amplitude: float  #: Of the sweep [m or rad].
    response: FrequencyResponse
    bandwidths: Bandwidths
    second_order: metrics.SecondOrder
    step: StepMetrics
    transport_delay: float  #: Of the sweep, by cross-correlation [s].
    describing_function: tuple[Described, ...]
    half_hertz_noise: tuple[tuple[float, metrics.Noise], ...]
    """Demand amplitude [m or rad] and its noise."""
    hysteresis: float  #: Loop width over peak-to-peak, fraction.
    threshold: tuple[Threshold, ...]
    crosstalk: NDArray[np.float64]
    """Accelerations over the driven one at 1 Hz, (6, 6), a row a driven degree of freedom; rad/s^2
    per m/s^2 or the reverse across kinds."""

    def summary(self) -> dict[str, Any]:
        """Everything but the response curve as JSON values; NaN becomes None."""
        return plain(
            {
                "plant": self.plant,
                "cab": self.cab,
                "hydraulics": self.hydraulics,
                "law": self.law,
                "dof": self.dof,
                "amplitude": self.amplitude,
                "bandwidths": self.bandwidths._asdict(),
                "second_order": self.second_order._asdict(),
                "step": self.step._asdict(),
                "transport_delay": self.transport_delay,
                "describing_function": [point._asdict() for point in self.describing_function],
                "half_hertz_noise": [
                    {"amplitude": size, **noise._asdict()} for size, noise in self.half_hertz_noise
                ],
                "hysteresis": self.hysteresis,
                "dynamic_threshold": [point._asdict() for point in self.threshold],
                "crosstalk": {
                    driven: dict(zip(DOFS, row, strict=True))
                    for driven, row in zip(DOFS, self.crosstalk, strict=True)
                },
            }
        )


def plain(value: Any) -> Any:
    """JSON values of nested results: NumPy numbers become Python's, NaN becomes None."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return bool(value) if isinstance(value, np.bool_) else value


def dof_accelerations(record: Record) -> NDArray[np.float64]:
    """Acceleration of the platform pose from the leg sensors, (N, 6) [m/s^2, rad/s^2].

    Raises:
        InputError: the record holds no leg velocities or accelerations.
    """
    pose = legs_to_pose(record["leg_position"])
    legs = (record["leg_velocity"], record["leg_acceleration"])
    return leg_motion_to_pose(pose, *legs).acceleration


def session_commands(dof: str, amplitude: float | None = None) -> list[signals.Command]:
    """The five rounds of seven sines of Table 2-3, checked against the operational limits.

    Args:
        dof: degree of freedom.
        amplitude: of each sine [m or rad]; default the report's 0.33 in or 0.2 deg.

    Raises:
        InputError: an argument out of range, or a demand beyond the limits; each is named.
    """
    size = dof_amplitude(dof, amplitude)
    numbers = range(1, len(excitations.ROUNDS) + 1)
    commands = [excitations.seven_sines(dof, size, number) for number in numbers]
    for command in commands:
        limits.check_limits(command)
    return commands


def facility_session(
    build: Callable[[], Plant],
    law: str | Law,
    dof: str,
    *,
    amplitude: float | None = None,
    electronics: ElectronicsSettings | None = None,
    jobs: int | None = None,
) -> list[Record]:
    """The facility's frequency-response session: five rounds of seven sines, at 128 Hz.

    Args:
        build: makes a plant, e.g. `lambda: Hexapod("ifd")`; called once a round.
        law: name, TOML file or loaded law.
        dof: degree of freedom.
        amplitude: of each sine [m or rad]; default the report's 0.33 in or 0.2 deg.
        electronics: sensors, converters and servo electronics; default ideal.
        jobs: threads; default one per core. Records do not depend on it.

    Raises:
        InputError: an argument out of range, named, or a demand beyond the operational limits.
    """
    loaded = load_law(law)
    commands = session_commands(dof, amplitude)

    def run(command: signals.Command) -> Record:
        return simulate(
            build(), loaded, command, electronics=electronics, record_every=RECORD_EVERY
        )

    return on_threads(run, commands, jobs)


def dof_amplitude(dof: str, amplitude: float | None) -> float:
    """The given amplitude [m or rad], or the report's: 0.33 in or 0.2 deg.

    Raises:
        InputError: an amplitude that is not a finite number above 0.
    """
    size = amplitude
    if size is None:
        size = units.to_si(dof_unit(dof), by_kind(dof, 0.33, 0.2))
    if not (np.isfinite(size) and size > 0.0):
        raise InputError(f"amplitude: {size} must be a finite number greater than 0")
    return size


def _whole_cycles(record: Record, frequency: float, cycles: int) -> slice:
    """The last samples before the fade-out that make up whole cycles."""
    fade = round(1.0 * record.rate)
    count = round(cycles * record.rate / frequency)
    end = record.time.size - fade
    return slice(end - count, end)


def measure(
    build: Callable[[], Plant],
    law: str | Law,
    dof: str,
    *,
    amplitude: float | None = None,
    frequencies: Sequence[float] = (0.5, 1.0, 2.0, 3.0, 4.0, 6.0),
    shares: Sequence[float] = (0.25, 1.0, 4.0),
    electronics: ElectronicsSettings | None = None,
) -> Measurement:
    """Run a whole measuring session.

    Args:
        build: makes the plant, e.g. `lambda: Hexapod("ifd")`.
        law: name, TOML file or loaded law.
        dof: degree of freedom.
        amplitude: of the sweep [m or rad]; default the report's 0.33 in or 0.2 deg.
        frequencies: of the describing function [Hz].
        shares: amplitudes of describing function and half-hertz noise, in `amplitude`.
        electronics: sensors, converters and servo electronics; default ideal.

    Raises:
        InputError: an argument out of range, named.
    """
    size = dof_amplitude(dof, amplitude)
    plant = build()

    def run(command: signals.Command, every: int = RECORD_EVERY) -> Record:
        return simulate(plant, law, command, electronics=electronics, record_every=every)

    sweep = run(signals.chirp(dof, size))
    response = frequency_response(sweep)
    delay = correlation_delay(
        dof_history(sweep, "leg_reference", dof),
        dof_history(sweep, "leg_position", dof),
        sweep.rate,
    )

    described, noise = [], []
    for frequency in frequencies:
        for share in shares:
            record = run(signals.sine(dof, share * size, frequency, cycles=4.0 + 4.0 * frequency))
            cut = _whole_cycles(record, frequency, max(1, int(2.0 * frequency)))
            histories = [
                dof_history(record, name, dof)[cut] for name in ("leg_reference", "leg_position")
            ]
            value = metrics.describing_function(
                [histories[0]], [histories[1]], record.rate, [frequency]
            )[0]
            described.append(
                Described(
                    frequency,
                    share * size,
                    float(20.0 * np.log10(abs(value))),
                    float(np.degrees(np.angle(value))),
                )
            )
    for share in shares:
        record = run(signals.sine(dof, share * size, HALF_HERTZ, cycles=8.0))
        moved = dof_accelerations(record)[_whole_cycles(record, HALF_HERTZ, 4), DOFS.index(dof)]
        noise.append((share * size, metrics.acceleration_noise(moved, record.rate, HALF_HERTZ)))

    slow = run(signals.sine(dof, size, SLOW, cycles=2.0))
    cut = _whole_cycles(slow, SLOW, 1)
    loop = metrics.hysteresis(
        dof_history(slow, "leg_reference", dof)[cut],
        dof_history(slow, "leg_position", dof)[cut],
        slow.rate,
        SLOW,
    )

    unit = by_kind(dof, 1.0, units.DEGREE * 5.0)
    threshold = []
    for step in (0.05 * unit, 0.1 * unit, 0.5 * unit):
        record = run(excitations.acceleration_step(dof, step, hold=0.5), every=4)
        reached = dof_accelerations(record)[:, DOFS.index(dof)]
        threshold.append(
            Threshold(step, metrics.dynamic_threshold(reached, record.rate, step, 1.0))
        )

    share = size / dof_amplitude(dof, None)
    crosstalk = []
    for index, driven in enumerate(DOFS):
        crossed = run(
            signals.sine(driven, share * dof_amplitude(driven, None), CROSSTALK, cycles=10.0)
        )
        moved = dof_accelerations(crossed)[_whole_cycles(crossed, CROSSTALK, 6)]
        crosstalk.append(metrics.crosstalk(moved, index))
    return Measurement(
        plant=plant.name,
        cab=plant.cab,
        hydraulics=plant.parameters.name,
        law=str(sweep.metadata["law"]),
        dof=dof,
        amplitude=size,
        response=response,
        bandwidths=bandwidths(response),
        second_order=metrics.fit_second_order(response.frequency, response.response),
        step=step_metrics(run(signals.step(dof, size / units.to_si("in", 0.33) * units.INCH), 8)),
        transport_delay=delay,
        describing_function=tuple(described),
        half_hertz_noise=tuple(noise),
        hysteresis=loop,
        threshold=tuple(threshold),
        crosstalk=np.array(crosstalk),
    )
