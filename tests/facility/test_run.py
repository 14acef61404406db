"""What is no plant, no option, no whole number and no file is refused in one sentence."""

import os
import subprocess
import sys
import threading
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba import typeof

import cmf_mj
from cmf_mj import Hexapod, Record, SingleLegs, drive, simulate
from cmf_mj.core.errors import CmfError, InputError
from cmf_mj.facility.front import from_table
from cmf_mj.facility.host.handover import make_log
from cmf_mj.facility.host_chain import HostChain
from cmf_mj.facility.pace import make_pace
from cmf_mj.facility.run import Run
from cmf_mj.facility.signal import LegDemand, ValveCommands
from cmf_mj.record.columns import read_mapped
from cmf_mj.studies.engine import Workers

STILL = np.zeros((8, 6))
PLANT = SingleLegs()


@pytest.mark.parametrize("field", ["record_every", "command_delay"])
@pytest.mark.parametrize("value", [1.5, True, np.True_, "2", -1, float("nan"), [1], 10**12])
def test_a_number_of_frames_is_a_whole_number(field: str, value: Any) -> None:
    with pytest.raises(InputError, match=f"{field}: .* is refused: input should be"):
        simulate(PLANT, "velocity", STILL, **{field: value})


@pytest.mark.parametrize("kind", [np.int32, np.int64, np.uint8])
def test_whole_numbers_of_numpy_become_python_s(kind: type) -> None:
    """A number of another type would compile a loop of its own, for 14 to 29 s."""
    run = Run(plant=PLANT, source=from_table(STILL), record_every=kind(2), command_delay=kind(1))
    session = run.session()
    numbers = session.record_every, session.controller.delay, session.frames
    assert numbers == (2, 1, 8) and {type(number) for number in numbers} == {int}
    one, other = (simulate(PLANT, "velocity", STILL, record_every=every) for every in (2, kind(2)))
    assert one["leg_position"].tobytes() == other["leg_position"].tobytes()


def test_a_run_is_what_simulate_and_drive_make_of_their_arguments() -> None:
    legs, options = 0.01 + STILL, {"record_every": 2, "command_delay": 3}
    pairs = (
        (simulate(PLANT, "velocity", STILL, **options), {"source": STILL}),
        (simulate(PLANT, "velocity", legs, legs=True, **options), {"source": LegDemand(legs)}),
        (drive(PLANT, legs, **options), {"law": None, "source": ValveCommands(legs)}),
    )
    for record, run in pairs:
        assert Run(plant=PLANT, **run, **options).record() == record


def test_all_runs_share_one_compiled_loop() -> None:
    """On a table, in open loop, on a host with electronics in real time: the same types."""
    bare = Run(plant=Hexapod(), source=from_table(STILL))
    chain = HostChain(begin="off")
    hosted = bare.changed(source=make_log(4), operation=chain, electronics={}, protection="default")
    runs = (
        bare.session(),
        bare.changed(law=None, source=ValveCommands(STILL)).session(),
        hosted.changed(duration=8 / 2048).session(pace=make_pace(8)),
    )
    assert len({str(typeof(run.parts)) for run in runs}) == 1


def test_an_option_that_there_is_not_is_named_with_those_there_are() -> None:
    said = "record_evry: is not a known field; allowed: .*record_every.*; did you mean record_every"
    wrong: dict[str, Any] = {"record_evry": 2}
    for run in (
        lambda: simulate(PLANT, "velocity", STILL, **wrong),
        lambda: drive(PLANT, STILL, **wrong),
    ):
        with pytest.raises(InputError, match=said):
            run()
    with pytest.raises(InputError, match="option: 'quik' is not one of quick, .*did you mean qui"):
        cmf_mj.compare(["velocity"], ["heave"], quik=True)


@pytest.mark.parametrize("plant", ["gfd", None, SingleLegs])
def test_a_plant_is_none_by_its_name(plant: Any) -> None:
    for run in (lambda: simulate(plant, "velocity", STILL), lambda: drive(plant, STILL)):
        with pytest.raises(InputError, match="plant: .* is refused: input should be 'hexapod' or"):
            run()


@pytest.mark.parametrize("bad", [1j * STILL, [["a"] * 6], [[0.0] * 6, [0.0]]], ids=type)
def test_poses_and_valve_commands_are_real_numbers(bad: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for run in (
            lambda: simulate(PLANT, "velocity", bad),
            lambda: simulate(PLANT, "velocity", bad, legs=True),
            lambda: drive(PLANT, bad),
        ):
            with pytest.raises(InputError, match="(command|valves): holds .*; allowed: real"):
                run()


def test_extensions_and_valve_commands_are_not_taken_for_one_another() -> None:
    """Metres were fractions of full command without a law, and fractions metres with one."""
    wrong = (None, STILL), (None, LegDemand(STILL)), ("velocity", ValveCommands(STILL))
    for law, source in wrong:
        with pytest.raises(InputError, match="law: None opens the loop; allowed with a `source`"):
            Run(plant=PLANT, law=law, source=source)
    for bad, said in ((STILL[:0], ": has no rows"), (STILL * np.nan, r"\[0, 0\]: nan is not a")):
        with pytest.raises(InputError, match=f"command{said}"):
            simulate(PLANT, "velocity", bad, legs=True)


# -- files --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["a.toml", "a.csv", "a.parquet"])
def test_a_pipe_is_not_waited_for(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / name)
    said: list[str] = []

    def read() -> None:
        load = {"toml": cmf_mj.load_law, "csv": read_mapped, "parquet": Record.load}[name[2:]]
        with pytest.raises(InputError) as refused:
            load(tmp_path / name)
        said.append(str(refused.value))

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    reader.join(20.0)
    assert said and name in said[0] and "not a file" in said[0]


def test_a_folder_is_no_record_however_many_it_holds(tmp_path: Path) -> None:
    record = simulate(PLANT, "velocity", STILL)
    for count in (1, 2):
        record.save(tmp_path / "runs" / f"{count}.parquet")
        with pytest.raises(InputError, match="runs: cannot be read: it is a folder"):
            Record.load(tmp_path / "runs")
    with pytest.raises(InputError, match="file: .*runs' is refused: is a folder"):
        record.save(tmp_path / "runs")


# -- what is around -----------------------------------------------------------------------------


def test_a_missing_package_is_not_a_scheduler_that_is_dead(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(CmfError, match="distributed is not installed: pip install .cmf-mj.cluster"):
        Workers(backend="dask", scheduler="tcp://127.0.0.1:9")


def test_a_way_to_draw_that_mujoco_does_not_know_is_refused() -> None:
    line = [sys.executable, "-m", "cmf_mj", "machine", "check", "cmf"]
    environment = os.environ | {"MUJOCO_GL": "foo"}
    run = subprocess.run(line, capture_output=True, text=True, env=environment, check=False)
    assert run.returncode == 2, run.stderr
    assert "MUJOCO_GL: foo; allowed: egl, osmesa, glfw or off" in " ".join(run.stderr.split())
    assert "Traceback" not in run.stderr
