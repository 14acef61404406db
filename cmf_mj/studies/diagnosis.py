"""Why a machine has changed since the master of a guide, most probably.

With z the differences of its signatures over their deviations, a their root mean square, and z_H
what a hypothesis H, one number of the machine or two, leaves of them after its fit,

    ln L_H = ln mean over eps of v^(-K/2) exp(-K mean(z_H^2) / 2 v - theta^2 / 2 s^2) / sqrt(det C)

with v = 1 + eps^2 a^2, eps = 0.01, 0.03, 0.1 how far a model is off in proportion, K as many
independent numbers as there are tests, channels and legs, s the deviation of a number before the
check, C = 1 + s^2 A^T A K / n v with the slopes A (n, p). None of these is a change of any form:
v = 1 + a^2, nothing fitted. Slopes come from one short simulation a number about the guide's
machine, or about one that was fitted to the master, all numbers together, where that explains the
master better; what looks most probable is then simulated at its own numbers and fitted again.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

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
_FITTED, _DAMPED = 6, (0.0, 0.03, 0.3, 3.0)  # steps to the master, and their dampings
_TRIED, _ROUNDS, _AGAIN = 4, 3, 3  # hypotheses that are simulated, rounds, times each
_SHOWN = 0.01  # least probability of a cause that is listed
_PRIOR = {0: 0.05, 1: 0.7, 2: 0.25}  # of none of these, of one number, of two, together


class Number(NamedTuple):
    """A number of a machine that may move, by its size theta."""

    name: str
    path: str  #: Of an unknown; `offset.N` of a position sensor.
    step: float  #: What theta = 1 is: exp(step) times, or so much more in SI.
    factor: bool = True


def numbers_of(plant: Hexapod) -> tuple[Number, ...]:
    """What a diagnosis tries."""
    oil, weight = plant.parameters, float(np.abs(plant.static_load()).max())
    reach = 0.05 * float(plant.machine.geometry.upper[:, :2].max())
    legs = [f"leg_{i + 1}" for i in range(plant.legs)]
    each = [
        ("valve gain of {leg}", "hydraulics.actuators.{leg}.valve_gain", 0.05, True),
        ("seal of {leg}", "hydraulics.actuators.{leg}.leakage", 0.5, True),
        ("position gain of {leg}", "electronics.leg_position.gain_errors.{i}", 0.005, False),
        ("position offset of {leg}", "offset.{i}", 0.002 * plant.machine.half_stroke, False),
    ]
    found = [
        Number(name.format(leg=leg), path.format(leg=leg, i=i), step, factor)
        for name, path, step, factor in each
        for i, leg in enumerate(legs, start=1)
    ]
    friction = max(oil.coulomb_friction.si, 0.01 * weight)
    found += [
        Number("oil stiffness", "hydraulics.bulk_modulus", 0.1),
        Number("drive lag", "hydraulics.drive_lag", 0.05),
        Number("valve lag", "hydraulics.valve_lag", 0.1),
        Number("supply pressure", "hydraulics.supply", 0.05),
        Number("friction", "hydraulics.friction", friction, False),
        Number("payload mass", "cab.mass", 0.05),
        *(Number(f"payload place {x}", f"cab.centre_of_mass.{x}", reach, False) for x in "xyz"),
    ]
    return tuple(found)


Moved = Mapping[Number, float]  #: Sizes theta of numbers.


def moved_machine(plant: Hexapod, electronics: ElectronicsSettings, moved: Moved) -> dict[str, Any]:
    """A machine with numbers moved, as `simulated` takes it."""
    known, values, shift = Unknowns(), {}, np.zeros(plant.legs)
    for one, theta in moved.items():
        size = float(np.exp(one.step * theta)) if one.factor else one.step * theta
        if one.path.startswith("offset."):
            shift[int(one.path[-1]) - 1] = size
            continue
        how: dict[str, Any] = {"low": 1e-9, "high": 1e9, "unit": "1"}
        if one.path == "hydraulics.friction":
            size = max(plant.parameters.coulomb_friction.si + size, 0.0)
            how = {"effect": "value", "low": 0.0, "high": 1e9, "unit": "N"}
        elif not one.factor:
            how["effect"] = "offset"
        known[one.name], values[one.name] = Unknown(path=one.path, source="tried", **how), size
    parts = electronics.of(plant.machine)
    sensors = known.apply(values, parts.sensors)
    changed = known.apply(values, plant) if values else plant
    return {
        "plant": changed,
        "electronics": electronics.model_copy(update={"sensors": sensors}),
        "shift": shift,
    }


class Slopes(NamedTuple):
    """The signatures of a guide's machine, and how its numbers move them."""

    numbers: tuple[Number, ...]
    tests: tuple[str, ...]
    channels: tuple[str, ...]
    base: Array  #: (n,).
    slope: Array  #: By theta, (n, numbers).
    start: Moved = MappingProxyType({})  #: The numbers of the machine about which.

    def at(self, on: Bench, moved: Moved) -> Array | None:
        """Signatures of a machine without noise, (n,); None where it leaves its bounds."""
        electronics = without_noise(ElectronicsSettings(), on.plant.machine)
        every = {**self.start, **{k: self.start.get(k, 0.0) + x for k, x in moved.items()}}
        try:
            machine = moved_machine(on.plant, electronics, every)
            found = []
            for name in self.tests:
                record = simulated(on, name, **machine)
                signs = signature(record, on.lines(name, record.rate))
                found += [signs[channel].ravel() for channel in self.channels]
        except (InputError, RunError):
            return None
        return np.concatenate(found)


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
    held = set.intersection(*({*master.records[t][0].channels} for t in tests)) & {*SIGNED}
    made = Slopes(
        tuple(numbers) or numbers_of(on.plant), tests, tuple(sorted(held)), np.empty(0), np.empty(0)
    )
    made = _sloped(master, made, jobs, progress)
    start = _start(master, made)
    return _sloped(master, made._replace(start=start), jobs, progress) if start else made


def _sloped(
    master: Master, made: Slopes, jobs: int | None, progress: Callable[[int, int], None] | None
) -> Slopes:
    """Slopes about the machine where they start."""
    cases: list[Moved] = [{}, *({one: 1.0} for one in made.numbers)]
    base, *rows = on_threads(lambda moved: made.at(master.bench, moved), cases, jobs, progress)
    if base is None:
        raise InputError(f"{master.folder}: its machine leaves its bounds in the simulation")
    kept = [(one, row) for one, row in zip(made.numbers, rows, strict=True) if row is not None]
    slope = np.stack([row - base for _, row in kept], axis=1)
    return made._replace(numbers=tuple(one for one, _ in kept), base=base, slope=slope)


def _start(master: Master, made: Slopes) -> Moved:
    """Numbers fitted to the master, each off by about 1; none where they explain less than half.

    What is not explained weighs as in a diagnosis, so that what shows little moves little.
    """
    _, deviation = _differences(master, master, made)
    means = [
        np.mean([signature(r, master.bench.lines(name, r.rate))[c] for r in records], axis=0)
        for name, records in ((name, master.records[name]) for name in made.tests)
        for c in made.channels
    ]
    rest = first = (np.concatenate([mean.ravel() for mean in means]) - made.base) / deviation
    local, theta, found = made.slope / deviation[:, None], np.zeros(len(made.numbers)), {}
    share = len(made.tests) * len(made.channels) * master.bench.plant.legs / first.size
    for _ in range(_FITTED):
        weight = share / (1.0 + _OFF[-1] ** 2 * float(rest @ rest) / rest.size)
        inner = weight * local.T @ local + np.eye(theta.size)
        along = weight * local.T @ rest - theta
        better = False
        for damping in _DAMPED:
            step = np.linalg.solve(inner + damping * np.diag(np.diag(inner)), along)
            moved = dict(zip(made.numbers, map(float, theta + step), strict=True))
            there = made.at(master.bench, moved)
            if there is None:
                continue
            after = first - (there - made.base) / deviation
            local = local + np.outer(rest - after - local @ step, step) / float(step @ step)
            if better := bool(np.linalg.norm(after) < np.linalg.norm(rest)):
                theta, rest, found = theta + step, after, moved
                break
        if not better:
            break
    return found if np.linalg.norm(rest) < 0.5 * np.linalg.norm(first) else {}


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
    z, slope = off / deviation, known.slope / deviation[:, None]
    gram, along, size = slope.T @ slope, slope.T @ z, float(z @ z)
    count = len(known.tests) * len(known.channels) * master.bench.plant.legs
    places = range(len(known.numbers))
    every: list[tuple[int, ...]] = [(i,) for i in places]
    every += combinations(places, 2)
    prior = {1: _PRIOR[1] / len(places), 2: _PRIOR[2] / max(1, len(every) - len(places))}

    def likelihood(one: _Fit) -> float:
        inner = gram[np.ix_(one.places, one.places)] * count / z.size
        parts = []
        for eps in _OFF:
            v = 1.0 + eps**2 * size / z.size
            spread = np.eye(len(one.places)) + _WIDE**2 * inner / v
            parts.append(
                -0.5 * count * (np.log(v) + one.left / v)
                - 0.5 * float(one.theta @ one.theta) / _WIDE**2
                - 0.5 * float(np.linalg.slogdet(spread)[1])
            )
        return float(special.logsumexp(parts)) - np.log(len(_OFF)) + np.log(prior[len(one.places)])

    def linear(places: tuple[int, ...]) -> _Fit:
        inner = gram[np.ix_(places, places)] + 1e-9 * size * np.eye(len(places))
        theta = np.linalg.solve(inner, along[list(places)])
        left = (
            size - 2.0 * theta @ along[list(places)] + theta @ gram[np.ix_(places, places)] @ theta
        )
        return _Fit(places, np.array(theta, float), max(float(left), 0.0) / z.size, False)

    def simulate(one: _Fit) -> _Fit:
        found, theta, local = [], one.theta, slope[:, list(one.places)]
        for _ in range(_AGAIN):
            moved = {known.numbers[i]: float(x) for i, x in zip(one.places, theta, strict=True)}
            there = known.at(master.bench, moved)
            if there is None:
                break
            reached = (there - known.base) / deviation
            rest = z - reached
            found.append(
                _Fit(one.places, np.array(theta, float), float(rest @ rest) / z.size, True)
            )
            local = local + np.outer(reached - local @ theta, theta) / float(theta @ theta)
            theta = theta + np.linalg.lstsq(local, rest, rcond=None)[0]
        best = min(found, key=lambda fit: fit.left, default=None)
        return best or one._replace(left=size / z.size, seen=True)

    fits = {places: linear(places) for places in every}
    for _ in range(_ROUNDS):
        ranked = sorted(fits.values(), key=likelihood, reverse=True)[:_TRIED]
        if all(one.seen for one in ranked[:3]):
            break
        ranked += sorted((fits[(i,)] for i in places), key=lambda fit: fit.left)[:_TRIED]
        again = {one.places: one for one in ranked if not one.seen}
        fits |= {fit.places: fit for fit in on_threads(simulate, list(again.values()), jobs)}
    v = 1.0 + size / z.size
    none = -0.5 * count * (np.log(v) + (v - 1.0) / v) + np.log(_PRIOR[0])
    ranked = sorted(fits.values(), key=likelihood, reverse=True)
    chances = special.softmax([none, *map(likelihood, ranked)])
    total = np.sqrt(size / z.size)
    rows = [Cause("none of these", float(chances[0]), "", 1.0)]
    for one, chance in zip(ranked, chances[1:], strict=True):
        named = [known.numbers[i] for i in one.places]
        text = ", ".join(_size(number, x) for number, x in zip(named, one.theta, strict=True))
        left = float(np.sqrt(one.left) / total)
        rows.append(Cause(" and ".join(x.name for x in named), float(chance), text, left))
    rows.sort(key=lambda row: -row.probability)
    return [row for row in rows if row.probability > _SHOWN or row is rows[0]]


def _differences(master: Master, new: Master, known: Slopes) -> tuple[Array, Array]:
    """Differences of the signatures and their deviations, in the order of the slopes."""
    off, deviation = [], []
    for name in known.tests:
        if name not in new.records:
            raise InputError(f"{new.folder}: {name}: was aborted; a diagnosis needs it")
        one = signed(master, new, name)
        for channel in known.channels:
            if channel not in one.difference:
                raise InputError(f"{new.folder}: {name}: {channel}: is missing; the master has it")
            off.append(one.difference[channel].ravel())
            wide = np.broadcast_to(one.deviation[channel], one.difference[channel].shape)
            deviation.append(wide.ravel())
    return np.concatenate(off), np.concatenate(deviation)


def _size(one: Number, theta: float) -> str:
    """How far a number moved."""
    if one.factor:
        return f"{100.0 * np.expm1(one.step * theta):+.1f} %"
    value = one.step * theta
    if "gain" in one.name:
        return f"{100.0 * value:+.2f} %"
    return f"{value:+.0f} N" if one.name == "friction" else f"{1e3 * value:+.2f} mm"
