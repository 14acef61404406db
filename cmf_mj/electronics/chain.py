"""What stands between the machine and the control law: sensors, converters, servo electronics.

    truth -> sensors -> (faults) -> anti-alias filter, ADC -> without gravity -> DCL, protection
    DCL's command -> DAC, limit switches, velocity clamp, rate limiter -> valves

Where accelerometers feel gravity (Appendix C) it is taken out, by the directions n of the legs that
the kinematics find at the measured positions,

    a = a_measured - g n . up.

The protection always watches accelerations without gravity; whether the DCL reads them so is the
law's choice. Through ideal electronics, which are not active, readings and commands go to the bit.
"""

from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator

from cmf_mj.control.feedback import LegFeedback
from cmf_mj.core.compiled import allocating, compiled, inlined
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.settings import Seed, Settings, name_or
from cmf_mj.electronics import servo_electronics as servo
from cmf_mj.electronics.converter import (
    ConverterSettings,
    convert_all,
    converter_state,
    load_converters,
    make_converters,
)
from cmf_mj.electronics.sensors import (
    Sensors,
    SensorSettings,
    SensorState,
    gravity_along,
    load_sensors,
    make_sensors,
    sense,
    sensor_state,
)
from cmf_mj.electronics.servo_electronics import ServoElectronics, ServoSettings, ServoState
from cmf_mj.machine import models
from cmf_mj.machine.kinematics import MachineOrGimbals
from cmf_mj.machine.leg_motion import TrackedPose, make_pose_tracker, track, tracked_pose
from cmf_mj.machine.machine import Machine, load_machine
from cmf_mj.plant.events import read_position
from cmf_mj.plant.parameters import fitting


class ElectronicsParts(NamedTuple):
    """Loaded settings of all parts."""

    sensors: SensorSettings
    converters: ConverterSettings
    servo: ServoSettings


class ElectronicsSettings(Settings):
    """Choice of the electronics of a run; sets by name, TOML files, or loaded settings."""

    sensors: Annotated[str | Path | SensorSettings, name_or(SensorSettings)] = "noisy"
    """`ideal`, `noisy` or a file."""
    converters: Annotated[str | Path | ConverterSettings, name_or(ConverterSettings)] = (
        "sixteen_bit"
    )
    """`off`, `sixteen_bit` or a file."""
    servo: Annotated[ServoSettings | str | Path, name_or(ServoSettings)] | None = None
    """File of changes to the servo electronics; default the shipped ones."""
    seed: Seed | None = None  #: Of the sensors' noise; default that of the scenario, or 0.

    def of(self, machine: Machine) -> ElectronicsParts:
        """All loaded, with the ranges of a machine; see `plant.parameters.fitting`."""
        fitted = fitting(machine)
        return ElectronicsParts(
            load_sensors(self.sensors, fitted),
            load_converters(self.converters, fitted),
            servo.load_servo_settings(self.servo, fitted),
        )

    def describe(self, machine: Machine) -> dict[str, Any]:
        """What a record keeps of the electronics of a machine."""
        parts = self.of(machine)._asdict()
        dumped = {name: part.model_dump(mode="json") for name, part in parts.items()}
        return dumped | {"sensor_seed": self.seed or 0}


ELECTRONICS = ("ideal", "noisy", "inertial")
"""Electronics by name; `inertial` are noisy and feel no gravity, for what is no motion base."""


def load_electronics(choice: str | ElectronicsSettings | None) -> ElectronicsSettings | None:
    """Electronics by name or as they are; `ideal` are none."""
    if not isinstance(choice, str):
        return choice
    match check_name("electronics", choice, ELECTRONICS):
        case "ideal":
            return None
        case "noisy":
            return ElectronicsSettings()
    changes = {"name": choice, "gravity": False}
    return ElectronicsSettings(sensors=load_sensors("noisy").model_copy(update=changes))


_SettingsOrName: Any = ElectronicsSettings | Literal[ELECTRONICS] | None
AnyElectronics = Annotated[
    ElectronicsSettings | None,
    BeforeValidator(load_electronics, json_schema_input_type=_SettingsOrName),
]
"""Electronics as settings or by name."""


class Electronics(NamedTuple):
    """Compiled parameters, states and workspace."""

    active: bool  #: Whether they act; if not, readings and commands pass as they are.
    sensors: Sensors
    sensor_state: SensorState
    converters: LegFeedback  #: `Converter` of each channel.
    converter_state: LegFeedback  #: Filter states (n, s, 2).
    measured_legs: TrackedPose  #: The legs as tracked from measured positions.
    gravity: NDArray[np.float64]
    """Gravity that the accelerometers feel, (n,) [m/s^2]; 0 where they feel none."""
    inertial_acceleration: NDArray[np.float64]  #: As measured, without gravity, (n,) [m/s^2].
    servo: ServoElectronics
    servo_state: ServoState
    reading: LegFeedback  #: What the sensors put out.


@cache
def ideal_electronics(legs: int) -> Electronics:
    """Electronics that are not active: nothing reads them or writes to them."""
    settings = ElectronicsSettings(sensors="ideal", converters="off")
    at_rest = LegFeedback(*np.zeros((len(LegFeedback._fields), legs)))
    return make_electronics(settings, at_rest)._replace(active=False)


def make_electronics(
    settings: ElectronicsSettings, at_rest: LegFeedback, machine: str | Machine = models.CMF
) -> Electronics:
    """Electronics that have seen a machine at rest for a long time.

    Sensors that feel gravity on other than six legs are refused.
    """
    carrier = load_machine(machine)
    parts, frame = settings.of(carrier), carrier.frame
    legs = at_rest.position.shape[0]
    truth = LegFeedback(*(np.array(values, dtype=float) for values in at_rest))
    sensors = make_sensors(parts.sensors, 1.0 / frame, settings.seed or 0, carrier)
    converters = make_converters(parts.converters, frame)
    state = sensor_state(sensors, truth)
    reading = LegFeedback(*(np.zeros(legs) for _ in LegFeedback._fields))
    sense(sensors, state, 0, truth, reading)
    extension = reading.position if sensors.gravity else np.zeros(6)
    return Electronics(
        active=True,
        sensors=sensors,
        sensor_state=state,
        converters=converters,
        converter_state=converter_state(converters, reading),
        measured_legs=tracked_pose(sensors.axes, extension),
        gravity=np.zeros(legs),
        inertial_acceleration=np.zeros(legs),
        servo=servo.make_servo_electronics(parts.servo, frame),
        servo_state=servo.start(legs),
        reading=reading,
    )


@compiled
def write_gravity(axes, measured_legs, position, gravity):  # type: ignore[no-untyped-def]
    """Write g n . up [m/s^2], which accelerometers feel, at measured extensions (6,) [m]."""
    track(axes, measured_legs, position)
    for leg in range(6):
        gravity[leg] = gravity_along(measured_legs, leg)


@allocating
def _write_gravity_history(axes, measured_legs, position, gravity):  # type: ignore[no-untyped-def]
    for frame in range(position.shape[0]):
        write_gravity(axes, measured_legs, position[frame], gravity[frame])


def gravity_history(
    position: NDArray[np.float64], machine: MachineOrGimbals = models.CMF
) -> NDArray[np.float64]:
    """Gravity along six legs at measured extensions (N, 6) [m], as the electronics find it."""
    if (shape := position.shape[1:]) != (6,):
        raise InputError(f"position: shape is {shape}; gravity along the legs needs (6,)")
    axes, gravity = make_pose_tracker(machine), np.empty(position.shape)
    position = np.ascontiguousarray(position)
    _write_gravity_history(axes, tracked_pose(axes, position[0]), position, gravity)
    return gravity


@compiled
def _read_and_convert(electronics, faults, frame, truth, reads_inertial, feedback):  # type: ignore[no-untyped-def]
    reading = electronics.reading
    sense(electronics.sensors, electronics.sensor_state, frame, truth, reading)
    for leg in range(truth.position.shape[0]):
        reading.position[leg] = read_position(faults, leg, reading.position[leg])
    convert_all(electronics.converters, electronics.converter_state, reading, feedback)
    if electronics.sensors.gravity:
        axes, measured_legs = electronics.sensors.axes, electronics.measured_legs
        write_gravity(axes, measured_legs, feedback.position, electronics.gravity)
    for leg in range(truth.position.shape[0]):
        acceleration = feedback.acceleration[leg] - electronics.gravity[leg]
        electronics.inertial_acceleration[leg] = acceleration
        if reads_inertial:
            feedback.acceleration[leg] = acceleration


@inlined
def measure(electronics, faults, frame, truth, reads_inertial, feedback):  # type: ignore[no-untyped-def]
    """Write the feedback that the DCL reads; through ideal electronics it is the truth.

    The number of the control frame chooses the noise; the law reads accelerations without gravity
    if `reads_inertial`.
    """
    if electronics.active:
        _read_and_convert(electronics, faults, frame, truth, reads_inertial, feedback)
        return
    for leg in range(truth.position.shape[0]):
        feedback.position[leg] = read_position(faults, leg, truth.position[leg])
        feedback.velocity[leg] = truth.velocity[leg]
        feedback.acceleration[leg] = truth.acceleration[leg]
        feedback.cap_pressure[leg] = truth.cap_pressure[leg]
        feedback.rod_pressure[leg] = truth.rod_pressure[leg]


@inlined
def inertial_feedback(electronics, feedback):  # type: ignore[no-untyped-def]
    """The feedback with accelerations without gravity, as views, for the protection."""
    return LegFeedback(
        feedback.position,
        feedback.velocity,
        electronics.inertial_acceleration if electronics.active else feedback.acceleration,
        feedback.cap_pressure,
        feedback.rod_pressure,
    )


@inlined
def deliver(electronics, watches_lower, position, command):  # type: ignore[no-untyped-def]
    """Turn the DCL's commands into those of the valves, in place.

    Commands (n,) are fractions, positions (n,) true extensions [m]. The lower switches are watched
    if `watches_lower`. Returns whether a limit switch has tripped, now or earlier.
    """
    if not electronics.active:
        return False
    return servo.step(electronics.servo, electronics.servo_state, watches_lower, command, position)


@inlined
def release(electronics):  # type: ignore[no-untyped-def]
    """Release latched limit switches."""
    if electronics.active:
        servo.reset(electronics.servo_state)
