"""Forms of laws: what a search of gains is free to choose, and the law that makes of it.

    modal_plan      this project's: modes, plan, load pressure feedback
    velocity        velocity feedback of the report, its two gains again: what the others stand on
    pressure        with dynamic load pressure feedback
    feed_forward    with feed-forward of the reference's velocity and acceleration
    acceleration    with opposing acceleration feedback, its filter's corner free too
    modal           gains of position, velocity and load pressure by mode, without a plan

The four in the middle keep the report's compensator: its state gives the position K = -C / (1 - A)
back through a lag of 29 Hz, so that D on the position is K - K_p where the leg is to have the net
gain K_p. Like velocity feedback they have no integral: where a demand jumps it overshoots by about
K_i / (k K_p^2) of the jump, for K_p / K_i seconds.

Bounds, start and gains of the report are for the CMF's valves and oil. On another machine gains on
motion are divided by how much faster its valves are, so that loop gains stay, and gains on load
also by the ratio of sqrt(K M) of the lowest mode, on which the damping by load feedback depends.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.modes import modes_of_cab, nominal_modes
from cmf_mj.control.coordinates import Modes
from cmf_mj.control.feedback import LoadFeedback
from cmf_mj.control.law import Gains, Law, ReferenceModel, load_law
from cmf_mj.control.plan import Plan
from cmf_mj.core import units
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.machine.models import CABS
from cmf_mj.plant.cylinder import Contact
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import HydraulicParameters, load_hydraulics
from cmf_mj.plant.single_legs import SingleLegs
from cmf_mj.studies.case import REPORT_AMPLITUDES
from cmf_mj.studies.tuning.evaluation import LinearCab, linear_cab

HEAVY = 2  #: Modes of the pair of surge and sway, which have separate gains.

EASY = 2  #: The next modes, yaw and heave, whose chirp and step ask little of the valves.

EASY_REACH = 8.0  #: Frequency that bounds the acceleration of their reference [Hz].

APPROACH, SMOOTH = 3.5, 6.5
"""Frequencies at which a plan's reference closes small errors, and that bounds its jerk [Hz]."""

LOAD_CORNER = 5.0
"""Corner of the plan's load feedback [Hz]: above what cabs are disturbed at, where it gives way."""

INTEGRAL = 10.0  #: Gain of the plan's error integral [%/(in s)].

Values = Mapping[str, float]  #: What a search chose, by name.


class Template(NamedTuple):
    """What is the same for all candidates."""

    name: str
    title: str
    modes: Mapping[str, Modes]  #: Nominal modes of the cabs, and of single legs.
    amplitude: NDArray[np.float64]
    """Largest modal amplitude of the chirp over cabs and degrees of freedom, (6,) [in]."""
    rate: NDArray[np.float64]  #: Rate of modes whose fastest leg is at its limit, (6,) [in/s].
    cabs: tuple[LinearCab, ...]  #: Linear plants they are judged on, friction as stated.
    frictionless: tuple[LinearCab, ...]  #: The same without dry friction.
    actuator: HydraulicParameters  #: Set of the machine.
    frame: float  #: Control frame [s].
    faster: float  #: Leg speed per command over the CMF's.
    heavier: float  #: sqrt(K M) of the lowest mode of its first cab over that of the CMF's.


class Form(NamedTuple):
    """One form of law."""

    free: Mapping[str, tuple[float, float]]
    """Bounds of what is searched: Hz, 1, %/in, %/(in/s), %/(in/s^2), %/klbf by the name."""
    start: tuple[float, ...]  #: Where the search starts: shipped laws, of earlier searches.
    law: Callable[[Template, Values], Law]
    spread: float = 0.1  #: Deviation of the first candidates, as a share of the bounds.
    reach: Callable[[Values], float] = lambda _: np.inf
    """Frequency to which its reference can follow the chirp [Hz]."""


_ON_MOTION = ("acceleration", "forward_velocity", "forward_acceleration")
"""Gains on motion, besides those on position and velocity."""


def make_template(
    name: str, title: str, cabs: Sequence[str | Path | Cab] = CABS, friction: Contact | None = None
) -> Template:
    """What a search needs besides the form; `friction` as `linearize` takes it."""
    plants = [Hexapod(cab) for cab in cabs]
    modes = {plant.cab: nominal_modes(plant) for plant in plants}
    legs = SingleLegs(machine=plants[0].machine)
    linear = frictionless = tuple(linear_cab(plant, friction) for plant in plants)
    if friction not in (None, "none"):
        frictionless = tuple(linear_cab(plant, "none") for plant in plants)
    moved = [
        np.abs(np.array(modes[cab.cab].shape) @ cab.jacobian * REPORT_AMPLITUDES).max(axis=1)
        for cab in linear
    ]
    known = modes | {legs.name: nominal_modes(legs)}
    machine, cmf = plants[0].machine, modes_of_cab(load_cab())
    first, set_of_cmf = modes_of_cab(load_cab(None, machine)), load_hydraulics()
    largest = [np.abs(np.array(modes[cab.cab].shape)).max(axis=1) for cab in linear]
    fastest = float(f"{units.from_si('in/s', machine.limits.leg.velocity.si):.6g}")
    return Template(
        name,
        title,
        known,
        np.max(moved, axis=0) / units.INCH,
        fastest / np.max(largest, axis=0),
        linear,
        frictionless,
        plants[0].parameters,
        machine.frame,
        plants[0].parameters.leg_speed.si / set_of_cmf.leg_speed.si,
        first.frequency[0] * first.mass[0] / (cmf.frequency[0] * cmf.mass[0]),
    )


def candidate(form: Form, template: Template, values: Sequence[float]) -> Law:
    """The law of some values of `form.free`, rounded as its table prints them."""
    found = {}
    for name, value in named(form, values).items():
        on = name.removesuffix("_heavy").removesuffix("_light")
        scale = template.faster if name in _ON_MOTION or on in ("position", "velocity") else 1.0
        scale *= template.faster * template.heavier if on == "load" else 1.0
        found[name] = float(f"{value / scale:.4g}")
    return form.law(template, found)


def named(form: Form, values: Sequence[float]) -> Values:
    """Values by name."""
    return dict(zip(form.free, map(float, values), strict=True))


def _six(at: Values, name: str, sign: float = 1.0) -> tuple[float, ...]:
    heavy, light = sign * at[f"{name}_heavy"], sign * at[f"{name}_light"]
    return (heavy,) * HEAVY + (light,) * (len(REPORT_AMPLITUDES) - HEAVY)


def _rounded(values: NDArray[np.float64]) -> tuple[float, ...]:
    return tuple(float(f"{v:.4g}") for v in values)


def _modal(template: Template, **fields: object) -> Law:
    common = {"name": template.name, "title": template.title, "modes": template.modes}
    return Law.model_validate(common | {"coordinates": "hydraulic_modes"} | fields)


def _modal_plan(template: Template, at: Values) -> Law:
    actuator = template.actuator
    bounds = np.array(_six(at, "acceleration"))
    bounds[HEAVY : HEAVY + EASY] = EASY_REACH
    swing = actuator.supply_pressure.si - actuator.return_pressure.si
    stall = 0.5 * swing * (actuator.cap_area + actuator.rod_area) / (1e3 * units.POUND_FORCE)
    speed, *lags = (
        float(f"{units.from_si(unit, getattr(actuator, field).si):.6g}")
        for field, unit in (("leg_speed", "in/s/%"), ("drive_lag", "Hz"), ("valve_lag", "Hz"))
    )
    plan = Plan(
        speed=speed,
        drive_lag=lags[0],
        valve_lag=lags[1],
        leak_rate=actuator.leak_rate.si,
        pairs=((at["first_pair"], at["first_damping"]), (at["second_pair"], at["second_damping"])),
        pole=at["pole"],
        rate=_rounded(template.rate),
        acceleration=_rounded((2.0 * np.pi * bounds) ** 2 * template.amplitude),
        smooth=SMOOTH,
        approach=APPROACH,
        stall=float(f"{stall:.4g}"),
        position=_six(at, "position"),
        velocity=_six(at, "velocity"),
    )
    return _modal(
        template,
        direct_gain=Gains(error_integral=float(f"{INTEGRAL / template.faster:.4g}")),
        plan=plan,
        load_feedback=LoadFeedback(gain=_six(at, "load"), corner=LOAD_CORNER),
    )


def _modal_feedback(template: Template, at: Values) -> Law:
    return _modal(
        template,
        direct_gain=Gains(
            reference=_six(at, "position"),
            position=_six(at, "position", -1.0),
            velocity=_six(at, "velocity", -1.0),
        ),
        load_feedback=LoadFeedback(gain=_six(at, "load"), corner=0.5),
    )


def _on_velocity(template: Template, at: Values, **fields: object) -> Law:
    """Velocity feedback with its net position gain and velocity gain as chosen."""
    flown = load_law("velocity").at_rate(round(1.0 / template.frame))
    back = flown.output_gain / template.faster
    through = -back / (1.0 - flown.state_gain)
    gains = flown.direct_gain.model_copy(
        update={
            "reference": at["position"],
            "position": float(f"{through - at['position']:.6g}"),
            "velocity": -at["velocity"],
            "acceleration": -at.get("acceleration", 0.0),
        }
    )
    changes = {
        "name": template.name,
        "title": template.title,
        "source": "",
        "output_gain": back,
        "direct_gain": gains,
    }
    return flown.model_copy(update=changes | fields)


def _pressure(template: Template, at: Values) -> Law:
    load = LoadFeedback(gain=at["load"], corner=at["corner"])
    return _on_velocity(template, at, load_feedback=load)


def _feed_forward(template: Template, at: Values) -> Law:
    model = ReferenceModel(
        natural_frequency=at["filter"],
        damping_ratio=0.7,
        velocity=at["forward_velocity"],
        acceleration=at["forward_acceleration"],
    )
    return _on_velocity(template, at, reference_model=model)


def _acceleration(template: Template, at: Values) -> Law:
    pole = float(f"{np.exp(-2.0 * np.pi * at['filter'] * template.frame):.4g}")
    filtered = {"accelerometer_pole": pole, "accelerometer_gain": float(f"{1.0 - pole:.4g}")}
    return _on_velocity(template, at, **filtered)


_OUTER = {"position": (10.0, 80.0), "velocity": (0.0, 6.0)}

FORMS: Mapping[str, Form] = {
    "modal_plan": Form(
        {
            "first_pair": (4.0, 20.0),
            "first_damping": (0.35, 1.2),
            "second_pair": (6.0, 60.0),
            "second_damping": (0.4, 1.6),
            "pole": (5.5, 60.0),
            "acceleration_heavy": (3.0, 9.0),
            "acceleration_light": (3.0, 9.0),
            "position_heavy": (15.0, 60.0),
            "position_light": (15.0, 60.0),
            "velocity_heavy": (-0.5, 9.0),
            "velocity_light": (-0.5, 4.0),
            "load_heavy": (-3.0, 6.0),
            "load_light": (-3.0, 6.0),
        },
        (14.3, 0.506, 58.0, 1.0, 6.7, 6.18, 6.92, 46.0, 41.0, 6.75, 0.0, 2.88, 0.0),
        _modal_plan,
        spread=0.05,
        reach=lambda at: min(at["acceleration_heavy"], at["acceleration_light"]),  # w^2 a <= A
    ),
    "velocity": Form(_OUTER, (25.5, 3.1), _on_velocity),
    "pressure": Form(
        _OUTER | {"load": (0.0, 10.0), "corner": (0.1, 5.0)}, (32.5, 3.7, 0.19, 1.3), _pressure
    ),
    "feed_forward": Form(
        _OUTER
        | {
            "forward_velocity": (0.0, 3.0),
            "forward_acceleration": (0.0, 0.2),
            "filter": (5.0, 40.0),
        },
        (18.0, 2.83, 1.42, 0.033, 34.0),
        _feed_forward,
    ),
    "acceleration": Form(
        _OUTER | {"acceleration": (0.0, 0.2), "filter": (1.0, 60.0)},
        (25.5, 3.1, 0.025, 2.5),
        _acceleration,
    ),
    "modal": Form(
        {
            "position_heavy": (10.0, 80.0),
            "position_light": (10.0, 80.0),
            "velocity_heavy": (-2.0, 4.0),
            "velocity_light": (-2.0, 4.0),
            "load_heavy": (-3.0, 8.0),
            "load_light": (-3.0, 8.0),
        },
        (60.3, 56.0, 3.27, 1.17, 1.04, 1.62),
        _modal_feedback,
    ),
}
"""All forms by name."""
