"""Whatever a host sends: the demand is finite, bounded, smooth, and every frame accounted for."""

import numpy as np
import pytest
from dcu_bounds import output_bounds
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from lengths import examples
from numpy.typing import NDArray

from cmf_mj.control.dcu import play
from cmf_mj.control.dcu.play import Arrivals, feed, upsample
from cmf_mj.control.dcu.state import DcuState, make_dcu, resting

RATE = 2048
DCU = make_dcu()
BOUNDS = output_bounds(DCU)

KINDS = (
    "smooth",
    "held",
    "edge",
    "metre_step",
    "not_finite",
    "huge",
    "beyond",
    "denormal",
    "repeated",
    "out_of_order",
    "sequence_jump",
    "time_back",
    "time_jump",
    "silence",
    "burst",
    "fast",
    "slow",
)


def stream(kinds: list[str], seed: int) -> tuple[Arrivals, int]:
    """A host that misbehaves in the order of `kinds`, some frames each."""
    generator = np.random.default_rng(seed)
    rows: list[tuple[int, int, float, NDArray[np.float64]]] = []
    arrival, sequence, time = 0.0, 0, float(generator.choice([0.0, 1.7e9, -5.0]))
    level = np.zeros((3, 6))
    for kind in kinds:
        interval = {"fast": 0.001, "slow": 0.2}.get(kind, 0.0125)
        for _ in range(int(generator.integers(1, 12))):
            sequence += 1
            time += interval
            arrival += 0.0 if kind == "burst" else interval * generator.uniform(0.5, 1.5)
            values, number, stamp = level.copy(), sequence, time
            if kind == "smooth":
                level[0] += 0.01 * level[1]
                level[1] = generator.normal(size=6) * 0.2
                level[2] = generator.normal(size=6)
                values = level.copy()
            elif kind == "edge":
                limits = np.array([DCU.pose, DCU.velocity, DCU.acceleration])
                values = limits * generator.choice([-1.0, 1.0], size=(3, 6))
                values *= generator.choice([1.0, 0.999], size=(3, 6))
            elif kind == "metre_step":
                level[0, :3] = generator.choice([-1.0, 0.0, 1.0], size=3)
                level[1:] = 0.0
                values = level.copy()
            elif kind == "not_finite":
                values[generator.integers(3), generator.integers(6)] = generator.choice(
                    [np.nan, np.inf, -np.inf]
                )
            elif kind == "huge":
                values = generator.choice([-1e308, 1e308, 1e12], size=(3, 6))
                stamp = float(generator.choice([time, 1e308, -1e308]))
            elif kind == "beyond":
                row, dof = int(generator.integers(3)), int(generator.integers(6))
                limit = (DCU.pose, DCU.velocity, DCU.acceleration)[row][dof]
                values[row, dof] = np.nextafter(limit, np.inf) * generator.choice([-1.0, 1.0])
            elif kind == "denormal":
                values = np.full((3, 6), 5e-324)
                stamp = float(generator.choice([time, time + 5e-324]))
            elif kind == "repeated":
                sequence -= 1
                number = sequence
            elif kind == "out_of_order":
                number = max(sequence - int(generator.integers(1, 50)), 0)
            elif kind == "sequence_jump":
                number = int(generator.choice([-1, -(2**63), 2**63 - 1, sequence + 5000]))
            elif kind == "time_back":
                stamp = time - generator.uniform(0.0, 10.0)
            elif kind == "time_jump":
                stamp = time + generator.uniform(0.2, 10.0)
            elif kind == "silence":
                arrival += generator.uniform(0.0, 0.4)
            rows.append((int(arrival * RATE), number, stamp, values))
    frame, number, stamp, values = zip(*rows, strict=True)
    arrivals = Arrivals(
        np.array(frame), np.array(number), np.array(stamp), np.array(values, dtype=float)
    )
    return arrivals, int(arrival * RATE) + RATE


def check(arrivals: Arrivals, frames: int) -> DcuState:
    state = resting(DCU)
    demand = upsample(DCU, state, arrivals, frames)
    assert np.isfinite(demand).all()
    assert (np.abs(demand).max(axis=0) <= BOUNDS).all()
    # Pose and velocity are continuous, with the next bound as Lipschitz constant.
    for row in (0, 1):
        change = np.abs(np.diff(demand[:, row], axis=0)) * RATE
        assert (change <= BOUNDS[row + 1] * (1.0 + 1e-9) + 1e-9).all()
    taken = state.counts["accepted"]
    assert taken + int(state.rejected.sum()) == arrivals.sequence.size
    return state


@pytest.mark.fuzz
@settings(max_examples=examples(150), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@example(kinds=["edge"] * 8, seed=0)
@example(kinds=["metre_step"] * 8, seed=1)
@example(kinds=["smooth", "huge", "smooth", "not_finite", "smooth", "silence", "smooth"], seed=2)
@given(
    kinds=st.lists(st.sampled_from(KINDS), min_size=1, max_size=12),
    seed=st.integers(0, 2**32 - 1),
)
def test_the_demand_is_bounded_and_every_frame_is_accounted_for(
    kinds: list[str], seed: int
) -> None:
    check(*stream(kinds, seed))


@pytest.mark.fuzz
@settings(max_examples=examples(60), deadline=None)
@given(
    values=st.lists(
        st.tuples(
            st.integers(-(2**63), 2**63 - 1),
            st.floats(allow_nan=True, allow_infinity=True),
            st.floats(allow_nan=True, allow_infinity=True),
            st.integers(0, 400),
        ),
        max_size=20,
    )
)
def test_numbers_without_any_sense(values: list[tuple[int, float, float, int]]) -> None:
    frame = np.cumsum([row[3] for row in values], dtype=np.int64)
    arrivals = Arrivals(
        frame,
        np.array([row[0] for row in values], dtype=np.int64),
        np.array([row[1] for row in values], dtype=float),
        np.array([np.full((3, 6), row[2]) for row in values]).reshape(-1, 3, 6),
    )
    check(arrivals, int(frame[-1]) + 600 if values else 600)


def adversary(count: int) -> Arrivals:
    """Pairs of frames that confirm each other, each pair elsewhere, at the limits of a frame."""
    generator = np.random.default_rng(7)
    time = np.arange(count) / 80.0
    values = np.zeros((count, 3, 6))
    for pair in range(0, count, 2):
        speed = generator.choice([-1.0, 1.0], size=6) * DCU.velocity * 0.99
        place = generator.uniform(-0.9, 0.9, size=6) * DCU.pose
        values[pair, 0], values[pair + 1, 0] = place, place + speed / 80.0
        values[pair : pair + 2, 1] = speed
    frame = np.ceil(time * RATE - 1e-6).astype(np.int64)
    return Arrivals(frame, np.arange(count), time, values)


def test_an_adversary_who_jumps_whenever_he_is_believed() -> None:
    state = check(adversary(4000), 4000 * 26 + 2048)
    assert state.counts["resynchronised"] > 1000


def test_no_gap_is_taken_up_beyond_the_limits_of_a_frame() -> None:
    """What the bounds rest on: reversals at full speed are waited out, not corrected away."""
    arrivals = adversary(200)
    state, demand, cursor = resting(DCU), np.empty((3, 6)), 0
    largest = np.zeros((3, 6))
    for frame in range(200 * 26):
        cursor = feed(DCU, state, arrivals, cursor, frame)
        play.step(DCU, state, demand)
        np.maximum(largest, np.abs(state.gap), out=largest)
    assert (largest[1] > 0.5 * DCU.velocity).all()
    assert (largest[1] <= DCU.velocity).all()
    assert (largest[2] <= DCU.acceleration).all()


def test_the_bounds_are_those_of_the_page_on_hosts() -> None:
    """Pose and velocity of surge and roll, m, rad and m/s, rad/s."""
    np.testing.assert_allclose(BOUNDS[:2, [0, 3]], [[2.79, 1.15], [11.29, 7.53]], atol=0.005)
