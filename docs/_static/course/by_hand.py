"""One leg by hand: the closed form of the lesson *Why does the simulator shake in surge*.

A mass on its oil spring, an actuator with the lag of its drive, a law with gains on position,
acceleration and force:

    (1 + tau s)(s + rate s^2 / w^2 + s^3 / w^2) x + S s^2 x + K (x - r) = 0
    w^2 = stiffness / mass, K = speed gain, S = speed (acceleration + load mass)

The page with sliders, leg.html, has it in JavaScript. `mark` marks the exercises of the lessons, 1
to 6, 7 to 9 and 10 to 12: it computes what is right, so do not read it before you have your own
numbers.
"""

from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from cmf_mj import Hexapod, load_hydraulics, load_law
from cmf_mj.core.units import INCH, RATE
from cmf_mj.machine.kinematics import leg_jacobian

Array = NDArray[np.float64]

LBM = 0.45359237  #: Of a pound [kg].


class Given(NamedTuple):
    """What the sliders set, beside the mass, and what is fixed."""

    stiffness: float  #: Of the oil of a leg, beta (A_c + A_r) / h [N/m].
    speed: float  #: Of the leg for one per cent of command [in/s/%].
    gain: float  #: Of the law on the position of a leg at rest [%/in].
    acceleration: float  #: Of the law on its acceleration [%/(in/s^2)].
    tau: float  #: Lag of the valve's drive [s].
    rate: float  #: At which leakage lets the load down [1/s].
    load: float  #: Of the law on the force of a leg, over its mass [%/(in/s^2)/kg].


def one(gain: float | tuple[float, ...]) -> float:
    """A gain that is the same for all legs."""
    return float(np.unique(gain).item())


def given(name: str = "velocity") -> Given:
    """The numbers of the set `hardware` and of a law.

    The law acts on the position by C(z) = D + C B / (z - A); about z = 1, with z = e^(sT), that is
    a gain, a gain on velocity, which the law's own nearly cancels, and one on acceleration,
    C B T^2 (1/q^2 - 1/(2q)) / q with q = 1 - A.
    """
    oil, law = load_hydraulics("hardware"), load_law(name)
    q, both = 1.0 - one(law.state_gain), one(law.output_gain) * one(law.input_gain.position)
    return Given(
        stiffness=oil.bulk_modulus.si * (oil.cap_area + oil.rod_area) / oil.half_stroke.si,
        speed=oil.leg_speed.si / 100.0 / INCH,
        gain=-(both / q + one(law.direct_gain.position)),
        acceleration=-both / q / RATE**2 * (1.0 / q**2 - 0.5 / q),
        tau=1.0 / oil.drive_lag.si,
        rate=oil.leak_rate.si,
        load=-one(law.direct_gain.cap_pressure) / oil.cap_area * INCH,
    )


def polynomial(mass: float, of: Given) -> Array:
    """Coefficients of s^4 ... 1: (1 + tau s)(s + rate s^2 / w^2 + s^3 / w^2) + S s^2 + K."""
    squared, added = of.stiffness / mass, of.speed * (of.acceleration + of.load * mass)
    loop = np.polymul([of.tau, 1.0], [1.0 / squared, of.rate / squared, 1.0, 0.0])
    return np.polyadd(loop, [added, 0.0, of.speed * of.gain])


def leg(mass: float, of: Given) -> dict[str, float]:
    """Where a leg of a mass [kg] rings and lags [Hz], its peak [dB], slowest swing, margin [dB].

    The slowest pair of poles swings at `swing` [Hz] with the ratio `damping`.
    """
    a = polynomial(mass, of)
    fourth, third, second, _, last = a
    w = 2.0 * np.pi * 0.1 * 150.0 ** (np.arange(4001) / 4000.0)
    poles = np.roots(a)
    slowest = min(poles, key=lambda pole: (abs(pole.imag) < 1e-6 * abs(pole), abs(pole)))
    lowest = (second - np.sqrt(max(second**2 - 4.0 * fourth * last, 0.0))) / (2.0 * fourth)
    return {
        "ring": np.sqrt(of.stiffness / mass) / (2.0 * np.pi),
        "lag90": np.sqrt(lowest) / (2.0 * np.pi),
        "peak": 20.0 * np.log10(max(1.0, np.abs(last / np.polyval(a, 1j * w)).max())),
        "swing": float(abs(slowest.imag)) / (2.0 * np.pi),
        "damping": float(-slowest.real / np.abs(slowest)),
        "margin": 20.0 * np.log10((second * third - fourth) / third**2 / last),
    }


def step(mass: float, time: Array, of: Given) -> Array:
    """Response to a unit step at 0: 1 and K e^(pt) / (p D'(p)) of each pole p."""
    a = polynomial(mass, of)
    poles = np.roots(a)
    swings = np.exp(np.outer(np.maximum(time, 0.0), poles))
    response = 1.0 + (a[-1] * swings / (poles * np.polyval(np.polyder(a), poles))).sum(axis=1).real
    return np.where(time > 0.0, response, 0.0)


def series(name: str, folder: Path = Path(__file__).parent) -> tuple[Array, Array]:
    """Time [s] and response [in] of the simulated step, from the file beside this one."""
    table = np.genfromtxt(folder / f"step_{name}.csv", delimiter=",", names=True)
    return table["time_s"], table["response_m"] / INCH


def tops(response: Array) -> NDArray[np.intp]:
    """Places of the maxima."""
    inner = response[1:-1]
    return 1 + np.flatnonzero((inner > response[:-2]) & (inner >= response[2:]) & (inner > 0.5))


def payload() -> float:
    """Mass of platform and cab, without the legs [kg]."""
    model = Hexapod("gfd").model
    return float(model.body("platform").mass.item() + model.body("cab/cab").mass.item())


def misfit(mass: float, of: Given, time: Array, response: Array) -> Array:
    """What the closed form leaves of a step at 1 s until 2.5 s [in], scaled to where it rests."""
    swing = (time > 1.0) & (time < 2.5)
    rest = response[time > 3.5].mean()
    return np.asarray(response[swing] - rest * step(mass, time[swing] - 1.0, of))


def peaks(mass: float, of: Given, name: str, values: Array) -> Array:
    """Peak [dB] for each value of one of the given numbers."""
    return np.array([leg(mass, of._replace(**{name: value}))["peak"] for value in values])


@cache
def fitted() -> float:
    """The mass [kg] whose step is nearest to the simulated one, by least squares."""
    given_now, recorded = given(), series("surge")
    found = minimize_scalar(
        lambda mass: np.mean(misfit(mass, given_now, *recorded) ** 2),
        bounds=(1e4, 3e4),
        method="bounded",
    )
    return float(found.x)


@cache
def enough(peak: float = 7.0) -> float:
    """Gain on acceleration [%/(in/s^2)] that brings the peak in surge down to so many dB."""
    tried = np.geomspace(given().acceleration, 0.1, 200)
    falling = peaks(surge(), given(), "acceleration", tried)
    return float(np.interp(-peak, -falling, tried))


@cache
def calm(peak: float = 3.0, of: float | None = None) -> float:
    """Gain on position [%/in] with which a mass, by default the fitted, peaks by so many dB."""
    tried, mass = np.linspace(20.0, given().gain, 200), fitted() if of is None else of
    return float(np.interp(peak, peaks(mass, given(), "gain", tried), tried))


def surge() -> float:
    """Mass that a leg feels in surge, from the mode [kg]."""
    return float(Hexapod("gfd").hydraulic_modes().leg_mass[0])


@cache
def right() -> dict[int, tuple[float, str, str]]:
    """What is right in each exercise, its unit and a hint."""
    of, masses = given(), Hexapod("gfd").hydraulic_modes().leg_mass
    aired = of._replace(stiffness=0.5 * of.stiffness)
    eased, soft = leg(masses[3], of._replace(gain=30.0)), leg(masses[0], aired)
    time, response = series("surge")
    stretch = leg_jacobian(np.zeros(6))[:, 0]
    heavy = 40000 * LBM / (stretch @ stretch)
    most = of.gain * 10.0 ** (soft["margin"] / 20.0)
    slowed = leg(surge(), of._replace(acceleration=enough()))
    lowest = peaks(surge(), of, "acceleration", np.geomspace(of.acceleration, 1.0, 200)).min()
    return {
        1: (aired.stiffness / 1e6, "MN/m", "Both chambers push back, each with beta A^2 / V."),
        2: (leg(masses[3], aired)["ring"], "Hz", "omega is in rad/s; pounds are not kilograms."),
        3: (heavy, "kg", "A leg stretches by sin(lean) cos(bearing)."),
        4: (eased["lag90"], "Hz", "A quadratic in w^2; take its smaller root."),
        5: (
            most,
            "%/in",
            f"Routh bounds K, K / sigma is g; {masses[0] / LBM:.0f} lbm in surge.",
        ),
        6: (1.0 / np.diff(time[tops(response)])[0], "Hz", "From maximum to maximum is a period."),
        7: (
            enough(),
            "%/(in/s^2)",
            "With it the largest gain is 7.0 dB: the last slider.",
        ),
        8: (slowed["lag90"], "Hz", "The page has it beside that gain."),
        9: (lowest, "dB", "Try gains from the law's own to 1: the peak falls, then rises."),
        10: (fitted(), "kg", "Where the step by hand is least apart from the simulated one."),
        11: (100.0 * abs(fitted() / surge() - 1.0), "%", "Against the mass of the mode, surge."),
        12: (calm(), "%/in", "The largest gain whose peak, for your mass, is at most 3 dB."),
    }


WITHIN = {6: 0.05, 7: 0.05, 11: 0.2}
"""How far an answer may be off, 2 % in the others: these magnify how far one reads or fits."""


def mark(number: int, answer: float | None) -> None:
    """Say whether the answer to an exercise is right within 2 % or what `WITHIN` has."""
    true, unit, hint = right()[number]
    if answer is None:
        verdict = "not answered yet"
    elif abs(float(answer) / true - 1.0) < WITHIN.get(number, 0.02):
        verdict = f"right: {true:.3g} {unit}"
    else:
        verdict = f"not {float(answer):.3g} {unit}. {hint}"
    print(f"{number}: {verdict}")
