"""What a machine with given numbers would have measured: each recording simulated again.

The demand of the legs, interpolated by a cubic spline to the control rate (steps are held from row
to row), is played to the recording's law on the plant with the numbers. Sensors and electronics
have their lags, ranges and constant errors, which may be unknowns too, but neither noise nor steps,
which are what the likelihood explains. The machine begins at rest at the first demand, `LEAD`
before the recording. What moved before is not known, and chambers of cylinders at rest forget it
slowly, so that `SETTLING` of a recording is left out.

Where the demand stands still, the legs bear what is carried, and cap and rod pressures weigh it:

    A_cap p_cap - A_rod p_rod = F(pose; mass, centre of mass)

which needs no simulation. Friction and sensors are off by about `FORCE_DEVIATION` of it.

The residual, measured less simulated, is low-passed below `top` without phase and taken at about
2.5 `top`, so that a stage of the fit sees what it can explain and nothing above.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import signal, stats
from scipy.interpolate import CubicSpline

from cmf_mj.control.law import Law
from cmf_mj.core.errors import InputError
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.electronics.sensors import CHANNELS
from cmf_mj.facility.run import Run
from cmf_mj.facility.signal import LegDemand, ValveCommands
from cmf_mj.machine.kinematics import legs_to_pose
from cmf_mj.machine.machine import Machine
from cmf_mj.plant.plant import Plant
from cmf_mj.studies.case import frames_a_row
from cmf_mj.studies.fit.campaign import MEASURED, Campaign, Recording

Array = NDArray[np.float64]

LEAD = 0.5  #: Rest before a recording [s].
SETTLING = (3.0, 0.3)
"""What is left out of a recording's beginning: so long [s], but at most this share of it."""

REST_LENGTH = 0.25  #: Length of a rest that is weighed [s], as long again after the motion.
STILL_SHARE = 1e-4  #: Part of the stroke that the demand moves at most in it.
FORCE_DEVIATION = 0.02  #: Deviation of a leg's force at rest, of the mean force of all.

_HIGHEST_RATE = 512  #: Rate at which a simulation is kept [Hz]; the recording lies between.

_CLOCK_DEVIATIONS = np.array([0.02, 1e-4])
"""Deviations of the clocks' offset [s] and skew [s/s] before the recordings."""

_WEIGHING_STEPS = 3  #: Steps of Gauss and Newton to what is nearly linear.

Residuals = Mapping[tuple[str, str], Array]
"""By recording and channel, (samples, legs), in SI; e of what is stated as `STATED`, (n, 1)."""

STATED = "evidence of numbers", "stated"

Change = Callable[[Plant, Array], Plant]
"""A machine with so much of an effect, in sizes (1,), or (legs,) where each leg has its own."""


def difference(end: Residuals, start: Residuals, step: float = 1.0) -> Residuals:
    """Difference of two sets of residuals over a step."""
    return {key: (value - start[key]) / step for key, value in end.items()}


class Piece(NamedTuple):
    """A recording, ready to be simulated and compared."""

    name: str
    law: Law | None  #: That it ran; None for valve commands.
    run_settings: Mapping[str, Any]  #: Source, start and spacing of its `Run`.
    time: Array  #: Of the samples, from the beginning of the simulation [s].
    measured: Mapping[str, Array]  #: By channel, (samples, legs).
    demand: Array  #: Of the legs, or of the valves, (samples, legs).
    rate: float  #: Of the recording [Hz].
    first_sample: int  #: From which on it counts.


def make_piece(recording: Recording, plant: Plant, seconds: float | None = None) -> Piece:
    """Prepare a recording, or its first `seconds`."""
    record, rate = recording.record, plant.machine.rate
    count = record.time.size if seconds is None else int(seconds * record.rate) + 1
    time = record.time[:count] - record.time[0]
    frames = np.arange(int(time[-1] * rate) + 1) / rate
    lead = round(LEAD * rate)
    is_valves = recording.law is None
    demand = record["valve_command" if is_valves else "leg_reference"][:count]
    if recording.settings.kind == "step":
        rows = demand[(frames * record.rate + 1e-6).astype(int)]
    else:
        rows = CubicSpline(time, demand)(frames)
    rest = np.zeros_like(demand[0]) if is_valves else demand[0]
    rows = np.concatenate([np.tile(rest, (lead, 1)), rows])
    start = record["leg_position"][0] if is_valves else demand[0]
    settings = {
        "source": ValveCommands(np.clip(rows, -1.0, 1.0)) if is_valves else LegDemand(rows),
        "start": legs_to_pose(start, plant.machine),
        "record_every": frames_a_row(plant.machine, _HIGHEST_RATE),
        "command_delay": 0 if is_valves else 1,
    }
    measured = {name: record[name][:count] for name in MEASURED if name in record.channels}
    longest, share = SETTLING
    first_sample = int(min(longest, share * record.time.size / record.rate) * record.rate)
    law, time = recording.law, time + lead / rate
    return Piece(recording.name, law, settings, time, measured, demand, record.rate, first_sample)


class Rest(NamedTuple):
    """What a machine bore at rest."""

    pose: Array  #: (6,), z down [m, rad].
    force: Array  #: Of the legs, positive extending [N], (legs,).


def find_rests(piece: Piece, plant: Plant) -> list[Rest]:
    """Find where the demand, with all pressures recorded, stands still for two `REST_LENGTH`."""
    length, cylinders = round(REST_LENGTH * piece.rate), plant.hydraulics.cylinder
    if piece.law is None or not set(MEASURED) <= set(piece.measured):
        return []
    largest_move = STILL_SHARE * plant.machine.half_stroke
    rests = []
    for begin in range(length, piece.demand.shape[0] - length + 1, length):
        end = begin + length
        if np.ptp(piece.demand[begin - length : end], axis=0).max() < largest_move:
            mean = {name: piece.measured[name][begin:end].mean(axis=0) for name in MEASURED}
            push = cylinders.cap_area * mean["cap_pressure"]
            force = push - cylinders.rod_area * mean["rod_pressure"]
            rests.append(Rest(legs_to_pose(mean["leg_position"], plant.machine), force))
    return rests


def without_noise(settings: ElectronicsSettings | None, machine: Machine) -> Any:
    """Electronics with neither noise nor steps of sensors, ADC and DAC."""
    if settings is None:
        return None
    parts = settings.of(machine)
    quiet = {"noise_density": None, "resolution": None}
    channels = {name: getattr(parts.sensors, name).model_copy(update=quiet) for name in CHANNELS}
    unlimited_bits = parts.servo.dac_bits.model_copy(update={"value": 0})
    return settings.model_copy(
        update={
            "sensors": parts.sensors.model_copy(update=channels),
            "converters": parts.converters.model_copy(update={"quantise": False}),
            "servo": parts.servo.model_copy(update={"dac_bits": unlimited_bits}),
        }
    )


class Model:
    """The machine of a campaign as a function of its numbers.

    Numbers have the coordinates z = Phi^-1(u), u the quantile of what is known of each: the prior
    is then standard normal. Those of an effect, which `change` gives the machine, follow, and a
    clock's offset and skew of each recording, where asked.
    """

    change: Change  #: Of the effect that `z` has coordinates of; set where it has some.

    def __init__(
        self,
        campaign: Campaign,
        *,
        held_back: bool = False,
        top: float | None = None,
        seconds: float | None = None,
    ) -> None:
        """Take the recordings that are fitted, or those held back, up to `top` [Hz]."""
        self.plant, self.unknowns = campaign.plant, campaign.unknowns
        self.size = len(self.unknowns.numbers())
        self.clocks = 2 * len(campaign.recordings_where(held_back)) * campaign.settings.clocks
        self._electronics = without_noise(campaign.settings.electronics, campaign.plant.machine)
        self.top = min(top or np.inf, campaign.settings.highest)
        self.pieces = tuple(
            make_piece(recording, campaign.plant, seconds)
            for recording in campaign.recordings_where(held_back)
        )
        self.evidence = campaign.evidence

    def values(self, z: Array) -> dict[str, Any]:
        """Values of the unknowns at coordinates (n,)."""
        return self.unknowns.at(stats.norm.cdf(z[: self.size]))

    def plant_at(self, z: Array) -> Plant:
        """The plant with the numbers, and with the effect if `z` has coordinates of one."""
        plant = self.unknowns.apply(self.values(z), self.plant)
        effect = z[self.size : z.size - self.clocks]
        return self.change(plant, effect) if effect.size else plant

    def simulate(
        self, piece: Piece, z: Array, plant: Plant, offset: float = 0.0, skew: float = 0.0
    ) -> dict[str, Array]:
        """The channels of a recording as the `plant` of these numbers would have measured them.

        Law and sensors have the numbers too. The measurement's clock is late by `offset` [s], and
        gains on the demand's by `skew` [s/s]. Raises `OutOfBounds` as `simulate`.
        """
        values, electronics = self.values(z), self._electronics
        if electronics is not None:
            sensors = self.unknowns.apply(values, electronics.sensors)
            electronics = electronics.model_copy(update={"sensors": sensors})
        law = piece.law and self.unknowns.apply(values, piece.law)
        record = Run(plant=plant, law=law, electronics=electronics, **piece.run_settings).record()
        time = piece.time + offset + skew * (piece.time - LEAD)
        return {
            name: np.asarray(CubicSpline(record.time, record[name])(time))
            for name in piece.measured
        }

    def residuals(self, z: Array) -> Residuals:
        """Measured less simulated below `top`.

        Raises `InputError` for numbers that no machine has, `OutOfBounds` where it leaves its own.
        """
        plant, residuals = self.plant_at(z), dict[tuple[str, str], Array]()
        clocks = _CLOCK_DEVIATIONS * z[z.size - self.clocks :].reshape(-1, 2)
        for i, piece in enumerate(self.pieces):
            offset, skew = clocks[i] if self.clocks else (0.0, 0.0)
            simulated = self.simulate(piece, z, plant, offset, skew)
            errors = {name: piece.measured[name] - value for name, value in simulated.items()}
            filtered = self.low_passed(piece, errors)
            residuals |= {(piece.name, channel): error for channel, error in filtered.items()}
        stated = self.evidence.excess(self.values(z), plant)
        if stated.size:
            residuals[STATED] = stated[:, None]
        return residuals

    def weigh(self) -> Array:
        """Coordinates (n,) of the numbers as the rests of all recordings weigh them, else 0."""
        rests = [rest for piece in self.pieces for rest in find_rests(piece, self.plant)]
        z = np.zeros(self.size)
        if not rests:
            return z
        deviation = FORCE_DEVIATION * float(np.mean([rest.force for rest in rests]))

        def relative_forces(z: Array) -> Array:
            plant, rows = self.plant_at(z), []
            for rest in rests:
                plant.place(rest.pose)
                rows.append(plant.static_load() / deviation)
            return np.ravel(rows)

        measured, width = np.ravel([rest.force for rest in rests]) / deviation, 0.1
        for _ in range(_WEIGHING_STEPS):
            try:
                force, moves = relative_forces(z), width * np.eye(z.size)
                slopes = np.stack([relative_forces(z + move) - force for move in moves]) / width
            except InputError:  # no machine weighs so: pressures of another one
                break
            matrix = slopes @ slopes.T + np.eye(z.size)
            z = z + np.linalg.solve(matrix, slopes @ (measured - force) - z)
        return z

    def low_passed(self, piece: Piece, histories: Mapping[str, Array]) -> dict[str, Array]:
        """Histories of one recording below `top`, thinned, without its first samples."""
        sections = signal.butter(4, min(self.top, 0.4 * piece.rate), fs=piece.rate, output="sos")
        rows = slice(piece.first_sample, None, round(self.spacing(piece) * piece.rate))
        return {
            name: signal.sosfiltfilt(sections, history, axis=0)[rows]
            for name, history in histories.items()
        }

    def spacing(self, piece: Piece) -> float:
        """Time between the samples of a recording's residuals [s]."""
        top = min(self.top, 0.4 * piece.rate)
        return max(1, int(piece.rate / (2.5 * top))) / piece.rate
