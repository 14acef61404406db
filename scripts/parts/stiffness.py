"""Draw what bandwidth and stiffness cost each other: laws side by side, and the gains of one mode.

Left, linearised machine with one cab: stiffness in surge over the lowest -90 deg of six axes, of
each law from 1 Hz down to the least between 0.5 and 5 Hz; `modal_plan` also at faster and slower
plans, and at larger and smaller gains on errors. Right, the lowest hydraulic mode under
`SAMPLES` random gains on errors: least share of the velocity law's stiffness from 0.5 to 5 Hz over
the damping ratio of its slowest poles, nominal and the worst with valves, oil and mass off.
`laws.csv` and `gains.md` have the numbers, `stiffness.png` the picture.
"""

import argparse
from pathlib import Path
from typing import Any, NamedTuple

import control
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import signal

from cmf_mj import Hexapod, Linear, load_law
from cmf_mj.analysis.frequency_response import line_bandwidths
from cmf_mj.analysis.modes import nominal_modes
from cmf_mj.control.law import Law
from cmf_mj.core import units
from cmf_mj.core.result import Table
from cmf_mj.core.tables import write_csv
from cmf_mj.core.units import FRAME
from cmf_mj.machine.geometry import DOFS
from cmf_mj.show.look import legend

LAWS = (
    *("velocity", "velocity_tuned", "dynamic_pressure", "acceleration_compensated"),
    *("feed_forward", "modal_feedback", "model_following", "modal_plan"),
)
SAMPLES = 20_000
BAND = np.linspace(0.5, 5.0, 19)
LINES = np.arange(0.5, 12.0, 0.1)
KLBF_IN = 1000.0 * units.POUND_FORCE / units.INCH
RANGES = {"position": (5.0, 70.0), "rate": (-1.0, 12.0), "load": (0.0, 6.0), "corner": (0.5, 8.0)}
"""Gains on errors that are drawn [%/in, %/(in/s), %/klbf, Hz]; the integral is that of the law."""
FRONT = (("damping ratio", ".2f"), ("share", ".2f"))
UNITS = (
    ("K_p [%/in]", ".0f"),
    ("K_r [%/(in/s)]", ".1f"),
    ("K_f [%/klbf]", ".1f"),
    ("corner [Hz]", ".1f"),
)
OFF = ((1.1, 1.0, 1.0), (0.9, 1.0, 1.0), (1.0, 0.8, 1.0), (1.0, 1.2, 1.0), (1.0, 1.0, 1.1))
"""Valve speed, oil and mass over the nominal."""


def scaled(law: Law, plan: float = 1.0, gains: float = 1.0) -> Law:
    """The law with its plan's poles faster, or its gains on errors larger."""
    old, load = law.plan, law.load_feedback
    assert old is not None and load is not None
    changes = {
        "pairs": tuple((plan * natural, damping) for natural, damping in old.pairs),
        "pole": plan * old.pole,
        "position": tuple(gains * np.array(old.position)),
        "velocity": tuple(gains * np.array(old.velocity)),
    }
    more = {"gain": tuple(gains * np.array(load.gain))}
    return law.model_copy(
        update={
            "plan": old.model_copy(update=changes),
            "load_feedback": load.model_copy(update=more),
        }
    )


def point(plant: Hexapod, name: str, law: Law) -> list[Any]:
    """Name, lowest -90 deg [Hz], stiffness in surge at 1 Hz and the least [klbf/in].

    NaN if unstable.
    """
    linear = Linear(plant)
    stiffness = float(linear.disturbance(law).least_stiffness[0]) / KLBF_IN
    slow = float(linear.stiffness(law, [1.0])[0, 0]) / KLBF_IN
    response = np.asarray(control.frequency_response(linear.loop(law), 2.0 * np.pi * LINES).frdata)
    phases = [line_bandwidths(LINES, response[i, i]).phase_hz for i in range(len(DOFS))]
    lowest = float(np.nanmin(phases)) if stiffness == stiffness else np.nan
    return [name, round(lowest, 3), round(slow, 1), round(stiffness, 2)]


class Gains(NamedTuple):
    """Random gains on errors and what they give, arrays (N,)."""

    values: NDArray[np.float64]  #: (N, 4) in the order of `RANGES`.
    damping: NDArray[np.float64]
    damping_off: NDArray[np.float64]
    share: NDArray[np.float64]


def loops(
    mode: tuple[float, float], gains: NDArray[np.float64], off: tuple[float, float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A (N, 9, 9) of the mode under the gains, in frames, and what a force adds to the state.

    The state is position, velocity, load, drive, spool, the command a frame late, the load before
    its corner, the integral. `mode` is mass [kg] and spring [N/m].
    """
    plan, law = load_law("modal_plan").plan, load_law("modal_plan")
    assert plan is not None
    mass, spring = off[2] * mode[0], off[1] * mode[1]
    speed = off[0] * plan.speed * units.INCH / units.PERCENT
    drive, spool = 2.0 * np.pi * plan.drive_lag, 2.0 * np.pi * plan.valve_lag
    a = np.zeros((5, 5))
    a[0, 1], a[1, 2] = 1.0, 1.0 / mass
    a[2] = [0.0, -spring, -plan.leak_rate, 0.0, spring * speed]
    a[3, 3], a[4] = -drive, [0.0, 0.0, 0.0, spool, -spool]
    b = np.array([[0.0, 0.0], [0.0, 1.0 / mass], [0.0, 0.0], [drive, 0.0], [0.0, 0.0]])
    a, b, *_ = signal.cont2discrete((a, b, np.eye(5), np.zeros((5, 2))), FRAME)
    scale = units.PERCENT / units.INCH
    position, rate = gains[:, 0] * scale, gains[:, 1] * scale
    load = gains[:, 2] * units.PERCENT / (1000.0 * units.POUND_FORCE)
    pole = np.exp(-2.0 * np.pi * gains[:, 3] * FRAME)
    integral = float(law.direct_gain.error_integral) * scale  # type: ignore[arg-type]
    whole = np.zeros((gains.shape[0], 8, 8))
    whole[:, :5, :5], whole[:, :5, 5] = a, b[:, 0]
    whole[:, 5, 0], whole[:, 5, 1] = -position, -rate
    whole[:, 5, 2], whole[:, 5, 6], whole[:, 5, 7] = -load, load, -integral
    whole[:, 6, 6], whole[:, 6, 2] = pole, 1.0 - pole
    whole[:, 7, 7], whole[:, 7, 0] = 1.0, FRAME
    return whole, np.append(b[:, 1], np.zeros(3))


def damping_of(whole: NDArray[np.float64]) -> NDArray[np.float64]:
    """Least damping ratio of oscillating poles below 20 Hz, (N,); negative where unstable."""
    poles = np.linalg.eigvals(whole)
    s = np.log(poles) / FRAME
    rings = (np.abs(s.imag) > 0.1) & (np.abs(s) < 2.0 * np.pi * 20.0)
    ratio = np.where(rings, -s.real / np.abs(s), 1.0).min(axis=1)
    return np.where((np.abs(poles) < 1.0).all(axis=1), ratio, -1.0)


def sampled(plant: Hexapod, seed: int = 0) -> Gains:
    """Random gains in the lowest mode; the law's own come first."""
    law, modes = load_law("modal_plan"), nominal_modes(plant)
    assert law.plan is not None and law.load_feedback is not None
    mass = modes.mass[0] * units.POUND_MASS
    mode = mass, mass * (2.0 * np.pi * modes.frequency[0]) ** 2
    own = [np.ravel(part)[0] for part in (law.plan.position, law.plan.velocity)]
    own += [np.ravel(law.load_feedback.gain)[0], law.load_feedback.corner]
    low, high = np.array(list(RANGES.values())).T
    random = np.random.default_rng(seed).uniform(low, high, (SAMPLES, low.size))
    values = np.vstack([own, random])
    whole, pushed = loops(mode, values, (1.0, 1.0, 1.0))
    z = np.exp(2j * np.pi * BAND * FRAME)
    moved = [
        np.linalg.solve(
            turn * np.eye(8) - whole, np.broadcast_to(pushed[:, None], (*whole.shape[:2], 1))
        )
        for turn in z
    ]
    shape = np.array(modes.shape)[0]
    flown = np.abs(shape @ Linear(plant).compliance("velocity", BAND) @ shape)
    share = (flown[:, None] / np.abs(np.array(moved)[:, :, 0, 0])).min(axis=0)
    off = np.min([damping_of(loops(mode, values, one)[0]) for one in OFF], axis=0)
    return Gains(values, damping_of(whole), off, share)


def front(gains: Gains) -> list[list[float]]:
    """Largest share by the least damping ratio that is asked for, nominal; 2/3 of it when off."""
    rows = []
    for least in (0.1, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6):
        kept = (gains.damping >= least) & (gains.damping_off >= least / 1.5)
        if kept.any():
            best = np.flatnonzero(kept)[gains.share[kept].argmax()]
            rows.append(
                [least, *(round(float(v), 2) for v in (gains.share[best], *gains.values[best]))]
            )
    return rows


def draw(rows: list[list[Any]], gains: Gains, best: list[list[float]]) -> Figure:
    """Both panels."""
    figure = Figure(figsize=(9.5, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, marker, column, label in (
        ("plan", "v-", 3, "its plan slower or faster"),
        ("gains", "^-", 2, "its gains smaller or larger"),
    ):
        along = np.array([row[1:] for row in rows if str(row[0]).startswith(name)], dtype=float)
        left.plot(along[:, 0], along[:, column - 1], marker, color="0.6", label=label)
    for name, phase, slow, least in rows[: len(LAWS)]:
        title = str(name).replace("_", " ")
        (line,) = left.plot([phase, phase], [slow, least], "-", linewidth=3.0, label=title)
        left.plot(phase, least, "o", color=line.get_color())
    left.set(
        xlabel="lowest -90 deg of six axes [Hz]",
        ylabel="stiffness in surge [klbf/in], from 1 Hz to the least",
        ylim=(0.0, 100.0),
    )
    stable = gains.damping > 0.0
    right.plot(gains.damping[stable], gains.share[stable], ",", color="0.7")
    right.plot(
        [row[0] for row in best], [row[1] for row in best], "o-", label="most, by damping asked for"
    )
    right.plot(gains.damping[0], gains.share[0], "s", color="k", label="modal plan")
    right.axhline(0.8, color="0.6", linestyle="--", linewidth=1.0)
    right.set(
        xlabel="damping ratio of the lowest mode",
        ylabel="least share of the velocity law's stiffness",
        xlim=(0.0, 0.8),
        ylim=(0.0, 1.2),
    )
    legend(figure)
    for axis in (left, right):
        axis.grid(alpha=0.3)
    return figure


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--cab", default="ifd")
    parser.add_argument("--out", type=Path, default=Path("out/stiffness"))


def run(options: argparse.Namespace) -> None:
    """Measure and draw."""
    plant = Hexapod(options.cab, "hardware")
    rows = [point(plant, name, load_law(name)) for name in LAWS]
    own = load_law("modal_plan")
    rows += [
        point(plant, f"plan x {by:g}", scaled(own, plan=by)) for by in (0.5, 0.7, 0.85, 1.0, 1.15)
    ]
    rows += [
        point(plant, f"gains x {by:g}", scaled(own, gains=by)) for by in (0.3, 0.6, 0.8, 1.0, 1.2)
    ]
    gains = sampled(plant)
    best = front(gains)
    options.out.mkdir(parents=True, exist_ok=True)
    write_csv(
        options.out / "laws.csv", ["law", "phase_hz", "stiffness_1_hz", "stiffness_least"], rows
    )
    Table("", (*FRONT, *UNITS), best).save(options.out / "gains.md")
    draw(rows, gains, best).savefig(options.out / "stiffness.png", dpi=110)
    for row in (*rows, *best):
        print(*row)
    print("modal_plan, one mode:", gains.damping[0], gains.damping_off[0], gains.share[0])
