"""The facility in operation: host frames to the legs through the whole chain of Figures 2-5 to 2-7.

    host -> DCU -> platform limits -> demand -> operating states -> leg limits -> DCL
         -> servo electronics -> valves -> machine -> sensors -> ADC -> DCL

`operate` runs frames as fast as it can; `serve` runs the machine in real time on frames from the
network. On the frames of an `Operation` `operate` gives the same demand bit for bit.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.dcu.play import Arrivals
from cmf_mj.control.law import Law
from cmf_mj.core.errors import InputError
from cmf_mj.core.units import FRAME, LONGEST
from cmf_mj.facility.host.handover import NEVER, Ring, capacity_for, filled_log, make_log, make_ring
from cmf_mj.facility.host.stream import HostStream
from cmf_mj.facility.host.stream import arrivals as arrivals_of
from cmf_mj.facility.host_chain import HostChain, dcu_of
from cmf_mj.facility.pace import make_pace
from cmf_mj.facility.run import Run
from cmf_mj.facility.session import Session
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.record.record import Record

_CHAIN_OPTIONS = {"requests", *HostChain.model_fields}  #: Options of `operate` for the chain.
_WARM_UP_FRAMES = 8  #: Control frames of the run that compiles all code.


class Timing(NamedTuple):
    """How a run in real time kept up."""

    busy: NDArray[np.float64]  #: Computing time of each control frame [s], (N,).
    late: NDArray[np.float64]  #: How late each began [s], (N,).
    frame: float = FRAME  #: Control frame [s].

    @property
    def overrun_frames(self) -> int:
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
    arrivals: Arrivals  #: The host's frames as they arrived.
    counts: dict[str, int]  #: What the DCU made of the frames: accepted, late, missing and so on.
    rejections: dict[str, int]  #: Frames the DCU refused, by reason.
    unused: dict[str, int]
    """Frames received that never came to the DCU, of a run in real time: `early` before the clock
    started, `lost` between receiver and loop, `thinned` because newer frames came too fast."""
    timing: Timing | None  #: Of a run in real time.


Attendant = Callable[[Session], int]
"""Attends to a run between its parts; returns the control frames of the next."""


def operate(
    plant: Hexapod,
    law: str | Path | Law,
    frames: HostStream | Arrivals,
    *,
    seconds: float | None = None,
    progress: Callable[[float], None] | None = None,
    **options: Any,
) -> Operation:
    """Run the facility on a host's stream, or on frames with the control frame they arrive in.

    The run lasts some `seconds`, by default until the last frame has had its turn. The host's
    silence trips the host watchdog soon after. It begins at the first frame's pose, or at neutral
    if that is beyond the operational limits or the legs' working stroke.

    Args:
        plant: the machine.
        law: name, TOML file or loaded `Law`.
        frames: those of the host.
        seconds: length of the run.
        progress: called with the seconds run, about once a second.
        **options: fields of `Run`: `begin`, an operating state, and the operator's `requests`;
            `events`; `dcu`, `limits` and `states`; `electronics`, by default noisy,
            and `protection`, by default on, None for ideal and none; `record_every`;
            `command_delay`.
    """
    rate = plant.machine.rate
    arrivals = arrivals_of(frames, rate=rate) if isinstance(frames, HostStream) else frames
    if not arrivals.frame.size:
        raise InputError("frames: the host sends none; give at least one")
    if seconds is None:
        delays = dcu_of(plant.machine, options.get("dcu")).delay.parts(rate)
        seconds = float(arrivals.frame[-1] / rate + sum(delays.values()))
    session = _hosted_run(plant, law, arrivals, seconds, options).session()
    _run_to_end(session, progress)
    return _make_operation(session, arrivals, {}, None)


def serve(
    plant: Hexapod,
    law: str | Path | Law,
    ring: Ring,
    seconds: float,
    *,
    attend: Attendant | None = None,
    paced: bool = True,
    progress: Callable[[float], None] | None = None,
    **options: Any,
) -> Operation:
    """Run the facility in real time on frames that a receiver puts into a ring.

    Compiles and warms up first; the clock starts after that, when `progress` is called with 0. The
    ring is that of a `UdpReceiver`, or filled by `put`; the pose at the start is neutral. `attend`
    is called with the session between parts of the run and returns the control frames until its
    next call; if not `paced`, the run does not wait. `options` are those of
    `operate`; every 16th frame is recorded by default. Raises `OSError` on systems without a
    monotonic clock to keep time by.
    """
    machine, log = plant.machine, make_log(capacity_for(_WARM_UP_FRAMES, plant.machine.rate))
    run = _hosted_run(plant, law, log, seconds, {"record_every": 16, **options})
    warm_up = run.changed(duration=_WARM_UP_FRAMES / machine.rate)
    warm_up.session(ring=make_ring(2), pace=make_pace(_WARM_UP_FRAMES, machine.frame)).run()
    frames = max(round(seconds * machine.rate), 1)
    run = run.changed(source=make_log(capacity_for(frames, machine.rate)))
    pace = make_pace(frames, machine.frame) if paced else None
    session = run.session(ring=ring, pace=pace)
    if progress is not None:
        progress(0.0)
    lost_before, thinned_before = int(ring.lost[0]), int(ring.thinned[0])
    written = int(ring.written[0])
    early = written - int(ring.read[0])
    ring.read[0] = written
    _run_to_end(session, progress, attend)
    log = session.source.arrivals
    arrivals = filled_log(log, int((log.frame < NEVER).sum()))
    lost, thinned = int(ring.lost[0]) - lost_before, int(ring.thinned[0]) - thinned_before
    unused = {"early": early, "lost": lost, "thinned": thinned}
    timing = None if pace is None else Timing(pace.busy, pace.late, machine.frame)
    return _make_operation(session, arrivals, unused, timing)


def _hosted_run(
    plant: Hexapod,
    law: str | Path | Law,
    frames: Arrivals,
    seconds: float,
    options: Mapping[str, Any],
) -> Run:
    """A run on a host's frames, by default with noisy electronics and the protection."""
    if not 0.0 < seconds <= LONGEST:
        raise InputError(f"seconds: {seconds} is refused; allowed: above 0, up to {LONGEST:g}")
    chain: dict[str, Any] = {"begin": "engaged", "requests": ()}
    settings: dict[str, Any] = {"electronics": {}, "protection": "default", "duration": seconds}
    for name, option in options.items():
        (chain if name in _CHAIN_OPTIONS else settings)[name] = option
    run = Run(plant=plant, law=law, source=frames, **{"operation": chain} | settings)
    assert run.operation is not None
    return run.changed(start=run.operation.starting_pose(plant.machine, frames))


def _run_to_end(
    session: Session, progress: Callable[[float], None] | None, attend: Attendant | None = None
) -> None:
    """Run a session to its end, by default a second at a time."""
    reported_frame = 0
    while session.frame < session.frames:
        session.run(session.rate if attend is None else attend(session))
        report_frame = min(reported_frame + session.rate, session.frames)
        if progress is not None and session.frame >= report_frame:
            reported_frame = session.frame
            progress(session.frame / session.rate)


def _make_operation(
    session: Session, arrivals: Arrivals, unused: dict[str, int], timing: Timing | None
) -> Operation:
    time, channels, units = session.history()
    dcu_state = session.source.dcu_state
    metadata = session.describe()
    metadata["command"] = {"signal": "host frames", "frames": int(arrivals.frame.size)}
    metadata["host_late"] = float(channels["host_late"].mean()) * session.frame / session.rate
    record = Record(time, channels, units, metadata)
    return Operation(record, arrivals, dcu_state.counts, dcu_state.rejections, unused, timing)


def account(
    operation: Operation, received: int | None = None, datagrams: Mapping[str, int] | None = None
) -> dict[str, int]:
    """What became of the host's frames, counted.

    Every frame a host sends is in exactly one line of the account:

        received = early + lost + thinned + after the end + at the DCU
        at the DCU = accepted + refused, by reason + waiting for confirmation at the end

    `received` counts what the receiver put into its ring until it was closed, by default what came
    to the DCU; `datagrams` counts what it dropped, by reason. Both together are all datagrams that
    came to its port.
    """
    other_counts, refused = dict(operation.counts), dict(operation.rejections)
    accepted = other_counts.pop("accepted")
    frames_at_dcu = operation.arrivals.frame.size
    unused = {name: operation.unused.get(name, 0) for name in ("early", "lost", "thinned")}
    frames_in_run = frames_at_dcu + sum(unused.values())
    all_frames = frames_in_run if received is None else received
    return {
        "received": all_frames,
        **unused,
        "after_end": all_frames - frames_in_run,
        "accepted": accepted,
        "waiting": frames_at_dcu - accepted - sum(refused.values()),
        **refused,
        **(datagrams or {}),
        **other_counts,
    }
