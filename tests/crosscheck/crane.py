"""The hydraulic crane in two more engines: Project Chrono's equations under SciPy, and Exudyn.

`examples/crane.py` has the benchmark and where its numbers are from. Here they are written a second
time. **Chrono's equations** (`ChHydraulicActuator2`, its two-volume circuit) are integrated by
Radau's method together with the crane, a double pendulum of the angles theta and phi:

    dp_cap/dt = (Q_cap - A_cap v) / C_cap,          dp_rod/dt = (A_rod v - Q_rod) / C_rod
    C = V (1/Bo + 1/Bc) + V_hose (1/Bo + 1/Bh),     Q = Cv u sqrt(dp), linear below 2 bar
    F = A_cap p_cap - A_rod p_rod - c v + stop,     du/dt = (command - u) / tau

Each of the `Terms` in which our plant differs can be exchanged for ours. The paper's circuit has a
third volume: a throttle between it and the cap's hose, its flow linear below 2 bar. (Chrono's
`ChHydraulicActuator3` computes that flow, but fills the cap chamber by the valve's.) **Exudyn** has
an element of its own, `HydraulicActuatorSimple`, after the same paper: no throttle, no laminar part
and no end stop, for which it gets a spring here. Pressures are Pa, forces N, angles rad.
"""

import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from cmf_mj.core.units import FRAME
from cmf_mj.facility.simulate import drive

Array = NDArray[np.float64]

GRAVITY, CRANE, LENGTH, BALL, ROPE, INERTIA = 9.8, 500.0, 1.0, 100.0, 0.3, 1.0
FOOT, ANGLE = np.sqrt(3.0) / 2.0, np.pi / 6.0
CAP = np.pi * 0.08**2 / 4.0
ROD = CAP - np.pi * 0.035**2 / 4.0
CHAMBER, START = 0.221, (4.163e6, 3.461e6)
PUMP, TANK, _LINEAR = 7.6e6, 0.1e6, 2e5
NOMINAL, LAG = 24e-3 / 60.0 / np.sqrt(35e5), 1.0 / (2.0 * np.pi * 35.0)
_SHUT = 1e-6  # opening below which Chrono's valve is shut
HOSES, MODULI = (3.14e-5, 7.85e-5), (1500e6, 150e6, 31500e6)  # oil, hose, cylinder
_THIRD, _BORED = 4.71e-5, 0.8 * np.pi * 0.006**2 / 4.0 * np.sqrt(2.0 / 850.0)
RESISTANCE = np.sqrt(_LINEAR) / _BORED  #: Of the throttle, below 2 bar [Pa s/m^3].
VISCOUS, _END, _STIFF, _DAMPED = 1e5, 0.008, 1e7, 5e3
_REACHED = 5.6  # a moment before the piston first reaches its end stop [s]
TIMES, COMMANDS = np.array([0.0, 0.5, 2.0, 7.0, 9.0, 10.0]), np.array([0, 0, 0.6, 0.6, -1, 0.0])


class Terms(NamedTuple):
    """In which terms the equations are Chrono's; without one, they are ours."""

    valve: bool = True  #: The valve is linear below 2 bar, and shut below an opening of 1e-6.
    damper: bool = True  #: The end stop damps with 5 kN s/m.
    volume: bool = True  #: Flows count volume at the chamber's pressure, not content of oil.
    start: bool = True  #: Starts at the printed pressures, not in static balance.
    hose: bool = True  #: The third volume lies before the throttle, not behind it.


class History(NamedTuple):
    """What an engine computed, at the frames of 1/2048 s."""

    cap: Array  #: [Pa], (N,).
    rod: Array  #: [Pa], (N,).
    force: Array  #: [N], (N,), friction taken off.
    angle: Array  #: [rad], (N,).


def example() -> dict[str, Any]:
    """What `examples/crane.py` defines."""
    return runpy.run_path(str(Path(__file__).parents[2] / "examples" / "crane.py"))


def in_mujoco(
    seconds: float, steps: int, *, throttled: bool = False, **changes: tuple[float, str]
) -> History:
    """The example in so many mechanical steps to a frame, with a throttle or without.

    `changes` are other numbers of its hydraulics, with their units.
    """
    names = example()
    valves = names["commanded"](np.arange(0.5 * FRAME, seconds, FRAME))
    plant = names["crane"](steps, **(names["THROTTLED"] if throttled else {}) | changes)
    record = drive(plant, valves[:, None])
    cap, rod = (record[f"{side}_pressure"][:, 0] for side in ("cap", "rod"))
    angle = ANGLE + record["generalised_position"][:, 0]
    return History(cap, rod, record["leg_force"][:, 0], angle)


def apart(first: History, second: History) -> tuple[float, float, float, float]:
    """Largest differences: pressure over the pump's, also before the stop, force, angle."""
    difference = [np.abs(mine - other) for mine, other in zip(first, second, strict=True)]
    pressure = np.maximum(difference[0], difference[1]) / PUMP
    early = pressure[: round(_REACHED / FRAME)].max()
    return (
        float(pressure.max()),
        float(early),
        float(difference[2].max()),
        float(difference[3].max()),
    )


def history(cap: Array, rod: Array, angle: Array, speed: Array) -> History:
    """A history with its force, from the crane's angle [rad] and its speed [rad/s]."""
    motion = speed * [cylinder(one)[1] for one in angle]
    return History(cap, rod, cap * CAP - rod * ROD - VISCOUS * motion, angle)


def cylinder(angle: float) -> tuple[float, float]:
    """Length [m], and its slope with the crane's angle [m/rad]."""
    length = np.sqrt(0.25 * LENGTH**2 + FOOT**2 - LENGTH * FOOT * np.cos(angle))
    return length, 0.5 * LENGTH * FOOT * np.sin(angle) / length * LENGTH


def _accelerations(angle: float, swing: float, speed: float, rate: float, force: float) -> Array:
    """Of the crane's angle and the ball's from the vertical, by Lagrange's equations."""
    arm, sine, cosine = LENGTH * ROPE * BALL, np.sin(swing - angle), np.cos(swing - angle)
    crane = INERTIA + (0.25 * CRANE + BALL) * LENGTH**2
    weight = GRAVITY * LENGTH * (0.5 * CRANE + BALL) * np.cos(angle)
    pulls = np.array(
        [
            force * cylinder(angle)[1] - weight - arm * cosine * rate**2,
            arm * cosine * speed**2 - BALL * GRAVITY * ROPE * np.sin(swing),
        ]
    )
    masses = [[crane, arm * sine], [arm * sine, INERTIA + BALL * ROPE**2]]
    return np.linalg.solve(np.array(masses), pulls)


def _flow(drop: float, terms: Terms, squeeze: Callable[[float], float]) -> float:
    """Flow of a fully open port."""
    if not terms.valve:
        root, middle = np.sqrt(0.5 * 0.1), 0.5 * (PUMP - TANK)  # as the example's set has it

        def sharp(of: float) -> float:
            return float(np.sign(of) * 0.5 * (np.sqrt(root**2 + 4.0 * abs(of)) - root))

        ratio = np.sqrt(middle) / sharp(middle) * sharp(drop)
    elif abs(drop) < _LINEAR:
        ratio = drop / np.sqrt(_LINEAR)
    else:
        ratio = np.sign(drop) * np.sqrt(abs(drop))
    return float(NOMINAL * ratio * (1.0 if terms.volume else squeeze(0.5 * (PUMP + TANK))))


def stop(length: float, speed: float, terms: Terms) -> float:
    """Force of the end stops."""
    cap, rod = CHAMBER + length - 0.5, CHAMBER - (length - 0.5)
    if min(cap, rod) > _END:
        return 0.0
    spring = _STIFF * (_END - cap) if cap <= _END else -_STIFF * (_END - rod)
    return spring - terms.damper * _DAMPED * speed


def _rates(time: float, state: Array, terms: Terms, throttled: bool) -> Array:
    """Rates of both angles, both speeds, spool, cap, rod and third pressure."""
    angle, swing, speed, rate, spool, cap, rod, third = state
    length, slope = cylinder(angle)
    motion = slope * speed
    force = cap * CAP - rod * ROD - VISCOUS * motion + stop(length, motion, terms)
    oil, hose, barrel = MODULI
    solid, soft = 1.0 / oil + 1.0 / barrel, 1.0 / oil + 1.0 / hose

    def squeeze(pressure: float) -> float:
        return 1.0 + pressure * solid + 0.5 * (pressure * solid) ** 2

    opened = abs(spool) * (abs(spool) >= _SHUT or not terms.valve)
    feed = third if throttled else cap
    if spool >= 0.0:
        fills = opened * _flow(PUMP - feed, terms, squeeze)
        drains = opened * _flow(rod - TANK, terms, squeeze)
    else:
        fills = -opened * _flow(feed - TANK, terms, squeeze)
        drains = -opened * _flow(PUMP - rod, terms, squeeze)
    passed = (third - cap) / RESISTANCE if throttled else fills
    # The third volume is a hundredth of its size where it counts as lying behind the throttle.
    before = _THIRD * throttled * (1.0 if terms.hose else 0.01)
    behind = _THIRD * throttled - before
    rates: list[float] = []
    for pressure, flow, swept, yields in (
        (cap, passed, CAP * motion, CAP * (CHAMBER + length - 0.5) * solid),
        (rod, -drains, -ROD * motion, ROD * (CHAMBER - length + 0.5) * solid),
        (third, fills - passed, 0.0, 0.0),
    ):
        hoses = (HOSES[0] + behind, HOSES[1], before or 1.0)[len(rates)]
        content, rise = (1.0, 1.0) if terms.volume else (squeeze(pressure), 1.0 + pressure * solid)
        rates.append((flow - content * swept) / (rise * (yields + hoses * soft)))
    asked = np.interp(time % TIMES[-1], TIMES, COMMANDS)
    bent = _accelerations(angle, swing, speed, rate, force)
    return np.array([speed, rate, *bent, (asked - spool) / LAG, *rates])


def in_scipy(seconds: float, terms: Terms | None = None, *, throttled: bool = False) -> History:
    """Chrono's equations, but for those terms that are ours, with a throttle or without."""
    chosen = terms or Terms()
    load = (CRANE + 2.0 * BALL) * GRAVITY
    cap = START[0] if chosen.start else (load + ROD * START[1]) / CAP
    state = np.array([ANGLE, 0.0, 0.0, 0.0, 0.0, cap, START[1], cap])
    frames = np.arange(round(seconds / FRAME)) * FRAME
    knots = [10.0 * turn + knot for turn in range(int(seconds / 10.0) + 1) for knot in TIMES[:-1]]
    rows = []
    for begin, end in zip(knots, [*knots[1:], np.inf], strict=True):
        if begin >= seconds:
            break
        inside = frames[(frames >= begin) & (frames < end)]
        until = min(end, seconds)
        found = solve_ivp(
            *(_rates, (begin, until), state, "Radau", np.append(inside, until)),
            args=(chosen, throttled),
            rtol=1e-9,
            max_step=0.02,
            atol=[1e-12, 1e-12, 1e-11, 1e-11, 1e-11, 1e-2, 1e-2, 1e-2],
        )
        rows.append(found.y[:, :-1])
        state = found.y[:, -1]
    angle, _, speed, _, _, cap, rod, _ = np.concatenate(rows, axis=1)
    return history(cap, rod, angle, speed)
