"""The Digital Control Unit: exact where it can be, known where it cannot, at rest in silence."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy.interpolate import BPoly
from scipy.signal import correlate, correlation_lags

from cmf_mj import InputError
from cmf_mj.analysis.metrics import harmonics
from cmf_mj.control.dcu.play import Arrivals, upsample
from cmf_mj.control.dcu.state import DcuSettings, DcuState, load_dcu, make_dcu, resting
from cmf_mj.control.protection import load_protection, make_protection

Array = NDArray[np.float64]
RATE = 2048
FRAME = 1.0 / RATE
SETTINGS = load_dcu()
DCU = make_dcu()
DELAY = SETTINGS.delay


def correlation_lag(demand: Array, response: Array) -> float:
    """Lag of the largest cross-correlation of two histories over what overlaps, in samples."""
    x, y = demand - demand.mean(), response - response.mean()
    lags = correlation_lags(y.size, x.size)
    near = np.abs(lags) <= x.size // 2
    values = correlate(y, x, method="fft")[near] / (x.size - np.abs(lags[near]))
    peak = int(values.argmax())
    before, top, after = values[peak - 1 : peak + 2]
    return float(lags[near][peak] + 0.5 * (before - after) / (before - 2.0 * top + after))


def arrivals(
    motion: Callable[[Array], Array], rate: float, duration: float, delay: int = 0
) -> Arrivals:
    """A host that samples `motion(time) -> (N, 3, 6)`; a frame arrives on the control frame."""
    time = np.arange(round(duration * rate)) / rate
    frame = np.ceil(time * RATE - 1e-6).astype(np.int64) + delay
    return Arrivals(frame, np.arange(time.size), time, motion(time))


def of(*functions: Callable[[Array], Array], dof: int = 2) -> Callable[[Array], Array]:
    """A motion of one degree of freedom from position, velocity and acceleration."""

    def motion(time: Array) -> Array:
        values = np.zeros((time.size, 3, 6))
        for row, function in enumerate(functions):
            values[:, row, dof] = function(time)
        return values

    return motion


def sine(amplitude: float, frequency: float) -> Callable[[Array], Array]:
    w = 2.0 * np.pi * frequency
    return of(
        lambda t: amplitude * np.sin(w * t),
        lambda t: amplitude * w * np.cos(w * t),
        lambda t: -amplitude * w * w * np.sin(w * t),
    )


def played(stream: Arrivals, frames: int) -> tuple[DcuState, Array]:
    """State and demand of a DCU that has had a stream, at rest before."""
    state = resting(DCU)
    return state, upsample(DCU, state, stream, frames)


def drop(stream: Arrivals, *indices: int) -> Arrivals:
    return Arrivals(*(np.delete(column, indices, axis=0) for column in stream))


def whole_delay(stream: Arrivals) -> float:
    """Delay from stamp to demand: the frame that starts the clock arrives on a control frame."""
    interval = stream.time[1] - stream.time[0]
    grid = stream.frame[1] * FRAME - stream.time[1]
    wait = max(interval, DELAY.host_interval.value) + DELAY.interpolation_hold.value
    return float(wait + grid + DELAY.line_frames * FRAME)


def expected(motion: Callable[[Array], Array], stream: Arrivals, frames: int) -> Array:
    return motion(np.arange(frames) * FRAME - whole_delay(stream))


def lag(samples: Array, frequency: float, first: int) -> float:
    """Delay of whole cycles of a sine that passes zero upwards at the time zero [s]."""
    now = 2.0 * np.pi * frequency * first * FRAME
    phase = harmonics(samples, RATE, frequency, 1).phase[0] - now
    return float((-phase % (2.0 * np.pi)) / (2.0 * np.pi * frequency))


def assert_smooth(demand: Array) -> None:
    """Pose, velocity and acceleration are derivatives of each other, without a jump.

    The mean value theorem: a difference quotient lies between the extremes of the derivative,
    which on a frame differ by the frame times the next derivative.
    """
    for row in (0, 1):
        quotient = np.diff(demand[:, row], axis=0) / FRAME
        low = np.minimum(demand[:-1, row + 1], demand[1:, row + 1])
        high = np.maximum(demand[:-1, row + 1], demand[1:, row + 1])
        bend = np.abs(np.diff(demand[:, row + 1], axis=0)).max() + 1e-9
        assert (quotient >= low - bend).all()
        assert (quotient <= high + bend).all()


SETTLED = slice(2700, 4000)  #: Frames in which the gap of the start is closed.


@pytest.mark.parametrize("rate", [80.0, 64.0, 40.0, 25.0])
def test_a_quintic_is_reproduced_to_round_off(rate: float) -> None:
    poly = Polynomial([0.01, -0.02, 0.03, 0.1, -0.15, 0.05])
    motion = of(poly, poly.deriv(), poly.deriv(2), dof=4)
    stream = arrivals(motion, rate, 2.0)
    state, demand = played(stream, 4100)
    error = demand[SETTLED] - expected(motion, stream, 4100)[SETTLED]
    assert np.abs(error).max(axis=(0, 2)) == pytest.approx(np.zeros(3), abs=1e-11)
    assert state.events.tolist() == [(stream.time.size, 0, 0, 1, 0)]
    assert not state.rejected.any()


def test_between_frames_it_is_scipys_hermite_interpolation() -> None:
    """Frames of one motion, bent by 1 m/s^2 from frame to frame, against polynomials of SciPy."""
    generator = np.random.default_rng(5)
    time = np.arange(200) / 80.0
    values = np.zeros((200, 3, 6))
    values[:, 2] = generator.normal(size=(200, 6))
    for frame in range(1, 200):  # of the third derivative that is constant in between
        before, h = values[frame - 1], 1.0 / 80.0
        bend = (values[frame, 2] - before[2]) / h
        values[frame, 1] = before[1] + before[2] * h + bend * h**2 / 2.0
        values[frame, 0] = before[0] + before[1] * h + before[2] * h**2 / 2.0 + bend * h**3 / 6.0
    stream = Arrivals(np.ceil(time * RATE - 1e-6).astype(np.int64), np.arange(200), time, values)
    state, demand = played(stream, 5300)
    assert not state.rejected.any()
    assert not state.stream.poses_alone[0]
    curve = BPoly.from_derivatives(time, values)
    at = np.arange(3000, 5000) * FRAME - whole_delay(stream)
    for row, function in enumerate((curve, curve.derivative(), curve.derivative(2))):
        assert np.abs(demand[3000:5000, row] - function(at)).max() < 1e-9
    assert_smooth(demand)


def test_the_delay_adds_up_to_what_the_report_found() -> None:
    assert sum(DELAY.parts().values()) == pytest.approx(DELAY.total, abs=1e-15)
    assert DELAY.total == pytest.approx(0.03, abs=0.0005)
    assert {part.status for _, part in DELAY} <= {"stated", "derived", "calibrated", "assumed"}


@pytest.mark.parametrize("transmission", [0, 6, 40])
def test_the_measured_delay_is_the_configured_one(transmission: int) -> None:
    """Cross-correlation of host and demand, within a frame (host at 80 Hz, off the grid)."""
    table = SETTINGS.model_dump()
    table["delay"]["transmission"]["value"] = float(transmission)
    settings = DcuSettings.model_validate(table)
    compiled = make_dcu(settings)
    generator = np.random.default_rng(3)
    lines = generator.uniform(0.5, 5.0, 12), generator.uniform(0.0, 6.0, 12)

    def pose(t: Array) -> Array:
        return 0.002 * np.sin(2.0 * np.pi * np.outer(t, lines[0]) + lines[1]).sum(axis=1)

    def velocity(t: Array) -> Array:
        w = 2.0 * np.pi * lines[0]
        return 0.002 * (w * np.cos(np.outer(t, w) + lines[1])).sum(axis=1)

    def acceleration(t: Array) -> Array:
        w = 2.0 * np.pi * lines[0]
        return -0.002 * (w * w * np.sin(np.outer(t, w) + lines[1])).sum(axis=1)

    motion = of(pose, velocity, acceleration)
    demand = upsample(compiled, resting(compiled), arrivals(motion, 80.0, 12.0), 24000)
    host = pose(np.arange(24000) * FRAME)
    found = correlation_lag(host[2048:], demand[2048:, 0, 2]) * FRAME
    assert found == pytest.approx(settings.delay.total, abs=FRAME)
    assert settings.delay.total - DELAY.total == pytest.approx((transmission - 6) * FRAME)


def test_a_lost_frame_is_bridged_by_the_hold() -> None:
    """Two intervals of 1/80 s fit in the delay: the quintic over both, no stop, no gap."""
    motion = sine(0.05, 1.0)
    stream = drop(arrivals(motion, 80.0, 3.0), 180)
    state, demand = played(stream, 6100)
    error = np.abs(demand - expected(motion, stream, 6100))[2800:, 0, 2].max()
    assert error < 0.05 * (2.0 * np.pi) ** 6 * (1 / 80) ** 6 / 720 * 1.1
    assert state.counts == {
        "accepted": 238,
        "late": 0,
        "missing": 1,
        "resynchronised": 1,
        "silent": 0,
    }


def test_missing_frames_are_waited_for_and_the_stream_is_rejoined_smoothly() -> None:
    motion = sine(0.05, 1.0)
    stream = drop(arrivals(motion, 80.0, 5.0), *range(180, 185))
    state, demand = played(stream, 10200)
    assert state.counts["missing"] == 5
    assert state.counts["late"] == 1
    error = np.abs(demand - expected(motion, stream, 10200))[2800:, 0, 2]
    assert 1e-4 < error.max() < 0.01
    # From the stop on: 62.5 ms without frames, and the gap to 6 % of what it was.
    away = np.flatnonzero(error > 0.06 * error.max())
    assert (away[-1] - away[0]) * FRAME < 0.0625 + SETTINGS.dcu.rejoin_time.si + 0.05
    assert error[-2048:].max() < 1e-9
    assert_smooth(demand)
    # Acceleration is continuous: its slope is that of sine, stop and gap, no more.
    w, fade, stop = 2.0 * np.pi, SETTINGS.dcu.acceleration_fade.si, SETTINGS.dcu.stop_time.si
    v, a, rate = 0.05 * w, 0.05 * w**2, DCU.gap_rate
    gap = rate**3 * 0.01 + 3.0 * rate**2 * v + 3.0 * rate * a
    slope = 0.05 * w**3 + 4.0 * a / fade + 6.0 * v / stop**2 + gap
    assert np.abs(np.diff(demand[2800:, 2, 2])).max() < slope * FRAME


def test_silence_ends_in_rest_with_a_flag() -> None:
    motion = of(lambda t: 0.4 * t, lambda t: 0.4 + 0.0 * t, lambda t: 0.0 * t)
    stream = arrivals(motion, 80.0, 2.0)
    state = resting(DCU)
    assert state.stream.is_stale[0]
    last = int(stream.frame[-1])
    before = last + round(0.24 * RATE)
    demand = upsample(DCU, state, stream, before)
    assert not state.stream.is_stale[0]
    empty = Arrivals(*(column[:0] for column in stream))
    after = upsample(DCU, state, empty, 2048)
    assert state.stream.is_stale[0]
    assert state.counts["silent"] == 1
    whole = np.concatenate([demand, after])
    rest = last + (whole_delay(stream) + SETTINGS.dcu.stop_time.si) * RATE
    still = whole[int(np.ceil(rest)) :, :, 2]
    assert (still[:, 1:] == 0.0).all()
    # The last frame's pose and half the stop time at its velocity.
    end = stream.values[-1, 0, 2] + 0.4 * SETTINGS.dcu.stop_time.si / 2.0
    assert still[:, 0] == pytest.approx(end, abs=1e-12)
    assert_smooth(whole)
    assert np.abs(whole[last:, 2, 2]).max() == pytest.approx(
        1.5 * 0.4 / SETTINGS.dcu.stop_time.si, rel=1e-3
    )


def test_a_host_that_comes_back_is_taken_up_wherever_it_is() -> None:
    first = arrivals(of(lambda t: 0.2 + 0 * t, np.zeros_like, np.zeros_like), 80.0, 1.8)
    other = arrivals(of(lambda t: -0.5 + 0 * t, np.zeros_like, np.zeros_like), 50.0, 3.0, 4500)
    both = Arrivals(*(np.concatenate(pair) for pair in zip(first, other, strict=True)))
    state = resting(DCU, [0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    demand = upsample(DCU, state, both, 10700)
    assert demand[0, 0, 2] == 0.1
    assert demand[4000, 0, 2] == pytest.approx(0.2, abs=1e-15)
    assert demand[-1, 0, 2] == pytest.approx(-0.5, abs=1e-15)
    assert state.counts["resynchronised"] == 2
    assert state.counts["accepted"] == 144 + 150
    speed = SETTINGS.dcu.rejoin_velocity_translation.si
    # Overshoot of s^2 + 3 w s + 3 w^2, and the peak of its impulse response.
    assert np.abs(demand[:, 1, 2]).max() == pytest.approx(speed * 1.0043, rel=1e-4)
    assert np.abs(demand[:, 2, 2]).max() == pytest.approx(0.6993 * DCU.gap_rate * speed, rel=1e-3)
    assert_smooth(demand)


def test_a_step_is_followed_within_the_rejoin_limits_and_one_wild_frame_is_not() -> None:
    """1 in, as in section 3.4.2: the frame is held, confirmed by the next, and costs no time."""
    stream = arrivals(of(lambda t: 0.0254 * (t >= 1.0), np.zeros_like, np.zeros_like), 80.0, 2.5)
    state, demand = played(stream, 5120)
    turn = np.ceil((1.0 + whole_delay(stream)) * RATE)
    moving = np.flatnonzero(np.diff(demand[:, 0, 2]))
    assert abs(moving[0] - turn) <= 1
    closed = 1.0 - demand[round(turn + SETTINGS.dcu.rejoin_time.si * RATE), 0, 2] / 0.0254
    assert closed == pytest.approx((1.0 + 6.0 + 18.0) * np.exp(-6.0), abs=0.002)
    assert demand[-1, 0, 2] == pytest.approx(0.0254, abs=1e-15)
    assert not state.rejected.any()

    wild = stream._replace(values=np.zeros_like(stream.values))
    wild.values[80, 0, 2] = 1.0
    state, demand = played(wild, 4096)
    assert (demand == 0.0).all()
    assert state.rejections["unconfirmed"] == 1
    assert state.counts["accepted"] == 159


def with_row(**changes: float) -> tuple[Arrivals, int]:
    """A resting stream whose frame 50 is changed; returns it and that index."""
    stream = arrivals(of(np.zeros_like, np.zeros_like, np.zeros_like), 80.0, 1.0)
    rows = {"pose": 0, "velocity": 1, "acceleration": 2}
    for name, value in changes.items():
        if name in rows:
            stream.values[50, rows[name], 1] = value
        else:
            getattr(stream, name)[50] = value
    return stream, 50


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"pose": np.nan}, "not_finite"),
        ({"velocity": np.inf}, "not_finite"),
        ({"acceleration": -np.inf}, "not_finite"),
        ({"time": np.nan}, "not_finite"),
        ({"pose": 2.55}, "pose_range"),
        ({"velocity": -2.55}, "velocity_range"),
        ({"acceleration": 98.1}, "acceleration_range"),
        ({"pose": 0.5}, "unconfirmed"),
        ({"sequence": 49}, "repeated"),
        ({"sequence": 3}, "out_of_order"),
        ({"sequence": -1}, "sequence_jump"),
        ({"sequence": 49 + 4097}, "sequence_jump"),
        ({"sequence": 2**62}, "sequence_jump"),
        ({"time": 0.3}, "time_reversed"),
        ({"time": 49 / 80 + 0.009}, "too_soon"),
        ({"time": 49 / 80 + 0.26}, "time_jump"),
        ({"time": 1e300}, "time_jump"),
    ],
)
def test_a_bad_frame_is_counted_by_its_reason_and_leaves_no_trace(
    changes: dict[str, float], reason: str
) -> None:
    stream, _ = with_row(**changes)
    state, demand = played(stream, 2048)
    assert {name: n for name, n in state.rejections.items() if n} == {reason: 1}
    assert state.counts["accepted"] == 79
    assert state.counts["missing"] == (1 if reason in ("repeated", "out_of_order") else 0)
    assert (demand == 0.0).all()


def test_a_host_of_1_khz_is_thinned() -> None:
    motion = sine(0.02, 1.0)
    stream = arrivals(motion, 1000.0, 2.0)
    state, demand = played(stream, 4096)
    assert state.counts["accepted"] == 200
    assert state.rejections["too_soon"] == 1800
    assert state.counts["missing"] == 0
    # Its interval is 10 ms, so that it waits as long as a host of 80 Hz.
    at = np.arange(4096) * FRAME - DELAY.total
    assert np.abs(demand - motion(at))[2800:4000, 0, 2].max() < 0.02 * 2 * np.pi * FRAME


def test_a_burst_is_refused_when_it_runs_ahead() -> None:
    stream = arrivals(of(np.zeros_like, np.zeros_like, np.zeros_like), 80.0, 10.0)
    state = resting(DCU)
    upsample(DCU, state, stream._replace(frame=np.zeros_like(stream.frame)), 10)
    early = state.rejections["too_early"] + state.rejections["time_jump"]
    assert early > 700
    assert state.counts["accepted"] + early == 800


@pytest.mark.parametrize("drift", [2e-4, -2e-4])
def test_the_play_clock_follows_a_host_whose_clock_drifts(drift: float) -> None:
    """After 100 s the clocks differ by 20 ms, more than the hold; the delay does not."""
    motion = sine(0.02, 1.0)
    time = np.arange(8000) / 80.0
    frame = np.ceil(time * (1.0 + drift) * RATE).astype(np.int64)
    stream = Arrivals(frame, np.arange(time.size), time, motion(time))
    state, demand = played(stream, 204000)
    assert state.counts["late"] == 0
    assert not state.rejected.any()
    tail = slice(180000, 200480)  # ten cycles
    found = lag(demand[tail, 0, 2], 1.0 / (1.0 + drift), tail.start)
    tolerance = SETTINGS.dcu.clock_tolerance.si + abs(drift) * SETTINGS.dcu.clock_time.si
    assert found == pytest.approx(DELAY.total, abs=tolerance + FRAME)
    assert_smooth(demand)


def test_a_host_that_falls_behind_for_good_is_followed() -> None:
    motion = sine(0.02, 1.0)
    stream = arrivals(motion, 80.0, 8.0)
    stream.frame[200:] += 205
    state, demand = played(stream, 16000)
    assert state.counts["late"] * 0.0125 < 2.0 * SETTINGS.dcu.clock_time.si
    assert state.counts["resynchronised"] == 1
    tail = slice(12000, 16000)
    error = demand[tail] - motion(np.arange(16000) * FRAME - 205 * FRAME - DELAY.total)[tail]
    tolerance = SETTINGS.dcu.clock_tolerance.si + 2 * FRAME
    assert np.abs(error[:, 0]).max() < 0.02 * 2 * np.pi * tolerance
    assert_smooth(demand)


def test_a_host_that_stumbles_and_catches_up_gets_its_delay_back() -> None:
    """Six frames held up for 75 ms come all at once; the burst is late, the stream is not."""
    motion = sine(0.05, 1.0)
    stream = arrivals(motion, 80.0, 6.0)
    stream.frame[200:206] = stream.frame[206]
    state, demand = played(stream, 12200)
    assert state.counts["late"] > 0
    assert state.counts["resynchronised"] == 1
    error = np.abs(demand - expected(motion, stream, 12200))[:, 0, 2]
    assert error[5200:].max() > 1e-4
    tolerance = SETTINGS.dcu.clock_tolerance.si + FRAME
    assert error[10500:].max() < 0.05 * 2 * np.pi * tolerance
    assert_smooth(demand)


@pytest.mark.parametrize(("before", "after"), [(80.0, 20.0), (20.0, 80.0)])
def test_a_host_may_change_its_rate(before: float, after: float) -> None:
    """The delay grows to the longer interval at once and shrinks at the rate of the clock."""
    motion = sine(0.02, 1.0)
    time = np.concatenate([np.arange(0.0, 2.0, 1 / before), np.arange(2.0, 60.0, 1 / after)])
    frame = np.ceil(time * RATE - 1e-6).astype(np.int64)
    stream = Arrivals(frame, np.arange(time.size), time, motion(time))
    state, demand = played(stream, 122000)
    assert not state.rejected.any()
    tail = slice(110000, 120240)  # five cycles
    found = lag(demand[tail, 0, 2], 1.0, tail.start)
    assert state.clock.interval[0] == pytest.approx(1.0 / after, rel=1e-6)
    assert abs(state.clock.lateness[0]) < SETTINGS.dcu.clock_tolerance.si + FRAME
    wait = max(1.0 / after, DELAY.host_interval.si)
    total = wait + DELAY.interpolation_hold.si + DELAY.line_frames * FRAME
    assert found == pytest.approx(total, abs=SETTINGS.dcu.clock_tolerance.si + 2 * FRAME)
    assert_smooth(demand)


def test_the_pose_ends_within_its_bound() -> None:
    """A stop from the edge of the pose range at full speed goes beyond it, and no further."""
    edge = SETTINGS.dcu.pose_translation.si
    motion = of(lambda t: edge - 2.0 * (1.0 - t), lambda t: 2.0 + 0 * t, np.zeros_like)
    stream = arrivals(motion, 80.0, 1.0)
    state, demand = played(stream, 6000)
    assert edge < demand[:, 0, 2].max() < edge + SETTINGS.dcu.overtravel_translation.si
    assert (demand[-1, 1:] == 0.0).all()
    assert_smooth(demand)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            '[delay]\ntransmission = { value = 2.5, unit = "1", status = "assumed", source = "x" }',
            "whole number of control frames",
        ),
        (
            '[delay]\nhost_interval = { value = 0.3, unit = "s", status = "stated", source = "x" }',
            "timeout: 0.25 s must exceed",
        ),
    ],
)
def test_a_bad_settings_file_is_refused_by_field(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        load_dcu(path)


def test_bad_arguments_are_refused_by_name() -> None:
    stream = arrivals(sine(0.05, 2.0), 80.0, 1.0)
    with pytest.raises(ValueError, match="frame: control frames"):
        upsample(DCU, resting(DCU), stream._replace(frame=stream.frame[::-1].copy()), 10)
    with pytest.raises(ValueError, match="values: shape"):
        upsample(DCU, resting(DCU), stream._replace(values=stream.values[:, 0]), 10)
    with pytest.raises(ValueError, match="frames: 0"):
        upsample(DCU, resting(DCU), stream, 0)
    for wrong in ("abc", [0.0] * 5, [np.nan] * 6, [9.0] * 6):
        with pytest.raises(InputError, match="pose"):
            resting(DCU, wrong)


@pytest.mark.parametrize("make", [make_dcu, partial(make_protection, load_protection())])
@pytest.mark.parametrize("frame", [0.0, -1.0, np.nan])
def test_a_control_frame_takes_time(make: Callable[..., object], frame: float) -> None:
    with pytest.raises(InputError, match="frame: .* s must be greater than 0"):
        make(frame=frame)
