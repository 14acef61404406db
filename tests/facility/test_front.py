"""Datagrams, good and bad, through the whole chain to the leg reference, frame by frame."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lengths import examples
from numpy.typing import NDArray
from shared import WORKING_STROKE

from cmf_mj.control import limiter, states
from cmf_mj.control.dcu.state import make_dcu
from cmf_mj.control.states import Request, State
from cmf_mj.core.compiled import allocating
from cmf_mj.facility.front import Blocks, Source, follow, from_host
from cmf_mj.facility.host.handover import filled_log, make_log, make_ring, put
from cmf_mj.facility.host.stream import HostFrame
from cmf_mj.facility.host.udp import (
    DATAGRAM_REASONS,
    MOST_SEQUENCE,
    DatagramError,
    decode_frame,
    encode_frame,
)
from cmf_mj.machine.machine import load_machine
from tests.control.test_dcu_streams import KINDS, stream
from tests.control.test_limiter_chain import check_limits

DCU = make_dcu()
POSE, LEGS = limiter.make_pose_limiter(), limiter.make_leg_limiter()
GEOMETRY, STATES = load_machine().geometry, states.make_states()
GARBAGE = ("bit", "cut", "long", "noise", "empty")


class Outcome(NamedTuple):
    source: Source
    out: NDArray[np.float64]  #: Leg reference, velocity, acceleration, (3, N, 6).
    sent: list[bytes]  #: Good datagrams, in order.
    refused: dict[str, int]


def build(begin: State, requests: list[tuple[int, Request]]) -> Source:
    legs = np.full(6, -WORKING_STROKE if begin in (State.OFF, State.SETTLED) else 0.0)
    return from_host(
        Blocks(DCU, POSE, GEOMETRY, STATES, LEGS),
        make_log(4096),
        requests,
        begin,
        position=legs,
        pose=np.zeros(6),
        ring=make_ring(64),
    )


@allocating
def _advance(source, first, last, position, tripped_at, out):
    """Legs that follow at once; a limit switch trips at a frame."""
    for frame in range(first, last):
        reference = out[0, frame]
        follow(source, frame, position, 0, frame >= tripped_at, reference)
        for row in range(1, 3):
            out[row, frame] = source.reference[row]
        position[:] = reference


def spoiled(datagram: bytes, kind: str, generator: np.random.Generator) -> bytes:
    """A datagram as a faulty network or a stranger sends it."""
    if kind == "bit":
        octets = bytearray(datagram)
        octets[generator.integers(len(octets))] ^= 1 << int(generator.integers(8))
        return bytes(octets)
    if kind == "cut":
        return datagram[: generator.integers(1, len(datagram))]
    if kind == "long":
        return datagram + b"\0"
    return generator.bytes(len(datagram)) if kind == "noise" else b""


def run(
    kinds: list[str],
    seed: int,
    begin: State,
    requests: list[tuple[int, Request]],
    garbage: list[str],
    tripped_at: int = 2**40,
) -> Outcome:
    """Send what `stream` makes of `kinds`, with garbage between, and run until after the last."""
    generator = np.random.default_rng(seed)
    arrivals, frames = stream(kinds, seed)
    frames = max(frames, 4096)
    source, out = build(begin, requests), np.zeros((3, frames, 6))
    position = source.reference[0].copy()
    sent, refused, now = [], dict.fromkeys(DATAGRAM_REASONS, 0), 0

    def deliver(datagram: bytes) -> None:
        """As the receiving thread does."""
        try:
            put(source.ring, decode_frame(datagram))
        except DatagramError as error:
            refused[error.reason] += 1

    for index, arrival in enumerate(arrivals.frame):
        _advance(source, now, int(arrival), position, tripped_at, out)
        now = max(now, int(arrival))
        frame = HostFrame(
            int(arrivals.sequence[index]) & MOST_SEQUENCE,
            float(arrivals.time[index]),
            *arrivals.values[index],
        )
        sent.append(encode_frame(frame))
        deliver(sent[-1])
        if garbage:
            deliver(spoiled(sent[-1], garbage[index % len(garbage)], generator))
    _advance(source, now, frames, position, tripped_at, out)
    return Outcome(source, out, sent, refused)


def logged_datagrams(source: Source) -> list[bytes]:
    """What reached the DCU, as datagrams: NaN compare like any octets."""
    log = filled_log(source.arrivals, int(source.progress[0].collected))
    return [
        encode_frame(HostFrame(int(s), float(t), *v))
        for s, t, v in zip(log.sequence, log.time, log.values, strict=True)
    ]


def check_account(outcome: Outcome, garbage: bool) -> None:
    """Every datagram sent is somewhere, and none but the good ones got through."""
    source, state = outcome.source, outcome.source.dcu_state
    filled = int(source.progress[0].collected)
    lost = int(source.ring.lost[0] + source.ring.thinned[0])
    assert sum(outcome.refused.values()) == (len(outcome.sent) if garbage else 0)
    assert filled + lost == len(outcome.sent)
    waiting = int(state.candidate[0].is_waiting)
    assert state.counts["accepted"] + sum(state.rejections.values()) + waiting == filled
    reached = logged_datagrams(source)
    assert reached == outcome.sent if not lost else set(reached) <= set(outcome.sent)


@pytest.mark.fuzz
@settings(max_examples=examples(60), deadline=None, derandomize=True)
@given(
    kinds=st.lists(st.sampled_from(KINDS), min_size=1, max_size=10),
    seed=st.integers(0, 2**32 - 1),
    begin=st.sampled_from([State.OFF, State.SETTLED, State.HOLD, State.ENGAGED]),
    requests=st.lists(st.tuples(st.integers(0, 4096), st.sampled_from(list(Request))), max_size=6),
    garbage=st.lists(st.sampled_from(GARBAGE), max_size=4),
    tripped_at=st.sampled_from([1000, 2**40]),
)
def test_whatever_comes_in_the_leg_reference_keeps_its_limits_and_all_is_counted(
    kinds, seed, begin, requests, garbage, tripped_at
):
    outcome = run(kinds, seed, begin, sorted(requests), garbage, tripped_at)
    check_limits(outcome.out)
    check_account(outcome, bool(garbage))
    if tripped_at < 2**40:
        assert outcome.source.progress[0].state in (State.FAULT, State.OFF)
