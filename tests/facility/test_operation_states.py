"""Operating states on the machine: each reached from each, requests in turns, faults by name."""

import itertools
from typing import Any

import numpy as np
import pytest
from lengths import examples
from shared import circuit

from cmf_mj import Hexapod, Record, law_names, signals
from cmf_mj.control.states import Request, State
from cmf_mj.facility.host.stream import HostStream, from_command
from cmf_mj.facility.operation import operate
from cmf_mj.plant.events import Event
from tests.facility import test_moog as moog

FEW = ["dynamic_pressure", "modal_plan"]
LAWS = [name for name in law_names("all") if name != "original_as_printed"]
"""Walked one and all in `make search`; that takes a quarter of an hour."""
ASKING = {
    "OFF": Request.OFF,
    "SETTLED": Request.SETTLE,
    "HOLD": Request.RAISE,
    "ENGAGED": Request.ENGAGE,
    "FAULT": Request.TRIP,
}
"""The request that leads to each state where the machine may stay, from any but fault."""
LONGEST = 36.0  #: Longest path, from off over return and raise to engaged [s].


def host(seconds: float, amplitude: float = 0.02, hertz: float = 0.5) -> HostStream:
    return from_command(signals.sine("heave", amplitude, hertz, cycles=hertz * seconds), rate=80.0)


def entered(record: Record) -> list[str]:
    code = record["operating_state"].astype(int)
    return [State(code[k]).name for k in [0, *(np.flatnonzero(np.diff(code)) + 1)]]


def visit(law: str, stations: list[str], machine: str = "cmf") -> Record:
    """Ask for one state after the other; each must have been reached before the next."""
    requests, now = [], 0.2
    arrivals = []
    for before, after in itertools.pairwise(stations):
        if before == "FAULT":
            requests.append((now, Request.RESET))
            now += 20.0
        requests.append((now, ASKING[after]))
        now += 15.0 if after == "FAULT" else LONGEST
        arrivals.append((now - 0.1, after))
    operation = operate(
        Hexapod(machine=machine), law, host(now), begin=State[stations[0]],
        requests=requests, seconds=now, record_every=16,
    )  # fmt: skip
    record = operation.record
    code = record["operating_state"].astype(int)
    for time, name in arrivals:
        assert State(code[np.searchsorted(record.time, time)]).name == name, (time, name)
    assert record.metadata["fault"] is None
    return record


@pytest.mark.parametrize(
    ("law", "machine"), [("velocity", "cmf"), ("modal_plan", "cmf"), (None, "simona")]
)
def test_a_parked_machine_and_one_in_fault_engage_again(law: str | None, machine: str) -> None:
    """The velocity law leaves the CMF's legs 66 mm above the settled position; SIMONA's sink to
    stops that lie 50 mm below. Both waited in off for ever."""
    plant = Hexapod(machine=machine)
    visit(
        law or plant.machine.law,
        ["OFF", "ENGAGED", "OFF", "ENGAGED", "FAULT", "OFF", "ENGAGED"],
        machine,
    )


def test_the_operators_emergency_stop_is_a_fault_and_can_be_left() -> None:
    """The legs lay on their stops, a stroke away from a demand that was followed for ever."""
    requests = [(20.0, Request.RESET), (40.0, Request.ENGAGE)]
    operation = operate(
        Hexapod(), "modal_plan", host(76.0), begin=State.ENGAGED, seconds=76.0, requests=requests,
        events=[Event(at=0.5, kind="emergency_stop")], record_every=16,
    )  # fmt: skip
    record = operation.record
    code = record["operating_state"].astype(int)
    assert (code[record.time < 0.5] == State.ENGAGED).all()
    assert (code[(record.time > 0.5) & (record.time < 20.0)] == State.FAULT).all()
    down = record["leg_reference"][np.searchsorted(record.time, 19.9)]
    np.testing.assert_allclose(down, -Hexapod().machine.working_stroke, atol=1e-9)
    assert entered(record)[1:3] == ["FAULT", "OFF"] and code[-1] == State.ENGAGED
    away = np.abs(record["leg_extension"] - record["leg_reference"])[-1]
    assert away.max() < 0.01


@pytest.mark.slow
@pytest.mark.fuzz
@pytest.mark.parametrize("law", LAWS if examples(1) > 1 else FEW)
def test_every_state_is_reached_from_every_other_with_every_law(law: str) -> None:
    way = circuit(tuple(ASKING))
    assert len(set(itertools.pairwise(way))) == 20
    visit(law, way)


def toggled(law: str, first: str, second: str, hertz: float, seconds: float = 20.0) -> Record:
    half = 0.5 / hertz
    turns = [(k * half, Request[(first, second)[k % 2]]) for k in range(int(seconds / half))]
    operation = operate(
        Hexapod(), law, host(seconds, 0.2), begin=State.ENGAGED, requests=turns, seconds=seconds,
        record_every=16,
    )  # fmt: skip
    assert operation.record.metadata["fault"] is None
    return operation.record


def check_near(record: Record, ends: tuple[float, ...]) -> None:
    """Heave within host and ends, and a stop from 0.63 m/s and 2 m/s^2; 10 % for the law."""
    reach = 0.628 * 0.48 / 2 + 1.97 * 0.48**2 / 16
    heave = record["platform_pose"][:, 2]
    low, high = min(-0.2, *ends) - reach, max(0.2, *ends) + reach
    assert 1.1 * low <= heave.min() and heave.max() <= 1.1 * high


def test_hold_and_engage_in_turns_keep_the_machine_near_its_host() -> None:
    """One second each; it walked to 1.158 m, onto the stops, without a fault."""
    record = toggled("velocity", "ENGAGE", "HOLD", 0.5)
    check_near(record, (0.0,))
    assert entered(record)[:3] == ["ENGAGED", "HOLD", "ENGAGED"]


@pytest.mark.slow
@pytest.mark.fuzz
@pytest.mark.parametrize("hertz", [0.2, 0.5, 1.0, 2.0, 5.0] if examples(1) > 1 else [0.5, 5.0])
@pytest.mark.parametrize("law", FEW)
def test_requests_in_turns_keep_the_machine_near_its_host(law: str, hertz: float) -> None:
    """Settle brings the platform down, 1.1 m; trip is not undone by another request."""
    ends = {"RAISE": 0.0, "SETTLE": 1.1, "HOLD": 0.0, "ENGAGE": 0.0}
    for first, second in itertools.combinations(ends, 2):
        record = toggled(law, first, second, hertz, max(8.0, 4.0 / hertz))
        check_near(record, (ends[first], ends[second]))


def test_a_return_that_does_not_arrive_says_so(tmp_path) -> None:
    """The velocity law stops 2.6 in above the stops; half an inch is all this file allows."""
    path = tmp_path / "strict.toml"
    path.write_text(
        "arrival_tolerance = { value = 0.5, unit = 'in', status = 'assumed', source = 'test' }"
    )
    operation = operate(
        Hexapod(), "velocity", host(51.0), begin=State.HOLD,
        requests=[(0.1, Request.SETTLE), (18.0, Request.RESET), (34.0, Request.ENGAGE)],
        seconds=50.0, states=path, record_every=16,
    )  # fmt: skip
    record = operation.record
    names = ["HOLD", "RETURN", "FAULT", "OFF", "RETURN", "RAISE", "ENGAGED"]
    assert entered(record) == names
    fault = record.metadata["fault"]
    assert fault["name"] == "not_arrived" and fault["leg"] is None
    assert fault["time"] == pytest.approx(17.1, abs=0.01)
    assert record["isolation"].max() == 0.0


def test_a_moog_host_engages_again_after_park() -> None:
    """Under the velocity law, whose DC gain leaves the legs 66 mm above the settled position."""

    def host(ask: Any, _: Any, __: Any) -> list[int]:
        words = (moog.DOF_MODE, moog.ENGAGE, moog.PARK, moog.ENGAGE)
        turns = zip(words, states, strict=True)
        return [moog.until(ask, state, moog.command(word))[-1].state for word, state in turns]

    states = [moog.IDLE, moog.ENGAGED] * 2
    assert moog.over_udp(host, 70.0)[0] == states
