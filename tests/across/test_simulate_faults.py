"""The search over the whole system: its seeds pass, and its checks notice what they are for."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
sys.path.insert(0, str(SCRIPTS))

import simulate_faults as script  # noqa: E402
from faults import checks, hosts, plans, runs  # noqa: E402
from faults.plans import Action, Oddity, Plan  # noqa: E402

from cmf_mj import Record  # noqa: E402
from cmf_mj.control.states import State  # noqa: E402

SHORT = Plan(seconds=0.1, speed=0.9, electronics="noisy", seed=3)
ODD = replace(
    SHORT,
    oddities=(Oddity("loss", 0.0, 0.1, 0.3), Oddity("not_finite", 0.02, 0.05, 0.5)),
    actions=(Action(0.03, "request", "hold"), Action(0.05, "law", "modal_plan")),
)


@cache
def plain() -> runs.Run:
    """A clean host for as long as every check has something to look at."""
    return runs.run(Plan(way_out=0.1))


def otherwise(
    channels: dict[str, np.ndarray] | None = None, fault: str = "", accepted: int = 0
) -> runs.Run:
    """The plain run as if channels, its fault or the count of accepted frames were others."""
    (part,) = plain().parts
    was, counts = part.operation.record, part.operation.counts
    of = {"fault": {"name": fault, "leg": None, "time": 3.9}} if fault else {}
    record = Record(was.time, was.channels | (channels or {}), was.units, was.metadata | of)
    counts = counts | {"accepted": counts["accepted"] + accepted}
    operation = part.operation._replace(record=record, counts=counts)
    return plain()._replace(parts=[part._replace(operation=operation)])


def with_channel(name: str, change: Callable[[np.ndarray], np.ndarray]) -> runs.Run:
    return otherwise({name: change(plain().parts[0].operation.record[name].copy())})


def put(rows: slice, value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(values: np.ndarray) -> np.ndarray:
        values[rows] = value
        return values

    return change


late = slice(7000, None)
DEFECTS: dict[str, tuple[str, Callable[[], runs.Run]]] = {
    "a demand far from its host": (
        "near",
        lambda: with_channel("demand_pose", put(slice(7000, 7010), 0.04)),
    ),
    "a demand of twice the host's motion": (
        "gain",
        lambda: with_channel("demand_pose", lambda pose: 2.0 * pose),
    ),
    "a jerk": (
        "acceleration",
        lambda: with_channel("demand_acceleration", put(slice(7000, 7001), 0.5)),
    ),
    "legs that walk away": ("legs", lambda: with_channel("leg_reference", put(late, 0.1))),
    "legs that do not follow": ("follows", lambda: with_channel("leg_extension", put(late, 0.3))),
    "no number": ("finite", lambda: with_channel("leg_force", put(late, np.nan))),
    "an open gimbal": ("gimbals", lambda: with_channel("gimbal_error", put(late, 1e-3))),
    "energy from nowhere": (
        "balance",
        lambda: with_channel("energy", lambda e: e * [1.01, *[1.0] * 8]),
    ),
    "lost oil": ("balance", lambda: with_channel("tank_content", put(late, 0.0))),
    "a frame counted twice": ("counts", lambda: otherwise(accepted=1)),
    "a stop of the run": ("bounds", lambda: plain()._replace(stopped="beyond the proof pressure")),
    "a chamber beyond proof": ("bounds", lambda: with_channel("cap_pressure", put(late, 1e8))),
    "a chamber below vacuum": ("bounds", lambda: with_channel("rod_pressure", put(late, -2e5))),
    "a fault of a clean host": ("alarm", lambda: otherwise(fault="tracking_error")),
    "a demand that left its host's range": ("alarm", lambda: otherwise(fault="host_range")),
    "half a record": ("disk", lambda: plain()._replace(damage="cap_pressure came back otherwise")),
    "no way out": ("way_out", lambda: plain()._replace(end=State.OFF)),
}


def test_a_clean_host_passes_every_check() -> None:
    assert not dict(checks.broken(plain()))


@pytest.mark.parametrize("defect", DEFECTS)
def test_a_check_notices_what_it_is_for(defect: str) -> None:
    name, run = DEFECTS[defect]
    assert name in dict(checks.broken(run()))


def test_every_check_has_a_defect_that_it_notices() -> None:
    assert {name for name, _ in DEFECTS.values()} == set(checks.CHECKS)


def test_the_hull_is_that_of_the_second_before_the_newest_arrival() -> None:
    """Against a loop over all frames: also through silence, and with the pose at rest before."""
    rng = np.random.default_rng(5)
    frames = np.sort(rng.integers(50, 900, 40))
    poses = rng.normal(size=(40, 6))
    low, high = checks.hulls(frames, poses, 1000, 100)
    for frame in range(0, 1000, 7):
        come = frames <= frame
        if not come.any():
            assert not low[frame].any() and not high[frame].any()
            continue
        since = frames[come][-1] - 100
        earlier = np.flatnonzero(frames < since)
        rows = poses[come & (frames >= since)]
        before = poses[earlier[-1:]] if earlier.size else np.zeros((1, 6))
        rows = np.vstack([before, rows])
        np.testing.assert_array_equal(low[frame], rows.min(axis=0))
        np.testing.assert_array_equal(high[frame], rows.max(axis=0))


def test_the_derivatives_of_the_host_are_those_of_its_motion() -> None:
    """A sine A sin(w t) has A w cos and -A w^2 sin once it has begun."""
    plan, time = Plan(dof="roll", amplitude=0.02, frequency=0.7), np.linspace(1.1, 3.0, 50)
    w = 2.0 * np.pi * 0.7
    velocity, acceleration = hosts.derivatives(plan, time)
    np.testing.assert_allclose(velocity[:, 3], 0.02 * w * np.cos(w * time), atol=1e-8)
    np.testing.assert_allclose(acceleration[:, 3], -0.02 * w * w * np.sin(w * time), atol=1e-6)
    assert not np.delete(velocity, 3, axis=1).any()


@pytest.mark.parametrize("speed", [0.5, 1.0, 2.0])
def test_a_slow_host_sends_the_same_frames_more_slowly(speed: float) -> None:
    sent = hosts.datagrams(Plan(speed=speed), 2.0)
    arrives = np.array([each.arrives for each in sent])
    np.testing.assert_allclose(np.diff(arrives), 1.0 / (80.0 * speed), rtol=1e-9)
    plain = hosts.datagrams(Plan(), 1.0)
    assert [each.data for each in sent[:80]] == [each.data for each in plain[:80]]


@pytest.mark.parametrize(
    ("kind", "size", "count"),
    [("loss", 1.0, 0), ("double", 1.0, 160), ("silent", 0.0, 0), ("skip", 0.26, 38)],
)
def test_an_oddity_does_what_it_says(kind: str, size: float, count: int) -> None:
    """One second of 80 frames, all of it odd."""
    sent = hosts.datagrams(Plan(oddities=(Oddity(kind, 0.0, 1.0, size),)), 0.999)
    assert len(sent) == count
    assert [each.arrives for each in sent] == sorted(each.arrives for each in sent)


@pytest.mark.parametrize("door", plans.DOORS)
def test_a_seed_gives_the_same_bits_again_and_in_other_parts(door: str) -> None:
    plan = replace(ODD, door=door)
    first = runs.run(plan).digest()
    assert runs.run(plan).digest() == first
    assert runs.run(replace(plan, piece=7)).digest() == first


INTERPRETED = """
import sys
sys.path.insert(0, sys.argv[1])
import numba
from faults.plans import Plan
from faults.runs import run
assert numba.config.DISABLE_JIT
print(run(Plan.read(sys.argv[2])).digest())
"""


@pytest.mark.slow
@pytest.mark.parametrize("door", plans.DOORS)
def test_interpreted_gives_the_same_bits(door: str) -> None:
    """200 frames of the whole chain with Numba switched off, in a process of their own."""
    plan = replace(ODD, door=door)
    done = subprocess.run(
        [sys.executable, "-c", INTERPRETED, str(SCRIPTS), plan.text()],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        capture_output=True, text=True, check=True, timeout=300,
    )  # fmt: skip
    assert done.stdout.strip() == runs.run(plan).digest()


@pytest.mark.parametrize("disk", ["full", "kill"])
def test_an_interrupted_saving_is_noticed_where_it_leaves_half_a_record(
    disk: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whole as it is; damaged by a writer that writes under the final name."""
    record = plain().parts[0].operation.record
    plan = Plan(disk=disk)
    assert runs._saved(record, plan) == ""

    def careless(self: Record, path: Path) -> Path:
        path.parent.mkdir(parents=True, exist_ok=True)
        runs.pyarrow.parquet.write_table(runs.pyarrow.table({"time": self.time}), path)
        return path

    monkeypatch.setattr(Record, "save", careless)
    assert runs._saved(record, plan) == "a record that was not whole took its name"


def test_a_plan_comes_back_from_its_text() -> None:
    for seed in range(40):
        plan = plans.draw(seed, 3.0)
        assert Plan.read(plan.text()) == plan == plans.draw(seed, 3.0)


def test_the_seeds_cover_every_choice() -> None:
    drawn = [plans.draw(seed, 4.0) for seed in range(400)]
    assert {plan.machine for plan in drawn} == set(plans.MACHINES)
    assert {plan.door for plan in drawn} == set(plans.DOORS)
    assert {o.kind for plan in drawn for o in plan.oddities} == set(plans.ODDITIES)
    assert {a.kind for plan in drawn for a in plan.actions} == {"request", "law", "event", "kill"}
    rates = [plan.rate * plan.speed for plan in drawn]
    assert min(rates) > 19.0 and max(rates) < 121.0
    assert min(plan.speed for plan in drawn) < 0.6 and max(plan.speed for plan in drawn) > 1.8


def test_a_failure_shrinks_to_what_it_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that needs lost frames of a slow Moog host, and nothing else of a rich plan."""

    def fails(plan: Plan, _: Any = ()) -> tuple[None, dict[str, str]]:
        lost = any(o.kind == "loss" for o in plan.oddities)
        return None, {"near": "far"} if lost and plan.door == "moog" and plan.speed < 1.0 else {}

    monkeypatch.setattr(script, "outcome", fails)
    rich = replace(
        plans.draw(4, 4.0),
        door="moog",
        speed=0.7,
        oddities=tuple(Oddity(kind, 0.1, 1.0, 0.1) for kind in ("late", "loss", "double")),
        actions=tuple(Action(0.1 * k, "request", "hold") for k in range(7)),
    )
    least, words = script.shrunk(rich, "near")
    assert words == "far"
    expected = Plan(
        seconds=least.seconds, door="moog", speed=0.9, oddities=(Oddity("loss", 0.1, 1.0, 0.1),)
    )
    assert least == expected and least.seconds <= 0.5


@pytest.fixture
def arguments(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    given = ["simulate_faults.py"]
    monkeypatch.setattr(sys, "argv", given)
    yield given


def test_a_failure_prints_seed_options_commit_and_the_least_plan(
    arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(script, "outcome", lambda *_: (None, {"near": "far"}))
    arguments += ["--seed", "5", "--runs", "2", "--seconds", "3"]
    assert script.main() == 1
    said = capsys.readouterr().out
    assert f"FAILED seed 5, --seconds 3, commit {script.commit()}\n  near: far\n" in said
    assert "simulate_faults.py --plan '{" in said and '"failures": 1' in said


FOUND = {
    "seed 13: 0.1 m of demand for 4 mm of a host that stalls twice a second": (
        '{"seconds": 3.0, "door": "telemetry", "oddities": [["skip", 1.358, 1.346, 0.1216]]}'
    ),
    "seed 5003: legs on their stops, engaged, after the operator's emergency stop": (
        '{"seconds": 8.0, "actions": [[0.1, "event", "emergency_stop", 1]]}'
    ),
    "seed 200260: the base of a Moog client ends where a position sensor is open": (
        '{"seconds": 2.02, "machine": "new", "door": "moog", '
        '"actions": [[2.002, "event", "sensor_open", 6]]}'
    ),
    "seed 200154: a demand at the machine's limit, of a host that asks for twice of it": (
        '{"machine": "lab", "door": "telemetry", "rate": 21.2, "speed": 1.988, '
        '"oddities": [["wild", 0.303, 2.943, 0.1722]]}'
    ),
}


@pytest.mark.parametrize("defect", FOUND)
def test_what_the_search_has_found_stays_mended(defect: str) -> None:
    _, wrong = script.outcome(Plan.read(FOUND[defect]))
    assert not wrong


@pytest.mark.slow
@pytest.mark.parametrize("first", range(1, 41, 5))
def test_seeds_pass_every_check(first: int) -> None:
    """Some 40 runs of 4 s of the whole system, a minute of them."""
    for seed in range(first, first + 5):
        plan = plans.draw(seed, 4.0)
        _, wrong = script.outcome(plan)
        assert not wrong, (seed, plan.text())
