"""Why a machine has changed since the master of a guide, most probably.

With z the differences of its signatures over their deviations, a their root mean square, and z_H
what a hypothesis H, one number of the machine or two, leaves of them after its fit,

    ln L_H = ln mean over eps of v^(-K/2) exp(-K mean(z_H^2) / 2 v - theta^2 / 2 s^2) / sqrt(det C)

with v = 1 + eps^2 a^2, eps = 0.01, 0.03, 0.1 how far a model is off in proportion, K as many
independent numbers as there are tests, channels and legs, s the deviation of a number before the
check, C = 1 + s^2 A^T A K / n v with the slopes A (n, p). None of these is a change of any form:
v = 1 + a^2, nothing fitted. Slopes come from one short simulation a number about the guide's
machine; what looks most probable is then simulated at its own numbers and fitted: by steps of Gauss
and Newton with K / n v times A^T A + s^-2, damped by Levenberg and Marquardt where they do not
gain, and with Broyden's update of the slopes.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from cmf_mj.core import units
from cmf_mj.core.errors import InputError, RunError
from cmf_mj.core.result import Field
from cmf_mj.core.threads import on_threads
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.unknown import Unknown
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.studies.fit.model import without_noise
from cmf_mj.studies.guide import Bench, simulated
from cmf_mj.studies.guide_check import Master, signed
from cmf_mj.studies.measurement import SIGNED, signature

Array = NDArray[np.float64]

_OFF = (0.01, 0.03, 0.1)  # eps
_WIDE = 3.0  # deviation of a number before the check, in its own size
_DAMPED = 0.03  # damping after a step that gains nothing, then ten times it
_TRIED, _ROUNDS, _STEPS = 4, 3, 3  # hypotheses that are simulated, rounds, steps of each
_SHOWN = 0.01  # least probability of a cause that is listed
_PRIOR = {0: 0.05, 1: 0.7, 2: 0.25}  # of none of these, of one number, of two, together


class Number(NamedTuple):
    """A number of a machine that may move, by its size theta."""

    name: str
    path: str  #: Of an unknown; `offset.N` of a position sensor.
    step: float  #: What theta = 1 is: exp(step) times, or so much more in SI.
    unit: str = ""  #: In which it is printed; empty for a factor.

    def moved(self, theta: float) -> float:
        """The factor, or what is added in SI."""
        return self.step * theta if self.unit else float(np.exp(self.step * theta))

    def text(self, theta: float) -> str:
        """How far it moved."""
        if not self.unit:
            return f"{100.0 * (self.moved(theta) - 1.0):+.1f} %"
        return f"{units.from_si(self.unit, self.moved(theta)):+.3g} {self.unit}"


def numbers_of(plant: Hexapod) -> tuple[Number, ...]:
    """What a diagnosis tries."""
    oil, weight = plant.parameters, float(np.abs(plant.static_load()).max())
    reach = 0.05 * float(plant.machine.geometry.upper[:, :2].max())
    friction = max(oil.coulomb_friction.si, 0.01 * weight)
    found = []
    for i in range(1, plant.legs + 1):
        own = f"hydraulics.actuators.leg_{i}"
        gain = f"electronics.leg_position.gain_errors.{i}"
        offset = 0.002 * plant.machine.half_stroke
        found += [
            Number(f"valve gain of leg_{i}", f"{own}.valve_gain", 0.05),
            Number(f"seal of leg_{i}", f"{own}.leakage", 0.5),
            Number(f"position gain of leg_{i}", gain, 0.005, "%"),
            Number(f"position offset of leg_{i}", f"offset.{i}", offset, "mm"),
        ]
    found += [
        Number("oil stiffness", "hydraulics.bulk_modulus", 0.1),
        Number("drive lag", "hydraulics.drive_lag", 0.05),
        Number("valve lag", "hydraulics.valve_lag", 0.1),
        Number("supply pressure", "hydraulics.supply", 0.05),
        Number("friction", "hydraulics.friction", friction, "N"),
        Number("payload mass", "cab.mass", 0.05),
        *(Number(f"payload place {x}", f"cab.centre_of_mass.{x}", reach, "mm") for x in "xyz"),
    ]
    return tuple(found)


Moved = Mapping[Number, float]  #: Sizes theta of numbers.


def moved_machine(plant: Hexapod, electronics: ElectronicsSettings, moved: Moved) -> dict[str, Any]:
    """A machine with numbers moved, as `simulated` takes it."""
    known, values, shift = Unknowns(), {}, np.zeros(plant.legs)
    for one, theta in moved.items():
        size, effect = one.moved(theta), "offset" if one.unit else "factor"
        if one.path.startswith("offset."):
            shift[int(one.path[-1]) - 1] = size
            continue
        if one.name == "friction":
            size, effect = max(plant.parameters.coulomb_friction.si + size, 0.0), "value"
        how: dict[str, Any] = {"effect": effect, "unit": one.unit or "1", "low": 0.0, "high": 1e9}
        known[one.name], values[one.name] = Unknown(path=one.path, source="tried", **how), size
    sensors = known.apply(values, electronics.of(plant.machine).sensors)
    return {
        "plant": known.apply(values, plant) if values else plant,
        "electronics": electronics.model_copy(update={"sensors": sensors}),
        "shift": shift,
    }


class Slopes(NamedTuple):
    """The signatures of a guide's machine, and how its numbers move them."""

    on: Bench
    numbers: tuple[Number, ...]
    tests: tuple[str, ...]
    channels: tuple[str, ...]
    base: Array  #: (n,).
    slope: Array  #: By theta, (n, numbers).

    def at(self, moved: Moved) -> Array | None:
        """Signatures of a machine without noise, (n,); None where it leaves its bounds."""
        on = self.on
        electronics = without_noise(ElectronicsSettings(), on.plant.machine)
        try:
            how = moved_machine(on.plant, electronics, moved)
            records = [(name, simulated(on, name, **how)) for name in self.tests]
        except (InputError, RunError):
            return None
        lines = [on.lines(name, record.rate) for name, record in records]
        every = zip(records, lines, strict=True)
        return np.concatenate([signature(r, line, self.channels).ravel() for (_, r), line in every])


def slopes(
    master: Master,
    jobs: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    numbers: Sequence[Number] = (),
) -> Slopes:
    """Simulate the tests that are `diagnosed`, once for each number, default `numbers_of`."""
    on = master.bench
    tests = tuple(t for t in on.commands if on.of[t].diagnosed and t in master.records)
    if not tests:
        raise InputError("tests: none is `diagnosed`; allowed: one at least, that was recorded")
    held = [{*master.records[test][0].channels} for test in tests]
    channels = tuple(name for name in SIGNED if all(name in one for one in held))
    tried = tuple(numbers) or numbers_of(on.plant)
    made = Slopes(on, tried, tests, channels, np.empty(0), np.empty(0))
    cases: list[Moved] = [{}, *({one: 1.0} for one in tried)]
    base, *rows = on_threads(lambda moved: made.at(moved), cases, jobs, progress)
    if base is None:
        raise InputError(f"{master.folder}: its machine leaves its bounds in the simulation")
    kept = [(one, row) for one, row in zip(tried, rows, strict=True) if row is not None]
    slope = np.stack([row - base for _, row in kept], axis=1)
    return made._replace(numbers=tuple(one for one, _ in kept), base=base, slope=slope)


class _Problem(NamedTuple):
    """Differences of signatures that numbers are to explain."""

    known: Slopes
    z: Array  #: Over their deviations, (n,).
    deviation: Array  #: (n,).

    @property
    def independent(self) -> int:
        """K, the independent numbers."""
        return len(self.known.tests) * len(self.known.channels) * self.known.on.plant.legs

    @property
    def slope(self) -> Array:
        """Of z, (n, numbers)."""
        return self.known.slope / self.deviation[:, None]

    def fitted(self, places: tuple[int, ...]) -> "_Fit":
        """A hypothesis, the numbers at these places moved, simulated and fitted."""
        numbers = [self.known.numbers[i] for i in places]
        theta, left, slope = np.zeros(len(places)), self.z, self.slope[:, list(places)]
        damping = 0.0
        for _ in range(_STEPS):
            before = float(left @ left)
            weight = self.independent / (self.z.size + _OFF[-1] ** 2 * before)
            inner = weight * slope.T @ slope + np.eye(theta.size) / _WIDE**2
            gradient = weight * slope.T @ left - theta / _WIDE**2
            step = np.linalg.solve(inner + damping * np.diag(np.diag(inner)), gradient)
            if not step.any():  # at its bound a number moves nothing
                break
            moved = map(float, theta + step)
            there = self.known.at(dict(zip(numbers, moved, strict=True)))
            damping = max(10.0 * damping, _DAMPED)
            if there is not None:
                after = self.z - (there - self.known.base) / self.deviation
                missed = left - after - slope @ step
                slope = slope + np.outer(missed, step) / float(step @ step)
                if float(after @ after) < before:
                    theta, left, damping = theta + step, after, 0.0
        return _Fit(places, np.asarray(theta), float(left @ left) / left.size, True)


class Cause(NamedTuple):
    """What may have changed."""

    numbers: str
    probability: Annotated[float, Field(form=".3f")]
    size: str
    left: Annotated[float, Field("", "left over", ".2g")]
    """Root mean square of what it does not explain, over that of all."""


class _Fit(NamedTuple):
    """A hypothesis fitted."""

    places: tuple[int, ...]  #: Of its numbers.
    theta: Array
    left: float  #: Mean square of what it leaves.
    seen: bool  #: Whether it was simulated.


def diagnose(master: Master, new: Master, known: Slopes, jobs: int | None = None) -> list[Cause]:
    """Causes of a change, the most probable first; of those that no probability adds to none."""
    off, deviation = _differences(master, new, known)
    problem = _Problem(known, off / deviation, deviation)
    z, slope, count = problem.z, problem.slope, problem.independent
    gram, along, mean = slope.T @ slope / z.size, slope.T @ z / z.size, float(z @ z) / z.size
    places = range(len(known.numbers))
    every: list[tuple[int, ...]] = [(i,) for i in places]
    every += combinations(places, 2)
    prior = {1: _PRIOR[1] / len(places), 2: _PRIOR[2] / max(1, len(every) - len(places))}

    def likelihood(one: _Fit) -> float:
        v = 1.0 + np.square(_OFF) * mean
        inner = _WIDE**2 * count * gram[np.ix_(one.places, one.places)]
        volume = np.linalg.slogdet(np.eye(len(one.places)) + inner / v[:, None, None])[1]
        parts = -0.5 * (count * (np.log(v) + one.left / v) + volume)
        parts -= 0.5 * float(one.theta @ one.theta) / _WIDE**2
        return float(special.logsumexp(parts)) + np.log(prior[len(one.places)] / len(_OFF))

    def linear(places: tuple[int, ...]) -> _Fit:
        inner, b = gram[np.ix_(places, places)], along[list(places)]
        theta = np.linalg.solve(inner + 1e-9 * mean * np.eye(len(places)), b)
        left = float(mean - 2.0 * theta @ b + theta @ inner @ theta)
        return _Fit(places, np.asarray(theta, float), max(left, 0.0), False)

    fits = {places: linear(places) for places in every}
    for _ in range(_ROUNDS):
        ranked = sorted(fits.values(), key=likelihood, reverse=True)[:_TRIED]
        if all(one.seen for one in ranked[:3]):
            break
        ranked += sorted((fits[(i,)] for i in places), key=lambda fit: fit.left)[:_TRIED]
        again = {one.places for one in ranked if not one.seen}
        fits |= {fit.places: fit for fit in on_threads(problem.fitted, sorted(again), jobs)}
    ranked = sorted(fits.values(), key=likelihood, reverse=True)
    none = -0.5 * count * (np.log(1.0 + mean) + mean / (1.0 + mean)) + np.log(_PRIOR[0])
    chance, *chances = map(float, special.softmax([none, *map(likelihood, ranked)]))
    rows = [Cause("none of these", chance, "", 1.0)]
    for one, chance in zip(ranked, chances, strict=True):
        named = [known.numbers[i] for i in one.places]
        text = ", ".join(x.text(theta) for x, theta in zip(named, one.theta, strict=True))
        names, left = " and ".join(x.name for x in named), float(np.sqrt(one.left / mean))
        rows.append(Cause(names, chance, text, left))
    rows.sort(key=lambda row: -row.probability)
    return [row for row in rows if row.probability > _SHOWN or row is rows[0]]


def _differences(master: Master, new: Master, known: Slopes) -> tuple[Array, Array]:
    """Differences of the signatures and their deviations, in the order of the slopes."""
    off, deviation = [], []
    for name in known.tests:
        if name not in new.records:
            raise InputError(f"{new.folder}: {name}: was left out; a diagnosis needs it")
        for channel in known.channels:
            if channel not in new.records[name][0].channels:
                raise InputError(f"{new.folder}: {name}: {channel}: is missing; the master has it")
        one = signed(master, new, name, known.channels)
        off.append(one.difference.ravel())
        deviation.append(np.broadcast_to(one.deviation, one.difference.shape).ravel())
    return np.concatenate(off), np.concatenate(deviation)
