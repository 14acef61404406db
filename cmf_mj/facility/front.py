"""Where the leg reference comes from: a table made before the run, or the chain of Figure 2-5.

    host frames -> DCU -> platform limits -> demand -> operating states -> leg limits -> reference

A run on a table passes None for the chain.
"""

from typing import NamedTuple

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from cmf_mj.control import dcu, demand, governor, states
from cmf_mj.control.dcu.state import SILENCE, STALE, TAKEN
from cmf_mj.control.protection import NO_FAULT
from cmf_mj.control.states import Request, State
from cmf_mj.core.compiled import compiled
from cmf_mj.facility.host.handover import Ring, collect

LOG = (
    "demand_pose",
    "demand_velocity",
    "demand_acceleration",
    "operating_state",
    "host_stale",
    "valve_gain",
)
"""What the chain records: three of six columns each, three of one."""

LOG_COLUMNS = 21

_CURSOR, _FILLED, _REQUEST, _STATE, _CLEARED = range(5)


class Chain(NamedTuple):
    """Compiled parameters, states and workspace."""

    dcu: dcu.Dcu
    dcu_state: dcu.DcuState
    arrivals: dcu.Arrivals  #: Host frames, known before the run or collected while it goes.
    live: bool  #: Whether they are collected from the ring.
    ring: Ring  #: Hand-over from the receiving thread.
    request_frame: NDArray[np.int64]  #: Control frames of the operator's requests, (m,).
    request: NDArray[np.int64]  #: What is requested, `states.Request`, (m,).
    pose_governor: governor.Governor
    pose_state: governor.GovernorState
    demand: demand.Demand
    states: states.States
    operating: states.OperatingState
    leg_governor: governor.Governor
    leg_state: governor.GovernorState
    marks: NDArray[np.int64]
    """Next arrival, arrivals collected, request in force, operating state, whether a fault has
    just been left, (5,)."""
    motion: NDArray[np.float64]  #: Platform demand within its limits and its derivatives, (3, 6).
    legs: NDArray[np.float64]  #: Leg demand and its derivatives, (3, 6).
    reference: NDArray[np.float64]  #: Leg reference and its derivatives, (3, 6).
    log: NDArray[np.float64]  #: (rows, 21), see `LOG`.


def make_chain(
    unit: dcu.Dcu,
    arrivals: dcu.Arrivals,
    requests: list[tuple[int, Request]],
    rows: int,
    *,
    begin: State,
    ring: Ring,
    live: bool,
    limits: tuple[governor.Governor, governor.Governor],
    shown: states.States,
    geometry: demand.Demand,
    position: NDArray[np.float64],
    pose: NDArray[np.float64],
) -> Chain:
    """A chain that has been in an operating state for a long time.

    Args:
        unit: DCU.
        arrivals: host frames, or an empty log for live ones.
        requests: control frame and request, in order of time.
        rows: rows to record.
        begin: operating state to begin in.
        ring: hand-over of live frames.
        live: whether frames come from it.
        limits: governors of platform and legs.
        shown: operating states' parameters.
        geometry: leg demand's parameters.
        position: leg positions at the start [m], (6,).
        pose: platform pose of the demand at the start, (6,).
    """
    operating = states.start(shown, begin, position)
    reference = np.zeros((3, 6))
    at_rest = begin in (State.OFF, State.SETTLED)
    reference[0] = -shown.travel if at_rest else operating.hold
    return Chain(
        unit,
        dcu.resting(unit, pose),
        arrivals,
        live,
        ring,
        np.array([frame for frame, _ in requests], dtype=np.int64),
        np.array([int(code) for _, code in requests], dtype=np.int64),
        limits[0],
        governor.start(limits[0], pose),
        geometry,
        shown,
        operating,
        limits[1],
        governor.start(limits[1], reference[0]),
        np.array([0, 0, int(Request.NONE), int(begin), 0], dtype=np.int64),
        np.zeros((3, 6)),
        np.zeros((3, 6)),
        reference,
        np.zeros((rows, LOG_COLUMNS)),
    )


@compiled
def _follow(chain, frame, position, fault, tripped, row, reference):  # type: ignore[no-untyped-def]
    marks = chain.marks
    for i in range(chain.request_frame.shape[0]):
        if chain.request_frame[i] == frame:
            marks[_REQUEST] = chain.request[i]
    request, before = marks[_REQUEST], marks[_STATE]
    leaving = request == Request.RESET.value and before == State.FAULT.value
    if (fault != NO_FAULT or tripped) and not leaving:
        request = Request.TRIP.value
    if chain.live:
        marks[_FILLED] = collect(chain.ring, chain.arrivals, marks[_FILLED], frame)
    marks[_CURSOR] = dcu.feed(chain.dcu, chain.dcu_state, chain.arrivals, marks[_CURSOR], frame)
    motion, legs, out = chain.motion, chain.legs, chain.reference
    dcu.step(chain.dcu, chain.dcu_state, motion)
    governor.step(chain.pose_governor, chain.pose_state, motion[0], motion[0], motion[1], motion[2])
    demand.step(chain.demand, motion[0], motion[1], motion[2], legs[0], legs[1], legs[2])
    marks[_STATE] = states.step(
        chain.states,
        chain.operating,
        request,
        legs[0],
        legs[1],
        legs[2],
        position,
        out[0],
        out[1],
        out[2],
    )
    if before == State.FAULT.value and marks[_STATE] == State.OFF.value:
        marks[_CLEARED] = 1
    governor.step(chain.leg_governor, chain.leg_state, out[0], out[0], out[1], out[2])
    gain = chain.operating.valve[1]
    for leg in range(6):
        reference[leg] = out[0, leg]
    if row >= 0:
        log = chain.log[row]
        for i in range(3):
            for j in range(6):
                log[6 * i + j] = motion[i, j]
        log[18] = marks[_STATE]
        log[19] = chain.dcu_state.whole[STALE]
        log[20] = gain
    return gain


def follow(chain, frame, table, position, fault, tripped, row, reference):  # type: ignore[no-untyped-def]
    """The leg reference of a control frame.

    Args:
        chain: `Chain`, or None to take the row of the table.
        frame: number of the control frame.
        table: (N, n) references [m], taken again from the start after the last.
        position: what the position sensors read [m], (n,).
        fault: code of the latched fault.
        tripped: whether a limit switch has.
        row: row to record, -1 for none.
        reference: (n,) overwritten [m].

    Returns:
        Gain on the valve command, 0 to 1.
    """
    if chain is None:
        reference[:] = table[frame % table.shape[0]]
        return 1.0
    return _follow(chain, frame, position, fault, tripped, row, reference)


@overload(follow, jit_options={"forceinline": True})
def _compiled_follow(chain, frame, table, position, fault, tripped, row, reference):  # type: ignore[no-untyped-def]
    if isinstance(chain, types.NoneType):

        def take(chain, frame, table, position, fault, tripped, row, reference):  # type: ignore[no-untyped-def]
            row = frame % table.shape[0]
            for leg in range(reference.shape[0]):
                reference[leg] = table[row, leg]
            return 1.0

        return take
    return lambda chain, frame, table, position, fault, tripped, row, reference: _follow(
        chain, frame, position, fault, tripped, row, reference
    )


@compiled
def _watched(chain):  # type: ignore[no-untyped-def]
    state = chain.marks[_STATE]
    return state == State.HOLD.value or state == State.ENGAGED.value


def watched(chain):  # type: ignore[no-untyped-def]
    """Whether the lower limit switches are watched: in hold and engaged."""
    return True if chain is None else _watched(chain)


@overload(watched, jit_options={"forceinline": True})
def _compiled_watched(chain):  # type: ignore[no-untyped-def]
    if isinstance(chain, types.NoneType):
        return lambda chain: True
    return lambda chain: _watched(chain)


@compiled
def _host_age(chain):  # type: ignore[no-untyped-def]
    engaged = chain.marks[_STATE] == State.ENGAGED.value
    if engaged and chain.dcu_state.events[TAKEN] > 0:
        return chain.dcu_state.real[SILENCE]
    return 0.0


def host_age(chain):  # type: ignore[no-untyped-def]
    """Time since the DCU accepted a frame [s], for the host watchdog.

    It counts while engaged, from the first frame on; 0 otherwise, and without a chain.
    """
    return 0.0 if chain is None else _host_age(chain)


@overload(host_age, jit_options={"forceinline": True})
def _compiled_host_age(chain):  # type: ignore[no-untyped-def]
    if isinstance(chain, types.NoneType):
        return lambda chain: 0.0
    return lambda chain: _host_age(chain)


@compiled
def _cleared(chain):  # type: ignore[no-untyped-def]
    found = chain.marks[_CLEARED] != 0
    chain.marks[_CLEARED] = 0
    return found


def cleared(chain):  # type: ignore[no-untyped-def]
    """Whether the operator has just reset a fault, told once; never without a chain."""
    return False if chain is None else _cleared(chain)


@overload(cleared, jit_options={"forceinline": True})
def _compiled_cleared(chain):  # type: ignore[no-untyped-def]
    if isinstance(chain, types.NoneType):
        return lambda chain: False
    return lambda chain: _cleared(chain)
