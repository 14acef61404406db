"""Hostile scenario files, live changes at any moment, and long random operation."""

import time
from typing import Any

import numpy as np
import pytest
from hostile import LAWS, hostile, random_change, scenarios, signals, spoiled
from hypothesis import given, settings
from lengths import examples
from numpy.random import Generator

from cmf_mj import InputError, RunError
from cmf_mj.core.units import FRAME
from cmf_mj.facility.changes import change_of
from cmf_mj.facility.run import Run
from cmf_mj.facility.scenario import scenario_of
from cmf_mj.facility.signal_session import SignalSession

LONGEST_RUN = 10_240  #: Frames of a run in random operation.

PATIENCE = 5.0  #: Longest time that a file may take before its run begins [s].


def check_refusal(error: InputError, table: dict[str, Any]) -> None:
    """Each line says where, what and why: a field of the file, and what is allowed."""
    for line in str(error).splitlines():
        assert line.startswith("test: ") or len(str(error).splitlines()) == 1, line
        assert len(line) > len("test: ") and "Traceback" not in line


def tried(table: dict[str, Any]) -> str:
    """How far a file comes: refused, or run to the end or to a bound that is named."""
    begun = time.process_time()
    try:
        run = SignalSession(scenario_of(table, "test"))
    except InputError as error:
        check_refusal(error, table)
        return "refused"
    finally:
        assert time.process_time() - begun < PATIENCE
    try:
        run.run(400)
    except RunError as error:
        assert " at " in str(error) and str(error).endswith(" s")
    record = run.record()
    assert record.time.size == -(-run.frame // run.done_run().record_every)
    for name, values in record.channels.items():
        assert np.isfinite(values).all(), name
    return "run"


@pytest.mark.parametrize("table", scenarios(), ids=["plain", "chain"])
def test_what_is_spoiled_below_runs_as_it_is(table: dict[str, Any]) -> None:
    run = SignalSession(scenario_of(table, "test"))
    run.run(400)
    assert run.frame == run.frames


@pytest.mark.fuzz
@settings(max_examples=examples(800), deadline=None, derandomize=True)
@given(table=hostile())
def test_a_hostile_file_is_refused_before_it_runs_or_runs(table: dict[str, Any]) -> None:
    tried(table)


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        (("duration",), 1e9, "duration: 1000000000.0 is refused: input should be less than or"),
        (("duration",), 1e6, "record_every: a record of "),
        (("record_every",), 2**70, "record_every: 1180591620717411303424 is refused"),
        (("event", 0, "at"), 1e17, "event.0.at: 1e+17 is refused: input should be less than or"),
        (("event", 0, "at"), 0.2, "event: at 0.2"),
        (("change", 0, "at"), 1e300, "change.0.at: 1e+300 is refused"),
        (("change", 2, "frame"), 4000, "change: at 1.95312 s never happens; allowed: before the"),
        (("change", 1, "fade"), 1e308, "change.1.fade: 1e+308 is refused"),
        (("change", 2, "push", "force"), [0.0, 0.0, 1e300], "1e+300 is refused: input should be"),
        (("change", 2, "push", "body"), "wing", "body: 'wing' is not one of "),
        (("event", 1, "leg"), 9, "leg: 9 of valve_jammed is not a leg; allowed: 1 to 6"),
        (("event", 0, "size"), [1e9, "in^2"], "size: 1e+09 in^2 must be at most 1550 in^2"),
        (("seed",), -1, "seed: -1 is refused"),
        (("protection",), "gone.toml", "gone.toml: cannot be read"),
        (("electronics",), {"sensors": "gone.toml"}, "gone.toml: cannot be read"),
        (
            ("signal", 0),
            {"kind": "host", "file": "gone.csv"},
            "gone.csv: cannot be read: there is no such file",
        ),
        (("signal", 0, "amplitude"), [1e9, "in"], "must be at most 3937.01 in size"),
        (("signal", 2, "cycles"), 1e6, "length: 500000 s of the signal is refused: at most 3600"),
        (("signal",), signals() * 11, "signal: "),
    ],
)
def test_what_once_died_in_the_middle_is_refused_at_the_start(
    place: tuple[str | int, ...], value: Any, said: str
) -> None:
    with pytest.raises(InputError) as refused:
        table = scenarios()[0]
        SignalSession(scenario_of(spoiled(table, place, value), "test"))
    assert said in str(refused.value)


def test_three_thousand_changes_are_done() -> None:
    """Each law is read once; the changes of a frame all happen in it."""
    changes = [
        {"frame": number // 10, "law": ("velocity", "force")[number % 2]} for number in range(100)
    ] + [{"frame": 20, "push": {"force": [float(number), 0.0, 0.0]}} for number in range(2900)]
    run = SignalSession(scenario_of({"duration": 0.02, "change": changes}, "test"))
    run.run(400)
    assert run.frame == run.frames and len(run.done_run().change) == 3000
    assert run.law_in_force.name == "force"


# Live


def machine(draw: Generator) -> Run:
    """Either machine, any cab, with or without the chain from the host, as in real use."""
    chain = bool(draw.random() < 0.5)
    table: dict[str, Any] = {
        **{"duration": "open", "record_every": 16, "protection": "default"},
        **{"law": str(draw.choice(LAWS)), "seed": int(draw.integers(1000))},
        **{"cab": str(draw.choice(["gfd", "rfd", "ifd"]))},
        "hydraulics": str(draw.choice(["report", "hardware", "lossy"])),
    }
    if chain:
        begin = str(draw.choice(["off", "settled", "hold", "engaged"]))
        table |= {"operation": {"begin": begin}, "electronics": {}}
    elif draw.random() < 0.3:
        table |= {"plant": "single_legs"}
    return scenario_of(table, "machine")


def operated(seed: int, frames: int) -> dict[str, int]:
    """Operate machines at random for so many control frames; what happened, counted.

    A run goes on until a bound that it names ends it, or for 5 s; then another begins. Every
    frame is in a run's account and in its record, every number is finite, and MuJoCo's clock shows
    that the state was never reset in between.
    """
    draw = np.random.default_rng(seed)
    counts = dict.fromkeys(("frames", "runs", "changes", "refused", "ended", "faults", "laws"), 0)
    laws = set()
    while counts["frames"] < frames:
        try:
            run = SignalSession(machine(draw), kept_seconds=5.0)
        except InputError:  # a law that is not for this machine
            counts["refused"] += 1
            continue
        counts["runs"] += 1
        most = min(LONGEST_RUN, frames - counts["frames"])
        chain = run.source.hosted
        try:
            while run.frame < most:
                run.run(int(min(draw.integers(1, 1500), most - run.frame)))
                counts["changes"] += 1
                laws.add(run.law_in_force.name)
                try:
                    run.apply(change_of(random_change(draw, chain)))
                except InputError as error:
                    assert str(error)
                    counts["refused"] += 1
        except RunError as error:
            assert str(error).endswith(f" at {run.frame * FRAME:.4f} s"), error
            counts["ended"] += 1
        ended = run.frame < most  # the step of the frame that ended it is made, its row is not
        assert abs(run.plant.data.time - (run.frame + ended) * FRAME) < 1e-6 + 2 * FRAME * ended
        check_kept(run)
        counts["faults"] += run.fault is not None
        counts["frames"] += max(run.frame, 1)
    return counts | {"laws": len(laws)}


def check_kept(run: SignalSession) -> None:
    """The record has a row for every sixteenth frame, with numbers within bounds."""
    record, plant = run.record(), run.plant
    rows = np.arange(-(-run.frame // 16))
    np.testing.assert_array_equal(record.time, rows * 16 * FRAME)
    for name, values in record.channels.items():
        assert np.isfinite(values).all(), name
    stroke = plant.hydraulics.cylinder.half_stroke + 0.05
    assert (np.abs(record["leg_extension"]) < stroke).all()
    pressures = np.stack([record["cap_pressure"], record["rod_pressure"]])
    assert np.abs(record["valve_command"]).max(initial=0.0) <= 1.0
    proof = plant.hydraulics.proof_pressure
    assert np.abs(pressures).max(initial=0.0) < 1.05 * proof  # as read, with errors of the sensors


@pytest.mark.fuzz
@pytest.mark.parametrize("seed", range(examples(5)))
def test_random_operation_loses_no_frame(seed: int) -> None:
    counts = operated(seed, 60_000)
    assert counts["frames"] >= 60_000
    assert 0 < counts["refused"] < counts["changes"]
