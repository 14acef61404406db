"""Machine code of the loop is made once: what is exported after it compiles nothing."""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import fmpy
import numba
import numpy as np
import pytest
from hydraulic_equations import changed

from cmf_mj import Hexapod, SingleLegs, load_law
from cmf_mj.core.errors import RunError
from cmf_mj.core.quantity import Quantity
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.export import machine_code
from cmf_mj.export.fmu import export_fmu
from cmf_mj.export.library import export_library
from cmf_mj.export.machine_code import load_or_make
from cmf_mj.machine.machine import load_machine
from cmf_mj.plant.parameters import hydraulics_of


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Where nothing is kept yet."""
    place = tmp_path / "kept"
    place.mkdir()
    fake = SimpleNamespace(stats=SimpleNamespace(cache_path=str(place)))
    monkeypatch.setattr(machine_code, "assign", fake)
    return place


def test_what_is_kept_is_that_of_its_sources(folder: Path) -> None:
    """It is made once for each thing; another source throws away what the one before made."""
    made: list[str] = []

    def of(thing: str, source: str) -> bytes:
        return load_or_make("code", [thing], [source], lambda: made.append(thing) or thing.encode())

    assert [of("a", "1"), of("b", "1"), of("a", "1"), of("b", "1")] == [b"a", b"b", b"a", b"b"]
    assert made == ["a", "b"] and len(list(folder.iterdir())) == 2
    assert load_or_make("other", ["a"], ["1"], lambda: b"o") == b"o"
    assert of("a", "2") == b"a" and made == ["a", "b", "a"]
    assert len(list(folder.glob("code-*"))) == 1 and len(list(folder.iterdir())) == 2


def test_code_that_calls_what_no_one_knows_is_refused() -> None:
    """As where another Numba leaves calls of its own, of Python's say, in the code."""

    def known(parts, first, last):  # type: ignore[no-untyped-def]
        parts[0][0] = math.tanh(parts[0][0])

    def unknown(parts, first, last):  # type: ignore[no-untyped-def]
        parts[0][0] = math.erf(parts[0][0])

    kind = numba.typeof((np.zeros(1),))
    assert machine_code.machine_code("known", known, kind)
    with pytest.raises(RunError, match="machine code of unknown: calls erf; Numba has changed"):
        machine_code.machine_code("unknown", unknown, kind)


@pytest.mark.slow
def test_exports_after_the_first_compile_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """At another rate, with friction, of another machine, plant and law: the code is the first's.

    `scripts/bench.py --exports` prints the times.
    """
    lab = load_machine("lab")
    hertz = Quantity(value=1000, unit="Hz", status="assumed", source="test")
    slow = lab.model_copy(update={"name": "slow", "control_rate": hertz})
    rubbing = {"coulomb_friction": (60.0, "N"), "breakaway_friction": (80.0, "N")}
    oil = changed(hydraulics_of(lab, None), name="rubbing", **rubbing)
    asked: list[tuple[str, tuple[str, ...]]] = []

    def noted(name: str, of: tuple[str, ...], *more: Any) -> bytes:
        asked.append((name, of))
        return load_or_make(name, of, *more)

    monkeypatch.setattr(machine_code, "load_or_make", noted)
    export_fmu(Hexapod(), "velocity", tmp_path / "first.fmu")
    first = set(asked)
    noise, other = ElectronicsSettings(), tmp_path / "other.fmu"
    export_fmu(Hexapod(machine=slow, hydraulics=oil), "velocity", other, fmi=3, electronics=noise)
    export_library(Hexapod(machine=lab), load_law(lab.law), tmp_path / "b")
    export_library(SingleLegs(), None, tmp_path / "c")
    assert set(asked) == first and len(asked) >= len(first) + 4
    unzipped = fmpy.extract(str(other), str(tmp_path / "other"))
    given, expected = (
        np.genfromtxt(
            f"{unzipped}/resources/reference_{part}.csv",
            delimiter=",",
            names=True,
            deletechars="",  # keep the dots of names
        )
        for part in ("in", "out")
    )
    shown = [f"leg_extension[{leg}]" for leg in range(1, 7)]
    result = fmpy.simulate_fmu(
        str(other),
        input=given,
        output=shown,
        output_interval=1.0 / 80.0,
        stop_time=1.0,
        set_input_derivatives=False,
    )
    found = np.array([[row[name] for name in shown] for row in result])
    columns = np.array([list(row)[1:7] for row in expected])
    assert np.abs(found - columns).max() < 1e-12 and np.ptp(columns) > 0.01
