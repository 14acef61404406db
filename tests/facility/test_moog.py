"""The virtual Moog base, by a client written from the published format with `struct` alone."""

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from cmf_mj import Hexapod, pose_to_legs, signals
from cmf_mj.control.dcu.acceptance import POSES_HOLD
from cmf_mj.control.states import State, StateSettings, load_state_settings
from cmf_mj.facility.host.moog import MoogBase, MoogServer
from cmf_mj.facility.host.stream import from_command
from cmf_mj.facility.operation import Operation, operate, serve
from cmf_mj.facility.session import Session

NEW_POSITION, INHIBIT, RESET, DOF_MODE, LENGTH_MODE = 130, 150, 160, 170, 172
START, ENGAGE, PARK, DISABLE = 175, 180, 210, 220
POWER_UP, IDLE, STANDBY, ENGAGED, PARKING = 0, 1, 2, 3, 7
FAULT_2, DISABLED, INHIBITED = 9, 11, 12
AT_HOME, DRIVE_BUS, AMPLIFIER = 0x01, 0x20, 0x40
INVALID_FRAME, COMMAND_RANGE, COMMUNICATION = 0x0100, 0x0200, 0x0008
REST = (0.0,) * 6


def command(word: int, values: tuple[float, ...] = REST) -> bytes:
    """Roll, pitch, heave, surge, yaw, lateral, or six lengths."""
    return struct.pack(">IffffffI", word, *values, 0)


class Answer(NamedTuple):
    faults: int
    io: int
    state: int
    mode: int
    values: tuple[float, ...]


def answer(data: bytes) -> Answer:
    faults, io, state, *values, _ = struct.unpack(">IIIffffffI", data)
    return Answer(faults, io, state & 0x0F, state & 0x60, tuple(values))


Ask = Callable[[bytes], Answer | None]


@pytest.fixture(scope="module")
def swift() -> StateSettings:
    """Fades that take a second or two, so that tests need not wait."""
    times = {name: 1.0 for name in ("raise_time", "engage_time", "return_time", "fault_time")}
    table = load_state_settings().model_dump()
    rates = {"speed": (40.0, "in/s"), "acceleration": (1.0, "g")}
    for name, (value, unit) in {**{n: (t, "s") for n, t in times.items()}, **rates}.items():
        table[name] |= {"value": value, "unit": unit}
    return StateSettings.model_validate(table)


def over_udp(
    host: Callable[[Ask, socket.socket, tuple[str, int]], Any],
    seconds: float,
    law: str = "velocity",
    *,
    lockstep: bool = True,
    **options: Any,
) -> tuple[Any, MoogServer, Operation]:
    """Run a host in a thread of its own against the base; what it returns, base and operation."""
    returned = []
    with MoogServer(lockstep=lockstep) as base, socket.socket(type=socket.SOCK_DGRAM) as line:
        line.settimeout(100.0)

        def ask(data: bytes) -> Answer:
            line.sendto(data, base.address)
            return answer(line.recv(64))

        thread = threading.Thread(target=lambda: returned.append(host(ask, line, base.address)))
        base._socket.settimeout(1.0 if lockstep else 0.0)
        thread.start()
        options = {"begin": State.OFF, "record_every": 64, "paced": not lockstep} | options
        done = serve(Hexapod(), law, base.ring, seconds, attend=base.attend, **options)
        thread.join(timeout=10.0)
        assert not thread.is_alive()
        return returned[0], base, done


def until(ask: Ask, state: int, data: bytes) -> list[Answer]:
    """Repeat a command until the base is in a state, as the published clients do."""
    answers: list[Answer] = []
    while not answers or answers[-1].state != state:
        got = ask(data)
        assert got is not None and len(answers) < 3000
        answers.append(got)
    return answers


def heave(frames: int) -> Iterator[bytes]:
    for k in range(frames):
        yield command(NEW_POSITION, (0.0, 0.0, 0.05 * np.sin(0.5 * np.pi * k / 60), 0.0, 0.0, 0.0))


def bad(address: tuple[str, int]) -> None:
    """Short, long, of an unknown word, not a number, far out, and from a foreign address."""
    far = (0.0, 0.0, 9.0, 0.0, 0.0, 0.0)
    with (
        socket.socket(type=socket.SOCK_DGRAM) as line,
        socket.socket(type=socket.SOCK_DGRAM) as foreign,
    ):
        good = command(NEW_POSITION)
        for data in (b"", good[:31], good + b"\0", command(131)):
            line.sendto(data, address)
        for values in ((np.nan, *REST[1:]), (*REST[1:], -np.inf), far):
            line.sendto(command(NEW_POSITION, values), address)
        foreign.bind(("127.0.0.2", 0))
        foreign.sendto(command(DISABLE), address)


def ride(troubled: bool) -> Callable[[Ask, socket.socket, tuple[str, int]], Any]:
    def host(ask: Ask, _: socket.socket, address: tuple[str, int]) -> list[list[Answer]]:
        begun = until(ask, IDLE, command(DOF_MODE))
        raised = until(ask, ENGAGED, command(ENGAGE))
        ridden = []
        for k, data in enumerate(heave(180)):
            if troubled and k % 60 == 10:
                bad(address)
            ridden.append(ask(data))
        return [begun, raised, ridden, until(ask, IDLE, command(PARK))]

    return host


@pytest.fixture(scope="module")
def cycle(swift: StateSettings) -> tuple[list[list[Answer]], MoogServer, Operation]:
    return over_udp(ride(False), 15.0, states=swift)


def test_a_cycle_goes_through_the_states_of_the_format(cycle: Any) -> None:
    (begun, raised, ridden, parked), base, done = cycle
    states = [a.state for part in (begun, raised, ridden, parked) for a in part]
    order = [states[0], *(b for a, b in zip(states, states[1:], strict=False) if a != b)]
    assert order == [POWER_UP, IDLE, STANDBY, ENGAGED, PARKING, IDLE]
    assert len(begun) == 61 and {a.mode for a in begun + ridden} == {0x20}  # 1 s of power-up
    assert begun[-1].io == AT_HOME | DRIVE_BUS  # on the stops, amplifiers off
    assert {a.io for a in ridden} == {AMPLIFIER | DRIVE_BUS}
    assert not any(a.faults for a in ridden + parked)
    assert base.counts["positions"] == 180 and base.counts["late"] == 0
    assert done.counts["missing"] == done.counts["late"] == sum(done.rejections.values()) == 0


def test_the_feedback_is_the_pose_of_the_machine(cycle: Any) -> None:
    """Heave is the third number and positive down: on the stops the platform is far below."""
    (begun, _, ridden, _), _, _ = cycle
    poses = np.array([a.values for a in ridden])
    assert begun[-1].values[2] > 0.9
    assert 0.04 < poses[:, 2].max() < 0.06
    assert np.abs(poses[:, [0, 1, 3, 4, 5]]).max() < 0.005


def test_bad_datagrams_are_counted_latch_their_fault_and_move_nothing(
    cycle: Any, swift: StateSettings
) -> None:
    parts, base, done = over_udp(ride(True), 15.0, states=swift)
    assert base.refused == {
        "wrong_sender": 3,
        "wrong_length": 9,
        "wrong_word": 3,
        "not_finite": 6,
        "out_of_range": 3,
        "disabled": 0,
    }
    assert {a.faults for a in parts[2][11:]} == {INVALID_FRAME | COMMAND_RANGE}
    assert [a.values for a in parts[2]] == [a.values for a in cycle[0][2]]
    clean = cycle[2].record
    for name in ("demand_pose", "leg_reference", "leg_extension"):
        assert (done.record[name] == clean[name]).all()


def test_in_length_mode_the_six_are_legs_from_the_settled_position(swift: StateSettings) -> None:
    """At mid-stroke but for a heave, whose legs follow from the geometry."""
    travel = 0.0254 * 37.5
    legs = pose_to_legs([0.0, 0.0, 0.05, 0.0, 0.0, 0.0])
    lengths = tuple((legs + travel).tolist())

    def host(ask: Ask, *_: Any) -> list[Answer]:
        until(ask, IDLE, command(LENGTH_MODE, (travel,) * 6))
        until(ask, ENGAGED, command(START, lengths))
        return [ask(command(NEW_POSITION, lengths)) for _ in range(60)]

    answers, _, _ = over_udp(host, 8.0, "velocity_integral", states=swift)
    assert answers[-1].mode == 0x00
    np.testing.assert_allclose(answers[-1].values, lengths, atol=2e-3)


def simulated(
    script: Callable[[Callable[[bytes, int], Answer | None], MoogBase], Iterator[None]],
    seconds: float,
    swift: StateSettings,
) -> MoogBase:
    """A host in simulated time: each `yield` of the script is 1/2048 s times what it yields."""
    base, running = MoogBase(), []

    def attend(session: Session) -> int:
        if not running:
            ask = lambda data: None if (a := base.obey(session, data)) is None else answer(a)  # noqa: E731
            running.append(script(ask, base))
        return next(running[0], session.frames)

    options: Any = {"begin": State.OFF, "states": swift, "record_every": 512}
    serve(Hexapod(), "velocity_integral", base.ring, seconds, attend=attend, paced=False, **options)
    assert next(running[0], None) is None, "the script did not come to its end"
    return base


def stepped(ask: Ask, state: int, data: bytes) -> Iterator[int]:
    while (got := ask(data)) is not None and got.state != state:
        yield 34


def test_a_late_command_is_counted_and_silence_is_a_fault(swift: StateSettings) -> None:
    seen = {}

    def script(ask: Ask, base: MoogBase) -> Iterator[int]:
        yield from stepped(ask, IDLE, command(DOF_MODE))
        yield from stepped(ask, ENGAGED, command(ENGAGE))
        for _ in range(30):
            ask(command(NEW_POSITION))
            yield 34
        yield 68  # 0.05 s from command to command
        seen["late"] = ask(command(NEW_POSITION))
        for _ in range(30):
            yield 34
            ask(command(NEW_POSITION))
        yield 1024
        seen["silent"] = ask(command(NEW_POSITION))
        yield from stepped(ask, IDLE, command(RESET))
        seen["reset"] = ask(command(NEW_POSITION))

    base = simulated(script, 20.0, swift)
    assert (seen["late"].state, seen["late"].faults) == (ENGAGED, 0) and base.counts["late"] == 1
    assert (seen["silent"].state, seen["silent"].faults) == (FAULT_2, COMMUNICATION)
    assert (seen["reset"].state, seen["reset"].faults) == (IDLE, 0)


def test_a_word_is_obeyed_in_its_states_only(swift: StateSettings) -> None:
    seen: list[tuple[int, int | None]] = []

    def script(ask: Ask, base: MoogBase) -> Iterator[int]:
        aside, raised = (0.0, 0.0, 0.0, 0.1, 0.0, 0.0), (0.0, 0.0, -0.1, 0.0, 0.0, 0.0)

        def tell(data: bytes) -> None:
            got = ask(data)
            seen.append((int.from_bytes(data[:4], "big"), None if got is None else got.state))

        tell(command(ENGAGE))  # not in power-up
        yield from stepped(ask, IDLE, command(NEW_POSITION))
        for data in (command(PARK), command(RESET), command(140), command(INHIBIT)):
            tell(data)
        tell(command(ENGAGE))  # inhibited
        ask(b"cut short")
        tell(command(RESET))
        assert not base.latched
        tell(command(ENGAGE, raised))  # engage begins at neutral, start where it says in heave
        tell(command(START, aside))
        tell(command(START, raised))
        tell(command(LENGTH_MODE))
        tell(command(DISABLE))
        tell(command(RESET))
        yield 34

    base = simulated(script, 2.0, swift)
    assert seen == [
        *((ENGAGE, POWER_UP), (PARK, IDLE), (RESET, IDLE), (140, IDLE), (INHIBIT, INHIBITED)),
        *((ENGAGE, INHIBITED), (RESET, IDLE), (ENGAGE, None), (START, None)),
        *((START, IDLE), (LENGTH_MODE, IDLE), (DISABLE, DISABLED), (RESET, None)),
    ]
    assert base.refused["disabled"] == 1 and base.refused["out_of_range"] == 2


def fundamental(values: NDArray[np.float64]) -> complex:
    """At the 0.25 Hz of `heave`, over its last whole periods of 240 commands."""
    values = values[-(values.size // 240) * 240 :]
    return complex((values - values.mean()) @ np.exp(-0.5j * np.pi * np.arange(values.size) / 60))


def late(before: complex, after: complex) -> float:
    """Delay [s] between amplitudes at 0.25 Hz."""
    return float(-np.angle(after / before) / (0.5 * np.pi))


def check_lag(ridden: list[Answer], delay: float, law: str) -> None:
    """Feedback less command is the configured delay and the lag of the law, measured apart."""
    asked = np.array([struct.unpack(">IffffffI", data)[3] for data in heave(len(ridden))])
    got = np.array([a.values[2] for a in ridden])
    lag = late(fundamental(asked[240:]), fundamental(got[240:]))
    stream = from_command(signals.sine("heave", 0.05, 0.25, cycles=3.0), 80.0)
    record = operate(Hexapod(), law, stream).record
    rows = slice(8192, 3 * 8192)  # two whole periods of 0.25 Hz
    turn = np.exp(-0.5j * np.pi * np.arange(2 * 8192) / 2048)
    reference, legs = (
        record[n][rows].mean(axis=1) @ turn for n in ("leg_reference", "leg_position")
    )
    assert lag == pytest.approx(delay + late(reference, legs), abs=1 / 60)


def delay_of(session: Session) -> float:
    """From a command to the demand: the DCU's delay of 60 poses a second [s]."""
    dcu = session.source.blocks.dcu
    wait = POSES_HOLD * dcu.hold + dcu.smoothing_delay
    return 1.0 / 60.0 + wait + session.plant.machine.frame * dcu.line_frames


@pytest.mark.parametrize("law", ["velocity", "acceleration"])
def test_the_feedback_lags_by_the_configured_delay(law: str, swift: StateSettings) -> None:
    def host(ask: Ask, *_: Any) -> list[Answer | None]:
        until(ask, IDLE, command(DOF_MODE))
        until(ask, ENGAGED, command(ENGAGE))
        return [ask(data) for data in heave(721)]

    delays: list[float] = []
    plain = MoogServer.attend
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            MoogServer,
            "attend",
            lambda self, session: delays.append(delay_of(session)) or plain(self, session),
        )
        ridden, _, _ = over_udp(host, 20.0, law, states=swift)
    check_lag(ridden, delays[-1], law)


def test_in_real_time_every_command_is_answered(swift: StateSettings) -> None:
    """One and a half seconds on the wall clock, at the host's own pace."""

    def host(ask: Ask, *_: Any) -> list[Answer]:
        def at_its_rate(data: bytes) -> Answer | None:
            time.sleep(1 / 60)
            return ask(data)

        return until(at_its_rate, STANDBY, command(ENGAGE))

    answers, base, done = over_udp(host, 2.0, lockstep=False, states=swift)
    assert done.timing is not None and base.counts["commands"] >= len(answers)
    assert [a.state for a in answers if a.state != POWER_UP][-1] == STANDBY


def test_moog_is_in_the_command_and_its_page_says_the_words() -> None:
    page = Path("docs/how_to/moog.md").read_text()
    for word in (NEW_POSITION, INHIBIT, RESET, DOF_MODE, LENGTH_MODE, START, ENGAGE, PARK, DISABLE):
        assert f"| {word} |" in page
