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

HEAVY_MODES = 2  #: Modes of the pair of surge and sway, which have separate gains.
EASY_MODES = 2  #: The next modes, yaw and heave, whose chirp and step ask little of the valves.
EASY_REACH = 8.0  #: Frequency that bounds the acceleration of their reference [Hz].
APPROACH = 3.5  #: Frequency at which a plan's reference closes small errors [Hz].
SMOOTH = 6.5  #: Frequency that bounds the jerk of a plan's reference [Hz].
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
    speed: NDArray[np.float64]  #: Of modes whose fastest leg is at its limit, (6,) [in/s].
    cabs: tuple[LinearCab, ...]  #: Linear plants they are judged on, friction as stated.
    frictionless: tuple[LinearCab, ...]  #: The same without dry friction.
    hydraulics: HydraulicParameters  #: The machine's hydraulic set.
    frame: float  #: Control frame [s].
    speed_ratio: float  #: Leg speed per command over the CMF's.
    impedance_ratio: float  #: sqrt(K M) of the lowest mode of its first cab over that of the CMF's.


class FreeNumber(NamedTuple):
    """A number that a search chooses: Hz, 1, %/in, %/(in/s), %/(in/s^2) or %/klbf by its name."""

    low: float
    high: float
    start: float  #: Where the search starts: that of a shipped law, of earlier searches.


class Form(NamedTuple):
    """One form of law."""

    free: Mapping[str, FreeNumber]
    law: Callable[[Template, Values], Law]
    spread: float = 0.1  #: Deviation of the first candidates, as a share of the bounds.
    reach: Callable[[Values], float] = lambda _: np.inf
    """Frequency to which its reference can follow the chirp [Hz]."""

    @property
    def start(self) -> list[float]:
        """Values where the search starts."""
        return [number.start for number in self.free.values()]

    def named(self, values: Sequence[float]) -> Values:
        """Values by the names of what is free."""
        return dict(zip(self.free, map(float, values), strict=True))


_ON_MOTION = ("acceleration", "forward_velocity", "forward_acceleration")
"""Gains on motion, besides those on position and velocity."""


def make_template(
    name: str, title: str, cabs: Sequence[str | Path | Cab] = CABS, friction: Contact | None = None
) -> Template:
    """What a search needs besides the form; `friction` as `linearize` takes it."""
    plants = [Hexapod(cab) for cab in cabs]
    machine, hydraulics = plants[0].machine, plants[0].parameters
    linear = frictionless = tuple(linear_cab(plant, friction) for plant in plants)
    if friction not in (None, "none"):
        frictionless = tuple(linear_cab(plant, "none") for plant in plants)
    legs = SingleLegs(machine=machine)
    modes = {plant.cab: nominal_modes(plant) for plant in plants}
    shapes = [np.array(modes[cab.carrier.name].shape) for cab in linear]
    amplitudes = [
        np.abs(shape @ cab.jacobian * REPORT_AMPLITUDES).max(axis=1)
        for shape, cab in zip(shapes, linear, strict=True)
    ]
    largest_of_legs = np.max([np.abs(shape).max(axis=1) for shape in shapes], axis=0)
    leg_speed = float(f"{units.from_si('in/s', machine.limits.leg.velocity.si):.6g}")
    own, cmf = modes_of_cab(load_cab(None, machine)), modes_of_cab(load_cab())
    return Template(
        name=name,
        title=title,
        modes=modes | {legs.name: nominal_modes(legs)},
        amplitude=np.max(amplitudes, axis=0) / units.INCH,
        speed=leg_speed / largest_of_legs,
        cabs=linear,
        frictionless=frictionless,
        hydraulics=hydraulics,
        frame=machine.frame,
        speed_ratio=hydraulics.leg_speed.si / load_hydraulics().leg_speed.si,
        impedance_ratio=own.frequency[0] * own.mass[0] / (cmf.frequency[0] * cmf.mass[0]),
    )


def candidate_law(form: Form, template: Template, values: Sequence[float]) -> Law:
    """The law of some values of `form.free`, rounded as its table prints them."""
    gains = {}
    for name, value in form.named(values).items():
        kind = name.removesuffix("_heavy").removesuffix("_light")
        is_on_motion = name in _ON_MOTION or kind in ("position", "velocity")
        scale = template.speed_ratio if is_on_motion else 1.0
        scale *= template.speed_ratio * template.impedance_ratio if kind == "load" else 1.0
        gains[name] = float(f"{value / scale:.4g}")
    return form.law(template, gains)


def _by_mode(gains: Values, name: str, sign: float = 1.0) -> tuple[float, ...]:
    """Gains of all modes, those of the heavy ones first."""
    heavy, light = sign * gains[f"{name}_heavy"], sign * gains[f"{name}_light"]
    return (heavy,) * HEAVY_MODES + (light,) * (len(REPORT_AMPLITUDES) - HEAVY_MODES)


def _rounded(values: NDArray[np.float64]) -> tuple[float, ...]:
    return tuple(float(f"{v:.4g}") for v in values)


def _modal_law(template: Template, **fields: object) -> Law:
    common = {"name": template.name, "title": template.title, "modes": template.modes}
    return Law.model_validate(common | {"coordinates": "hydraulic_modes"} | fields)


def _modal_plan(template: Template, gains: Values) -> Law:
    hydraulics = template.hydraulics
    bounds = np.array(_by_mode(gains, "acceleration"))
    bounds[HEAVY_MODES : HEAVY_MODES + EASY_MODES] = EASY_REACH
    pressure_drop = hydraulics.supply_pressure.si - hydraulics.return_pressure.si
    areas = hydraulics.cap_area + hydraulics.rod_area
    stall = 0.5 * pressure_drop * areas / (1e3 * units.POUND_FORCE)
    plan = Plan(
        speed=float(f"{units.from_si('in/s/%', hydraulics.leg_speed.si):.6g}"),
        drive_lag=float(f"{units.from_si('Hz', hydraulics.drive_lag.si):.6g}"),
        valve_lag=float(f"{units.from_si('Hz', hydraulics.valve_lag.si):.6g}"),
        leak_rate=hydraulics.leak_rate.si,
        pairs=(
            (gains["first_pair"], gains["first_damping"]),
            (gains["second_pair"], gains["second_damping"]),
        ),
        pole=gains["pole"],
        rate=_rounded(template.speed),
        acceleration=_rounded((2.0 * np.pi * bounds) ** 2 * template.amplitude),
        smooth=SMOOTH,
        approach=APPROACH,
        stall=float(f"{stall:.4g}"),
        position=_by_mode(gains, "position"),
        velocity=_by_mode(gains, "velocity"),
    )
    return _modal_law(
        template,
        direct_gain=Gains(error_integral=float(f"{INTEGRAL / template.speed_ratio:.4g}")),
        plan=plan,
        load_feedback=LoadFeedback(gain=_by_mode(gains, "load"), corner=LOAD_CORNER),
    )


def _modal_feedback(template: Template, gains: Values) -> Law:
    return _modal_law(
        template,
        direct_gain=Gains(
            reference=_by_mode(gains, "position"),
            position=_by_mode(gains, "position", -1.0),
            velocity=_by_mode(gains, "velocity", -1.0),
        ),
        load_feedback=LoadFeedback(gain=_by_mode(gains, "load"), corner=0.5),
    )


def _on_velocity(template: Template, gains: Values, **fields: object) -> Law:
    """Velocity feedback with its net position gain and velocity gain as chosen."""
    report_law = load_law("velocity").at_rate(round(1.0 / template.frame))
    output_gain = report_law.output_gain / template.speed_ratio
    gain_of_position = -output_gain / (1.0 - report_law.state_gain)
    direct_gain = report_law.direct_gain.model_copy(
        update={
            "reference": gains["position"],
            "position": float(f"{gain_of_position - gains['position']:.6g}"),
            "velocity": -gains["velocity"],
            "acceleration": -gains.get("acceleration", 0.0),
        }
    )
    changes = {
        "name": template.name,
        "title": template.title,
        "source": "",
        "output_gain": output_gain,
        "direct_gain": direct_gain,
    }
    return report_law.model_copy(update=changes | fields)


def _pressure(template: Template, gains: Values) -> Law:
    load = LoadFeedback(gain=gains["load"], corner=gains["corner"])
    return _on_velocity(template, gains, load_feedback=load)


def _feed_forward(template: Template, gains: Values) -> Law:
    model = ReferenceModel(
        natural_frequency=gains["filter"],
        damping_ratio=0.7,
        velocity=gains["forward_velocity"],
        acceleration=gains["forward_acceleration"],
    )
    return _on_velocity(template, gains, reference_model=model)


def _acceleration(template: Template, gains: Values) -> Law:
    pole = float(f"{np.exp(-2.0 * np.pi * gains['filter'] * template.frame):.4g}")
    filtered = {"accelerometer_pole": pole, "accelerometer_gain": float(f"{1.0 - pole:.4g}")}
    return _on_velocity(template, gains, **filtered)


def _motion_gains(position: float, velocity: float) -> dict[str, FreeNumber]:
    """Gains on position and velocity of forms without modes, by their starts."""
    bounded_position = FreeNumber(10.0, 80.0, position)
    return {"position": bounded_position, "velocity": FreeNumber(0.0, 6.0, velocity)}


FORMS: Mapping[str, Form] = {
    "modal_plan": Form(
        {
            "first_pair": FreeNumber(4.0, 20.0, start=14.3),
            "first_damping": FreeNumber(0.35, 1.2, start=0.506),
            "second_pair": FreeNumber(6.0, 60.0, start=58.0),
            "second_damping": FreeNumber(0.4, 1.6, start=1.0),
            "pole": FreeNumber(5.5, 60.0, start=6.7),
            "acceleration_heavy": FreeNumber(3.0, 9.0, start=6.18),
            "acceleration_light": FreeNumber(3.0, 9.0, start=6.92),
            "position_heavy": FreeNumber(15.0, 60.0, start=46.0),
            "position_light": FreeNumber(15.0, 60.0, start=41.0),
            "velocity_heavy": FreeNumber(-0.5, 9.0, start=6.75),
            "velocity_light": FreeNumber(-0.5, 4.0, start=0.0),
            "load_heavy": FreeNumber(-3.0, 6.0, start=2.88),
            "load_light": FreeNumber(-3.0, 6.0, start=0.0),
        },
        _modal_plan,
        spread=0.05,
        reach=lambda gains: min(gains["acceleration_heavy"], gains["acceleration_light"]),
    ),
    "velocity": Form(_motion_gains(25.5, 3.1), _on_velocity),
    "pressure": Form(
        {
            **_motion_gains(32.5, 3.7),
            "load": FreeNumber(0.0, 10.0, start=0.19),
            "corner": FreeNumber(0.1, 5.0, start=1.3),
        },
        _pressure,
    ),
    "feed_forward": Form(
        {
            **_motion_gains(18.0, 2.83),
            "forward_velocity": FreeNumber(0.0, 3.0, start=1.42),
            "forward_acceleration": FreeNumber(0.0, 0.2, start=0.033),
            "filter": FreeNumber(5.0, 40.0, start=34.0),
        },
        _feed_forward,
    ),
    "acceleration": Form(
        {
            **_motion_gains(25.5, 3.1),
            "acceleration": FreeNumber(0.0, 0.2, start=0.025),
            "filter": FreeNumber(1.0, 60.0, start=2.5),
        },
        _acceleration,
    ),
    "modal": Form(
        {
            "position_heavy": FreeNumber(10.0, 80.0, start=60.3),
            "position_light": FreeNumber(10.0, 80.0, start=56.0),
            "velocity_heavy": FreeNumber(-2.0, 4.0, start=3.27),
            "velocity_light": FreeNumber(-2.0, 4.0, start=1.17),
            "load_heavy": FreeNumber(-3.0, 8.0, start=1.04),
            "load_light": FreeNumber(-3.0, 8.0, start=1.62),
        },
        _modal_feedback,
    ),
}
"""All forms by name. The reference of a plan can follow the chirp while w^2 a <= A."""
