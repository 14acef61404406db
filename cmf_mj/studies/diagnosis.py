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
from cmf_mj.studies.guide import Bench, simulate_test
from cmf_mj.studies.guide_check import Master, compare_signatures
from cmf_mj.studies.measurement import SIGNATURE_CHANNELS, signature

Array = NDArray[np.float64]

_MODEL_ERRORS = (0.01, 0.03, 0.1)  #: The values of eps.
_PRIOR_DEVIATION = 3.0  #: Deviation of a number before the check, in its own size.
_DAMPING = 0.03  #: After a step that gains nothing, then ten times it.
_HYPOTHESES, _ROUNDS, _STEPS = 4, 3, 3  #: Simulated in a round; rounds; steps of a hypothesis.
_LEAST_PROBABILITY = 0.01  #: Least probability of a cause that is listed.
_PRIOR_NONE, _PRIOR_ONE, _PRIOR_TWO = 0.05, 0.7, 0.25  #: Of no, one and two numbers, together.


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
    """The numbers that a diagnosis tries."""
    load = float(np.abs(plant.static_load()).max())
    friction = max(plant.parameters.coulomb_friction.si, 0.01 * load)
    reach = 0.05 * float(plant.machine.geometry.upper[:, :2].max())
    offset = 0.002 * plant.machine.half_stroke
    numbers = []
    for i in range(1, plant.legs + 1):
        actuator = f"hydraulics.actuators.leg_{i}"
        gain = f"electronics.leg_position.gain_errors.{i}"
        numbers += [
            Number(f"valve gain of leg_{i}", f"{actuator}.valve_gain", 0.05),
            Number(f"seal of leg_{i}", f"{actuator}.leakage", 0.5),
            Number(f"position gain of leg_{i}", gain, 0.005, "%"),
            Number(f"position offset of leg_{i}", f"offset.{i}", offset, "mm"),
        ]
    numbers += [
        Number("oil stiffness", "hydraulics.bulk_modulus", 0.1),
        Number("drive lag", "hydraulics.drive_lag", 0.05),
        Number("valve lag", "hydraulics.valve_lag", 0.1),
        Number("supply pressure", "hydraulics.supply", 0.05),
        Number("friction", "hydraulics.friction", friction, "N"),
        Number("payload mass", "cab.mass", 0.05),
        *(Number(f"payload place {x}", f"cab.centre_of_mass.{x}", reach, "mm") for x in "xyz"),
    ]
    return tuple(numbers)


Sizes = Mapping[Number, float]  #: Theta of numbers that moved.


def moved_machine(plant: Hexapod, electronics: ElectronicsSettings, sizes: Sizes) -> dict[str, Any]:
    """A machine with numbers moved, as `simulate_test` takes it."""
    unknowns, values, shift = Unknowns(), {}, np.zeros(plant.legs)
    for number, theta in sizes.items():
        change, effect = number.moved(theta), "offset" if number.unit else "factor"
        if number.path.startswith("offset."):
            leg = int(number.path.removeprefix("offset."))
            shift[leg - 1] = change
            continue
        if number.name == "friction":
            change, effect = max(plant.parameters.coulomb_friction.si + change, 0.0), "value"
        table: dict[str, Any] = {"effect": effect, "unit": number.unit or "1"}
        table |= {"low": 0.0, "high": 1e9, "source": "tried"}
        unknowns[number.name] = Unknown(path=number.path, **table)
        values[number.name] = change
    sensors = unknowns.apply(values, electronics.of(plant.machine).sensors)
    return {
        "plant": unknowns.apply(values, plant) if values else plant,
        "electronics": electronics.model_copy(update={"sensors": sensors}),
        "shift": shift,
    }


class Slopes(NamedTuple):
    """The signatures of a guide's machine, and how its numbers move them."""

    bench: Bench
    numbers: tuple[Number, ...]
    tests: tuple[str, ...]
    channels: tuple[str, ...]
    base: Array  #: Signatures of the guide's machine, (n,).
    by_theta: Array  #: Slopes of the signatures, (n, numbers).

    def signatures(self, sizes: Sizes) -> Array | None:
        """Signatures of a machine without noise, (n,); None where it leaves its bounds."""
        bench = self.bench
        electronics = without_noise(ElectronicsSettings(), bench.plant.machine)
        rows = []
        try:
            machine = moved_machine(bench.plant, electronics, sizes)
            for test in self.tests:
                record = simulate_test(bench, test, **machine)
                lines = bench.lines(test, record.rate)
                rows.append(signature(record, lines, self.channels).ravel())
        except (InputError, RunError):
            return None
        return np.concatenate(rows)


def find_slopes(
    master: Master,
    jobs: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    numbers: Sequence[Number] = (),
) -> Slopes:
    """Simulate the tests that are `diagnosed`, once for each number, default `numbers_of`."""
    bench = master.bench
    recorded_tests = [name for name in bench.commands if name in master.records]
    tests = tuple(name for name in recorded_tests if bench.tests[name].diagnosed)
    if not tests:
        raise InputError("tests: none is `diagnosed`; allowed: one at least, that was recorded")
    recorded_channels = set.intersection(*({*master.records[test][0].channels} for test in tests))
    channels = tuple(name for name in SIGNATURE_CHANNELS if name in recorded_channels)
    numbers = tuple(numbers) or numbers_of(bench.plant)
    template = Slopes(bench, numbers, tests, channels, np.empty(0), np.empty(0))
    cases: list[Sizes] = [{}, *({number: 1.0} for number in numbers)]
    base, *moved = on_threads(template.signatures, cases, jobs, progress)
    if base is None:
        raise InputError(f"{master.folder}: its machine leaves its bounds in the simulation")
    pairs = zip(numbers, moved, strict=True)
    changes = {number: row - base for number, row in pairs if row is not None}
    by_theta = np.stack([*changes.values()], axis=1)
    return template._replace(numbers=tuple(changes), base=base, by_theta=by_theta)


class _Fit(NamedTuple):
    """A hypothesis fitted."""

    indices: tuple[int, ...]  #: Of its numbers among those tried.
    theta: Array
    residual: float  #: Mean of z_H^2.
    is_simulated: bool


class _Problem:
    """Differences of signatures that numbers are to explain."""

    def __init__(self, slopes: Slopes, z: Array, deviation: Array) -> None:
        """Take differences over their deviations, and those, (n,)."""
        self.slopes, self.z, self.deviation = slopes, z, deviation
        self.slope = slopes.by_theta / deviation[:, None]
        self.independent = len(slopes.tests) * len(slopes.channels) * slopes.bench.plant.legs
        self.gram = self.slope.T @ self.slope / z.size
        self.projection, self.mean = self.slope.T @ z / z.size, float(z @ z) / z.size

    def fit_linear(self, indices: tuple[int, ...]) -> _Fit:
        """Fit a hypothesis, that the numbers with these indices moved, by the slopes."""
        curvature, projection = self.gram[np.ix_(indices, indices)], self.projection[list(indices)]
        theta = np.linalg.solve(curvature + 1e-9 * self.mean * np.eye(len(indices)), projection)
        residual = float(self.mean - 2.0 * theta @ projection + theta @ curvature @ theta)
        return _Fit(indices, np.asarray(theta, float), max(residual, 0.0), False)

    def fit_simulated(self, indices: tuple[int, ...]) -> _Fit:
        """The same, simulated at each step of its fit."""
        numbers = [self.slopes.numbers[i] for i in indices]
        theta, z, slope = np.zeros(len(indices)), self.z, self.slope[:, list(indices)]
        damping = 0.0
        for _ in range(_STEPS):
            weight = self.independent / (z.size + _MODEL_ERRORS[-1] ** 2 * float(z @ z))
            curvature = weight * slope.T @ slope + np.eye(theta.size) / _PRIOR_DEVIATION**2
            gradient = weight * slope.T @ z - theta / _PRIOR_DEVIATION**2
            step = np.linalg.solve(curvature + damping * np.diag(np.diag(curvature)), gradient)
            if not step.any():  # at its bound a number moves nothing
                break
            sizes = dict(zip(numbers, (theta + step).tolist(), strict=True))
            signatures = self.slopes.signatures(sizes)
            damping = max(10.0 * damping, _DAMPING)
            if signatures is not None:
                new_z = self.z - (signatures - self.slopes.base) / self.deviation
                missed = z - new_z - slope @ step
                slope = slope + np.outer(missed, step) / float(step @ step)
                if float(new_z @ new_z) < float(z @ z):
                    theta, z, damping = theta + step, new_z, 0.0
        return _Fit(indices, np.asarray(theta), float(z @ z) / z.size, True)

    def log_likelihood(self, fit: _Fit) -> float:
        """Ln L_H, without the part that all hypotheses have."""
        v = 1.0 + np.square(_MODEL_ERRORS) * self.mean
        gram = self.gram[np.ix_(fit.indices, fit.indices)]
        curvature = _PRIOR_DEVIATION**2 * self.independent * gram
        _, volume = np.linalg.slogdet(np.eye(len(fit.indices)) + curvature / v[:, None, None])
        terms = -0.5 * (self.independent * (np.log(v) + fit.residual / v) + volume)
        terms -= 0.5 * float(fit.theta @ fit.theta) / _PRIOR_DEVIATION**2
        return float(special.logsumexp(terms))


class Cause(NamedTuple):
    """What may have changed."""

    numbers: str
    probability: Annotated[float, Field(form=".3f")]
    size: str
    left: Annotated[float, Field("", "left over", ".2g")]
    """Root mean square of what it does not explain, over that of all."""


def diagnose(master: Master, new: Master, slopes: Slopes, jobs: int | None = None) -> list[Cause]:
    """Causes of a change, the most probable first; improbable ones are not listed."""
    difference, deviation = _differences(master, new, slopes)
    problem = _Problem(slopes, difference / deviation, deviation)
    singles = [(i,) for i in range(len(slopes.numbers))]
    pairs = list(combinations(range(len(slopes.numbers)), 2))
    prior_of_single, prior_of_pair = _PRIOR_ONE / len(singles), _PRIOR_TWO / max(1, len(pairs))

    def log_posterior(fit: _Fit) -> float:
        prior = prior_of_single if len(fit.indices) == 1 else prior_of_pair
        return problem.log_likelihood(fit) + np.log(prior / len(_MODEL_ERRORS))

    fits = {indices: problem.fit_linear(indices) for indices in (*singles, *pairs)}
    for _ in range(_ROUNDS):
        ranked = sorted(fits.values(), key=log_posterior, reverse=True)[:_HYPOTHESES]
        if all(fit.is_simulated for fit in ranked[:3]):
            break
        ranked += sorted((fits[i] for i in singles), key=lambda fit: fit.residual)[:_HYPOTHESES]
        indices = sorted({fit.indices for fit in ranked if not fit.is_simulated})
        fits |= {fit.indices: fit for fit in on_threads(problem.fit_simulated, indices, jobs)}
    ranked = sorted(fits.values(), key=log_posterior, reverse=True)
    v = 1.0 + problem.mean
    log_none = -0.5 * problem.independent * (np.log(v) + problem.mean / v) + np.log(_PRIOR_NONE)
    chance_of_none, *chances = map(float, special.softmax([log_none, *map(log_posterior, ranked)]))
    rows = [Cause("none of these", chance_of_none, "", 1.0)]
    for fit, chance in zip(ranked, chances, strict=True):
        numbers = [slopes.numbers[i] for i in fit.indices]
        sizes = [number.text(theta) for number, theta in zip(numbers, fit.theta, strict=True)]
        names, share = " and ".join(n.name for n in numbers), np.sqrt(fit.residual / problem.mean)
        rows.append(Cause(names, chance, ", ".join(sizes), float(share)))
    rows.sort(key=lambda row: -row.probability)
    return [row for row in rows if row.probability > _LEAST_PROBABILITY or row is rows[0]]


def _differences(master: Master, new: Master, slopes: Slopes) -> tuple[Array, Array]:
    """Differences of the signatures and their deviations, in the order of the slopes."""
    differences, deviations = [], []
    for test in slopes.tests:
        if test not in new.records:
            raise InputError(f"{new.folder}: {test}: was left out; a diagnosis needs it")
        for channel in slopes.channels:
            if channel not in new.records[test][0].channels:
                raise InputError(f"{new.folder}: {test}: {channel}: is missing; the master has it")
        change = compare_signatures(master, new, test, slopes.channels)
        differences.append(change.difference.ravel())
        deviations.append(np.broadcast_to(change.deviation, change.difference.shape).ravel())
    return np.concatenate(differences), np.concatenate(deviations)
