"""Scenarios: files, live runs, changes, and the same bits from both."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomlkit
from shared import cmf

from cmf_mj import Hexapod, load_law, load_machine, signals, simulate
from cmf_mj.control.states import State
from cmf_mj.core import units
from cmf_mj.core.units import FRAME, RATE
from cmf_mj.facility.changes import change_of
from cmf_mj.facility.run import Run
from cmf_mj.facility.scenario import load_scenario, save_scenario, scenario_names, scenario_of
from cmf_mj.facility.signal import LayeredDemand, added
from cmf_mj.facility.signal_session import SignalSession
from cmf_mj.record.record import Record
from cmf_mj.signals.signal import motion_of_table

SINE = {"kind": "sine", "dof": "heave", "amplitude": [1.0, "in"], "frequency": 2.0, "fade": 0.2}
ROLL = {"kind": "sine", "dof": "roll", "amplitude": [0.5, "deg"], "frequency": 1.0, "fade": 0.1}


def scenario(**fields: Any) -> Run:
    return scenario_of({"duration": 0.5, "signal": [SINE]} | fields, "test")


# Files


@pytest.mark.parametrize("name", scenario_names())
def test_shipped_scenarios_read_back_equal(name: str, tmp_path: Path) -> None:
    shipped = load_scenario(name)
    assert load_scenario(save_scenario(shipped, tmp_path / "again.toml")) == shipped


def test_a_run_saved_to_another_folder_reads_back_as_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its files count from where it was made, not from where it is saved."""
    monkeypatch.chdir(tmp_path)
    mass = '{value = 9000.0, unit = "kg", status = "assumed", source = "test"}'
    Path("mine.toml").write_text(f'base = "gfd"\n[mine]\nmass = {mass}\n')
    run = Run(cab="mine.toml", duration=0.5)
    again = load_scenario(save_scenario(run, tmp_path / "elsewhere" / "run.toml"))
    assert again.loaded_cab == run.loaded_cab
    assert again.cab == str(tmp_path / "mine.toml")
    assert again == run.changed(cab=again.cab)
    assert load_scenario(save_scenario(again, tmp_path / "again.toml")) == again


@pytest.mark.parametrize("machine", ["cmf", "simona", "lab"])
def test_the_law_survives_the_file_on_every_machine(machine: str, tmp_path: Path) -> None:
    """Of any law: a default is the machine's, `velocity` that of the CMF alone."""
    own = load_machine(machine).law
    for law in (own, "velocity", "original"):
        run = Run(machine=machine, law=law)
        assert load_scenario(save_scenario(run, tmp_path / "run.toml")).law == law
    assert Run(machine=machine).law == own
    assert (
        Run().changed(machine=machine).law == own == Run(machine="cmf").changed(machine=machine).law
    )
    assert Run(machine="cmf", law="velocity").changed(machine=machine).law == "velocity"


def test_every_field_survives_the_file(tmp_path: Path) -> None:
    full = scenario(
        title='quoted "title"',
        cab="ifd",
        duration="open",
        gains={"direct_gain": {"velocity": -1.5}, "state_gain": 0.9},
        event=[{"at": 0.1, "kind": "valve_hard_over", "leg": 2, "size": [50.0, "%"]}],
        electronics={"sensors": "ideal"},
        operation={"begin": "engaged", "request": [{"at": 0.2, "request": "hold"}]},
        change=[{"at": 0.1, "signal": [], "fade": 0.0}, {"frame": 999, "push": {}}],
    )
    assert load_scenario(save_scenario(full, tmp_path / "full.toml")) == full


def test_files_count_from_the_scenario_s_folder(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("[soft]\ntitle = 'S'\ndirect_gain = { reference = 40.0 }\n")
    path = tmp_path / "run.toml"
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "b.parquet").touch()
    path.write_text("law = 'mine.toml'\n[[signal]]\nkind = 'host'\nfile = 'a/b.parquet'\n")
    found = load_scenario(path)
    assert found.law == str(tmp_path / "mine.toml")
    assert found.signal[0].model_dump()["file"] == str(tmp_path / "a" / "b.parquet")


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"plant": "truck"}, "plant: 'truck' is refused: input should be 'hexapod' or"),
        ({"law": "fast"}, "law: 'fast' is not one of original"),
        ({"signal": [{"kind": "sin"}]}, "does not match any of the expected tags: 'step'"),
        ({"signal": [SINE | {"amplitude": [1.0, "deg"]}]}, "'deg' is refused for heave"),
        ({"signal": [SINE | {"amplitude": [1.0, "ft"]}]}, "unit 'ft' is not one of in, m"),
        ({"gains": {"state_gain": 1.5}}, "state_gain: 1.5 is refused: input should be less than 1"),
        ({"change": [{"law": "velocity"}]}, "change.0: needs `at` in s or `frame`"),
        ({"change": [{"at": 1.0, "frame": 1}]}, "at, frame: both are given"),
        ({"change": [{"at": 1.0}, {"at": 0.5}]}, "frame 1024 comes after frame 2048"),
        ({"change": [{"at": 1.0, "request": "hold"}]}, "request 'hold' needs [operation]"),
        ({"change": [{"at": 1.0, "failure": [{"kind": "valve_dead"}]}]}, "leg: is missing"),
        ({"plant": "single_legs", "operation": {}}, "operation: is for the hexapod"),
    ],
)
def test_what_is_refused_is_named(table: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match="test") as refused:
        scenario_of(table, "test")
    assert said in str(refused.value)


def test_an_open_run_has_no_record() -> None:
    with pytest.raises(ValueError, match="duration: is open"):
        scenario(duration="open").record()


# Demand


def test_a_take_over_joins_without_a_jump() -> None:
    """Least jerk: the blend is half way at half time, and rests at both ends."""
    low, high = (motion_of_table(np.full((2, 6), value)) for value in (1.0, 3.0))
    demand = LayeredDemand(low)
    demand.change(100, high, 200)
    poses = demand.poses(0, 400)[:, 0]
    assert (poses[:101] == 1.0).all()
    assert poses[200] == 2.0
    assert (poses[300:] == 3.0).all()
    peak = np.abs(np.diff(poses, 2)).max()
    assert peak < 1.01 * 2.0 * (10.0 / np.sqrt(3.0)) / 200**2  # of 10 s^3 - 15 s^4 + 6 s^5


def test_a_second_take_over_starts_from_the_first() -> None:
    parts = [motion_of_table(np.full((1, 6), value)) for value in (0.0, 1.0, 2.0)]
    demand = LayeredDemand(parts[0])
    demand.change(10, parts[1], 100)
    demand.change(60, parts[2], 100)
    poses = demand.poses(0, 200)[:, 0]
    assert np.abs(np.diff(poses)).max() < 0.05
    assert poses[60] == 0.5
    assert poses[-1] == 2.0
    again = LayeredDemand(parts[0])
    again.change(10, parts[1], 100)
    before = again.poses(0, 200)
    again.change(60, parts[2], 100)
    np.testing.assert_array_equal(before[:60], demand.poses(0, 60))
    np.testing.assert_array_equal(again.poses(150, 50), np.full((50, 6), poses[150:200, None]))


def test_an_endless_sine_is_the_sine_after_its_fade() -> None:
    (sine,) = scenario().signal
    frames = np.arange(2 * RATE)
    heave = added([sine], 0, RATE)(frames)[:, 2]
    time = frames / RATE
    late = time >= 0.2
    expected = units.INCH * np.sin(2.0 * np.pi * 2.0 * time[late])
    np.testing.assert_allclose(heave[late], expected, atol=1e-15)
    assert np.abs(heave[~late]).max() < units.INCH


# Runs


def test_a_plain_scenario_is_the_run_of_simulate() -> None:
    step = {"kind": "step", "dof": "surge", "amplitude": [1.0, "in"], "at": 0.25}
    record = scenario(signal=[step]).record()
    command = signals.step("surge", units.INCH, at=0.25, duration=0.5)
    expected = simulate(Hexapod("gfd"), "velocity", command)
    assert set(record.channels) == set(expected.channels)
    for name in expected.channels:
        np.testing.assert_array_equal(record[name], expected[name], err_msg=name)


LIVE = [
    {"law": "position_error_rate"},
    {"signal": [ROLL], "fade": 0.3},
    {"gains": {"direct_gain": {"velocity": -2.0}}},
    {"failure": [{"kind": "overload"}, {"kind": "valve_dead", "leg": 2, "valve": 1}]},
    {"push": {"force": [0.0, 0.0, 2000.0]}},
    {"push": {}, "law": "velocity"},
]


@pytest.fixture(scope="module")
def live() -> Iterator[SignalSession]:
    """Changed at odd frames, advanced in odd parts; the changes end in the third block."""
    run = SignalSession(scenario(duration="open", record_every=3))
    for number, change in enumerate(LIVE):
        for part in (7, 201 + 31 * number, 100):
            run.run(part)
        run.apply(change_of(change))
    run.run(333)
    yield run


def test_what_was_done_live_runs_again_bit_for_bit(live: SignalSession, tmp_path: Path) -> None:
    path = save_scenario(live.done_run(), tmp_path / "done.toml")
    cmf("run", path, "--out", tmp_path / "out")
    assert live.record() == Record.load(tmp_path / "out" / "record.parquet")
    assert load_scenario(tmp_path / "out" / "scenario.toml") == live.done_run()


def test_the_state_of_a_run_is_the_last_row_of_its_record(live: SignalSession) -> None:
    full = SignalSession(live.done_run().model_copy(update={"record_every": 1}))
    full.run(live.frame)
    record = full.record()
    np.testing.assert_array_equal(full.memory.command[0], record["valve_command"][-1])
    np.testing.assert_array_equal(full.memory.reference, record["leg_reference"][-1])
    assert full.law_in_force is not None and full.law_in_force.name == "velocity"
    assert full.fault is None
    np.testing.assert_array_equal(live.plant.data.qpos, full.plant.data.qpos)


def test_each_change_acts(live: SignalSession) -> None:
    """A scenario without one of the changes is another run."""
    done = live.done_run()
    for number in range(len(done.change) - 1):
        fewer = done.change[:number] + done.change[number + 1 :]
        other = done.model_copy(update={"change": fewer}).record()
        frame = done.change[number].at_frame() // 3
        own = live.record()["generalised_position"]
        np.testing.assert_array_equal(own[:frame], other["generalised_position"][:frame])
        assert (own[-1] != other["generalised_position"][-1]).any(), done.change[number]


def test_a_push_lifts_what_it_pushes() -> None:
    """A force through the centre of mass: m a, before legs and hydraulics answer."""
    push = {"frame": 8, "push": {"body": "cab/cab", "force": [0.0, 0.0, 5.0e4]}}
    runs = [scenario(signal=[], duration=0.02, change=c).record() for c in ([], [push])]
    z = [r["generalised_position"][:, 2] for r in runs]
    rise = z[1] - z[0]
    assert (rise[:9] == 0.0).all()
    mass = Hexapod("gfd").reflected_mass()
    up = np.full(6, 1.0)  # heave moves all legs nearly alike; their inertia comes with the platform
    heave = up @ mass @ up
    first = rise[9] / FRAME**2
    assert 0.3 * 5.0e4 / heave < first < 3.0 * 5.0e4 / heave
    assert rise[-1] > 0.0


def test_an_open_run_keeps_only_the_last_seconds() -> None:
    run = SignalSession(scenario(duration="open", record_every=4), kept_seconds=0.5)
    run.run(3 * 1024 + 512)
    record = run.record()
    assert record.time.size == 1024 // 4
    assert record.time[0] == 1.25
    whole = run.done_run().record()
    for name in record.channels:
        np.testing.assert_array_equal(record[name], whole[name][-record.time.size :])


@pytest.mark.parametrize("law", ["velocity", "modal_plan"])
def test_gains_of_any_law_change_live_and_again_from_the_file(law: str) -> None:
    """A list of six too; what a file holds is read back."""
    run = SignalSession(scenario(law=law, duration="open", record_every=3))
    changes = [{"law": "modal_plan"}, {"gains": {"plan": {"position": [30.0] * 6}}}, {"law": law}]
    for change in changes:
        run.run(300)
        run.apply(change_of(change))
    run.run(100)
    done = run.done_run()
    assert [change.law for change in done.change] == ["modal_plan", None, law]
    assert run.record() == done.record()


def test_a_law_that_the_machine_cannot_run_is_refused_before_it_does(tmp_path: Path) -> None:
    modes = load_law("modal_plan").modes
    table = load_law("modal_feedback").model_dump(mode="json", exclude={"name"}, exclude_none=True)
    table["modes"] = {"ifd": modes["ifd"].model_dump(mode="json")}
    path = tmp_path / "odd.toml"
    path.write_text(tomlkit.dumps({"odd": table}))
    change = {"frame": 300, "law": str(path)}
    assert scenario(cab="ifd", change=[change]).change
    for fields in ({"change": [change]}, {"law": str(path)}):
        with pytest.raises(ValueError, match="law odd has none of 'gfd'; it has ifd"):
            scenario(**fields)
    run = SignalSession(scenario())
    with pytest.raises(ValueError, match="none of 'gfd'"):
        run.apply(change_of({"law": str(path)}))
    run.run(10)


def test_a_live_change_leaves_the_coming_ones_possible(tmp_path: Path) -> None:
    """Gains of a plan are for a law with a plan; a law file may go once it is read."""
    path = tmp_path / "mine.toml"
    path.write_text(tomlkit.dumps({"mine": {"title": "Mine", "direct_gain": {"reference": 40.0}}}))
    gains = {"frame": 300, "gains": {"plan": {"position": 20.0}}}
    later = [gains, {"frame": 400, "law": str(path)}]
    run = SignalSession(scenario(law="modal_plan", duration=0.25, change=later))
    path.unlink()
    run.run(100)
    with pytest.raises(ValueError, match="plan.speed: is missing"):
        run.apply(change_of({"law": "velocity"}))
    run.apply(change_of({"law": "modal_plan"}))
    run.run(1000)
    assert run.frame == run.frames and run.law_in_force.name == "mine"


def test_the_chain_from_host_to_valves_runs_again_bit_for_bit() -> None:
    chain = {"operation": {"begin": "engaged"}, "electronics": {}, "protection": "default"}
    signal = [SINE | {"frequency": 1.0, "fade": 1.0}]
    run = SignalSession(scenario(duration="open", record_every=2, signal=signal, **chain))
    for change in ({"signal": [ROLL | {"fade": 1.0}]}, {"request": "hold"}, {"law": "original"}):
        run.run(700)
        run.apply(change_of(change))
    run.run(500)
    assert run.source.progress[0].state == State.HOLD
    record = run.record()
    assert record.metadata["host_counts"]["accepted"] == -(-2600 // 26)
    assert not any(record.metadata["host_rejections"].values())
    assert record == run.done_run().record()


# Command line


def shortened(full: Run, seconds: float) -> Run:
    """All times of a scenario squeezed into a few seconds; its signals begin as they do."""
    assert isinstance(full.duration, float)
    share = seconds / full.duration
    fields: dict[str, Any] = {"duration": seconds}
    fields["events"] = tuple(e.model_copy(update={"at": e.at * share}) for e in full.events)
    fields["change"] = tuple(
        c.model_copy(update={"at": None, "frame": round(c.at_frame() * share)}) for c in full.change
    )
    if full.operation is not None:
        requests = tuple(r.model_copy(update={"at": r.at * share}) for r in full.operation.requests)
        fields["operation"] = full.operation.model_copy(update={"requests": requests})
    return full.model_copy(update=fields)


@pytest.mark.parametrize("name", scenario_names())
def test_shipped_scenarios_run(name: str, tmp_path: Path, drawn: dict[str, set[str]]) -> None:
    full = load_scenario(name)
    assert full.title
    path = save_scenario(shortened(full, 0.3), tmp_path / f"{name}.toml")
    cmf("run", path, "--out", tmp_path / "out")
    record = Record.load(tmp_path / "out" / "record.parquet")
    assert record.time.size == -(-round(0.3 * RATE) // full.record_every)
    assert set(drawn) == {"overview.png"}


def test_schema_and_list() -> None:
    schema = json.loads(cmf("run", "--schema"))
    names = {"event" if name == "events" else name for name in Run.model_fields}
    assert set(schema["properties"]) == names - {"source", "start"}
    listed = cmf("run")
    assert all(name in listed for name in scenario_names())


def test_an_error_writes_nothing(tmp_path: Path) -> None:
    out = tmp_path / "out"
    said = cmf("run", "no_such", "--out", out, code=2)
    assert "'no_such' is not one of capacity_limited" in said
    broken = tmp_path / "broken.toml"
    broken.write_text("duration = 0.1\n[[signal]]\nkind = 'host'\nfile = 'gone.csv'\n")
    assert "gone.csv: cannot be read" in cmf("run", broken, "--out", out, code=2)
    assert not out.exists()
