"""From the aircraft to the cab: host, washout, DCU, control law, machine, what the pilot feels.

    aircraft -> washout -> frames within the limits -> DCU -> DCL -> valves -> cab -> pilot

`fly` compares three motions at the pilot's station, all at the host's times: that of the aircraft,
that which the host's frames ask of the platform, and the true one of the cab. The first two differ
by the washout, the last two by delay, law and machine.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.metrics import transient_delay
from cmf_mj.control.law import Law, load_law
from cmf_mj.control.states import State
from cmf_mj.facility.host.stream import HostStream, make_stream, resample
from cmf_mj.facility.operation import Operation, operate
from cmf_mj.machine import kinematics
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.machine.limits import MotionLimits
from cmf_mj.machine.machine import Machine
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.pilot.cueing import Excursion, cue, excursion
from cmf_mj.pilot.motion import COLUMNS, PilotMotion, interpolated
from cmf_mj.pilot.perception import CueingError, cueing_error
from cmf_mj.pilot.washout_settings import PredictiveSettings, WashoutSettings, load_washout
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import HydraulicParameters
from cmf_mj.record.record import Record

RECORD_EVERY = 8  #: Control frames a row of the record: 256 Hz.
_LOW_PASS_CORNER = 30.0
"""Of the zero-phase low-pass before 80 Hz samples are taken of the cab's motion [Hz]: rows of the
record hold vibration beyond half the host's rate."""


class FlightResult(NamedTuple):
    """A flight in the cab."""

    law: str
    cab: str
    aircraft: PilotMotion  #: At the pilot's station of the aircraft.
    stream: HostStream  #: What the host sends to the DCU.
    limited: NDArray[np.bool_]  #: Frames that the limits held back before they were sent, (N,).
    asked: PilotMotion
    """At the pilot's station of the cab, if the machine followed the frames at once."""
    simulator: PilotMotion  #: At the pilot's station of the cab, in truth.
    cueing: CueingError  #: Sensed in the aircraft less sensed in the cab.
    machine: CueingError  #: Sensed if the machine followed at once less sensed in the cab.
    use: Excursion  #: Of the limits by the machine while engaged.
    host_delay: float
    """From the host's frames to the leg reference, by `transient_delay` of leg velocities [s]."""
    loop_delay: float  #: From there to the legs, likewise [s]: a mean over the flight's band.
    operation: Operation  #: Record and account of the run.
    plans: str | None = None  #: See `Washout.plans`.
    refused: int = 0  #: Datagrams of live telemetry that were not of its format.

    @property
    def washout_error(self) -> CueingError:
        """Perceived error of a machine that follows the frames at once."""
        return cueing_error(self.aircraft, self.asked)

    @property
    def fault(self) -> str | None:
        """Name of the fault that ended the flight, or None."""
        fault = self.operation.record.metadata["fault"]
        return None if fault is None else str(fault["name"])


def fly(
    motion: PilotMotion,
    law: str | Path | Law = "velocity",
    *,
    cab: str | Path | Cab | None = None,
    washout: str | WashoutSettings = "simona",
    hydraulics: str | HydraulicParameters | None = None,
    **options: Any,
) -> FlightResult:
    """Fly a motion at a pilot's station through the facility.

    Law, washout and hydraulics are names, TOML files or loaded; `options` are those of `operate`.

    >>> from cmf_mj.pilot.flight import load_flight
    >>> from cmf_mj.pilot.fly import fly
    >>> fly(load_flight("gusts").motion).use.travel < 1.0
    True
    """
    loaded_cab = load_cab(cab)
    limits = load_motion_limits(options.get("limits"), loaded_cab.machine)
    plant = Hexapod(loaded_cab, hydraulics)
    lead = law_delay(plant, law, washout)
    ideal = cue(motion, washout, cab=loaded_cab, limits=limits, lead=lead)
    operation = operate(plant, law, ideal.stream, record_every=RECORD_EVERY, **options)
    result = flight_result(plant, ideal.aircraft, ideal.stream, operation, limits)
    return result._replace(limited=ideal.limited, plans=ideal.plans)


def law_delay(plant: Hexapod, law: str | Path | Law, washout: str | WashoutSettings) -> float:
    """What a predictive washout leads by [s]: the delay of the linear loop; 0 for others.

    The mean over the degrees of freedom of -phase / omega at 0.5 Hz.
    """
    if not isinstance(load_washout(washout), PredictiveSettings):
        return 0.0
    loop, omega = Linear(plant).loop(load_law(law)), np.pi
    phases = np.angle(np.diag(loop(np.exp(1j * omega * loop.dt))))
    return float(-phases.mean() / omega)


def flight_result(
    plant: Hexapod,
    aircraft: PilotMotion,
    stream: HostStream,
    operation: Operation,
    limits: MotionLimits,
) -> FlightResult:
    """What the pilot felt in an operation on the frames of an aircraft, none of them held back."""
    asked = PilotMotion.from_platform(stream, load_cab(plant.cab_parameters).station)
    record = operation.record
    is_engaged = record["operating_state"] == State.ENGAGED
    platform = make_stream(record.time[is_engaged], record["platform_pose"][is_engaged])
    simulator = crew_motion(record, asked.time)
    host_delay, loop_delay = _delays(stream, record, plant.machine)
    return FlightResult(
        law=str(record.metadata["law"]),
        cab=plant.cab,
        aircraft=aircraft,
        stream=stream,
        limited=np.zeros(stream.time.size, dtype=bool),
        asked=asked,
        simulator=simulator,
        cueing=cueing_error(aircraft, simulator),
        machine=cueing_error(asked, simulator),
        use=excursion(platform, limits, plant.machine),
        host_delay=host_delay,
        loop_delay=loop_delay,
        operation=operation,
    )


def crew_motion(record: Record, time: NDArray[np.float64]) -> PilotMotion:
    """The crew's motion of a record at some times [s], without what lies beyond 30 Hz."""
    motion, record_time = PilotMotion.from_record(record), time - time[0]
    channels = (
        low_passed(record, getattr(motion, name), motion.time, record_time) for name in COLUMNS
    )
    return PilotMotion(time, *channels)


def low_passed(
    record: Record,
    values: NDArray[np.float64],
    time: NDArray[np.float64],
    new_time: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Columns at a record's rate and some times [s], at others, without what lies beyond 30 Hz."""
    sections = signal.butter(4, _LOW_PASS_CORNER, fs=record.rate, output="sos")
    return interpolated(new_time, time, signal.sosfiltfilt(sections, values, axis=0))


def _delays(stream: HostStream, record: Record, machine: Machine) -> tuple[float, float]:
    """Host to reference and reference to legs [s], by the leg that moves most."""
    legs = kinematics.pose_to_legs(resample(stream, record.rate).pose, machine)
    reference, extension = record["leg_reference"], record["leg_extension"]
    rows = min(len(legs), len(reference))
    leg = int(np.ptp(reference, axis=0).argmax())
    if np.ptp(reference[:, leg]) == 0.0:
        return float("nan"), float("nan")
    host_rate, reference_rate, leg_rate = (
        np.diff(values[:rows, leg]) for values in (legs, reference, extension)
    )
    host_delay = transient_delay(host_rate, reference_rate, record.rate)
    return host_delay, transient_delay(reference_rate, leg_rate, record.rate)
