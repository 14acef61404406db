"""Where the time from host to pilot goes, at one frequency.

A slow sine in one degree of freedom runs through the whole facility. With c the complex amplitude
of a signal at w, a stage from x to y takes the phase delay

    d = -arg(c_y / c_x) / w

which adds up along the chain exactly; where a stage turns position into velocity, c_x is multiplied
by jw first. A stage of the closed loop is what is measured between its ends, so that a control law
that leads shows a negative delay. Legs are projected on the pattern of the degree of freedom.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj import signals
from cmf_mj.analysis import metrics
from cmf_mj.analysis.delay import phase_delay
from cmf_mj.control.dcu.settings import load_dcu
from cmf_mj.control.law import Law
from cmf_mj.core.errors import InputError
from cmf_mj.core.rates import RATE
from cmf_mj.facility.host.stream import from_command
from cmf_mj.facility.operation import FacilitySettings, operate
from cmf_mj.machine import kinematics
from cmf_mj.machine.dof import by_kind, dof_index
from cmf_mj.machine.kinematics import FLIP
from cmf_mj.pilot import host as pilot_host
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters

_SETTLE, _CYCLES = 4, 4


class Stage(NamedTuple):
    """A part of the way from host to pilot."""

    name: str
    delay: float  #: [s]; negative where it leads.
    known: bool  #: Whether it is a setting; otherwise it is measured.


class TransportDelay(NamedTuple):
    """The way from the host's stamp to the pilot's station."""

    dof: str
    frequency: float  #: [Hz].
    stages: tuple[Stage, ...]  #: In the order of the signal.
    host_to_reference: float  #: Measured, to compare with the sum of the DCU's settings [s].
    total: float
    """Measured from host to pilot [s]; the stages add up to it but for what the DCU's settings
    differ from `host_to_reference`."""


def transport_delay(
    law: str | Path | Law = "velocity",
    *,
    cab: str = "gfd",
    dof: str = "heave",
    frequency: float = 1.0,
    amplitude: float | None = None,
    hydraulics: str | HydraulicParameters = "hardware",
    facility: FacilitySettings | None = None,
) -> TransportDelay:
    """Measure the delay from host to pilot and its parts.

    The sine has a whole number of control frames a period, `frequency` in Hz, and by default an
    amplitude of 10 mm or 0.5 deg [m, rad].
    """
    index = dof_index(dof)
    signals.check_positive(frequency=frequency)
    if not (RATE / frequency).is_integer() or frequency > 8.0:
        raise InputError(
            f"frequency: {frequency} Hz; allowed: up to 8 Hz with whole control frames a period, "
            "such as 0.5, 1 or 2"
        )
    settings = facility or FacilitySettings()
    size = amplitude if amplitude is not None else by_kind(dof, 0.01, np.radians(0.5))
    command = signals.sine(dof, size, frequency, cycles=_SETTLE + _CYCLES + 2.0, fade=1.0)
    stream = from_command(command, pilot_host.MOST_RATE)
    plant = Hexapod(cab, hydraulics)
    record = operate(plant, law, stream, facility=settings).record
    omega = 2.0 * np.pi * frequency
    first = round(_SETTLE * RATE / frequency)
    count = round(_CYCLES * RATE / frequency)

    def fundamental(values: NDArray[np.float64]) -> complex:
        fit = metrics.harmonics(values[first : first + count], RATE, frequency, 1)
        return complex(fit.amplitude[0] * np.exp(1j * fit.phase[0]))

    pattern = kinematics.pose_jacobian(np.zeros(6))[:, index]

    def legs(name: str) -> complex:
        return fundamental(record[name] @ pattern)

    def late(before: complex, after: complex) -> float:
        return phase_delay(before, after, frequency)

    sent = fundamental(kinematics.pose_to_legs(command.pose) @ pattern)
    reference, valve, opening = map(legs, ("leg_reference", "valve_command", "valve_opening"))
    moved = legs("leg_extension")
    if index < 3:  # an accelerometer's row is of one mechanical step before
        since = omega * float(record.metadata["mechanical_step"])
        force = fundamental(record["crew_accelerometer"][:, index] * FLIP[index])
        felt = force * np.exp(1j * since) / -(omega**2)
    else:
        felt = fundamental(record["platform_gyro"][:, index - 3] * FLIP[index - 3]) / (1j * omega)
    ahead = fundamental(command.pose[:, index])
    dcu = load_dcu(settings.dcu).delay
    stages = [
        Stage(f"DCU: {name.replace('_', ' ')}", part, True) for name, part in dcu.parts().items()
    ]
    for name, part in (
        ("control law: reference to valve command", late(1j * omega * reference, valve)),
        ("servo drive and valve: command to opening", late(valve, opening)),
        ("hydraulics and mechanics: opening to legs", late(opening, 1j * omega * moved)),
        ("legs to pilot's station", late(moved / sent, felt / ahead)),
    ):
        stages.append(Stage(name, part, False))
    return TransportDelay(dof, frequency, tuple(stages), late(sent, reference), late(ahead, felt))
