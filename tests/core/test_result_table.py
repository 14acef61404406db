"""The one table and the one way of a figure to its file."""

from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from cmf_mj.core.result import Field, Table, number
from cmf_mj.machine.geometry import pose_text
from cmf_mj.show.look import bode_axes, save_figure

TABLE = Table(
    "bandwidths [Hz]",
    ("law", "of", ("published\n-90", ".2f"), ("off", "+.1f %")),
    [
        ("velocity", "h", 4.0, float("nan")),
        ("velocity", "m", np.float64(4.129), -3.21),
        ("force", "", None, "unstable"),
    ],
    caption="h [hardware]",
    grouped=True,
)


def test_markdown_and_csv_hold_every_cell(tmp_path: Path) -> None:
    assert TABLE.markdown() == (
        "| law | of | published -90 | off |\n| --- | --- | --- | --- |\n"
        "| velocity | h | 4.00 | - |\n| velocity | m | 4.13 | -3.2 % |\n"
        "| force |  | - | unstable |\n"
    )
    assert Table("", ("file",), [("a|b.csv",)]).markdown().endswith("| a\\|b.csv |\n")
    saved = TABLE.save(tmp_path / "new" / "t.md").read_text()
    assert saved == f"# bandwidths [Hz]\n\n{TABLE.markdown()}\nh [hardware]\n"
    lines = TABLE.save(tmp_path / "t.csv").read_text().splitlines()
    assert lines[2:] == ["velocity,h,4.00,-", "velocity,m,4.13,-3.2 %", "force,,-,unstable"]


@pytest.mark.parametrize(
    ("value", "form", "text"),
    [
        *((value, ".2f Hz", "0.00 Hz") for value in (-0.0, -1e-9, 0.0, np.float64(-0.0049))),
        *((value, "+.1f %", "+0.0 %") for value in (-0.0, -1e-9, 0.0)),
        *((value, "", "0.0") for value in (-0.0, 0.0)),
        (-1e-9, ".3g", "-1e-09"),
        (-0.006, ".2f", "-0.01"),
        (-np.inf, ".2f", "-inf"),
        (0, "d", "0"),
    ],
)
def test_what_rounds_to_zero_has_no_minus_sign(value: float, form: str, text: str) -> None:
    assert number(value, form) == text
    assert Field("x", form=form).text(value) == text


def test_terminal_shows_brackets_and_writes_a_repeated_name_once() -> None:
    console = Console(width=80, record=True)
    console.print(TABLE)
    text = console.export_text()
    assert "bandwidths [Hz]" in text
    assert "h [hardware]" in text
    assert text.count("velocity") == 1
    lines = [line.strip() for line in text.splitlines()]
    place = next(i for i, line in enumerate(lines) if line.startswith("force"))
    assert lines[place - 1] == ""


@pytest.mark.parametrize("kind", ["png", "svg", "pdf"])
def test_the_same_figure_gives_the_same_bits(kind: str, tmp_path: Path) -> None:
    paths = []
    for name in ("a", "b"):
        figure, gain, _ = bode_axes("gain", limits=True)
        gain.plot([0.1, 1.0], [0.0, -3.0], label="line")
        paths.append(save_figure(figure, tmp_path / name / f"bode.{kind}"))
        assert not figure.axes
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert b"atplotlib" not in paths[0].read_bytes() or kind != "png"
    assert [path.name for path in paths[0].parent.iterdir()] == [paths[0].name]


def test_a_figure_that_fails_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="nonsense"):
        save_figure(bode_axes("gain")[0], tmp_path / "bad.nonsense")
    assert not list(tmp_path.iterdir())


def test_poses_are_written_in_the_fields_units() -> None:
    assert pose_text(np.zeros(6)) == "neutral"
    pose = np.array([0.0254, 0.0, -0.00127, np.radians(3.0), 0.0, 0.0])
    assert pose_text(pose) == "surge 1 in, heave -0.05 in, roll 3 deg"
    assert pose_text(pose, ".1f") == "surge 1.0 in, heave -0.1 in, roll 3.0 deg"
    assert pose_text(0.1 * pose, ".1f") == "surge 0.1 in, roll 0.3 deg"


def test_a_narrow_terminal_has_groups_of_columns_one_below_the_other() -> None:
    heads = ("law", "dof", "hexapod\n-90", "\n-3 dB", "published\n-90", "\nof")
    rows = [("velocity", "surge", 2.5, 4.4, None, "h"), ("velocity", "heave", 2.7, 3.9, 2.9, "h")]
    table = Table("laws", heads, rows, caption="h: hardware", grouped=True)
    first, last = table.column_groups()
    assert first.header == ["law", "dof", "hexapod\n-90", "\n-3 dB"]
    assert last.header == ["law", "dof", "published\n-90", "\nof"]
    assert [[*a, *b[2:]] for a, b in zip(first.rows, last.rows, strict=True)] == [
        list(row) for row in rows
    ]
    assert (first.title, first.caption, last.title, last.caption) == ("laws", "", "", "h: hardware")
    assert TABLE.column_groups() == [TABLE]
