"""Laws as machine code: the object file runs without a compiler, and gives a run's output."""

import ctypes
import math
import re
import subprocess
from pathlib import Path

import llvmlite.binding as llvm
import numba
import numpy as np
import pytest

from cmf_mj import Hexapod, Record, law_names, load_law, pose_to_legs, signals, simulate
from cmf_mj.analysis.modes import bound
from cmf_mj.control.dcl import DclState
from cmf_mj.core.errors import InputError, RunError
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.export.library import _header, export_law, law_code, law_parts
from cmf_mj.export.machine import make_image
from cmf_mj.export.machine_code import machine_code
from cmf_mj.facility.replay import FEEDBACK

HOST = Path(__file__).with_name("export_law_host.c")


@pytest.fixture(scope="module")
def recorded() -> dict[str, Record]:
    """A quarter of a second with noise under each law."""
    legs = pose_to_legs(signals.step("heave", 0.02, at=0.05, duration=0.25).pose)
    options = {"legs": True, "start": np.zeros(6), "electronics": ElectronicsSettings()}
    return {law: simulate(Hexapod(), law, legs, **options) for law in law_names("all")}


def test_the_object_of_every_law_gives_the_recorded_output(recorded: dict[str, Record]) -> None:
    """Linked in this process, called with a table made from the law: no compiler, no Python."""
    code = law_code(law_parts(bound(load_law("velocity"), "gfd")))
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    module = llvm.parse_assembly("")
    target = llvm.Target.from_default_triple().create_target_machine()
    engine = llvm.create_mcjit_compiler(module, target)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    pointer, number = ctypes.c_void_p, ctypes.c_int64
    kind = ctypes.CFUNCTYPE(ctypes.c_int, pointer, pointer, number, number, number)
    step = kind(engine.get_function_address("cmf_law_code"))
    unused = (ctypes.c_void_p * 2)()
    inputs = {"reference": "leg_reference"}
    inputs |= {f"feedback.{name}": channel for name, channel in FEEDBACK.items()}
    for law, record in recorded.items():
        parts = law_parts(bound(load_law(law), "gfd"))
        parts = parts._replace(state=DclState.of(record.metadata["law_state"]))
        image = make_image(parts)
        block, slots = image.block.copy(), image.slots.copy()
        slots[image.pointers] += block.ctypes.data

        views = {
            path: block[image.slots[image.at[path]] :][:48].view(np.float64)
            for path in ("dcl.workspace.output", *inputs)
        }
        output = np.empty(record["compensator_output"].shape)
        for frame in range(output.shape[0]):
            for path, channel in inputs.items():
                views[path][:] = record[channel][frame]
            first, second = (ctypes.addressof(unused) + 8 * i for i in range(2))
            assert step(first, second, slots.ctypes.data, 0, 0) == 0
            output[frame] = views["dcl.workspace.output"]
        assert output.tobytes() == record["compensator_output"].tobytes(), law


def test_code_that_calls_what_no_one_knows_is_refused() -> None:
    """As where another Numba leaves calls of its own, of Python's say, in the code."""

    def known(parts, first, last):  # type: ignore[no-untyped-def]
        parts[0][0] = math.tanh(parts[0][0])

    def unknown(parts, first, last):  # type: ignore[no-untyped-def]
        parts[0][0] = math.erf(parts[0][0])

    kind = numba.typeof((np.zeros(1),))
    assert machine_code("known", known, kind)
    with pytest.raises(RunError, match="machine code of unknown: calls erf; Numba has changed"):
        machine_code("unknown", unknown, kind)


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("CC", "no-such-compiler", "cc: there is no C compiler"),
        ("machine", "arm64", "system: Linux"),
    ],
)
def test_without_compiler_or_on_another_system_nothing_is_written(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, field: str, value: str, said: str
) -> None:
    if field == "CC":
        monkeypatch.setenv(field, value)
    else:
        monkeypatch.setattr("platform.machine", lambda: value)
    with pytest.raises(InputError, match=said):
        export_law("velocity", tmp_path / "out", form="machine-code")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_replay_in_c_gives_the_recorded_output_of_every_law(
    recorded: dict[str, Record], tmp_path: Path
) -> None:
    for law, record in recorded.items():
        out = tmp_path / law
        export_law(law, out, form="machine-code")
        command = ["cc", "-std=c99", HOST, "-o", "host", "libcmf_law.so", "-Wl,-rpath,$ORIGIN"]
        subprocess.run([*command, "-I."], cwd=out, check=True)
        states = np.array(list(record.metadata["law_state"].values()))
        inputs = [record[name] for name in ("leg_reference", *FEEDBACK.values())]
        (out / "in").write_bytes(states.tobytes() + np.concatenate(inputs, axis=1).tobytes())
        subprocess.run([out / "host", out / "in", out / "out"], env={}, check=True)
        assert (out / "out").read_bytes() == record["compensator_output"].tobytes(), law


@pytest.mark.parametrize("title", ["**//", "*\\\n/", "x */ #error"])
def test_no_title_ends_the_comment_it_stands_in(title: str) -> None:
    """With the middle taken out or a line joined, a new end of comment came to be."""
    law = load_law("velocity").model_copy(update={"title": title})
    parts = law_parts(bound(law, "gfd"))
    text = _header(law, parts, make_image(parts)).replace("\\\n", "")
    assert text.count("*/") == 1


@pytest.mark.slow
def test_a_law_needs_the_c_library_at_most(tmp_path: Path) -> None:
    files = export_law("modal_plan", tmp_path, form="machine-code")
    dynamic = subprocess.run(["readelf", "-dW", files[-1]], capture_output=True, text=True).stdout
    assert set(re.findall(r"NEEDED.*\[(.*)\]", dynamic)) <= {"libc.so.6", "libm.so.6"}
    assert "TEXTREL" not in dynamic
    done = subprocess.run(["cmake", "-S", tmp_path, "-B", tmp_path / "build"], capture_output=True)
    assert not done.returncode, done.stderr
    subprocess.run(["cmake", "--build", tmp_path / "build"], check=True, capture_output=True)
    said = subprocess.run([tmp_path / "build" / "example"], capture_output=True, text=True).stdout
    assert len(said.splitlines()) == 8
