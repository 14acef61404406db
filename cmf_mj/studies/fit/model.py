"""What a machine with given numbers would have measured: each recording simulated again.

The demand of the legs, interpolated by a cubic spline to the control rate (steps are held from row
to row), is played to the recording's law on the plant with the numbers. Sensors and electronics
have their lags, ranges and constant errors, which may be unknowns too, but neither noise nor steps,
which are what the likelihood explains. The machine begins at rest at the first demand, `LEAD`
before the recording. What moved before is not known, and chambers of cylinders at rest forget it
slowly, so that `SETTLING` of a recording is left out.

Where the demand stands still, the legs bear what is carried, and cap and rod pressures weigh it:

    A_cap p_cap - A_rod p_rod = F(pose; mass, centre of mass)

which needs no simulation. Friction and sensors are off by about `FORCE` of it.

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

REST = 0.25  #: Length of a rest that is weighed [s], as long again after the motion.
STILL = 1e-4  #: Part of the stroke that the demand moves at most in it.
FORCE = 0.02  #: Deviation of a leg's force at rest, of the mean force of all.

_MOST_RATE = 512  #: Rate at which a simulation is kept [Hz]; the recording lies between.

_CLOCK = np.array([0.02, 1e-4])
"""Deviations of the clocks' offset [s] and skew [s/s] before the recordings."""

_WEIGHED = 3  #: Steps of Gauss and Newton to what is nearly linear.

Residuals = Mapping[tuple[str, str], Array]
"""By recording and channel, (samples, legs), in SI; e of what is stated as `STATED`, (n, 1)."""

STATED = "evidence of numbers", "stated"

Change = Callable[[Plant, Array], Plant]
"""A machine with so much of an effect, in sizes (1,), or (legs,) where each leg has its own."""


def minus(one: Residuals, other: Residuals, by: float = 1.0) -> Residuals:
    """Difference of two sets of residuals, over `by`."""
    return {key: (value - other[key]) / by for key, value in one.items()}


class Piece(NamedTuple):
    """A recording, ready to be simulated and compared."""

    name: str
    law: Law | None  #: That it ran; None for valve commands.
    how: Mapping[str, Any]  #: Source, start and spacing of its `Run`.
    since: Array  #: Times of the samples from the beginning of the simulation [s].
    measured: Mapping[str, Array]  #: By channel, (samples, legs).
    demand: Array  #: Of the legs, or of the valves, (samples, legs).
    rate: float  #: Of the recording [Hz].
    first: int  #: Sample from which it counts.


def piece(recording: Recording, plant: Plant, seconds: float | None = None) -> Piece:
    """Make one of a recording, or of its first `seconds`."""
    record, rate = recording.record, plant.machine.rate
    count = record.time.size if seconds is None else int(seconds * record.rate) + 1
    time = record.time[:count] - record.time[0]
    frames = np.arange(int(time[-1] * rate) + 1) / rate
    lead = round(LEAD * rate)
    driven = recording.law is None
    given = record["valve_command" if driven else "leg_reference"][:count]
    if recording.settings.kind == "step":
        rows = given[(frames * record.rate + 1e-6).astype(int)]
    else:
        rows = CubicSpline(time, given)(frames)
    rows = np.concatenate([np.repeat(given[:1] * (not driven), lead, axis=0), rows])
    begin = record["leg_position"][0] if driven else given[0]
    source = ValveCommands(np.clip(rows, -1.0, 1.0)) if driven else LegDemand(rows)
    how = {
        "source": source,
        "start": legs_to_pose(begin, plant.machine),
        "record_every": frames_a_row(plant.machine, _MOST_RATE),
        "command_delay": 0 if driven else 1,
    }
    measured = {name: record[name][:count] for name in MEASURED if name in record.channels}
    first = int(min(SETTLING[0], SETTLING[1] * record.time.size / record.rate) * record.rate)
    since = time + lead / rate
    return Piece(recording.name, recording.law, how, since, measured, given, record.rate, first)


class Rest(NamedTuple):
    """What a machine bore at rest."""

    pose: Array  #: (6,), z down [m, rad].
    force: Array  #: Of the legs, positive extending [N], (legs,).


def rests(one: Piece, plant: Plant) -> list[Rest]:
    """Where the demand of a recording with all pressures stood still for two times `REST`."""
    length, cylinders = round(REST * one.rate), plant.hydraulics.cylinder
    if one.law is None or not set(MEASURED) <= set(one.measured):
        return []
    still = STILL * plant.machine.half_stroke
    found = []
    for at in range(length, one.demand.shape[0] - length + 1, length):
        if np.ptp(one.demand[at - length : at + length], axis=0).max() < still:
            way, cap, rod = (one.measured[c][at : at + length].mean(axis=0) for c in MEASURED)
            force = cylinders.cap_area * cap - cylinders.rod_area * rod
            found.append(Rest(legs_to_pose(way, plant.machine), force))
    return found


def without_noise(chosen: ElectronicsSettings | None, machine: Machine) -> Any:
    """Electronics with neither noise nor steps of sensors, ADC and DAC."""
    if chosen is None:
        return None
    parts = chosen.of(machine)
    none = {"noise_density": None, "resolution": None}
    channels = {name: getattr(parts.sensors, name).model_copy(update=none) for name in CHANNELS}
    endless = parts.servo.dac_bits.model_copy(update={"value": 0})
    return chosen.model_copy(
        update={
            "sensors": parts.sensors.model_copy(update=channels),
            "converters": parts.converters.model_copy(update={"quantise": False}),
            "servo": parts.servo.model_copy(update={"dac_bits": endless}),
        }
    )


class Model:
    """The machine of a campaign as a function of its numbers.

    Numbers have the coordinates z = Phi^-1(u), u the quantile of what is known of each: the prior
    is then standard normal. Those of an effect, which `change` gives the machine, follow, and a
    clock's offset and skew of each recording, where asked.
    """

    change: Change

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
        self.clocks = 2 * len(campaign.of(held_back)) * campaign.settings.clocks
        self._electronics = without_noise(campaign.settings.electronics, campaign.plant.machine)
        self.top = min(top or np.inf, campaign.settings.highest)
        chosen = campaign.of(held_back)
        self.pieces = tuple(piece(one, campaign.plant, seconds) for one in chosen)
        self.evidence = campaign.evidence

    def values(self, z: Array) -> dict[str, Any]:
        """Values of the unknowns at coordinates (n,)."""
        return self.unknowns.at(stats.norm.cdf(z[: self.size]))

    def machine(self, z: Array) -> Plant:
        """The plant with these numbers, and the effect where they have those of it."""
        plant = self.unknowns.apply(self.values(z), self.plant)
        added = z[self.size : z.size - self.clocks]
        return self.change(plant, added) if added.size else plant

    def simulated(
        self, one: Piece, z: Array, machine: Plant, late: float = 0.0, gain: float = 0.0
    ) -> dict[str, Array]:
        """The channels of a recording as the `machine` of these numbers would have measured them.

        Its law and sensors have theirs. The measurement's clock is `late` [s], and gains on the
        demand's by `gain` [s/s]. Raises `OutOfBounds` as `simulate`.
        """
        values, electronics = self.values(z), self._electronics
        if electronics is not None:
            sensors = self.unknowns.apply(values, electronics.sensors)
            electronics = electronics.model_copy(update={"sensors": sensors})
        law = one.law and self.unknowns.apply(values, one.law)
        record = Run(plant=machine, law=law, electronics=electronics, **one.how).record()
        at = one.since + late + gain * (one.since - LEAD)
        return {
            name: np.asarray(CubicSpline(record.time, record[name])(at)) for name in one.measured
        }

    def residuals(self, z: Array) -> Residuals:
        """Measured less simulated below `top`.

        Raises `InputError` for numbers that no machine has, `OutOfBounds` where it leaves its own.
        """
        plant, found = self.machine(z), dict[tuple[str, str], Array]()
        clocks = _CLOCK * z[z.size - self.clocks :].reshape(-1, 2)
        for number, one in enumerate(self.pieces):
            clock = clocks[number] if self.clocks else (0.0, 0.0)
            simulated = self.simulated(one, z, plant, *clock)
            found |= {(one.name, c): left for c, left in self.compared(one, simulated).items()}
        if (stated := self.evidence.excess(self.values(z), plant)).size:
            found[STATED] = stated[:, None]
        return found

    def weighed(self) -> Array:
        """Coordinates (n,) of the numbers as the rests of all recordings weigh them, else 0."""
        held = [rest for one in self.pieces for rest in rests(one, self.plant)]
        z = np.zeros(self.size)
        if not held:
            return z
        size = FORCE * float(np.mean([rest.force for rest in held]))

        def forces(z: Array) -> Array:
            machine, found = self.machine(z), []
            for rest in held:
                machine.place(rest.pose)
                found.append(machine.static_load() / size)
            return np.ravel(found)

        measured, width = np.ravel([rest.force for rest in held]) / size, 0.1
        for _ in range(_WEIGHED):
            try:
                here, moves = forces(z), width * np.eye(z.size)
                slopes = np.stack([forces(z + move) - here for move in moves]) / width
            except InputError:  # no machine weighs so: pressures of another one
                break
            matrix = slopes @ slopes.T + np.eye(z.size)
            z = z + np.linalg.solve(matrix, slopes @ (measured - here) - z)
        return z

    def compared(self, one: Piece, simulated: Mapping[str, Array]) -> dict[str, Array]:
        """Residuals of one recording by channel, low-passed and thinned."""
        sections = signal.butter(4, min(self.top, 0.4 * one.rate), fs=one.rate, output="sos")
        every, first = round(self.spacing(one) * one.rate), one.first
        return {
            name: signal.sosfiltfilt(sections, one.measured[name] - value, axis=0)[first::every]
            for name, value in simulated.items()
        }

    def spacing(self, one: Piece) -> float:
        """Time between the samples of a recording's residuals [s]."""
        top = min(self.top, 0.4 * one.rate)
        return max(1, int(one.rate / (2.5 * top))) / one.rate
