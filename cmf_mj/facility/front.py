"""Sources of the leg reference: a table made before the run, or the chain of Figure 2-5.

host frames -> DCU -> platform limits -> demand -> operating states -> leg limits -> reference
"""

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control import demand, limiter, states
from cmf_mj.control.dcu import play
from cmf_mj.control.dcu.acceptance import host_is_late
from cmf_mj.control.dcu.play import Arrivals, feed, has_strayed
from cmf_mj.control.dcu.state import Dcu, DcuState, make_dcu, resting
from cmf_mj.control.protection import FaultCode
from cmf_mj.control.states import Request, State
from cmf_mj.core.arrays import record_array
from cmf_mj.core.compiled import compiled, inlined
from cmf_mj.facility.host.handover import Ring, collect, make_log, make_ring
from cmf_mj.machine.geometry import Geometry
from cmf_mj.machine.machine import geometry_of
from cmf_mj.machine.models import CMF


class Blocks(NamedTuple):
    """Compiled parameters of the chain's blocks, in signal order."""

    dcu: Dcu
    pose_limits: limiter.Limiter
    geometry: Geometry
    states: states.States
    leg_limits: limiter.Limiter


class Progress(NamedTuple):
    """Present state of the chain, but for its blocks."""

    arrival: int = 0  #: Number of the next arrival.
    collected: int = 0  #: Arrivals collected.
    request: int = Request.NONE.value  #: Request in force.
    state: int = State.OFF.value  #: Operating state.
    reset: int = 0  #: Whether a fault has just been reset.
    fault: int = FaultCode.NONE.value  #: Code of a fault of operating states or DCU.


class Source(NamedTuple):
    """A table, and compiled parameters, states and workspace of the chain."""

    hosted: bool  #: Whether the reference comes through the chain; from the table otherwise.
    table: NDArray[np.float64]
    """Leg references [m], or valve commands as fractions in open loop, (N, n); its first row
    follows its last."""
    poses: NDArray[np.float64]
    """Platform demand of the table's rows [m, rad], (N, 6); (1, 0) where there is none."""
    blocks: Blocks
    dcu_state: DcuState
    pose_state: limiter.LimiterState
    operating: states.OperatingState
    leg_state: limiter.LimiterState
    arrivals: Arrivals  #: Host frames, known before the run or collected while it goes.
    live: bool  #: Whether the arrivals are collected from the ring.
    ring: Ring  #: Hand-over from the receiving thread.
    request_frame: NDArray[np.int64]  #: Control frames of the operator's requests, (m,).
    request: NDArray[np.int64]  #: What is requested, `states.Request`, (m,).
    progress: np.recarray[Any, Any]  #: `Progress`, (1,).
    motion: NDArray[np.float64]  #: Platform demand within its limits and its derivatives, (3, 6).
    legs: NDArray[np.float64]  #: Leg demand and its derivatives, (3, 6).
    reference: NDArray[np.float64]  #: Leg reference and its derivatives, (3, 6).


def _read_only(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """A read-only view, so that one compiled loop takes writable and read-only arrays."""
    view = np.ascontiguousarray(rows).view()
    view.flags.writeable = False
    return view


def from_table(rows: NDArray[np.float64], poses: NDArray[np.float64] | None = None) -> Source:
    """References of the legs (N, n), and the platform demand (N, 6) that they are made of."""
    pose_rows = _read_only(np.empty((1, 0)) if poses is None else poses)
    return _idle_chain()._replace(hosted=False, table=_read_only(rows), poses=pose_rows)


def from_host(
    blocks: Blocks,
    arrivals: Arrivals,
    requests: Sequence[tuple[int, Request]],
    begin: State,
    *,
    position: NDArray[np.float64],
    pose: NDArray[np.float64],
    ring: Ring | None = None,
) -> Source:
    """The chain when it has been in the operating state `begin` for a long time.

    Its legs are at `position` (6,) [m], and the demand's pose is `pose` (6,). Requests are control
    frame and request in order of time. With a ring of live frames `arrivals` is an empty log.
    """
    operating = states.start(blocks.states, begin, position)
    reference = np.zeros((3, 6))
    on_stops = begin in (State.OFF, State.SETTLED)
    reference[0] = -blocks.states.travel if on_stops else operating.hold_position
    return Source(
        hosted=True,
        table=_read_only(reference[:1].copy()),
        poses=_read_only(np.empty((1, 0))),
        blocks=blocks,
        dcu_state=resting(blocks.dcu, pose),
        pose_state=limiter.start(blocks.pose_limits, pose),
        operating=operating,
        leg_state=limiter.start(blocks.leg_limits, reference[0]),
        arrivals=arrivals,
        live=ring is not None,
        ring=ring or make_ring(2),
        request_frame=np.array([frame for frame, _ in requests], dtype=np.int64),
        request=np.array([int(code) for _, code in requests], dtype=np.int64),
        progress=record_array(Progress, [Progress(state=int(begin))]),
        motion=np.zeros((3, 6)),
        legs=np.zeros((3, 6)),
        reference=reference,
    )


@cache
def _idle_chain() -> Source:
    """The chain of the source of a table: nothing reads it or writes to it."""
    blocks = Blocks(
        make_dcu(),
        limiter.make_pose_limiter(),
        geometry_of(CMF),
        states.make_states(),
        limiter.make_leg_limiter(),
    )
    rest = np.zeros(6)
    return from_host(blocks, make_log(1), (), State.HOLD, position=rest, pose=rest)


@compiled
def _run_chain(source, frame, position, fault, tripped, reference):  # type: ignore[no-untyped-def]
    blocks, progress = source.blocks, source.progress[0]
    for i in range(source.request_frame.shape[0]):
        if source.request_frame[i] == frame:
            progress.request = source.request[i]
            tripped = tripped or source.request[i] == Request.TRIP.value
    request, state_before = progress.request, progress.state
    was_in_fault = state_before == State.FAULT.value
    resets = request == Request.RESET.value and was_in_fault
    if (fault != FaultCode.NONE.value or tripped) and not resets:
        request = Request.TRIP.value
    if source.live:
        rate = round(1.0 / blocks.dcu.frame)
        progress.collected = collect(source.ring, source.arrivals, progress.collected, frame, rate)
    progress.arrival = feed(blocks.dcu, source.dcu_state, source.arrivals, progress.arrival, frame)
    motion, legs, leg_reference = source.motion, source.legs, source.reference
    play.step(blocks.dcu, source.dcu_state, motion)
    limiter.step(blocks.pose_limits, source.pose_state, motion)
    demand.step(blocks.geometry, motion, legs)
    operating = source.operating
    progress.state = states.step(blocks.states, operating, request, legs, position, leg_reference)
    if was_in_fault and progress.state == State.OFF.value:
        progress.reset = 1
    progress.fault = FaultCode.NONE.value
    enters_fault = progress.state == State.FAULT.value and not was_in_fault
    if enters_fault and request != Request.TRIP.value:
        progress.fault = FaultCode.NOT_ARRIVED.value
    if progress.state == State.ENGAGED.value and has_strayed(source.dcu_state):
        progress.fault = FaultCode.HOST_RANGE.value
    limiter.step(blocks.leg_limits, source.leg_state, leg_reference)
    for leg in range(6):
        reference[leg] = leg_reference[0, leg]
    return operating.phase[0].gain


@inlined
def follow(source, frame, position, fault, tripped, reference):  # type: ignore[no-untyped-def]
    """Write the leg reference (n,) [m] of a frame; returns the gain on the valve command, 0 to 1.

    The chain goes by the legs' positions, the code of a fault, and whether something has tripped.
    """
    if source.hosted:
        return _run_chain(source, frame, position, fault, tripped, reference)
    row = frame % source.table.shape[0]
    for leg in range(reference.shape[0]):
        reference[leg] = source.table[row, leg]
    return 1.0


@compiled
def _record_chain(source, row, columns):  # type: ignore[no-untyped-def]
    for i in range(6):
        row[columns.demand_pose + i] = source.motion[0, i]
        row[columns.demand_velocity + i] = source.motion[1, i]
        row[columns.demand_acceleration + i] = source.motion[2, i]
    row[columns.operating_state] = source.progress[0].state
    row[columns.host_stale] = source.dcu_state.stream[0].is_stale
    row[columns.host_late] = host_is_late(source.blocks.dcu, source.dcu_state)
    row[columns.host_clock] = 1.0 + source.dcu_state.clock[0].slew
    row[columns.valve_gain] = source.operating.phase[0].gain


@inlined
def record_demand(source, frame, row, columns):  # type: ignore[no-untyped-def]
    """Write the demand into a row of the record."""
    if source.hosted:
        _record_chain(source, row, columns)
        return
    poses = source.poses
    for i in range(poses.shape[1]):
        row[columns.demand_pose + i] = poses[frame % poses.shape[0], i]


@inlined
def watches_switches(source):  # type: ignore[no-untyped-def]
    """Whether the lower limit switches are watched: in hold and engaged, and on a table."""
    state = source.progress[0].state
    return not source.hosted or state == State.HOLD.value or state == State.ENGAGED.value


@inlined
def host_age(source):  # type: ignore[no-untyped-def]
    """Time since the DCU accepted a frame [s], for the host watchdog.

    It counts while engaged, from the first frame on; 0 otherwise, and on a table.
    """
    engaged = source.hosted and source.progress[0].state == State.ENGAGED.value
    if engaged and source.dcu_state.events[0].accepted > 0:
        return source.dcu_state.stream[0].silence
    return 0.0


@inlined
def take_reset(source):  # type: ignore[no-untyped-def]
    """Whether the operator has just reset a fault; a reset is taken once."""
    progress = source.progress[0]
    has_reset = source.hosted and progress.reset != 0
    if has_reset:
        progress.reset = 0
    return has_reset


@inlined
def source_fault(source):  # type: ignore[no-untyped-def]
    """Code of a fault that operating states or DCU have found in this frame, 0 for none."""
    return source.progress[0].fault
