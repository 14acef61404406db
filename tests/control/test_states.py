"""Operating states: every request is reached, every handover is smooth, every fault ends safely."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shared import WORKING_STROKE

from cmf_mj.control import states as block
from cmf_mj.control.states import Request, State, load_state_settings, make_states, start
from cmf_mj.core.compiled import allocating

T = 1.0 / 2048.0
LEGS = 3
STATES = make_states()


def smooth_host(frames):
    """Positions, velocities and accelerations (frames, 3) of three tones of 0.1 m."""
    rates = np.array([2.0, 3.0, 4.0])
    phase = np.outer(T * np.arange(frames), rates)
    sine, cosine = 0.1 * np.sin(phase), 0.1 * np.cos(phase)
    return np.array([0.5, 0.2, -0.3]) + sine, cosine * rates, -sine * rates**2


HOST, HOST_RATES, HOST_CHANGES = smooth_host(100 * 2048)
TIME = T * np.arange(30 * 2048)


@allocating
def _run(states, state, requests, host, rates, changes, stuck, out, codes, valve):
    measured = state.hold_position.copy()
    if state.phase[0].code < 2:
        measured[:] = -states.travel
    demand, reference = np.zeros((3, host.shape[1])), np.zeros((3, host.shape[1]))
    for k in range(requests.size):
        if stuck == 1:
            measured[0] = 0.3
        elif stuck == 2:
            measured[0] = np.nan
        elif stuck == 3:
            measured *= 0.931
        demand[0], demand[1], demand[2] = host[k], rates[k], changes[k]
        codes[k] = block.step(states, state, requests[k], demand, measured, reference)
        out[:, k] = reference
        measured[:] = out[0, k]
        valve[k] = state.phase[0].gain


def run(state, requests, host=None, stuck=0, states=STATES):
    """References (3, N, n), states, valve gains (N,); legs follow perfectly unless stuck."""
    frames = len(requests)
    moving = (HOST[:frames], HOST_RATES[:frames], HOST_CHANGES[:frames]) if host is None else host
    out, codes, valve = np.zeros((3, frames, LEGS)), np.zeros(frames, int), np.zeros(frames)
    _run(states, state, np.asarray(requests, int), *moving, stuck, out, codes, valve)
    return out, codes, valve


def at(code):
    """A machine that has long been in `code`; engaged with the host's first position."""
    return start(STATES, code, HOST[0])


def assert_smooth(out):
    """Position, velocity and acceleration belong together and none of them jumps.

    Trapezoids: errors T^3 jerk / 12 and, where the jerk jumps, T^2 jerk / 8, with a jerk of at most
    200 m/s^3 (6 x 0.6 m/s over the square of half a second, and fades): 2e-9 m, 6e-6 m/s.
    """
    position, velocity, change = out
    drift = np.diff(position, axis=0) - T * 0.5 * (velocity[1:] + velocity[:-1])
    assert np.abs(drift).max() < 2e-9
    drift = np.diff(velocity, axis=0) - T * 0.5 * (change[1:] + change[:-1])
    assert np.abs(drift).max() < 6e-6
    assert np.abs(np.diff(change, axis=0)).max() < 200.0 * T


def stop(velocity):
    """S of a stop [s]."""
    return max(0.25, 4.0 * velocity / (np.e * 0.2 * 9.80665))


def passed(codes):
    """Names of the states in order, without repeats."""
    return [State(codes[k]).name for k in range(codes.size) if k == 0 or codes[k] != codes[k - 1]]


@pytest.mark.parametrize(
    ("first", "request_", "path"),
    [
        ("OFF", "SETTLE", "SETTLED"),
        ("OFF", "RAISE", "SETTLED RAISE HOLD"),
        ("OFF", "ENGAGE", "SETTLED RAISE ENGAGED"),
        ("OFF", "HOLD", "OFF"),
        ("SETTLED", "OFF", "OFF"),
        ("SETTLED", "ENGAGE", "RAISE ENGAGED"),
        ("SETTLED", "HOLD", "SETTLED"),
        ("HOLD", "ENGAGE", "ENGAGED"),
        ("HOLD", "RAISE", "RAISE HOLD"),
        ("HOLD", "SETTLE", "RETURN SETTLED"),
        ("HOLD", "OFF", "RETURN SETTLED OFF"),
        ("ENGAGED", "HOLD", "HOLD"),
        ("ENGAGED", "RAISE", "RAISE HOLD"),
        ("ENGAGED", "SETTLE", "RETURN SETTLED"),
        ("ENGAGED", "OFF", "RETURN SETTLED OFF"),
        ("ENGAGED", "NONE", "ENGAGED"),
        ("ENGAGED", "RESET", "ENGAGED"),
        ("ENGAGED", "TRIP", "FAULT"),
        ("SETTLED", "TRIP", "FAULT"),
        ("OFF", "TRIP", "FAULT"),
    ],
)
def test_each_request_leads_to_its_state(first, request_, path):
    """A request changes the state in its own frame where it can."""
    out, codes, valve = run(at(State[first]), [Request[request_]] * TIME.size)
    assert " ".join(passed(codes)) == path
    assert_smooth(out)
    final = State(codes[-1])
    resting = {"OFF": -WORKING_STROKE, "SETTLED": -WORKING_STROKE, "FAULT": -WORKING_STROKE}
    if final.name in resting or path.endswith("RAISE HOLD"):
        np.testing.assert_array_equal(out[0, -1], resting.get(final.name, 0.0))
    if final != State.ENGAGED:
        assert not out[1:, -1].any()
    assert valve[-1] == (0.0 if final in (State.OFF, State.FAULT) else 1.0)


def test_engaged_is_the_host_to_the_bit_after_its_fade():
    """From hold: the host's position, velocity and acceleration; the fade takes 3 s or what 8 in/s
    and 0.2 g ask for."""
    machine = start(STATES, State.HOLD, [0.5, 0.2, -0.3])
    out, codes, _ = run(machine, [Request.ENGAGE] * (4 * 2048))
    assert (codes == State.ENGAGED).all()
    end = int(3.0 / T) + 2
    for found, wanted in zip(out, (HOST, HOST_RATES, HOST_CHANGES), strict=True):
        np.testing.assert_array_equal(found[end:], wanted[end : 4 * 2048])
    np.testing.assert_array_equal(out[0, 0], [0.5, 0.2, -0.3])


def test_long_fades_keep_speed_and_acceleration():
    """From the top: 6 s would take 0.6 m/s; 8 in/s stretch it to 17.6 s, for all legs alike."""
    machine = start(STATES, State.HOLD, [WORKING_STROKE, 0.0, -0.9])
    out, _, _ = run(machine, [Request.TRIP] * (20 * 2048))
    assert np.abs(out[1]).max() == pytest.approx(8 * 0.0254, rel=1e-6)
    moving = np.flatnonzero(np.abs(out[1]).max(axis=1) > 0.0)
    assert moving[-1] * T == pytest.approx(1.875 * 75.0 / 8.0, abs=2 * T)
    progress = (out[0] - out[0, 0]) / (-WORKING_STROKE - out[0, 0])
    np.testing.assert_allclose(progress, progress[:, :1].repeat(LEGS, axis=1), rtol=0, atol=1e-12)


def test_hold_comes_to_rest_where_the_stop_ends():
    """v0 S / 2 + a0 S^2 / 16 from where it was asked for, S = 0.25 s or 4 v0 / (e 0.2 g)."""
    engaged, k = at(State.ENGAGED), 500
    out, _, _ = run(engaged, [Request.NONE] * k + [Request.HOLD] * 8000)
    longest = stop(np.abs(HOST_RATES[k]).max())
    wanted = HOST[k] + HOST_RATES[k] * longest / 2 + HOST_CHANGES[k] * longest**2 / 16
    np.testing.assert_allclose(out[0, -1], wanted, rtol=0, atol=1e-14)
    assert_smooth(out)
    assert np.abs(out[0, k + 3 * int(longest / T) :] - wanted).max() < 1e-5
    np.testing.assert_array_equal(
        out[0, k + 3 * 2048 + 2 :], out[0, -1:].repeat(8000 - 3 * 2048 - 2, 0)
    )


def test_stop_beyond_the_stroke_holds_on_the_stroke():
    top, count = WORKING_STROKE, 8 * 2048
    host = np.full((count, LEGS), top - 0.01), np.full((count, LEGS), 0.4), np.zeros((count, LEGS))
    out, _, _ = run(at(State.ENGAGED), [Request.HOLD] * count, host)
    np.testing.assert_array_equal(out[0, -1], [top] * LEGS)
    assert_smooth(out)


def test_the_diagram_of_the_documentation_has_every_change_and_no_other():
    """From every state, every request, legs on the stops, at neutral and between, fade begun, ended
    and long ended, valve faded in or out, hold at neutral or not."""
    drawn = (
        Path(__file__).resolve().parents[2].joinpath("docs", "explanation", "limits.md").read_text()
    )
    diagram = set(re.findall(r"^    (\w+) --> (\w+)", drawn, re.MULTILINE))
    still, found = np.zeros((3, LEGS)), set()
    for code, request, place, time, valve, hold in itertools.product(
        State, Request, (-WORKING_STROKE, 0.0, 0.4), (0.0, 2.0, 50.0), (0.0, 1.0), (0.0, 0.4)
    ):
        machine = at(State.HOLD)
        machine.phase[0] = (code, time, 1.0, 0.5, valve, valve)
        machine.hold_position[:] = hold
        out = np.zeros((3, LEGS))
        after = block.step(STATES, machine, request, still, np.full(LEGS, place), out)
        if after != code:
            found.add((code.name.lower(), State(after).name.lower()))
    assert found == diagram


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(st.sampled_from(list(Request)), st.integers(1, 3 * 2048)), max_size=12),
    st.sampled_from([State.OFF, State.SETTLED, State.HOLD, State.ENGAGED]),
    st.sampled_from([Request.OFF, Request.ENGAGE, Request.TRIP]),
)
def test_any_sequence_of_requests_is_smooth_and_ends_where_wanted(sequence, first, last):
    """Requests in any order at any time, in the middle of any fade; afterwards reset until out of
    a fault, then the last request for as long as the slowest path takes."""
    machine = at(first)
    sequence = [*sequence, (Request.RESET, 20 * 2048), (last, 40 * 2048)]
    requests = np.repeat(*np.array(sequence).T)
    out, codes, valve = run(machine, requests)
    assert_smooth(out)
    wanted = {Request.OFF: State.OFF, Request.ENGAGE: State.ENGAGED, Request.TRIP: State.FAULT}
    assert codes[-1] == wanted[last]
    assert np.abs(np.diff(valve)).max() <= 1.875 * T * 1.0001
    end = HOST[len(requests) - 1] if last == Request.ENGAGE else [-WORKING_STROKE] * LEGS
    np.testing.assert_array_equal(out[0, -1], end)


@pytest.mark.parametrize("stuck", [1, 2])
@pytest.mark.parametrize("request_", [Request.RAISE, Request.ENGAGE])
def test_a_leg_that_does_not_arrive_is_a_fault(stuck, request_):
    """One leg stands 0.3 m up, or its sensor gives no number: 12 s of profile and 5 s of patience;
    then the reference goes down and the valves close. Reset leads to off, where nothing moves, not
    while a sensor gives no number."""
    out, codes, valve = run(at(State.SETTLED), [request_] * TIME.size, stuck=stuck)
    assert passed(codes) == ["RAISE", "FAULT"]
    assert np.flatnonzero(codes == State.FAULT)[0] * T == pytest.approx(17.0, abs=2 * T)
    assert_smooth(out)
    machine = start(STATES, State.HOLD, [0.0] * LEGS)
    _, codes, valve = run(machine, [Request.TRIP] + [Request.RESET] * (TIME.size - 1), stuck=stuck)
    assert passed(codes) == (["FAULT", "OFF"] if stuck == 1 else ["FAULT"]) and valve[-1] == 0.0


def test_a_return_that_does_not_arrive_is_a_fault():
    _, codes, _ = run(at(State.ENGAGED), [Request.SETTLE] * TIME.size, stuck=1)
    assert passed(codes) == ["RETURN", "FAULT"]


def test_a_law_that_stops_short_arrives_all_the_same():
    """DC gain 47/50.48 = 0.931 of the velocity law: 2.6 in above the settled position."""
    _, codes, _ = run(at(State.ENGAGED), [Request.SETTLE] * TIME.size, stuck=3)
    assert passed(codes) == ["RETURN", "SETTLED"]


def test_legs_off_the_stops_go_down_from_where_they_lie():
    """The reference comes to them first, with closed valves, at 8 in/s: 1.25 m in 11.6 s."""
    out, codes, valve = run(at(State.OFF), [Request.SETTLE] * TIME.size, stuck=1)
    assert passed(codes) == ["OFF", "RETURN", "FAULT"]  # the leg is stuck
    assert_smooth(out)
    begun = np.flatnonzero(codes == State.RETURN)[0]
    assert begun * T == pytest.approx(1.875 * (0.3 + WORKING_STROKE) / (8 * 0.0254), abs=3 * T)
    np.testing.assert_array_equal(out[0, begun], [0.3, -WORKING_STROKE, -WORKING_STROKE])
    assert not valve[:begun].any()


def test_legs_that_lie_high_engage_all_the_same():
    """A return that ended high left off and a reset from fault did so for ever."""
    machine = at(State.HOLD)
    machine.phase.code, machine.phase.valve_phase, machine.phase.gain = State.FAULT, 0.0, 0.0
    requests = [Request.RESET] * 2048 + [Request.ENGAGE] * (20 * 2048)
    out, codes, _ = run(machine, requests)
    assert passed(codes) == ["OFF", "RETURN", "RAISE", "ENGAGED"]
    assert_smooth(out)


@pytest.mark.parametrize("below", [0.05, -0.0656])
def test_off_is_left_from_mechanical_stops_and_where_a_law_leaves_the_legs(below):
    """SIMONA's stops lie 50 mm below the settled position; the velocity law's DC gain stops the
    CMF's legs 65.6 mm above it."""
    still, out, machine = np.zeros((3, LEGS)), np.zeros((3, LEGS)), at(State.OFF)
    lying = np.full(LEGS, -WORKING_STROKE - below)
    code = block.step(STATES, machine, Request.ENGAGE, still, lying, out)
    assert code == State.SETTLED


def test_a_leg_without_reading_is_a_fault_of_whoever_wants_to_leave_off():
    out, codes, valve = run(at(State.OFF), [Request.OFF] * 100 + [Request.ENGAGE] * 100, stuck=2)
    assert passed(codes) == ["OFF", "FAULT"] and np.flatnonzero(codes)[0] == 100
    assert np.isfinite(out).all() and not valve.any()


def test_a_fade_is_the_weighted_mean_of_stop_and_source():
    """From rest to a host in motion."""
    count, rest = 4 * 2048, np.array([0.4, 0.1, -0.2])
    machine = at(State.HOLD)
    machine.hold_position[:] = rest
    out, _, _ = run(machine, [Request.ENGAGE] * count)
    fade = machine.phase[0].fade_time
    x = np.clip(T * np.arange(count) / fade, 0.0, 1.0)[:, None]
    s = 10 * x**3 - 15 * x**4 + 6 * x**5
    np.testing.assert_allclose(out[0], s * HOST[:count] + (1 - s) * rest, rtol=0, atol=1e-14)


def test_a_stop_started_anew_in_its_course_is_the_same_stop():
    """Hold and raise in turns, a frame each: no fade goes on, and the stop as if asked for once."""
    k, count = 500, 6000
    turns = [Request.HOLD, Request.RAISE] * (count // 2)
    out, _, _ = run(at(State.ENGAGED), [Request.NONE] * k + turns)
    longest = stop(np.abs(HOST_RATES[k]).max())
    wanted = HOST[k] + HOST_RATES[k] * longest / 2 + HOST_CHANGES[k] * longest**2 / 16
    np.testing.assert_allclose(out[0, -1], wanted, rtol=0, atol=1e-3)


PAIRS = list(itertools.combinations(("HOLD", "ENGAGE", "RAISE", "SETTLE", "TRIP"), 2))


@pytest.mark.parametrize("hertz", [0.2, 0.5, 1.0, 2.0, 5.0])
@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_requests_in_turns_do_not_lead_the_legs_away(first, second, hertz):
    """A host of +-0.2 m at 0.5 Hz and of +-20 mm at 3 Hz. Every leg stays in the hull of host and
    targets, widened by the longest stop of the host; no leg is faster than host or fade."""
    count, half = 40 * 2048, round(1024 / hertz)
    turns = np.where(np.arange(count) // half % 2, Request[first], Request[second])
    targets = {"RAISE": [0.0], "SETTLE": [-WORKING_STROKE], "TRIP": [-WORKING_STROKE]}
    ends = targets.get(first, []) + targets.get(second, [])
    for size, rate in ((0.2, np.pi), (0.02, 6 * np.pi)):
        phase = rate * T * np.arange(count)[:, None] + [0.0, 0.7, 1.9]
        host = np.sin(phase), rate * np.cos(phase), -(rate**2) * np.sin(phase)
        out, _, _ = run(
            start(STATES, State.ENGAGED, size * host[0][0]), turns, [size * h for h in host]
        )
        swift = max(size * rate, 8 * 0.0254)
        longest = stop(swift)
        reach = swift * longest / 2 + size * rate**2 * longest**2 / 16
        low, high = min([-size, *ends]) - reach, max([size, *ends]) + reach
        assert low <= out[0].min() and out[0].max() <= high
        assert np.abs(out[1]).max() <= size * rate + 8 * 0.0254
        assert_smooth(out) if size == 0.2 else None


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_host_that_sends_no_numbers_is_held_at_its_last_position(bad):
    host = [a[:2048].copy() for a in (HOST, HOST_RATES, HOST_CHANGES)]
    host[0][1000:], host[2][500, 1] = bad, bad
    out, _, _ = run(at(State.ENGAGED), [Request.NONE] * 2048, tuple(host))
    assert np.isfinite(out).all()
    np.testing.assert_array_equal(out[0, 1000:], np.tile(HOST[999], (1048, 1)))
    assert not out[1:, 1000:].any()
    np.testing.assert_array_equal(out[:, 500, 1], [HOST[499, 1], 0.0, 0.0])


def test_the_valve_fades_in_before_the_raise_and_out_after_the_return():
    """s(t / 1 s)."""
    _, codes, valve = run(at(State.OFF), [Request.RAISE] * 4096)
    raised = np.flatnonzero(codes == State.RAISE)[0]
    assert raised * T == pytest.approx(1.0, abs=3 * T)
    x = np.clip(np.arange(raised) / 2048.0, 0.0, 1.0)
    wanted = 10 * x**3 - 15 * x**4 + 6 * x**5
    np.testing.assert_allclose(valve[:raised], wanted, rtol=0, atol=1.875 * 2 * T)
    assert (valve[raised:] == 1.0).all()


def test_passing_states_are_no_start():
    for code in (State.RAISE, State.RETURN, State.FAULT):
        with pytest.raises(ValueError, match=f"code: <State.{code.name}: .> is no state to start"):
            start(STATES, code, [0.0])


def test_shipped_settings_are_assumed():
    shipped = load_state_settings()
    assert {getattr(shipped, n).status for n in type(shipped).model_fields} == {"assumed"}


def test_raise_is_the_minimum_jerk_profile():
    """-h (1 - s(t / 12 s)), s = 10 x^3 - 15 x^4 + 6 x^5; peaks 1.875 h / D and 5.7735 h / D^2."""
    out, _, _ = run(at(State.SETTLED), [Request.RAISE] * (13 * 2048))
    x = np.clip(TIME[: 13 * 2048] / 12.0, 0.0, 1.0)
    wanted = -WORKING_STROKE * (1.0 - 10 * x**3 + 15 * x**4 - 6 * x**5)
    np.testing.assert_allclose(out[0], np.tile(wanted[:, None], LEGS), rtol=0, atol=1e-14)
    assert out[1].max() == pytest.approx(1.875 * WORKING_STROKE / 12.0, rel=1e-6)
    assert out[2].max() == pytest.approx(10 / np.sqrt(3) * WORKING_STROKE / 144.0, rel=1e-6)
