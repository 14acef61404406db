"""The facility in operation: host frames to the legs through the whole chain of Figures 2-5 to 2-7.

    host -> DCU -> platform limits -> demand -> operating states -> leg limits -> DCL
         -> servo electronics -> valves -> machine -> sensors -> ADC -> DCL

`operate` runs recorded or made-up frames as fast as it can; `serve` runs the machine in real time
on frames from the network. Both give an `Operation`: the record, what became of the host's frames,
and the session, which run again gives the same demand bit for bit.
"""

from collections.abc import Callable, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple, TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control import limiter, states
from cmf_mj.control.dcu.arrivals import Arrivals
from cmf_mj.control.dcu.settings import DcuSettings, load_dcu, make_dcu
from cmf_mj.control.demand import Demand, make_demand
from cmf_mj.control.law import Law, load_law
from cmf_mj.control.protection import ProtectionSettings, load_protection
from cmf_mj.control.states import Request, State, StateSettings, load_state_settings
from cmf_mj.core.errors import InputError
from cmf_mj.core.rates import FRAME, LONGEST
from cmf_mj.core.units import INCH
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.front import Blocks, make_chain
from cmf_mj.facility.host.files import HostSession
from cmf_mj.facility.host.handover import (
    NEVER,
    Ring,
    capacity_for,
    logged,
    make_log,
    make_ring,
)
from cmf_mj.facility.host.stream import HostStream
from cmf_mj.facility.host.stream import arrivals as arrivals_of
from cmf_mj.facility.options import Options
from cmf_mj.facility.pace import Pace, make_pace
from cmf_mj.facility.session import Session
from cmf_mj.machine import kinematics
from cmf_mj.machine.limits import MotionLimits
from cmf_mj.machine.machine import Machine
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.plant.events import Event
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters.loading import fitting
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record

_RESTING = 0.05
"""What a leg on the stops is above its mechanical end [in]."""


class FacilitySettings(NamedTuple):
    """Choice of everything between host and valves; names, TOML files or loaded settings."""

    dcu: str | Path | DcuSettings | None = None  #: Digital Control Unit; default the machine's.
    limits: str | Path | MotionLimits | None = None
    """Limits of platform and legs; default Table 2-1 with the assumed rates."""
    states: str | Path | StateSettings | None = None  #: Operating states.
    demand: Demand | None = None  #: Leg demand, with body flexibility or without; default rigid.
    electronics: ElectronicsSettings | None = ElectronicsSettings()
    """Sensors, converters, servo electronics; None for ideal ones."""
    protection: str | Path | ProtectionSettings | None = "default"
    """Fault detection; None for none."""


class Timing(NamedTuple):
    """How a run in real time kept up."""

    busy: NDArray[np.float64]  #: Computing time of each control frame [s], (N,).
    late: NDArray[np.float64]  #: How late each began [s], (N,).
    frame: float = FRAME  #: Control frame [s].

    @property
    def over(self) -> int:
        """Frames that computed for longer than a control frame."""
        return int((self.busy > self.frame).sum())

    def percentile(self, share: float) -> float:
        """Computing time that a share of the frames, in per cent, stays below [s]."""
        return float(np.percentile(self.busy, share))


class Operation(NamedTuple):
    """What a run of the facility gave."""

    record: Record
    """All signals; `demand_pose`, its derivatives, `operating_state`, `host_stale`,
    `host_late`, `host_clock` (rate of the play clock) and `valve_gain` besides those of
    `simulate`."""
    session: HostSession  #: The host's frames as they arrived.
    counts: dict[str, int]  #: What the DCU made of the frames: accepted, late, missing and so on.
    rejections: dict[str, int]  #: Frames the DCU refused, by reason.
    unused: dict[str, int]
    """Frames received that never came to the DCU, of a run in real time: `early` before the clock
    started, `lost` between receiver and loop, `thinned` because newer ones came too fast."""
    timing: Timing | None  #: Of a run in real time.


class OperationOptions(TypedDict, total=False):
    """Options of `operate` and `serve`."""

    begin: State
    """Operating state to begin in: off, settled, hold or engaged, the default. Off and settled
    begin on the stops, the others at the first frame's pose, or neutral if that is beyond the
    operational limits or the legs' working stroke. Settled has its valves open from the first
    frame, so that a law whose balance is elsewhere jumps; off fades them in."""
    requests: Sequence[tuple[float, Request]]
    """Operator's requests and their times [s]; of one instant the last counts, after any trip."""
    events: Sequence[Event]  #: Failures on the time line.
    facility: FacilitySettings  #: Everything between host and valves.
    record_every: int  #: Keep one frame in this many; default 1, in real time 16.
    progress: Callable[[float], None] | None
    """Called with the seconds run, about once a second; in real time with 0 when the clock
    starts."""


Attendant = Callable[[Session], int]
"""Attends to a run between its parts; returns the control frames of the next."""


class Start(NamedTuple):
    """How a run of the chain begins, and what the operator does."""

    state: State  #: Operating state to begin in.
    pose: NDArray[np.float64]  #: Of the demand at the start, (6,) [m, rad].
    requests: Sequence[tuple[float, Request]] = ()  #: Operator's requests and their times [s].


def operate(
    plant: Hexapod,
    law: str | Path | Law,
    frames: HostStream | Arrivals,
    *,
    seconds: float | None = None,
    **options: Unpack[OperationOptions],
) -> Operation:
    """Run the facility on a host's stream, or on frames with the control frame they arrive in.

    The run lasts some `seconds`, by default until the last frame has had its turn. The host's
    silence trips the host watchdog soon after.
    """
    rate = plant.machine.rate
    arrivals = arrivals_of(frames, rate=rate) if isinstance(frames, HostStream) else frames
    if not arrivals.frame.size:
        raise InputError("frames: the host sends none; give at least one")
    settings = options.get("facility") or FacilitySettings()
    last = arrivals.frame[-1] / rate + sum(
        dcu_of(plant.machine, settings.dcu).delay.parts(rate).values()
    )
    count = _count(last if seconds is None else seconds, rate)
    pose = starting_pose(
        arrivals.values[0, 0], load_motion_limits(settings.limits, plant.machine), plant.machine
    )
    session = facility_session(
        plant, load_law(law), arrivals, settings, _start(options, pose), _options(options, count, 1)
    )
    _run(session, options)
    return _operation(session, arrivals, settings, pose, {}, None)


def serve(
    plant: Hexapod,
    law: str | Path | Law,
    ring: Ring,
    seconds: float,
    *,
    attend: Attendant | None = None,
    paced: bool = True,
    **options: Unpack[OperationOptions],
) -> Operation:
    """Run the facility in real time on frames that a receiver puts into a ring.

    Compiles and warms up first; the clock starts after that. The ring is that of a `UdpReceiver`,
    or filled by `put`; the pose at the start is neutral. `attend` is called with the session
    between parts of the run and returns the control frames until it wants to be called again; if
    not `paced`, the run does not wait. Raises `OSError` on systems without a monotonic
    clock to keep time by.
    """
    settings, loaded = options.get("facility") or FacilitySettings(), load_law(law)
    start = _start(options, np.zeros(6))

    def session_of(count: int, source: Ring, pace: Pace | None) -> Session:
        log = make_log(capacity_for(count, plant.machine.rate))
        run = _options(options, count, 16)
        return facility_session(plant, loaded, log, settings, start, run, ring=source, pace=pace)

    session_of(8, make_ring(2), make_pace(8)).run()
    count = _count(seconds, plant.machine.rate)
    pace = make_pace(count) if paced else None
    session = session_of(count, ring, pace)
    if (progress := options.get("progress")) is not None:
        progress(0.0)
    started, lost, thinned = (int(count[0]) for count in (ring.written, ring.lost, ring.thinned))
    unused = {"early": started - int(ring.read[0])}
    ring.read[0] = started
    _run(session, options, attend)
    log = session.chain.arrivals
    arrivals = logged(log, int((log.frame < NEVER).sum()))
    unused |= {"lost": int(ring.lost[0]) - lost, "thinned": int(ring.thinned[0]) - thinned}
    timing = None if pace is None else Timing(pace.busy, pace.late, plant.machine.frame)
    return _operation(session, arrivals, settings, start.pose, unused, timing)


def dcu_of(machine: Machine, source: str | Path | DcuSettings | None = None) -> DcuSettings:
    """A DCU fitted to a machine, by default the machine's."""
    return load_dcu(machine.dcu if source is None else source, fitting(machine))


def _start(options: OperationOptions, pose: NDArray[np.float64]) -> Start:
    return Start(options.get("begin", State.ENGAGED), pose, options.get("requests", ()))


def _options(options: OperationOptions, frames: int, every: int) -> Options:
    return Options(
        events=options.get("events", ()),
        record_every=options.get("record_every", every),
        frames=frames,
    )


def _run(session: Session, options: OperationOptions, attend: Attendant | None = None) -> None:
    """Run a session to its end, by default a second at a time."""
    progress, shown = options.get("progress"), 0
    while session.frame < session.frames:
        session.run(session.rate if attend is None else attend(session))
        if progress is not None and session.frame >= min(shown + session.rate, session.frames):
            shown = session.frame
            progress(session.frame / session.rate)


def starting_pose(
    pose: NDArray[np.float64], limits: MotionLimits, machine: Machine
) -> NDArray[np.float64]:
    """The pose, or neutral where the limits forbid it."""
    low, high = limits.operational.T
    inside = bool(((pose >= low) & (pose <= high)).all())
    if inside and np.abs(kinematics.pose_to_legs(pose, machine)).max() <= limits.leg.position.si:
        return np.array(pose)
    return np.zeros(6)


def _resting(machine: Machine) -> float:
    """Position of a leg on the stops [m]."""
    return -round(machine.half_stroke / INCH - _RESTING, 9) * INCH


def _count(seconds: float, rate: int) -> int:
    if not (np.isfinite(seconds) and seconds > 0.0):
        raise InputError(f"seconds: {seconds} must be greater than 0")
    if seconds > LONGEST:
        raise InputError(f"seconds: {seconds} must be at most {LONGEST:g}")
    return max(round(seconds * rate), 1)


def facility_session(
    plant: Plant,
    law: Law,
    arrivals: Arrivals,
    settings: FacilitySettings,
    start: Start,
    options: Options,
    *,
    ring: Ring | None = None,
    pace: Pace | None = None,
) -> Session:
    """A session of the whole chain from host to valves.

    With a ring of live frames `arrivals` is the log they are collected in. Start, protection and
    electronics of the `options` are those of `start` and `settings`.
    """
    options = options.checked()
    for one in start.requests:
        match one:
            case (int() | float() | np.integer() as at, Request()) if 0.0 <= at <= LONGEST:
                continue
        allowed = f"a time of 0 to {LONGEST:g} s and a Request"
        raise InputError(f"requests: {one!r} is refused; allowed: {allowed}")
    machine = plant.machine
    limits = load_motion_limits(settings.limits, machine)
    down = start.state in (State.OFF, State.SETTLED)
    legs = np.full(6, _resting(machine)) if down else kinematics.pose_to_legs(start.pose, machine)
    chain = make_chain(
        Blocks(
            make_dcu(dcu_of(machine, settings.dcu), machine.frame),
            limiter.make_pose_limiter(limits, machine.frame),
            settings.demand or make_demand(machine),
            states.make_states(load_state_settings(settings.states, fitting(machine)), machine),
            limiter.make_leg_limiter(limits, frame=machine.frame),
        ),
        arrivals,
        sorted(
            ((round(at * machine.rate), code) for at, code in start.requests), key=itemgetter(0)
        ),
        start.state,
        position=legs,
        pose=start.pose,
        ring=ring,
    )
    protection = settings.protection
    run = options._replace(
        start=kinematics.legs_to_pose(legs, machine) if down else start.pose,
        protection=None if protection is None else load_protection(protection, fitting(machine)),
        electronics=settings.electronics,
    )
    session = Session(plant, law, chain, run, pace)
    if down:
        session.forget_integral()
    return session


def _operation(
    session: Session,
    arrivals: Arrivals,
    settings: FacilitySettings,
    pose: NDArray[np.float64],
    unused: dict[str, int],
    timing: Timing | None,
) -> Operation:
    time, channels, units = session.history()
    chain, unit = session.chain, dcu_of(session.plant.machine, settings.dcu)
    counts, rejections = chain.dcu_state.counts, chain.dcu_state.rejections
    context: dict[str, Any] = {
        "command": {"signal": "host frames", "frames": int(arrivals.frame.size)},
        "seed": None,
        "dcu": unit.model_dump(mode="json"),
        "host_counts": counts,
        "host_rejections": rejections,
        "host_late": float(channels["host_late"].mean()) * session.frame / session.rate,
    }
    record = Record(time, channels, units, session.describe() | context)
    played = HostSession(arrivals, session.frame, pose, unit)
    return Operation(record, played, counts, rejections, unused, timing)


def account(
    operation: Operation,
    received: int | None = None,
    datagrams: Mapping[str, int] | None = None,
) -> dict[str, int]:
    """What became of the host's frames, counted.

    Every frame a host sends is in exactly one line of the account:

        received = early + lost + thinned + after the end + at the DCU
        at the DCU = accepted + refused, by reason + the one that waits for confirmation at the end

    `received` counts what the receiver put into its ring until it was closed, by default what came
    to the DCU; `datagrams` counts what it dropped, by reason. Both together are all datagrams that
    came to its port.
    """
    counts, refused = dict(operation.counts), dict(operation.rejections)
    arrived = operation.session.arrivals.frame.size
    unused = {name: operation.unused.get(name, 0) for name in ("early", "lost", "thinned")}
    before = arrived + sum(unused.values())
    all_frames = before if received is None else received
    accepted = counts.pop("accepted")
    return {
        "received": all_frames,
        **unused,
        "after_end": all_frames - before,
        "accepted": accepted,
        "waiting": arrived - accepted - sum(refused.values()),
        **refused,
        **(datagrams or {}),
        **counts,
    }
