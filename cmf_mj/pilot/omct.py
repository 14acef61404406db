"""Objective motion cueing test: frequency responses from the aircraft's pilot to the simulator's.

A sine drives one input of the aircraft at the pilot's station; the fundamental of each output at
the pilot's station of the simulator is its response. Ten tests, input > output:

    pitch > pitch    roll > roll    yaw > yaw      angle over angle
    surge > surge    sway > sway    heave > heave  specific force over specific force
    pitch > surge    roll > sway                   specific force over angle [m/s^2/rad]
    surge > pitch    sway > roll                   angle over specific force [rad/(m/s^2)]

An input in pitch or roll turns the aircraft about the pilot's station, gravity with it, so that the
specific force over angle is g (minus g in roll). Responses are taken at three places: behind
the washout (host frames), behind the DCU (an ideal machine), and at the crew's accelerometer of the
machine under each control law; the last over the one before is the law's share. What an output has
beyond mean and fundamental, harmonics, ringing or a limit cycle, is measured by its root mean
square over that of the fundamental: where this is large the fundamental alone says little.

Single sines, because the washout is not linear: its tilt rate is limited. The procedure is that of
ICAO 9625 as far as it was known here: frequencies and amplitudes are recalled, not read, and the
units of the cross tests are this project's. No boundary of acceptance is known, and none is given.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.periodic import sine_response
from cmf_mj.control.dcu.play import upsample
from cmf_mj.control.dcu.state import load_dcu, make_dcu, resting
from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.threads import on_threads
from cmf_mj.core.units import DEGREE, RATE
from cmf_mj.facility.host.stream import HostStream, arrivals, make_stream
from cmf_mj.facility.operation import operate
from cmf_mj.facility.session import OutOfBounds
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.machine.geometry import DOFS, by_kind, dof_index
from cmf_mj.machine.kinematics import legs_to_pose
from cmf_mj.machine.machine import recorded_machine
from cmf_mj.pilot.motion import MOST_RATE, PilotMotion, gravity_in_body
from cmf_mj.pilot.washout import Washout
from cmf_mj.pilot.washout_settings import WashoutSettings, load_washout
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import HydraulicParameters, load_hydraulics
from cmf_mj.record.record import Record
from cmf_mj.signals.signal import Command, PoseTable, check_positive

TESTS = (
    *(("pitch", "pitch"), ("pitch", "surge"), ("roll", "roll"), ("roll", "sway"), ("yaw", "yaw")),
    *(("surge", "surge"), ("surge", "pitch"), ("sway", "sway"), ("sway", "roll")),
    ("heave", "heave"),
)
"""Input and output of the ten tests; results have a row for each."""
FREQUENCIES = (0.1, 0.158, 0.251, 0.398, 0.631, 1.0, 1.585, 2.512, 3.981, 6.31, 10.0, 15.849)
"""Frequencies [rad/s], five a decade; recalled."""
FORCE = 1.0  #: Amplitude of surge, sway and heave [m/s^2]; recalled.
ANGLE = 6.0 * DEGREE  #: Largest amplitude of an angle [rad]; recalled.
ANGULAR_RATE = 1.0 * DEGREE  #: Largest amplitude of an angle's rate [rad/s]; recalled.
STAGES = ("washout", "ideal")
"""Places without a machine: the host's frames, and an ideal one's motion behind the DCU."""
_SETTLE = 20.0  #: Least time before the cycles that are measured [s].
_MEASURE = 5.0  #: Least time measured [s].
_FADE = 5.0  #: Longest fade-in [s].
_SAMPLE_EVERY = 16  #: Control frames a sample of the machine's response: 128 Hz.


class Omct(NamedTuple):
    """Responses of all tests."""

    washout: str
    cab: str
    hydraulics: str
    frequency: NDArray[np.float64]  #: [rad/s], (K,).
    responses: dict[str, NDArray[np.complex128]]
    """By `STAGES` and law: complex responses in SI, (10, K); NaN where the machine left its
    bounds."""
    remainder: dict[str, NDArray[np.float64]]
    """By `STAGES` and law: what the output has beyond mean and fundamental, rms over the rms of the
    fundamental, (10, K); NaN likewise."""

    def share(self, law: str) -> NDArray[np.complex128]:
        """Response of the machine under a law over that of an ideal one, (10, K)."""
        with np.errstate(invalid="ignore"):
            return self.responses[law] / self.responses["ideal"]


def amplitude(dof: str, frequency: float) -> float:
    """Amplitude of an input [m/s^2 or rad] at a frequency [rad/s]."""
    return by_kind(dof, FORCE, min(ANGLE, ANGULAR_RATE / frequency))


def measurement_start(frequency: float) -> float:
    """When the measured cycles of a frequency [rad/s] begin [s]."""
    return max(2.0 * np.pi / frequency, _SETTLE)


def aircraft_motion(dof: str, frequency: float) -> PilotMotion:
    """The aircraft's motion of one run at a frequency [rad/s]."""
    period, size = 2.0 * np.pi / frequency, amplitude(dof, frequency)
    end = measurement_start(frequency) + period * np.ceil(_MEASURE / period)
    time = np.arange(int(np.ceil((end + 0.5) * MOST_RATE))) / MOST_RATE
    span = min(period, _FADE)
    share = np.clip(time / span, 0.0, 1.0)
    fade = 0.5 * (1.0 - np.cos(np.pi * share))
    slope = np.where(time < span, 0.5 * np.pi / span * np.sin(np.pi * share), 0.0)
    sine, cosine = np.sin(frequency * time), np.cos(frequency * time)
    value, rate = size * fade * sine, size * (slope * sine + fade * frequency * cosine)
    force, angular_rate, attitude = np.zeros((3, time.size, 3))
    axis = dof_index(dof) % 3
    if dof in DOFS[:3]:
        force[:, axis] = value
    else:
        attitude[:, axis], angular_rate[:, axis] = value, rate
    return PilotMotion(time, force - gravity_in_body(attitude), angular_rate, attitude)


def omct(
    laws: Sequence[str | Path | Law] = ("velocity",),
    *,
    washout: str | WashoutSettings = "simona",
    cab: str | Path | Cab | None = None,
    hydraulics: str | Path | HydraulicParameters | None = None,
    frequencies: Sequence[float] = FREQUENCIES,
    dofs: Sequence[str] = DOFS,
    jobs: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Omct:
    """Run the tests, without a machine and on the machine under each law.

    Laws, which may be none, washout and hydraulics are names, TOML files or loaded; frequencies in
    rad/s, whose runs last from 25 s to two periods of the lowest. `dofs` are the inputs to drive;
    the tests of others are NaN. `progress` is called with runs done and in all.
    """
    settings, parameters = load_washout(washout), load_hydraulics(hydraulics)
    loaded_laws = [load_law(law) for law in laws]
    loaded_cab = load_cab(cab)
    for dof in dofs:
        check_name("dofs", dof, sorted(DOFS))
    if not frequencies:
        raise InputError("frequencies: is empty; at least one is needed")
    for frequency in frequencies:
        check_positive(frequencies=frequency)
        if frequency > 0.25 * np.pi * MOST_RATE:
            raise InputError(
                f"frequencies: {frequency} rad/s must be at most {0.25 * np.pi * MOST_RATE:.4g}"
            )
    names = [*STAGES, *(law.name for law in loaded_laws)]
    shape = len(TESTS), len(frequencies)
    responses = {name: np.full(shape, np.nan + 0j) for name in names}
    remainders = {name: np.full(shape, np.nan) for name in names}
    cases = list(product(dofs, range(len(frequencies)), (None, *loaded_laws)))

    def run(case: tuple[str, int, Law | None]) -> None:
        dof, column, law = case
        frequency = float(frequencies[column])
        stream = Washout(settings, cab=loaded_cab).run(aircraft_motion(dof, frequency))
        if law is None:
            motions = _ideal_motions(stream, loaded_cab)
        else:
            motions = _machine_motion(stream, law, Hexapod(loaded_cab, parameters))
        for name, motion in motions.items():
            for row, (response, remainder) in fundamentals(dof, frequency, motion).items():
                responses[name][row, column], remainders[name][row, column] = response, remainder

    on_threads(run, cases, jobs, progress)
    omega = np.array(frequencies, dtype=float)
    return Omct(settings.name, loaded_cab.name, parameters.name, omega, responses, remainders)


def _ideal_motions(stream: HostStream, cab: Cab) -> dict[str, PilotMotion]:
    """Motions by `STAGES`: by the host's frames, and by the DCU's demand at 128 Hz."""
    samples = _dcu_demand(stream)[::_SAMPLE_EVERY]
    time = np.arange(len(samples)) * _SAMPLE_EVERY / RATE
    demand = make_stream(time, samples[:, 0], samples[:, 1], samples[:, 2])
    return {
        stage: PilotMotion.from_platform(frames, cab.station)
        for stage, frames in zip(STAGES, (stream, demand), strict=True)
    }


def _machine_motion(stream: HostStream, law: Law, plant: Hexapod) -> dict[str, PilotMotion]:
    """The motion of the machine by the law's name; none where it left its bounds."""
    ideal = {"electronics": None, "protection": None}
    with suppress(OutOfBounds):
        operation = operate(plant, law, stream, record_every=_SAMPLE_EVERY, **ideal)
        return {law.name: PilotMotion.from_record(operation.record)}
    return {}


def _dcu_demand(stream: HostStream) -> NDArray[np.float64]:
    """The DCU's demand of host frames, (N, 3, 6)."""
    unit, frames = make_dcu(load_dcu()), int(stream.time[-1] * RATE)
    return upsample(unit, resting(unit, stream.pose[0]), arrivals(stream), frames)


def aircraft_command(table: Mapping[str, Any], plant: Hexapod) -> Command:
    """The platform's demand in one test of a guide, `{ dof, frequency [rad/s], washout }`."""
    settings, rate = load_washout(str(table.get("washout", "simona"))), plant.machine.rate
    aircraft = aircraft_motion(str(table["dof"]), float(table["frequency"]))
    poses = _dcu_demand(Washout(settings, cab=plant.cab_parameters).run(aircraft))[:, 0]
    rows = np.arange(int(len(poses) * rate / RATE)) * RATE // rate
    return Command(poses[rows], PoseTable(**{**table, "rate": rate}))


def cueing_responses(record: Record) -> dict[str, float]:
    """Modulus and phase of what an input drives, of a record of a guide: legs to pilot's station.

    The station is that of the cab that the metadata name.
    """
    command, machine = record.metadata["command"], recorded_machine(record.metadata)
    dof, frequency = str(command["dof"]), float(command["frequency"])
    stream = make_stream(record.time, legs_to_pose(record["leg_position"], machine))
    station = load_cab(record.metadata["cab"], machine).station
    motion, values = PilotMotion.from_platform(stream, station), {}
    for row, (response, _) in fundamentals(dof, frequency, motion).items():
        _, output = TESTS[row]
        name = f"{dof} > {output} {frequency:g} rad/s"
        values[f"{name} modulus"] = abs(response)
        values[f"{name} phase [deg]"] = float(np.degrees(np.angle(response)))
    return values


def fundamentals(
    dof: str, frequency: float, motion: PilotMotion
) -> dict[int, tuple[complex, float]]:
    """Response and remainder of all outputs that an input drives, by row of `TESTS`."""
    results, size, begin = {}, amplitude(dof, frequency), measurement_start(frequency)
    for row, (driven_dof, output) in enumerate(TESTS):
        if driven_dof == dof:
            channel = by_kind(output, motion.specific_force, motion.attitude)
            values = channel[:, dof_index(output) % 3]
            results[row] = _fundamental(motion.time, values, frequency, size, begin)
    return results


def _fundamental(
    time: NDArray[np.float64],
    values: NDArray[np.float64],
    frequency: float,
    size: float,
    begin: float,
) -> tuple[complex, float]:
    """Fundamental of an output over an input size sin(frequency time), and the remainder.

    Over the whole cycles from `begin` on a fundamental of amplitude A has the variance A^2 / 2;
    what the output's variance has more is the remainder's, the mean taken out.
    """
    rate = (time.size - 1) / float(time[-1] - time[0])
    period = 2.0 * np.pi * rate / frequency
    start = int(np.searchsorted(time, begin))
    count = int(np.ceil(int((time.size - start) / period) * period))
    rows = slice(start, start + count)
    sine = size * np.sin(frequency * time[rows])
    estimate = sine_response(sine, values[rows], rate, frequency / (2.0 * np.pi))
    response = complex(estimate.response[0])
    power = 0.5 * abs(size * response) ** 2
    return response, float(np.sqrt(max(values[rows].var() - power, 0.0) / power))
