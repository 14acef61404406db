"""Runs of one event each, in a sine from rest to rest, and what it does to legs and crew.

Before and after the event, at the full frame rate:

    axial leg load       cylinder force plus force of the mechanical stop on the rod; the multiple
                         is that of the same leg's static load at the start
    crew acceleration    a = R f + g, f what an accelerometer at the crew's heads reads: rotation of
                         the platform included, gravity removed

The final state is one of these:

    running        legs follow the demand to the end, at most twice as far off as before the event,
                   or as without it where it comes before the manoeuvre is faded in
    degraded       legs follow it within `FOLLOWING` half strokes
    holding        legs stand still off their stops
    moving         legs neither follow nor stand still when the run ends
    settled        all legs stand on their lower stops, the first met its at most at `FALL` times
                   the settle speed of the hydraulic set
    fallen         the same, the first came faster
    against_stop   some legs stand on a stop
    out_of_bounds  the state left its physical bounds; the message says which and where
"""

from collections.abc import Callable, Sequence
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
from cmf_mj.signals.peaks import check_limits
from cmf_mj.signals.signal import Command, check_positive, commanded
from cmf_mj.signals.single import sine
from cmf_mj.studies.case import Case, frames_a_row, make_case

REST = 2.0  #: Rest after the manoeuvre [s].

FADE = 1.0  #: Fade of the manoeuvre at both ends [s].

FALL = 2.5
"""Speed of the first leg at a stop, over the settle speed, above which the platform has fallen;
assumed: 10 in/s at the CMF."""

FOLLOWING = 6.0 / 38.0
"""Distance of a leg from its demand, over its half stroke, at which it no longer follows: 6 in of
the CMF, at which its protection finds a fault; of other machines nobody states one."""

_STILL = 1e-3
"""Swing of a leg over the last second, or distance from its demand, that counts as none [m]."""
_AT_STOP = 2e-3  #: Distance from a stop that counts as on it [m].
_ROWS = 256  #: Rows of the record kept a second, at least [Hz].


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

    event: Event  #: What failed.
    size: float  #: How much, in SI; 0 for kinds without a size.
    dof: str  #: Degree of freedom of the manoeuvre.
    protected: bool  #: Whether a detected fault made an emergency stop.
    static_load: NDArray[np.float64]  #: Axial loads at the start [N], (6,).
    load: Phases  #: Largest axial leg load [N], by size; negative pulls.
    acceleration: Phases  #: Largest crew acceleration [m/s^2].
    detected_by: str | None  #: First fault detected; None if there was none.
    detection_time: float | None
    """Time from the event to the fault [s]; negative for a false alarm."""
    state: str  #: How it ends, see the module.
    message: str  #: What left its bounds; empty otherwise.
    pressure_peak: Peak  #: Largest chamber pressure from the event on [Pa].
    pressure_least: Peak  #: Least chamber pressure from the event on [Pa], gauge.
    supply_least: Peak  #: Least pressure of the supply manifold from the event on [Pa].
    contact_speed: Peak | None  #: Speed at which the first leg met a stop [m/s]; none if none did.
    impact_speed: Peak | None
    """Largest speed at which a leg met a stop [m/s]. Legs that come later may come faster: the
    platform tips on those that stand."""
    record: Record
    """The run at 256 Hz, or as few more as make whole frames, with the channels of `simulate`, and
    `axial_load` and `crew_acceleration` (world axes, z up) among them."""

    @property
    def label(self) -> str:
        """The event in a few words, fit for a file name."""
        places = {"leg": self.event.leg, "valve": self.event.valve}
        known = (f"{name}_{place}" for name, place in places.items() if place is not None)
        return "-".join([self.event.kind, *known])

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


def _loads(phase: str, title: str) -> list[Field]:
    return [
        Field(f"load_{phase}_n", title, ".1f", "kN", of=f"load.{phase}.value"),
        Field(f"load_{phase}_multiple", "\nx", ".2f", of=f"multiples.{phase}"),
        Field(f"load_{phase}_leg", of=f"load.{phase}.leg", printed=False),
    ]


def _crew(phase: str, title: str) -> Field:
    return Field(
        f"crew_acceleration_{phase}_m_s2", title, ".2f", "g", of=f"acceleration.{phase}.value"
    )


FAILURES = (
    Field("", "event", of=lambda row: row.label.replace("-", " ")),
    Field("event", of="event.kind", printed=False),
    Field("leg", of="event.leg", printed=False),
    Field("valve", of="event.valve", printed=False),
    Field("size_si", of="size", printed=False),
    Field("at_s", of="event.at", printed=False),
    *(
        Field(name, of=f"record.metadata.{name}", printed=False)
        for name in ("law", "cab", "hydraulics")
    ),
    Field("dof", printed=False),
    Field("protected", printed=False),
    *_loads("before", "load\nbefore"),
    *_loads("free", "\nafter"),
    *_loads("after", "\nall"),
    _crew("before", "crew\nbefore"),
    _crew("free", "\nafter"),
    _crew("after", "\nall"),
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
    usual: float | None = None,
) -> FailureResult:
    """All measures of a run recorded at every frame.

    The record is as `simulate` returns it; `message` says what left its bounds; `usual` is how far
    legs are off their demand without the event [m], by default before it.
    """
    extension = record["leg_extension"][:-1]
    # MuJoCo's accelerometers and stop forces of t[k] stand in row k + 1.
    stop = record["stop_force"][1:]
    load = record["leg_force"][:-1] - np.sign(extension) * stop
    force = record["crew_accelerometer"][1:]
    start = plant.model.joint("platform").qposadr[0] + 3
    position = record["generalised_position"][:-1, start : start + 4]
    turn = Rotation.from_quat(position, scalar_first=True)
    acceleration = turn.apply(force.copy()) + plant.model.opt.gravity
    time = record.time[:-1]
    after = time >= event.at
    chambers = np.stack([record["cap_pressure"][:-1], record["rod_pressure"][:-1]], axis=2)
    fault = record.metadata["fault"]
    contact, impact = _contacts(record, plant)
    free = after & (time < contact.time) if contact is not None else after

    def phases(values: NDArray[np.float64]) -> Phases:
        parts = (~after, after, free)
        return Phases(*(extreme(time, values, where, np.abs) for where in parts))

    every = frames_a_row(plant.machine, _ROWS)
    rows = slice(0, load.shape[0], every)
    channels = {name: values[rows] for name, values in record.channels.items()}
    channels |= {"axial_load": load[rows], "crew_acceleration": acceleration[rows]}
    named = {**record.units, "axial_load": "N", "crew_acceleration": "m/s^2"}
    metadata = {**record.metadata, "sample_rate": record.rate / every}
    if usual is None:
        usual = float(_off(record)[record.time < event.at].max(initial=0.0))
    state = "out_of_bounds" if message else _final_state(record, plant, event.at, usual, contact)
    return FailureResult(
        event=event,
        size=event.magnitude(plant.machine.half_stroke),
        dof=dof,
        protected=protected,
        static_load=record["leg_force"][0].copy(),
        load=phases(load),
        acceleration=phases(np.linalg.norm(acceleration, axis=1)),
        detected_by=fault and fault["name"],
        detection_time=fault and fault["time"] - event.at,
        state=state,
        message=message,
        pressure_peak=extreme(time, chambers.max(axis=2), after),
        pressure_least=extreme(time, chambers.min(axis=2), after, np.negative),
        supply_least=extreme(time, record["supply_pressure"][:-1], after, np.negative),
        contact_speed=contact,
        impact_speed=impact,
        record=Record(record.time[rows], channels, named, metadata),
    )


def extreme(
    time: NDArray[np.float64],
    values: NDArray[np.float64],
    where: NDArray[np.bool_],
    rank: Callable[[NDArray[np.float64]], NDArray[np.float64]] = np.positive,
) -> Peak:
    """The value of the largest rank of (N,) or (N, n) where asked; NaN if nowhere."""
    rows = np.flatnonzero(where)
    if rows.size == 0:
        return Peak(float("nan"), float("nan"))
    chosen = values[rows]
    place = np.unravel_index(int(np.argmax(rank(chosen))), chosen.shape)
    leg = int(place[1]) + 1 if len(place) > 1 else None
    return Peak(float(chosen[place]), float(time[rows[place[0]]]), leg)


def _contacts(record: Record, plant: Hexapod) -> tuple[Peak | None, Peak | None]:
    """The first and the fastest contact of a leg with a stop, by its speed the frame before."""
    time, extension = record.time[:-1], record["leg_extension"][:-1]
    on = np.abs(extension) >= plant.hydraulics.cylinder.half_stroke
    met = on[2:] & ~on[1:-1]
    rows = met.any(axis=1)
    if not rows.any():
        return None, None
    travel = np.abs(extension[1:-1] - extension[:-2])
    speed = np.where(met, travel / plant.machine.frame, -1.0)
    first = np.arange(rows.size) == rows.argmax()
    return extreme(time[2:], speed, first), extreme(time[2:], speed, rows)


def _off(record: Record) -> NDArray[np.float64]:
    """How far legs are off their demand [m], (N, 6)."""
    return np.abs(record["leg_reference"] - record["leg_extension"])


def _final_state(
    record: Record, plant: Hexapod, at: float, usual: float, contact: Peak | None
) -> str:
    """How a run with an event `at` ends that stayed in bounds."""
    time, extension = record.time, record["leg_extension"]
    half = plant.hydraulics.cylinder.half_stroke
    end = extension[-1]
    last = extension[time >= time[-1] - 1.0]
    still = bool((np.ptp(last, axis=0) < _STILL).all())
    on_stop = np.abs(end) > half - _AT_STOP
    if still and (on_stop & (end < 0.0)).all():
        fall = FALL * plant.parameters.settle_speed.si
        return "fallen" if contact is not None and contact.value > fall else "settled"
    if still and on_stop.any():
        return "against_stop"
    final = float(_off(record)[time >= max(time[-1] - 2.0 * REST - FADE, at)].max())
    if final <= 2.0 * usual + _STILL:
        return "running"
    if final <= FOLLOWING * half.min():
        return "degraded"
    return "holding" if still else "moving"


AMPLITUDES = (6.0 * units.INCH, 4.0 * units.DEGREE)
"""Default amplitude of the manoeuvre on the CMF in translation [m] and rotation [rad]."""

FREQUENCY = 0.5  #: Default frequency of the manoeuvre [Hz]; 6 in then move a leg at 16 in/s.

AFTER = 26.0
"""Default length of the run after the event [s]: pump lost, noticed after 11 s, and settled."""


def faded_sine(
    dof: str, amplitude: float, frequency: float, *, at: float, after: float = AFTER
) -> Command:
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
    after: float = AFTER,
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
    chosen = make_case("velocity") if case is None else case
    check_name("plant", chosen.plant, [Hexapod.name])
    plant = Hexapod(chosen.cab, chosen.hydraulics)
    machine, size = plant.machine, chosen.amplitude
    if size is None:
        size = by_kind(chosen.dof, *AMPLITUDES) * relative_travel(machine, chosen.dof)
    if command is None:
        command = faded_sine(chosen.dof, size, frequency, at=event.at, after=after)
        command = Command(command.pose + np.asarray(chosen.pose), command.signal, command.seed)
        check_limits(command, machine=machine)
    command = commanded(command, machine.rate)
    length = (command.pose.shape[0] - 1) * machine.frame
    if not event.at < length:
        raise InputError(f"at: {event.at} s must be within the run of {length:g} s")
    message, usual = "", None
    usually: dict[str, Any] = {
        "electronics": chosen.electronics,
        "command_delay": chosen.command_delay,
    }
    options = usually | {"events": [event], "protection": protection}
    try:
        record = simulate(plant, chosen.law, command, **options)
    except OutOfBounds as left:
        # The same run again, up to the frame before.
        message = str(left)
        shorter = Command(command.pose[: max(left.frame, 2)], command.signal, command.seed)
        record = simulate(plant, chosen.law, shorter, **options)
    if event.at < FADE and not message:
        usual = float(_off(simulate(plant, chosen.law, command, **usually)).max())
    how = (chosen.dof, protection is not None, record)
    return measure_failure(plant, event, *how, message=message, usual=usual)


def run_failures(
    events: Sequence[Event], case: Case | None = None, *, jobs: int | None = None, **options: Any
) -> Result[FailureResult]:
    """Run several events with the options of `run_failure`, each on a new machine, on threads."""
    if not events:
        raise InputError("events: is empty; name at least one event")
    results = on_threads(lambda event: run_failure(event, case, **options), events, jobs)
    first = results[0]
    about = {name: first.record.metadata[name] for name in ("law", "cab", "hydraulics")}
    title = "{law} in {dof}, {cab} cab, {hydraulics} hydraulics, {setting}"
    title = title.format(dof=first.dof, setting=first.setting, **about)
    return Result(results, FAILURES, title, _LEGEND, about)
