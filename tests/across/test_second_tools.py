"""Numbers of the package against tools of other authors, and why they differ."""

import sys

import pytest
from crosscheck import second
from shared import data_rows


def test_bounds_of_real_numbers_are_those_of_ab13md() -> None:
    """Over 24 loops and frequencies: upper bounds, found by searches that end at 1 %."""
    least, most = second.structured()
    assert -0.01 < least < most < 0.01


def test_a_gain_that_may_change_has_the_gain_margin_of_python_control() -> None:
    """The bound is 1 % above the one found, so that the margin is at most this short."""
    assert second.margins() == pytest.approx(0.01, abs=0.002)


def test_welch_is_that_of_matplotlib() -> None:
    assert second.spectra() < 1e-12


def test_arx_is_the_realisation_of_impulses_as_more_of_them_are_taken() -> None:
    """The mode rings with exp(-7.6 t): 30 more impulses at 64 Hz leave exp(-3.6) of it."""
    apart = [second.realised(impulses) for impulses in (60, 90, 120)]
    assert apart[0] < 1e-3
    assert apart[1] < 0.05 * apart[0]
    assert apart[2] < 0.1 * apart[1]


def test_kinematics_are_those_of_pinocchio() -> None:
    """Legs, Jacobian, velocities, accelerations; anything but rounding would be a mistake."""
    apart = second.kinematics()
    assert len(apart) == 4
    assert max(apart.values()) < 1e-13


@pytest.mark.parametrize(
    ("package", "comparison"),
    [("pinocchio", second.kinematics), ("slycot", second.write_ab13md)],
)
def test_without_a_tool_the_error_says_what_to_install(
    package: str, comparison: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=rf"{package} is not installed: pip install"):
        comparison()  # type: ignore[operator]


def test_regression_table_of_the_page_lists_every_comparison() -> None:
    """But those of FMUs, which `tests/export/test_fmu.py` makes; none has grown tenfold."""
    rows = {row["number"]: row for row in data_rows("second_tools")}
    measured = {"gain margin": second.margins(), "H1 and coherence, Welch": second.spectra()}
    measured |= {name.split(" [")[0]: worst for name, worst in second.kinematics().items()}
    for name, worst in measured.items():
        assert worst < 10.0 * float(rows[name]["largest difference"]), name
    assert all(float(rows[f"legs of an FMU {n}"]["largest difference"]) == 0.0 for n in (2, 3))
    assert len(rows) == 6 + 4
