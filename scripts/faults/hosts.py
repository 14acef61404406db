"""Hosts, and the network between them and the machine, on a clock that the run moves."""

import struct
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.facility.host import moog
from cmf_mj.facility.host.stream import HostFrame
from cmf_mj.facility.host.udp import encode_frame
from cmf_mj.machine.geometry import DOFS
from faults.plans import ODDITIES, Oddity, Plan

Array = NDArray[np.float64]

HOST = ("127.0.0.1", 4000)
"""Address of the host."""

FADE = 1.0
"""Time in which a host's motion begins [s]."""

WILD = 0.3
"""Poses beyond it are no host's own [m or rad]."""

_STALLS = 0.5
"""Time from stall to stall [s]."""

_STEP = 1e-4
"""For derivatives of the host's motion [s]."""


def motion(plan: Plan, time: Array) -> Array:
    """Pose of the host at its own time [s], (N, 6): a sine that begins smoothly."""
    x = np.clip(time / FADE, 0.0, 1.0)
    pose = np.zeros((time.size, 6))
    wave = np.sin(2.0 * np.pi * plan.frequency * time)
    pose[:, DOFS.index(plan.dof)] = plan.amplitude * x**3 * (10.0 - 15.0 * x + 6.0 * x * x) * wave
    return pose


def derivatives(plan: Plan, time: Array) -> tuple[Array, Array]:
    """Velocity and acceleration of the host's motion over its own time, (N, 6) each."""
    before, here, after = (motion(plan, time + shift * _STEP) for shift in (-1, 0, 1))
    return (after - before) / (2.0 * _STEP), (after - 2.0 * here + before) / _STEP**2


class Sent(NamedTuple):
    """One datagram on its way."""

    arrives: float  #: At the machine [s].
    number: int  #: In the order of sending.
    time: float  #: The host's own [s].
    data: bytes  #: Of a Moog position the numbers only; its word depends on the answers.
    sender: tuple[str, int]


def _within(oddity: Oddity, at: Array) -> NDArray[np.bool_]:
    return np.asarray((at >= oddity.at) & (at < oddity.at + oddity.length))


def _ticks(plan: Plan, end: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Host's own times of its frames, when each is sent, and which are sent at all."""
    own, real, now, at = [], [], 0.0, 0.0
    while at < end:
        own.append(now)
        real.append(at)
        rates = [o.size for o in plan.oddities if o.kind == "rate" and o.at <= at < o.at + o.length]
        step = 1.0 / (plan.rate * float(np.prod(rates)))
        now, at = now + step, at + step / plan.speed
        for o in plan.oddities:
            if o.kind == "freeze" and o.at <= at < o.at + o.length and at % _STALLS < o.size:
                at += o.size - at % _STALLS
    time, sent = np.array(own), np.array(real)
    goes = np.ones(time.size, dtype=bool)
    for o in plan.oddities:
        within = _within(o, sent)
        stalled = within & (sent % _STALLS < o.size)
        if o.kind == "burst":
            sent = np.where(stalled, sent - sent % _STALLS + o.size, sent)
        if o.kind in ("skip", "silent"):
            goes &= ~(stalled if o.kind == "skip" else within)
    return time, sent, goes


def datagrams(plan: Plan, end: float) -> list[Sent]:
    """Everything that comes to the machine's port until the end [s], in order of arrival."""
    time, sent, goes = _ticks(plan, end)
    arrives = sent + 1e-4
    values = says(plan, time)
    stamps, numbers = time.copy(), np.arange(time.size)
    draws = {kind: np.random.default_rng([plan.seed, n]) for n, kind in enumerate(ODDITIES)}
    extra: list[Sent] = []
    blank = np.zeros(time.size, dtype=bool)
    for o in plan.oddities:
        within, size, rng = _within(o, sent), time.size, draws[o.kind]
        share = within & (rng.random(size) < o.size)
        if o.kind == "jitter":
            later = np.where(within, arrives + o.size * rng.random(size), arrives)
            arrives = np.maximum.accumulate(later)
        elif o.kind == "loss":
            goes &= ~share
        elif o.kind == "late":
            arrives = np.where(share, arrives + rng.uniform(0.01, 0.06, size), arrives)
        elif o.kind == "not_finite":
            odd = rng.choice((np.nan, np.inf, -np.inf), size)
            blank |= share & (rng.random(size) < 0.2)
            values[share, rng.integers(3, size=size)[share], rng.integers(6, size=size)[share]] = (
                odd[share]
            )
        elif o.kind == "wild":
            values[share, 0] += rng.choice((-1.0, 1.0), (size, 6))[share]
        elif o.kind == "restart":
            first = int(np.argmax(sent >= o.at)) if (sent >= o.at).any() else size
            stamps[first:] -= stamps[min(first, size - 1)]
            numbers[first:] -= numbers[min(first, size - 1)]
        elif o.kind in ("garbage", "double", "second"):
            extra += _others(plan, o, sent, share, rng)
    stamps[blank] = np.nan
    rows = zip(arrives, numbers, stamps, values, sent, strict=True)
    own = [
        Sent(float(a), k, float(s), _octets(plan, int(n), float(t), v), HOST)
        for k, ((a, n, t, v, s), here) in enumerate(zip(rows, goes, strict=True))
        if here
    ]
    doubles = {e.number: e for e in extra if not e.data and e.sender == HOST}
    twice = [s._replace(arrives=doubles[s.number].arrives) for s in own if s.number in doubles]
    return sorted([*own, *twice, *(e for e in extra if e.number < 0)])


def _others(
    plan: Plan, oddity: Oddity, sent: Array, share: NDArray[np.bool_], rng: np.random.Generator
) -> list[Sent]:
    """Second copies, octets of a stranger, and another host's datagrams; numbers of these < 0."""
    if oddity.kind == "double":
        pairs = zip(np.flatnonzero(share).tolist(), rng.random(sent.size), strict=False)
        return [Sent(float(sent[k] + 0.02 * r), k, 0.0, b"", HOST) for k, r in pairs]
    if oddity.kind == "garbage":
        at = sent[share]
        return [
            Sent(float(t), -1 - k, 0.0, rng.bytes(int(rng.integers(1, 200))), HOST)
            for k, t in enumerate(at)
        ]
    at = np.arange(oddity.at, oddity.at + oddity.length, 1.0 / plan.rate)
    values = says(plan, at + 100.0)
    values *= oddity.size
    port = HOST[1] + (int(rng.integers(2)) if plan.door == "native" else 0)
    return [
        Sent(float(t), -1 - k, float(t), _octets(plan, k, float(t) + 100.0, v), (HOST[0], port))
        for k, (t, v) in enumerate(zip(at, values, strict=True))
    ]


def says(plan: Plan, time: Array) -> Array:
    """Pose, velocity and acceleration as the host says them, (N, 3, 6)."""
    velocity, acceleration = derivatives(plan, time)
    rng = np.random.default_rng([plan.seed, 99])
    if plan.derivatives == "zero":
        velocity, acceleration = 0.0 * velocity, 0.0 * acceleration
    elif plan.derivatives == "delayed":
        velocity, acceleration = derivatives(plan, time - 1.0 / plan.rate)
    elif plan.derivatives == "noisy":
        velocity = velocity + 0.1 * np.abs(velocity).max(initial=0.0) * rng.normal(size=(1, 6))
        noise = rng.normal(size=acceleration.shape)
        acceleration = acceleration + 0.1 * np.abs(acceleration).max(initial=0.0) * noise
    return np.stack([motion(plan, time), velocity, acceleration], axis=1)


def _octets(plan: Plan, number: int, stamp: float, values: Array) -> bytes:
    if plan.door == "native":
        return encode_frame(HostFrame(number, stamp, *values))
    if plan.door == "moog":
        return struct.pack(">6f", *values[0][list(moog.DOF_ORDER)])
    # An aircraft that is pushed to and fro along an axis; the washout makes poses of it.
    force, axis = np.array([0.0, 0.0, -STANDARD_GRAVITY]), DOFS.index(plan.dof) % 3
    force[axis] += 20.0 * values[0, DOFS.index(plan.dof)]
    numbers = (stamp, *force.tolist(), *([0.0] * 6))
    return ",".join(map(repr, numbers)).encode()


class Line:
    """A socket whose datagrams come when the run's clock says so."""

    def __init__(self, coming: list[Sent]) -> None:
        """Take what will arrive."""
        self.now = 0.0  #: The run's clock [s].
        self.answer = b""  #: The last that was sent back.
        self.taken: list[Sent] = []
        """Datagrams that were received."""
        self._coming = deque(coming)

    @property
    def next(self) -> float:
        """When the next datagram arrives [s]."""
        return self._coming[0].arrives if self._coming else np.inf

    def recvfrom(self, size: int) -> tuple[bytes, tuple[str, int]]:
        """The next datagram and its sender."""
        if self.next > self.now:
            raise BlockingIOError
        self.taken.append(self._coming.popleft())
        return self.taken[-1].data[:size], self.taken[-1].sender

    def recv(self, size: int) -> bytes:
        """The next datagram."""
        return self.recvfrom(size)[0]

    def sendto(self, data: bytes, _: tuple[str, int]) -> None:
        """Keep an answer."""
        self.answer = data

    def setblocking(self, _: bool) -> None:
        """Nothing waits here."""

    def settimeout(self, _: float) -> None:
        """Nothing waits here."""

    def fileno(self) -> int:
        """No file of the system."""
        return -1

    def close(self) -> None:
        """Nothing is open."""

    def __enter__(self) -> "Line":
        """Itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is open."""


_WORD = {
    moog.MachineState.POWER_UP: moog.Word.DOF_MODE,
    moog.MachineState.IDLE: moog.Word.ENGAGE,
    moog.MachineState.FAULT_2: moog.Word.RESET,
    moog.MachineState.INHIBITED: moog.Word.RESET,
}
"""What a client says in a state; its position in any other."""


class MoogLine(Line):
    """The same for a Moog client, whose words follow from the answers it got."""

    def __init__(self, coming: list[Sent]) -> None:
        """Take what will arrive."""
        super().__init__(coming)
        self.word: int | None = None  #: Said once in place of the next one.

    def recvfrom(self, size: int) -> tuple[bytes, tuple[str, int]]:
        """The client's next command."""
        data, sender = super().recvfrom(size)
        if self.taken[-1].number < 0 and len(data) != 24:
            return data, sender
        state = moog.ANSWER.unpack(self.answer)[2] & 0x0F if self.answer else 3
        word, self.word = self.word, None
        if word is None:
            word = _WORD.get(moog.MachineState(state), moog.Word.NEW_POSITION)
        numbers = data if word == moog.Word.NEW_POSITION else bytes(24)
        return struct.pack(">I", word) + numbers + bytes(4), sender
