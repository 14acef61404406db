"""Failure study: one event during a manoeuvre, what the legs and the crew feel, how it ends.

The manoeuvre is a sine in one degree of freedom from rest to rest. The event strikes at a set
time; with protection on, the first detected fault makes an emergency stop. Measured, before and
after the event, at the full frame rate:

    axial leg load       cylinder force plus force of the mechanical stop on the rod; the multiple
                         is that of the same leg's static load at the start
    crew specific force  f at the crew's heads, what an accelerometer there reads
    crew acceleration    a = R f + g: rotation of the platform included, gravity removed

The final state is one of `STATES`:

    running        legs follow the demand to the end, at most twice as far off as before the event
    degraded       legs follow it within `FOLLOWING`
    holding        legs stand still off their stops
    moving         legs neither follow nor stand still when the run ends
    settled        all legs stand on their lower stops, the first met its at most at `FALL_SPEED`
    fallen         the same, the first came faster
    against_stop   some legs stand on a stop
    out_of_bounds  the state left its physical bounds; the message tells which and where
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cmf_mj import units
from cmf_mj.control.law import FRAME, Law, load_law
from cmf_mj.control.protection import ProtectionSettings, load_protection
from cmf_mj.events import Event
from cmf_mj.limits import check_limits
from cmf_mj.parameters import HydraulicParameters, load_hydraulics
from cmf_mj.plant import Hexapod
from cmf_mj.record import Record
from cmf_mj.signals import Command, check_not_negative, check_positive, dof_index, sine
from cmf_mj.simulation import OutOfBounds, simulate

AMPLITUDES = (6.0 * units.INCH, 4.0 * units.DEGREE)
"""Default amplitude of the manoeuvre in translation [m] and rotation [rad]."""

FREQUENCY = 0.5
"""Default frequency of the manoeuvre [Hz]; 6 in then move a leg at 16 in/s."""

AT = 4.0
"""Default time of the event [s]: after the fade-in, at the largest speed of the default sine."""

AFTER = 26.0
"""Default length of the run after the event [s]: pump lost, noticed after 11 s, and settled."""

FALL_SPEED = 10.0 * units.INCH
"""Speed of the first leg at a stop above which the platform has fallen, not settled [m/s]; assumed,
two and a half times the settle speed."""

FOLLOWING = 6.0 * units.INCH
"""Distance of a leg from its demand at which it no longer follows [m]; the default protection's."""

STATES = (
    "running",
    "degraded",
    "holding",
    "moving",
    "settled",
    "fallen",
    "against_stop",
    "out_of_bounds",
)
"""How a run may end."""

_REST = 2.0
"""Rest after the manoeuvre [s]."""
_FADE = 1.0
"""Fade of the manoeuvre at both ends [s]."""
_STILL = 1e-3
"""Swing of a leg over the last second, or distance from its demand, that counts as none [m]."""
_AT_STOP = 2e-3
"""Distance from a stop that counts as on it [m]."""
_KEEP = 8
"""Frames from row to row of the record kept."""


class Peak(NamedTuple):
    """An extreme value."""

    value: float
    """In SI."""
    time: float
    """When [s]."""
    leg: int | None = None
    """Leg it belongs to, from 1."""


class FailureResult(NamedTuple):
    """What an event did."""

    event: Event
    """What failed."""
    dof: str
    """Degree of freedom of the manoeuvre."""
    protected: bool
    """Whether a detected fault made an emergency stop."""
    static_load: NDArray[np.float64]
    """Axial loads at the start [N], (6,)."""
    load_before: Peak
    """Largest axial leg load [N] before the event, by size."""
    load_after: Peak
    """The same from the event on; negative pulls."""
    load_free: Peak
    """The same from the event until the first leg meets a stop."""
    acceleration_before: Peak
    """Largest crew acceleration before the event [m/s^2]."""
    acceleration_after: Peak
    """The same from the event on."""
    acceleration_free: Peak
    """The same from the event until the first leg meets a stop."""
    specific_force_before: Peak
    """Largest specific force on the crew before the event [m/s^2]; 1 g at rest."""
    specific_force_after: Peak
    """The same from the event on."""
    detected_by: str | None
    """Fault that was found first; none if nothing was."""
    detection_time: float | None
    """Time from the event to the fault [s]; negative for a false alarm."""
    state: str
    """One of `STATES`."""
    message: str
    """What left its bounds; empty otherwise."""
    pressure_peak: Peak
    """Largest chamber pressure from the event on [Pa]."""
    pressure_least: Peak
    """Least chamber pressure from the event on [Pa], gauge."""
    supply_least: Peak
    """Least pressure of the supply manifold from the event on [Pa]."""
    contact_speed: Peak | None
    """Speed at which the first leg met a stop [m/s]; none if none did."""
    impact_speed: Peak | None
    """Largest speed at which a leg met a stop [m/s]. Legs that come later may come faster: the
    platform tips on those that stand."""
    record: Record
    """The run at 256 Hz, with the channels of `simulate`, and `axial_load` and
    `crew_acceleration` (world axes, z up) among them."""

    def multiple(self, load: Peak) -> float:
        """A load over the static load of its leg."""
        return load.value / float(self.static_load[(load.leg or 1) - 1])


def manoeuvre(
    dof: str, amplitude: float, frequency: float, *, at: float, after: float = AFTER
) -> Command:
    """The sine of a failure run, faded in and out, and two seconds of rest.

    Args:
        dof: degree of freedom.
        amplitude: of the sine [m or rad].
        frequency: of the sine [Hz].
        at: time of the event [s].
        after: length of the run after the event [s], at least 4 s.

    Raises:
        ValueError: an argument out of range, or the motion exceeds the machine's limits.
    """
    check_positive(frequency=frequency)
    check_not_negative(at=at)
    if not after >= 2.0 * _REST:
        raise ValueError(f"after: {after} s must be at least {2.0 * _REST:g} s")
    cycles = (at + after - _REST) * frequency
    moving = sine(dof, amplitude, frequency, cycles=cycles, fade=_FADE)
    rest = np.zeros((round(_REST / FRAME), 6))
    command = Command(np.vstack([moving.pose, rest]), {**moving.description, "rest": _REST}, None)
    check_limits(command)
    return command


def run_failure(
    event: Event,
    plant: Hexapod | None = None,
    law: str | Path | Law = "velocity",
    dof: str = "heave",
    amplitude: float | None = None,
    frequency: float = FREQUENCY,
    *,
    after: float = AFTER,
    command: Command | None = None,
    protection: str | Path | ProtectionSettings | None = "default",
) -> FailureResult:
    """Run one event and measure what it does.

    Args:
        event: what fails, where, when and how much.
        plant: default the hexapod with the GFD and the `hardware` set.
        law: name, TOML file or loaded law.
        dof: degree of freedom of the manoeuvre.
        amplitude: of its sine [m or rad]; default 6 in or 4 deg.
        frequency: of its sine [Hz].
        after: length of the run after the event [s].
        command: another manoeuvre in place of the sine; it must be longer than `event.at`.
        protection: `default`, a TOML file, or None for no protection.

    Raises:
        ValueError: an argument out of range, named.
    """
    machine = Hexapod() if plant is None else plant
    loaded = load_law(law)
    size = _amplitude(dof, amplitude)
    run = manoeuvre(dof, size, frequency, at=event.at, after=after) if command is None else command
    frames = run.pose.shape[0]
    if not event.at < (frames - 1) * FRAME:
        raise ValueError(
            f"at: {event.at} s must be less than the run of {(frames - 1) * FRAME:g} s"
        )
    message = ""
    try:
        record = simulate(machine, loaded, run, events=[event], protection=protection)
    except OutOfBounds as left:
        # The same run again, up to the frame before.
        message = str(left)
        shorter = Command(run.pose[: max(left.frame, 2)], run.description, run.seed)
        record = simulate(machine, loaded, shorter, events=[event], protection=protection)
    return _measure(machine, event, dof, protection is not None, record, message)


def run_failures(
    events: Sequence[Event],
    *,
    cab: str = "gfd",
    hydraulics: str | Path | HydraulicParameters = "hardware",
    law: str | Path | Law = "velocity",
    dof: str = "heave",
    amplitude: float | None = None,
    frequency: float = FREQUENCY,
    after: float = AFTER,
    protection: str | Path | ProtectionSettings | None = "default",
    jobs: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[FailureResult]:
    """Run several events, each alone on a machine of its own, on threads.

    Args:
        events: one run each.
        cab: `gfd`, `rfd` or `ifd`.
        hydraulics: a set's name, a TOML file or a loaded set.
        law: as for `run_failure`.
        dof: as for `run_failure`.
        amplitude: as for `run_failure`.
        frequency: as for `run_failure`.
        after: as for `run_failure`.
        protection: as for `run_failure`.
        jobs: threads; default one a core. Results do not depend on it.
        progress: called with (runs done, runs in all) after each.

    Raises:
        ValueError: an argument out of range, named.
    """
    loaded, parameters = load_law(law), load_hydraulics(hydraulics)
    guard = None if protection is None else load_protection(protection)
    size = _amplitude(dof, amplitude)
    if jobs is not None and jobs < 1:
        raise ValueError(f"jobs: {jobs} must be at least 1")

    def one(index: int) -> tuple[int, FailureResult]:
        plant = Hexapod(cab, parameters)
        result = run_failure(
            events[index], plant, loaded, dof, size, frequency, after=after, protection=guard
        )
        return index, result

    found: dict[int, FailureResult] = {}
    pool = Parallel(n_jobs=jobs or -1, backend="threading", return_as="generator_unordered")
    for index, result in pool(delayed(one)(index) for index in range(len(events))):
        found[index] = result
        if progress is not None:
            progress(len(found), len(events))
    return [found[index] for index in range(len(events))]


def _amplitude(dof: str, amplitude: float | None) -> float:
    if amplitude is None:
        return AMPLITUDES[0] if dof_index(dof) < 3 else AMPLITUDES[1]
    dof_index(dof)
    check_positive(amplitude=amplitude)
    return amplitude


def _measure(
    plant: Hexapod, event: Event, dof: str, protected: bool, record: Record, message: str
) -> FailureResult:
    """All measures of a run recorded at every frame."""
    half = plant.hydraulics.cylinder.half_stroke
    extension = record["leg_extension"][:-1]
    # MuJoCo's accelerometers and stop forces of t[k] stand in row k + 1.
    stop = record["stop_force"][1:]
    load = record["leg_force"][:-1] - np.sign(extension) * stop
    force = record["crew_accelerometer"][1:]
    acceleration = _without_gravity(plant, record["generalised_position"][:-1], force)
    time = record.time[:-1]
    before, after = time < event.at, time >= event.at
    size = np.abs(load)
    felt, whole = np.linalg.norm(acceleration, axis=1), np.linalg.norm(force, axis=1)
    chambers = np.stack([record["cap_pressure"][:-1], record["rod_pressure"][:-1]], axis=2)
    fault = record.metadata["fault"]
    contact, impact = _contacts(time, extension, half)
    free = after & (time < contact.time) if contact is not None else after
    state = "out_of_bounds" if message else _final_state(record, event.at, half, contact)
    load_peaks = [
        peak._replace(value=_signed(peak, time, load))
        for peak in (_largest(time, size, where) for where in (before, after, free))
    ]
    return FailureResult(
        event=event,
        dof=dof,
        protected=protected,
        static_load=record["leg_force"][0].copy(),
        load_before=load_peaks[0],
        load_after=load_peaks[1],
        load_free=load_peaks[2],
        acceleration_before=_largest(time, felt, before),
        acceleration_after=_largest(time, felt, after),
        acceleration_free=_largest(time, felt, free),
        specific_force_before=_largest(time, whole, before),
        specific_force_after=_largest(time, whole, after),
        detected_by=fault and fault["name"],
        detection_time=fault and fault["time"] - event.at,
        state=state,
        message=message,
        pressure_peak=_largest(time, chambers.max(axis=2), after),
        pressure_least=_least(time, chambers.min(axis=2), after),
        supply_least=_least(time, record["supply_pressure"][:-1], after),
        contact_speed=contact,
        impact_speed=impact,
        record=_thinned(record, load, acceleration),
    )


def _without_gravity(
    plant: Hexapod, position: NDArray[np.float64], force: NDArray[np.float64]
) -> NDArray[np.float64]:
    """A = R f + g in the world's axes, (N, 3)."""
    start = plant.model.joint("platform").qposadr[0] + 3
    turn = Rotation.from_quat(position[:, start : start + 4], scalar_first=True)
    return turn.apply(force.copy()) + plant.model.opt.gravity


def _signed(peak: Peak, time: NDArray[np.float64], load: NDArray[np.float64]) -> float:
    """The load (N, n) at a peak of its size."""
    if peak.leg is None:
        return peak.value
    return float(load[np.searchsorted(time, peak.time), peak.leg - 1])


def _largest(
    time: NDArray[np.float64], values: NDArray[np.float64], where: NDArray[np.bool_]
) -> Peak:
    """The largest of (N,) or (N, n) values where asked; NaN if nowhere."""
    rows = np.flatnonzero(where)
    if rows.size == 0:
        return Peak(float("nan"), float("nan"))
    chosen = values[rows]
    place = np.unravel_index(int(np.argmax(chosen)), chosen.shape)
    leg = int(place[1]) + 1 if len(place) > 1 else None
    return Peak(float(chosen[place]), float(time[rows[place[0]]]), leg)


def _least(
    time: NDArray[np.float64], values: NDArray[np.float64], where: NDArray[np.bool_]
) -> Peak:
    peak = _largest(time, -values, where)
    return peak._replace(value=-peak.value)


def _contacts(
    time: NDArray[np.float64], extension: NDArray[np.float64], half: NDArray[np.float64]
) -> tuple[Peak | None, Peak | None]:
    """The first and the fastest contact of a leg with a stop, by its speed the frame before."""
    on = np.abs(extension) >= half
    met = on[2:] & ~on[1:-1]
    frames = np.flatnonzero(met.any(axis=1))
    if frames.size == 0:
        return None, None
    speed = np.where(met, np.abs(extension[1:-1] - extension[:-2]) / FRAME, -1.0)
    every = np.ones(met.shape[0], dtype=bool)
    first = np.arange(met.shape[0]) == frames[0]
    return _largest(time[2:], speed, first), _largest(time[2:], speed, every)


def _final_state(record: Record, at: float, half: NDArray[np.float64], contact: Peak | None) -> str:
    """One of `STATES` for a run that stayed in bounds."""
    time, extension = record.time, record["leg_extension"]
    end = extension[-1]
    last = extension[time >= time[-1] - 1.0]
    still = bool((np.ptp(last, axis=0) < _STILL).all())
    on_stop = np.abs(end) > half - _AT_STOP
    if still and (on_stop & (end < 0.0)).all():
        fell = contact is not None and contact.value > FALL_SPEED
        return "fallen" if fell else "settled"
    if still and on_stop.any():
        return "against_stop"
    error = np.abs(record["leg_reference"] - extension)
    usual = float(error[time < at].max(initial=0.0))
    final = float(error[time >= max(time[-1] - 2.0 * _REST - _FADE, at)].max())
    if final <= 2.0 * usual + _STILL:
        return "running"
    if final <= FOLLOWING:
        return "degraded"
    return "holding" if still else "moving"


def _thinned(
    record: Record, load: NDArray[np.float64], acceleration: NDArray[np.float64]
) -> Record:
    """A record of fewer rows, with the channels of this study."""
    rows = slice(0, load.shape[0], _KEEP)
    channels = {name: values[rows] for name, values in record.channels.items()}
    channels |= {"axial_load": load[rows], "crew_acceleration": acceleration[rows]}
    named = {**record.units, "axial_load": "N", "crew_acceleration": "m/s^2"}
    metadata = {**record.metadata, "sample_rate": record.rate / _KEEP}
    return Record(record.time[rows], channels, named, metadata)
