"""A virtual Moog 6DOF2000E: its real-time Ethernet interface in front of the facility.

The host sends 60 commands a second and the base answers each; all numbers are big-endian.

command   uint32 command word, six float32, uint32 spare                             32 octets
answer    uint32 latched faults, discrete I/O, machine state, six float32, spare     40 octets

The six are roll, pitch, heave, surge, yaw, lateral [rad, m], heave positive down from neutral, in
degree-of-freedom mode; in length mode the legs' extensions from the settled position [m]. Words,
masks, states and the states a word is valid in are those of two public clients
(`docs/how_to/moog.md`, which also says what no source could confirm).

The host has no clock. A command is stamped where one is expected, with T the mean interval,

    expected = last + T,    x = arrival - expected,    stamp = expected + x / 2,    T += x / 64

so that a host of any steady rate is taken as steady and jitter is averaged; one that comes more
than four intervals late is stamped with its arrival, and of commands that pile up the newest
counts. Positions come without derivatives, so that the DCU filters them.
"""

import math
import struct
import sys
from contextlib import suppress
from enum import IntEnum, IntFlag

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.states import Request, State
from cmf_mj.core.errors import InputError, NoPoseError
from cmf_mj.facility.host.handover import make_ring, put
from cmf_mj.facility.host.port import LOOPBACK, HostPort
from cmf_mj.facility.host.stream import HostFrame
from cmf_mj.facility.session import Session
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import legs_to_pose

RATE = 60  #: Commands a second [Hz].

COMMAND, ANSWER = struct.Struct(">I6fI"), struct.Struct(">3I6fI")

DOF_ORDER = tuple(map(DOFS.index, ("roll", "pitch", "heave", "surge", "yaw", "sway")))
"""Degree of freedom of each of the six numbers, as its place in a pose."""

POWER_UP = 1.0  #: Time from the start to idle [s]; assumed.

REFUSALS = ("wrong_sender", "wrong_length", "wrong_word", "not_finite", "out_of_range", "disabled")
"""Reasons for which a datagram is dropped: nothing moves by it."""

_POLL_FRAMES = 4  #: Control frames between two looks at the network in real time: 2 ms.

_STAMP_SHARE, _INTERVAL_SHARE = 1.0 / 2.0, 1.0 / 64.0
"""Shares of a command's lateness by which its stamp and the mean interval follow it."""

_INTERVALS = (1.0 / 150.0, 1.0 / 30.0)  #: Least and largest mean interval of commands [s].

_POLL_DATAGRAMS = 64  #: Datagrams taken at one look, so that a flood does not hold up the machine.

_LOCKSTEP_WAIT = 10.0
"""Longest wait for a command in lockstep [s]; then the host is taken to have gone."""

_NO_MOTION = np.zeros(6)


class Word(IntEnum):
    """Command words."""

    NEW_POSITION = 130
    MDA_MODE = 140
    INHIBIT = 150
    RESET = 160
    DOF_MODE = 170
    LENGTH_MODE = 172
    START = 175
    ENGAGE = 180
    LOW_LIMIT_DISABLE = 190
    LOW_LIMIT_ENABLE = 200
    PARK = 210
    DISABLE = 220


class MachineState(IntEnum):
    """Low nibble of the machine state; a fault of the facility is `FAULT_2`, which can be reset."""

    POWER_UP, IDLE, STANDBY, ENGAGED, PARKING = 0, 1, 2, 3, 7
    FAULT_1, FAULT_2, FAULT_3, DISABLED, INHIBITED = 8, 9, 10, 11, 12


class Latched(IntFlag):
    """Latched faults that the facility can have."""

    ACTUATOR_RUNAWAY, COMMAND_RANGE, INVALID_FRAME = 0x2000, 0x0200, 0x0100
    WATCHDOG, LIMIT_SWITCH, DRIVE_BUS = 0x80, 0x40, 0x20
    AMPLIFIER, COMMUNICATION = 0x10, 0x08


class Discrete(IntFlag):
    """Discrete I/O."""

    AMPLIFIER_ENABLE, DRIVE_BUS, LIMIT_SWITCH, AT_HOME = 0x40, 0x20, 0x08, 0x01


_MODES = {Word.LENGTH_MODE: 0x00, Word.DOF_MODE: 0x20}  #: Mode bits of the machine state.

_STOPPED_STATES = {Word.INHIBIT: MachineState.INHIBITED, Word.DISABLE: MachineState.DISABLED}
"""State that a word stops the base in."""

_REQUESTS = {
    **dict.fromkeys((Word.ENGAGE, Word.START), Request.ENGAGE),
    **dict.fromkeys((Word.PARK, Word.DISABLE), Request.OFF),
    Word.RESET: Request.RESET,
}
"""What a word requests of the facility."""

_VALID_STATES = {
    Word.PARK: (MachineState.ENGAGED, MachineState.STANDBY),
    Word.ENGAGE: (MachineState.IDLE,),
    Word.START: (MachineState.IDLE,),
    Word.DOF_MODE: (MachineState.IDLE, MachineState.POWER_UP),
    Word.LENGTH_MODE: (MachineState.IDLE, MachineState.POWER_UP),
    Word.INHIBIT: (MachineState.IDLE, MachineState.POWER_UP),
    Word.RESET: (MachineState.FAULT_2, MachineState.INHIBITED),
    Word.NEW_POSITION: tuple(MachineState),
    Word.DISABLE: tuple(MachineState),
}
"""States in which a word is obeyed; in others, and words without an entry, it is answered only."""

_FAULT_BITS = {
    "host_watchdog": Latched.COMMUNICATION,
    "frame_watchdog": Latched.WATCHDOG,
    "under_pressure": Latched.DRIVE_BUS,
    "over_pressure": Latched.AMPLIFIER,
}
"""Bit of a fault of the facility; the others are a runaway actuator."""


class MoogBase:
    """The base without its network: commands in, answers out, between parts of a session.

    The session begins in `State.OFF`, on the frames of `ring`.
    """

    def __init__(self) -> None:
        """Power up."""
        self.ring = make_ring()  #: Positions for the DCU.
        self.refused = dict.fromkeys(REFUSALS, 0)
        """Datagrams that were dropped, by reason."""
        self.counts = dict.fromkeys(("commands", "not_valid_now", "positions", "late"), 0)
        """Commands answered, those not valid in their state, positions taken while engaged, and
        commands that came more than half an interval late while engaged."""
        self.latched = Latched(0)
        """Faults since the last reset."""
        self._mode = Word.DOF_MODE
        self._stopped_state: MachineState | None = None  #: What a word stopped the base in.
        self._target_pose, self._measured_pose = np.zeros(6), np.zeros(6)
        self._sent_frames, self._stamp, self._sent_stamp = 0, -math.inf, -math.inf
        self._last_arrival, self._interval = 0.0, 1.0 / RATE

    def state(self, session: Session) -> MachineState:
        """What the base says it is."""
        if self._stopped_state is not None:
            return self._stopped_state
        source = session.source
        operating_state, request = source.progress[0].state, source.progress[0].request
        if operating_state == State.FAULT:
            return MachineState.FAULT_2
        if operating_state == State.OFF and session.frame < POWER_UP * session.rate:
            return MachineState.POWER_UP
        if request == Request.OFF and operating_state != State.OFF:
            return MachineState.PARKING
        phase = source.operating.phase[0]
        if operating_state == State.ENGAGED and phase.time >= max(phase.fade_time, phase.stop_time):
            return MachineState.ENGAGED
        return MachineState.IDLE if operating_state == State.OFF else MachineState.STANDBY

    def obey(self, session: Session, data: bytes) -> bytes | None:
        """Obey a command; its answer, or None for what is dropped."""
        state = self.state(session)
        if state == MachineState.DISABLED:
            return self._drop("disabled")
        if len(data) != COMMAND.size:
            return self._drop("wrong_length", Latched.INVALID_FRAME)
        number, *values, _ = COMMAND.unpack(data)
        if number not in set(Word):
            return self._drop("wrong_word", Latched.INVALID_FRAME)
        if not all(map(math.isfinite, values)):
            return self._drop("not_finite", Latched.COMMAND_RANGE)
        word, pose = Word(number), self._pose_of(session, values)
        if pose is None:
            return self._drop("out_of_range", Latched.COMMAND_RANGE)
        if word in (Word.ENGAGE, Word.START) and state == MachineState.IDLE:
            neutral_dofs = pose if word == Word.ENGAGE else np.delete(pose, DOFS.index("heave"))
            if self._mode == Word.DOF_MODE and neutral_dofs.any():
                return self._drop("out_of_range", Latched.COMMAND_RANGE)
        self.counts["commands"] += 1
        if state in _VALID_STATES.get(word, ()):
            self._carry_out(session, word, pose)
        else:
            self.counts["not_valid_now"] += 1
        if state in (MachineState.STANDBY, MachineState.ENGAGED):
            moved = state == MachineState.ENGAGED
            self._send_position(session, pose if moved and word == Word.NEW_POSITION else None)
        return self._make_answer(session)

    def _drop(self, reason: str, fault: int = 0) -> bytes | None:
        self.refused[reason] += 1
        self.latched = self.latched | Latched(fault)
        return None

    def _pose_of(self, session: Session, values: list[float]) -> NDArray[np.float64] | None:
        """The pose of six numbers, or None if the machine has none."""
        pose, blocks = np.zeros(6), session.source.blocks
        if self._mode == Word.DOF_MODE:
            pose[list(DOF_ORDER)] = values
        else:
            try:
                pose = legs_to_pose(np.array(values) - blocks.states.travel, session.plant.machine)
            except InputError:
                return None
        return pose if (np.abs(pose) <= blocks.dcu.pose).all() else None

    def _carry_out(self, session: Session, word: Word, pose: NDArray[np.float64]) -> None:
        """Do what a word says that is valid now."""
        self._mode = word if word in _MODES else self._mode
        if word in (Word.ENGAGE, Word.START):
            self._target_pose = pose
        if word == Word.RESET:
            self.latched = Latched(0)
            if self._stopped_state is not None:  # inhibited: the machine itself has no fault
                self._stopped_state = None
                return
        self._stopped_state = _STOPPED_STATES.get(word, self._stopped_state)
        if word in _REQUESTS:
            session.source.progress[0].request = _REQUESTS[word].value

    def _send_position(self, session: Session, pose: NDArray[np.float64] | None) -> None:
        """Let a position follow the one before; None for the one to begin at, and to stay."""
        now = session.frame / session.rate
        if pose is not None:
            self.counts["positions"] += 1
            self.counts["late"] += now - self._last_arrival > 1.5 * self._interval
            self._target_pose = pose
        self._last_arrival = now
        lateness = now - self._stamp - self._interval
        if lateness < -self._interval:
            return
        if lateness > 4.0 * self._interval:
            self._stamp = now
        else:
            self._stamp += self._interval + _STAMP_SHARE * lateness
            shortest, longest = _INTERVALS
            interval = self._interval + _INTERVAL_SHARE * lateness
            self._interval = min(max(interval, shortest), longest)
        if self._stamp - self._sent_stamp < session.source.blocks.dcu.minimum_interval:
            return
        self._sent_frames, self._sent_stamp = self._sent_frames + 1, self._stamp
        pose, stamp = self._target_pose, self._stamp
        put(self.ring, HostFrame(self._sent_frames, stamp, pose, _NO_MOTION, _NO_MOTION))

    def _make_answer(self, session: Session) -> bytes:
        memory, source = session.memory, session.source
        progress, fault = source.progress[0], session.fault
        is_fresh = progress.state == State.FAULT and progress.request != Request.RESET
        if is_fresh and fault is not None:
            self.latched |= _FAULT_BITS.get(fault.name, Latched.ACTUATOR_RUNAWAY)
        tripped, travel = bool(memory.progress[0].tripped), source.blocks.states.travel
        if tripped:
            self.latched |= Latched.LIMIT_SWITCH
        legs = memory.feedback.position
        is_home = (np.abs(legs + travel) <= source.blocks.states.settled_tolerance).all()
        bits = {
            Discrete.AMPLIFIER_ENABLE: source.operating.phase[0].gain > 0.0,
            Discrete.DRIVE_BUS: memory.progress[0].stopped == 0,
            Discrete.LIMIT_SWITCH: tripped,
            Discrete.AT_HOME: is_home,
        }
        values = legs + travel
        if self._mode == Word.DOF_MODE:
            with suppress(NoPoseError):  # a failed sensor: the last pose that the legs had
                self._measured_pose = legs_to_pose(legs, session.plant.machine)
            values = self._measured_pose[list(DOF_ORDER)]
        discrete_io = sum(bit for bit, is_on in bits.items() if is_on)
        mode_bits = self.state(session) | _MODES[self._mode]
        return ANSWER.pack(self.latched, discrete_io, mode_bits, *values, 0)


class MoogServer(MoogBase, HostPort):
    """The base on a UDP socket; its `attend` belongs to `serve`. A context manager."""

    def __init__(
        self,
        port: int = 0,
        *,
        host: str = LOOPBACK,
        host_port: int | None = None,
        bind: str = LOOPBACK,
        lockstep: bool = False,
    ) -> None:
        """Bind to the IPv4 address `bind`, and take commands of `host` only, by its address.

        In lockstep the machine goes on by 1/60 s with each command and waits for the next; else
        the run is paced.
        """
        MoogBase.__init__(self)
        HostPort.__init__(self, port, host, host_port, bind, _LOCKSTEP_WAIT if lockstep else 0.0)
        self._lockstep, self._lockstep_commands = lockstep, 0

    def attend(self, session: Session) -> int:
        """Answer what has come; the control frames until the next look."""
        for _ in range(sys.maxsize if self._lockstep else _POLL_DATAGRAMS):
            try:
                datagram = self.receive(COMMAND.size + 1)
            except OSError:  # nothing has come, or an answer was refused
                return session.frames if self._lockstep else _POLL_FRAMES
            if not datagram.is_from_host:
                self._drop("wrong_sender")
            elif (answer := self.obey(session, datagram.data)) is not None:
                self._socket.sendto(answer, datagram.sender)
                if self._lockstep:
                    break
        else:
            return _POLL_FRAMES
        self._lockstep_commands += 1
        return self._lockstep_commands * session.rate // RATE - session.frame
