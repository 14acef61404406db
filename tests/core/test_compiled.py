"""The compiled code is that of the present sources, and says what the interpreted code says."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher
from numba.core.runtime import rtsys
from numba.core.runtime._nrt_python import memsys_disable_stats, memsys_enable_stats

import cmf_mj
from cmf_mj import SingleLegs, signals, simulate
from cmf_mj.core.compiled import kernel_sources
from cmf_mj.facility.front import from_table
from cmf_mj.facility.run import Run

FORCES = """
import numpy as np
from cmf_mj.plant.parameters import load_hydraulics
from cmf_mj.plant.hydraulics import make_hydraulics, rest, write_loads
hydraulics = make_hydraulics(load_hydraulics("report"), ["leg"], 1 / 2048)
state = rest(hydraulics, np.zeros(1), np.zeros(1))
state.pressure[0] = 2.0e6, 0.0
out = np.zeros(1)
write_loads(hydraulics.cylinder, state.pressure, state.friction, out)
print(out[0] / hydraulics.cylinder.cap_area[0])
"""


def test_editing_a_called_block_recompiles_its_callers(tmp_path: Path) -> None:
    """`write_loads` of hydraulics.py inlines `force` of cylinder.py: doubling that doubles this."""
    package = tmp_path / "cmf_mj"
    source = Path(cmf_mj.__file__).parent
    shutil.copytree(source, package, ignore=shutil.ignore_patterns("__pycache__"))

    def run() -> float:
        environment = os.environ | {"PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
        environment.pop("NUMBA_CACHE_DIR", None)
        command = [sys.executable, "-c", FORCES]
        result = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        )
        return float(result.stdout)

    assert run() == 2.0e6
    assert list(package.rglob("*.nbi")), "nothing was cached: the test would prove nothing"
    block = package / "plant" / "cylinder.py"
    text = block.read_text()
    line = "    return cylinder.cap_area * cap_pressure - "
    assert line in text
    block.write_text(text.replace(line, "    return 2.0 * cylinder.cap_area * cap_pressure - "))
    assert run() == 4.0e6


def test_the_stamp_covers_every_module_compiled_code_can_come_from() -> None:
    """What the imports of the running package say, against what the sources say."""
    inside = {Path(m.__file__) for m in map(sys.modules.get, sys.modules) if is_kernel(m)}
    sources = set(kernel_sources())
    assert inside and inside <= sources
    package = Path(cmf_mj.__file__).parent
    assert {package / "plant" / "valve.py", package / "core" / "units.py"} <= sources
    assert not {package / "show" / "comparison.py", package / "cli" / "__init__.py"} & sources


def is_kernel(module: ModuleType | None) -> bool:
    """Whether a module of the package holds a compiled function of its own."""
    name = getattr(module, "__name__", "")
    members = list(vars(module).values()) if name.startswith("cmf_mj.") else []
    return any(isinstance(m, Dispatcher) and m.py_func.__module__ == name for m in members)


PROGRAM = """
import sys
import numpy as np
import numba
from cmf_mj import SingleLegs, load_law, signals, simulate

assert numba.config.DISABLE_JIT
command = signals.step("heave", -0.0254, at=0.02, duration=200 / 2048)
record = simulate(SingleLegs(), sys.argv[1], command)
np.savez(sys.argv[2], **record.channels)
"""


@pytest.mark.parametrize("name", ["force", "combined_rate"])
def test_the_interpreted_program_gives_the_same_record(tmp_path: Path, name: str) -> None:
    """200 frames with Numba switched off, in a process of their own, against the compiled run.

    1e-12 of each channel's size: compiled and NumPy exponentials and logarithms may differ in
    the last digit; accelerations, second differences over 1/2048 s, carry more of it: 1e-11.
    """
    target = tmp_path / "interpreted.npz"
    subprocess.run(
        [sys.executable, "-c", PROGRAM, name, str(target)],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        check=True,
        timeout=120,
    )
    command = signals.step("heave", -0.0254, at=0.02, duration=200 / 2048)
    compiled = simulate(SingleLegs(), name, command)
    with np.load(target) as interpreted:
        assert set(interpreted) == set(compiled.channels)
        for channel, values in compiled.channels.items():
            share = 1e-11 if channel == "leg_acceleration" else 1e-12
            size = np.abs(values).max()
            np.testing.assert_allclose(
                interpreted[channel], values, rtol=0, atol=share * size, err_msg=channel
            )
    assert np.abs(compiled["valve_command"]).max() > 0.1


def calls(function: Dispatcher) -> set[Dispatcher]:
    """Compiled functions whose names a compiled function uses, its own module's or another's."""
    seen, names = function.py_func.__globals__, set(function.py_func.__code__.co_names)
    found = {seen.get(name) for name in names}
    for module in [thing for thing in found if isinstance(thing, ModuleType)]:
        found |= {getattr(module, name, None) for name in names}
    return {thing for thing in found if isinstance(thing, Dispatcher)}


def test_what_counts_no_references_calls_nothing_that_makes_arrays() -> None:
    """An array that an `allocating` function returned there would never be freed."""
    modules = [m for m in map(sys.modules.get, list(sys.modules)) if is_kernel(m)]
    functions = {f for m in modules for f in vars(m).values() if isinstance(f, Dispatcher)}
    frame = {f for f in functions if f.targetoptions.get("_nrt", True) is False}
    assert len(frame) > 120, "the check would see too few functions"
    wrong = {f.__name__: [c.__name__ for c in calls(f) if c not in frame] for f in frame}
    assert not any(wrong.values())


def test_the_loop_allocates_nothing() -> None:
    session = Run(plant=SingleLegs(), source=from_table(np.zeros((64, 6)))).session()
    session.run(32)
    memsys_enable_stats()
    try:
        before = rtsys.get_allocation_stats()
        session.run()
        after = rtsys.get_allocation_stats()
    finally:
        memsys_disable_stats()
    assert session.frame == 64
    assert after == before
