"""Runs of one event each, in a sine from rest to rest, and what it does to legs and crew.

Before and after the event, at the full frame rate:

    axial leg load       cylinder force plus force of the mechanical stop on the rod; the multiple
                         is that of the same leg's static load at the start
    crew acceleration    a = R f + g, f what an accelerometer at the crew's heads reads: rotation of
                         the platform included, gravity removed

The final state is one of these:

    running        legs follow the demand to the end, at most twice as far off as before the event,
                   or as without it where it comes before the manoeuvre is faded in
    degraded       legs follow it within `LARGEST_ERROR` half strokes
    holding        legs stand still off their stops
    moving         legs neither follow nor stand still when the run ends
    settled        all legs stand on their lower stops, the first of which met its stop at most at
                   `FALL_RATIO` times the settle speed of the hydraulic set
    fallen         the same, but the first leg came faster
    against_stop   some legs stand on a stop
    out_of_bounds  the state left its physical bounds; the message says which and where
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from cmf_mj.control.protection import ProtectionSettings
from cmf_mj.core import units
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.result import Field, Result
from cmf_mj.core.threads import on_threads
from cmf_mj.facility.session import OutOfBounds
from cmf_mj.facility.simulate import simulate
from cmf_mj.machine.geometry import by_kind
from cmf_mj.machine.motion_limits import relative_travel
from cmf_mj.plant.events import Event
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.record.record import Record
from cmf_mj.signals.signal import Command, as_command, check_positive
from cmf_mj.signals.single import sine
from cmf_mj.signals.travel import check_travel
from cmf_mj.studies.case import Case, frames_a_row, make_case

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FADE, REST = 1.0, 2.0  #: Fade of the manoeuvre at both ends, and rest after it [s].
FALL_RATIO = 2.5
"""Least speed of a fall at the first stop, over the settle speed; assumed: 10 in/s at the CMF."""
LARGEST_ERROR = 6.0 / 38.0
"""Of a leg that follows, over its half stroke: 6 in of the CMF, where protection finds a fault."""
_REST_SWING = 1e-3  #: Swing over the last second, or distance from the demand, that is none [m].
_STOP_GAP = 2e-3  #: Distance from a stop that counts as on it [m].
_RECORD_RATE = 256  #: Rows of the record that is kept, a second, at least [Hz].
_LATE_CHANNELS = ("stop_force", "crew_accelerometer")  #: They stand a row after their frame.


class Peak(NamedTuple):
    """An extreme value."""

    value: float  #: In SI.
    time: float  #: When [s].
    leg: int | None = None  #: Leg it belongs to, from 1.


class Phases(NamedTuple):
    """A quantity before and after the event."""

    before: Peak
    after: Peak  #: From the event on.
    free: Peak  #: From the event until the first leg meets a stop.


class FailureResult(NamedTuple):
    """What an event did."""

    event: Event
    size: float  #: How much fails, in SI; 0 for kinds without a size.
    dof: str  #: Degree of freedom of the manoeuvre.
    protected: bool  #: Whether a detected fault made an emergency stop.
    static_load: Array  #: Axial loads at the start [N], (6,).
    load: Phases  #: Largest axial leg load [N], by size; negative pulls.
    acceleration: Phases  #: Largest crew acceleration [m/s^2].
    detected_by: str | None  #: First fault detected; None if there was none.
    detection_time: float | None  #: From event to fault [s]; negative for a false alarm.
    state: str  #: How it ends, see the module.
    message: str  #: What left its bounds; empty otherwise.
    pressure_peak: Peak  #: Largest chamber pressure from the event on [Pa].
    pressure_least: Peak  #: Least chamber pressure from the event on [Pa], gauge.
    supply_least: Peak  #: Least pressure of the supply manifold from the event on [Pa].
    contact_speed: Peak | None  #: Speed at which the first leg met a stop [m/s]; none if none did.
    impact_speed: Peak | None
    """Largest speed at which a leg met a stop [m/s]; the platform tips on legs that stand."""
    record: Record
    """The run at `_RECORD_RATE`, with `axial_load` and `crew_acceleration` (world axes, z up)."""

    @property
    def label(self) -> str:
        """The event in a few words, fit for a file name."""
        places = {"leg": self.event.leg, "valve": self.event.valve}
        numbered = (f"{name}_{number}" for name, number in places.items() if number is not None)
        return "-".join([self.event.kind, *numbered])

    @property
    def setting(self) -> str:
        """Whether the protection could stop the machine."""
        return f"protection {'on' if self.protected else 'off'}"

    @property
    def multiples(self) -> dict[str, float]:
        """Loads over the static load of their leg, by the phase."""
        return {
            phase: load.value / float(self.static_load[(load.leg or 1) - 1])
            for phase, load in self.load._asdict().items()
        }


_LEGEND = (
    "load: largest axial leg load before the event, after it until a leg meets a stop, and in all "
    "the time after it, in kN and times the leg's static load, negative pulls; crew: largest "
    "acceleration at the crew's heads, gravity removed, in g; found: time to detect in s; "
    "pressures in psi gauge: least supply, least and largest of all chambers; stops: speed of the "
    "first and of the fastest leg to meet one, in/s."
)


def _load_fields(phase: str, title: str) -> list[Field]:
    return [
        Field(f"load_{phase}_n", title, ".1f", "kN", of=f"load.{phase}.value"),
        Field(f"load_{phase}_multiple", "\nx", ".2f", of=f"multiples.{phase}"),
        Field(f"load_{phase}_leg", of=f"load.{phase}.leg", printed=False),
    ]


def _crew_field(phase: str, title: str) -> Field:
    return Field(
        f"crew_acceleration_{phase}_m_s2", title, ".2f", "g", of=f"acceleration.{phase}.value"
    )


FAILURE_FIELDS = (
    Field("", "event", of=lambda row: row.label.replace("-", " ")),
    Field("event", of="event.kind", printed=False),
    Field("leg", of="event.leg", printed=False),
    Field("valve", of="event.valve", printed=False),
    Field("size_si", of="size", printed=False),
    Field("at_s", of="event.at", printed=False),
    Field("law", of="record.metadata.law", printed=False),
    Field("cab", of="record.metadata.cab", printed=False),
    Field("hydraulics", of="record.metadata.hydraulics", printed=False),
    *(Field(name, printed=False) for name in ("dof", "protected")),
    *_load_fields("before", "load\nbefore"),
    *_load_fields("free", "\nafter"),
    *_load_fields("after", "\nall"),
    _crew_field("before", "crew\nbefore"),
    _crew_field("free", "\nafter"),
    _crew_field("after", "\nall"),
    Field("detected_by", "found\nby"),
    Field("detection_time_s", "\nafter", ".4f", of="detection_time"),
    Field("state", "ends"),
    Field("supply_pressure_least_pa", "supply\nleast", ".0f", "psi", of="supply_least.value"),
    Field("chamber_pressure_least_pa", "chamber\nleast", ".0f", "psi", of="pressure_least.value"),
    Field("chamber_pressure_most_pa", "\nmost", ".0f", "psi", of="pressure_peak.value"),
    Field("stop_speed_first_m_s", "stops\nfirst", ".1f", "in/s", of="contact_speed.value"),
    Field("stop_speed_fastest_m_s", "\nfastest", ".1f", "in/s", of="impact_speed.value"),
    Field("message", printed=False),
)


def measure_failure(
    plant: Hexapod,
    event: Event,
    dof: str,
    protected: bool,
    record: Record,
    *,
    message: str = "",
    usual_error: float | None = None,
) -> FailureResult:
    """All measures of a run recorded at every frame.

    The record is as `simulate` returns it; `message` says what left its bounds; `usual_error` is
    how far legs are off their demand without the event [m], by default before it.
    """
    time = record.time[:-1]
    load, acceleration = _axial_load(record), _crew_acceleration(record, plant)
    contact, impact = _contacts(record, plant)
    after = time >= event.at
    free = after if contact is None else after & (time < contact.time)

    def phases(values: Array) -> Phases:
        return Phases(
            before=_extreme(time, values, ~after, np.abs),
            after=_extreme(time, values, after, np.abs),
            free=_extreme(time, values, free, np.abs),
        )

    chambers = np.stack([_frames(record, f"{side}_pressure") for side in ("cap", "rod")], axis=2)
    fault = record.metadata["fault"]
    if usual_error is None:
        usual_error = float(_demand_error(record)[record.time < event.at].max(initial=0.0))
    state = "out_of_bounds"
    if not message:
        state = _final_state(record, plant, event.at, usual_error, contact)
    return FailureResult(
        event=event,
        size=event.magnitude(plant.machine.half_stroke),
        dof=dof,
        protected=protected,
        static_load=record["leg_force"][0].copy(),
        load=phases(load),
        acceleration=phases(np.linalg.norm(acceleration, axis=1)),
        detected_by=fault["name"] if fault else None,
        detection_time=fault["time"] - event.at if fault else None,
        state=state,
        message=message,
        pressure_peak=_extreme(time, chambers.max(axis=2), after),
        pressure_least=_extreme(time, chambers.min(axis=2), after, np.negative),
        supply_least=_extreme(time, _frames(record, "supply_pressure"), after, np.negative),
        contact_speed=contact,
        impact_speed=impact,
        record=_kept_record(record, plant, load, acceleration),
    )


def _extreme(time: Array, values: Array, mask: Mask, measure: np.ufunc = np.positive) -> Peak:
    """The value of the largest measure among the masked rows of (N,) or (N, legs); NaN for none."""
    rows = np.flatnonzero(mask)
    if rows.size == 0:
        return Peak(float("nan"), float("nan"))
    candidates = values[rows]
    row, *leg = np.unravel_index(int(np.argmax(measure(candidates))), candidates.shape)
    value = float(candidates[row, *leg])
    return Peak(value, float(time[rows[row]]), int(leg[0]) + 1 if leg else None)


def _frames(record: Record, channel: str) -> Array:
    """A channel at all frames but the last, (N - 1, ...)."""
    return record[channel][1:] if channel in _LATE_CHANNELS else record[channel][:-1]


def _axial_load(record: Record) -> Array:
    """Axial loads of the legs [N], (N - 1, 6)."""
    stop = np.sign(_frames(record, "leg_extension")) * _frames(record, "stop_force")
    return np.asarray(_frames(record, "leg_force") - stop)


def _crew_acceleration(record: Record, plant: Hexapod) -> Array:
    """Acceleration at the crew's heads in world axes, z up [m/s^2], (N - 1, 3)."""
    first = plant.model.joint("platform").qposadr[0] + 3  # after the three of its place
    quaternion = _frames(record, "generalised_position")[:, first : first + 4]
    turn = Rotation.from_quat(quaternion, scalar_first=True)
    force = turn.apply(_frames(record, "crew_accelerometer").copy())
    return np.asarray(force + plant.model.opt.gravity)


def _kept_record(record: Record, plant: Hexapod, load: Array, acceleration: Array) -> Record:
    """The record at `_RECORD_RATE`, with axial loads and acceleration of the crew."""
    row_frames = frames_a_row(plant.machine, _RECORD_RATE)
    rows = slice(0, len(load), row_frames)
    channels = {**record.channels, "axial_load": load, "crew_acceleration": acceleration}
    channels = {name: values[rows] for name, values in channels.items()}
    own_units = {**record.units, "axial_load": "N", "crew_acceleration": "m/s^2"}
    metadata = {**record.metadata, "sample_rate": record.rate / row_frames}
    return Record(record.time[rows], channels, own_units, metadata)


def _contacts(record: Record, plant: Hexapod) -> tuple[Peak | None, Peak | None]:
    """The first and the fastest contact of a leg with a stop, by its speed the frame before."""
    time, extension = record.time[:-1], _frames(record, "leg_extension")
    on_stop = np.abs(extension) >= plant.hydraulics.cylinder.half_stroke
    is_contact = on_stop[2:] & ~on_stop[1:-1]
    has_contact = is_contact.any(axis=1)
    if not has_contact.any():
        return None, None
    travel = np.abs(np.diff(extension, axis=0))[:-1]
    speed = np.where(is_contact, travel / plant.machine.frame, -1.0)
    is_first = np.arange(has_contact.size) == has_contact.argmax()
    return _extreme(time[2:], speed, is_first), _extreme(time[2:], speed, has_contact)


def _demand_error(record: Record) -> Array:
    """How far legs are off their demand [m], (N, 6)."""
    return np.abs(record["leg_reference"] - record["leg_extension"])


def _final_state(
    record: Record, plant: Hexapod, at: float, usual_error: float, contact: Peak | None
) -> str:
    """The final state of a run that stayed in bounds, with an event `at`; see the module."""
    time, extension = record.time, record["leg_extension"]
    half_stroke = plant.hydraulics.cylinder.half_stroke
    last_second = extension[time >= time[-1] - 1.0]
    is_still = bool((np.ptp(last_second, axis=0) < _REST_SWING).all())
    on_stop = np.abs(extension[-1]) > half_stroke - _STOP_GAP
    if is_still and (on_stop & (extension[-1] < 0.0)).all():
        fall_speed = FALL_RATIO * plant.parameters.settle_speed.si
        return "fallen" if contact is not None and contact.value > fall_speed else "settled"
    if is_still and on_stop.any():
        return "against_stop"
    final = time >= max(time[-1] - 2.0 * REST - FADE, at)
    final_error = float(_demand_error(record)[final].max())
    if final_error <= 2.0 * usual_error + _REST_SWING:
        return "running"
    if final_error <= LARGEST_ERROR * half_stroke.min():
        return "degraded"
    return "holding" if is_still else "moving"


_TRANSLATION, _ROTATION = 6.0 * units.INCH, 4.0 * units.DEGREE  #: Default amplitudes on the CMF.
FREQUENCY = 0.5  #: Default frequency of the manoeuvre [Hz]; 6 in then move a leg at 16 in/s.
TIME_AFTER_EVENT = 26.0  #: Default length of a run after the event [s]; a lost pump shows at 11 s.


def faded_sine(dof: str, amplitude: float, frequency: float, *, at: float, after: float) -> Command:
    """The sine of a failure run, faded in and out, and two seconds of rest.

    `amplitude` is in m or rad, `frequency` in Hz; the event comes `at`, the run ends `after` it, at
    least 4 s later [s].
    """
    check_positive(frequency=frequency)
    if not 0.0 <= at < np.inf:
        raise InputError(f"at: {at} must be a finite number, at least 0")
    if not after >= 2.0 * REST:
        raise InputError(f"after: {after} s must be at least {2.0 * REST:g} s")
    cycles = (at + after - REST) * frequency
    return sine(dof, amplitude, frequency, cycles=cycles, fade=FADE, rest=REST)


def run_failure(
    event: Event,
    case: Case | None = None,
    *,
    frequency: float = FREQUENCY,
    after: float = TIME_AFTER_EVENT,
    command: Command | ArrayLike | None = None,
    protection: str | Path | ProtectionSettings | None = "default",
) -> FailureResult:
    """Run one event and measure what it does.

    `case` names law, hexapod, degree of freedom and amplitude of the manoeuvre's sine (default 6 in
    or 4 deg in heave with velocity feedback, the GFD, the `hardware` set), about its pose, and has
    its electronics and delay; `after` is the length of the run after the event [s]. `command`, or
    poses (N, 6) at the machine's control rate, stands in for the sine and must be longer than
    `event.at`. `protection` is `default`, a TOML file, or None for none.
    """
    case = case or make_case("velocity")
    check_name("plant", case.plant, [Hexapod.name])
    plant = Hexapod(case.cab, case.hydraulics)
    if command is None:
        command = _case_sine(case, frequency, event.at, after)
    command = as_command(command, plant.machine.rate)
    length = (command.pose.shape[0] - 1) * plant.machine.frame
    if not event.at < length:
        raise InputError(f"at: {event.at} s must be within the run of {length:g} s")
    message, usual_error = "", None
    options: dict[str, Any] = {"electronics": case.electronics, "command_delay": case.command_delay}
    with_event = options | {"events": [event], "protection": protection}
    try:
        record = simulate(plant, case.law, command, **with_event)
    except OutOfBounds as error:
        # The same run again, up to the frame before.
        message = str(error)
        shorter = Command(command.pose[: max(error.frame, 2)], command.signal, command.seed)
        record = simulate(plant, case.law, shorter, **with_event)
    if event.at < FADE and not message:
        usual_error = float(_demand_error(simulate(plant, case.law, command, **options)).max())
    outcome: dict[str, Any] = {"message": message, "usual_error": usual_error}
    return measure_failure(plant, event, case.dof, protection is not None, record, **outcome)


def _case_sine(case: Case, frequency: float, at: float, after: float) -> Command:
    """The sine of a case about its pose, within the limits of the machine."""
    default = by_kind(case.dof, _TRANSLATION, _ROTATION)
    amplitude = case.amplitude or default * relative_travel(case.motion_base, case.dof)
    command = faded_sine(case.dof, amplitude, frequency, at=at, after=after)
    command = Command(command.pose + np.asarray(case.pose), command.signal, command.seed)
    check_travel(command, machine=case.motion_base)
    return command


def run_failures(
    events: Sequence[Event], case: Case | None = None, *, jobs: int | None = None, **options: Any
) -> Result[FailureResult]:
    """Run several events with the options of `run_failure`, each on a new machine, on threads."""
    if not events:
        raise InputError("events: is empty; name at least one event")
    results = on_threads(lambda event: run_failure(event, case, **options), events, jobs)
    first, *_ = results
    about = {name: first.record.metadata[name] for name in ("law", "cab", "hydraulics")}
    title = "{law} in {dof}, {cab} cab, {hydraulics} hydraulics, {setting}"
    title = title.format(dof=first.dof, setting=first.setting, **about)
    return Result(results, FAILURE_FIELDS, title, _LEGEND, about)
