"""The facility's CSV files: exact to their decimals, and one clear error if broken."""

import re

import numpy as np
import pytest

from cmf_mj import Record, SingleLegs, signals, simulate
from cmf_mj.core import units
from cmf_mj.record.columns import ColumnMap, load_columns, read_mapped, write_facility_csv

INCH = 0.0254  # international yard and pound agreement
N = 40
LAYOUT = load_columns().channels
FEEDBACK = [f"DCL2DVS_FDK_LEG_POS_{i} [in]" for i in range(1, 7)]
DEMAND = [f"DCL2DVS_DMD_LEG_POS_{i} [in]" for i in range(1, 7)]


def synthetic(drop=(), **changes):
    """Six legs with every channel of the layout, in SI, not on the grid of any resolution."""
    random = np.random.default_rng(5)
    scale = {"m": 0.3, "m/s": 0.4, "m/s^2": 8.0, "Pa": 7e6, "1": 0.5}
    si = {name: units.si_unit(one.unit) for name, one in LAYOUT.items() if name not in drop}
    values = {
        "time": np.arange(N) / 128.0,
        "channels": {k: random.normal(size=(N, 6)).clip(-3, 3) * scale[v] for k, v in si.items()},
        "units": si,
        "metadata": {"sample_rate": 128.0, "law": "velocity", "command": {"kind": "recording"}},
    }
    return Record(**(values | changes))


@pytest.fixture(scope="module")
def run():
    command = signals.multisine("heave", 0.005, period=0.5, start=2.0, stop=20.0, seed=3)
    return simulate(SingleLegs(), "velocity", command, record_every=16)


def put(folder, content):
    path = folder / "run.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def test_round_trip_is_exact_to_six_decimals(tmp_path):
    """Half of 1e-6 in the column's unit, plus the round-off of the conversion to SI."""
    record = synthetic(time=5.0 + np.arange(N) / 128.0)
    back = read_mapped(write_facility_csv(record, tmp_path / "run.csv"))
    assert set(back.channels) == set(LAYOUT)
    for name, one in LAYOUT.items():
        worst = np.abs(back[name] - record[name]).max()
        rounding = 4e-16 * np.abs(record[name]).max()
        assert worst <= 0.5e-6 * units.factor(one.unit) + rounding, name
        assert back.units[name] == record.units[name]
    np.testing.assert_array_equal(back.time, record.time)
    again = write_facility_csv(back, tmp_path / "two.csv").read_text().splitlines()
    assert again[:-1] == (tmp_path / "run.csv").read_text().splitlines()[:-1]


def test_metadata_and_command_come_back(run, tmp_path):
    back = dict(read_mapped(write_facility_csv(run, tmp_path / "run.csv")).metadata)
    read = back.pop("recording")
    assert back == dict(run.metadata)
    assert read["file"] == "run.csv" and read["last_place"] == pytest.approx(1e-6 * INCH)


def test_optional_channels_may_be_missing(tmp_path):
    record = synthetic(drop=("cap_pressure", "valve_command"))
    path = write_facility_csv(record, tmp_path / "run.csv")
    assert set(read_mapped(path).channels) == set(record.channels)


def test_the_reports_places_are_a_map_of_whoever_has_them(tmp_path):
    """Appendix A: dlmread BO2..FW, Data(:,1:6) feedback and Data(:,63:68) demand, in inches."""
    values = np.arange(N * 179.0).reshape(N, 179) % 37.0 / 4.0
    text = "\n".join(["CMF heave sweep", *(",".join(f"{x:g}" for x in row) for row in values)])
    places = {
        name: {"columns": [f"column_{first + k}" for k in range(6)], "unit": "in"}
        for name, first in (("leg_position", 67), ("leg_reference", 129))
    }
    made = ColumnMap.model_validate({"time": {"rate": 128.0}, "channels": places})
    back = read_mapped(put(tmp_path, text), made)
    np.testing.assert_allclose(back["leg_position"], values[:, 66:72] * INCH, rtol=1e-15)
    np.testing.assert_allclose(back["leg_reference"], values[:, 128:134] * INCH, rtol=1e-15)


def test_order_comments_and_habits_of_editors_do_not_matter(tmp_path):
    path = write_facility_csv(synthetic(), tmp_path / "run.csv")
    rows = [line.split(",") for line in path.read_text().splitlines()[:-1]]
    lines = [";".join([*row[:0:-1], row[0]]) for row in rows]
    lines[5:5] = ["# operator: stopped for coffee", "  # 12, 13", ""]
    expected = read_mapped(path)["leg_position"]
    text = "\ufeff" + "\r\n".join(["# heave", *lines, "# end"]) + "\r\n\r\n"
    np.testing.assert_array_equal(read_mapped(put(tmp_path, text))["leg_position"], expected)


# Broken files


def lines_of(text):
    return text.split("\n")


def cell(row, column, value):
    """Change one cell, both counted from 1."""

    def change(text):
        lines = lines_of(text)
        cells = lines[row - 1].split(",")
        cells[column - 1] = value
        lines[row - 1] = ",".join(cells)
        return "\n".join(lines)

    return change


def without(*rows):
    return lambda text: "\n".join(x for i, x in enumerate(lines_of(text), 1) if i not in rows)


def renamed(old, new):
    return lambda text: text.replace(old, new)


NUMBER = r"DCL2DVS_FDK_LEG_POS_1 \[in\]: row 4 has no such; allowed: a number"

MUTATED = {
    # truncated, missing and repeated rows
    "empty": (lambda t: "", "no row of numbers"),
    "header only": (lambda t: lines_of(t)[0] + "\n", "no row of numbers"),
    "header missing": (without(1), "column: 'TIME"),
    "truncated in a row": (lambda t: t[:9000] + "\n", r"Row #\d+: Expected 49 columns, got \d+"),
    "truncated in the last number": (
        lambda t: t[: t.index("# cmf_mj") - 2],
        "the last row has no line end and may be cut off",
    ),
    "truncated metadata": (lambda t: t[:-60], "# cmf_mj: is not valid JSON"),
    "metadata of another kind": (lambda t: t + "# cmf_mj [1]\n", "allowed: a table"),
    "long row": (cell(7, 49, "1,3.25"), "Row #6: Expected 49 columns, got 50"),
    "missing row": (without(9), "time: row 8, 0.0625 s, is 0.015625 s after the row before"),
    "repeated row": (lambda t: "\n".join(lines_of(t)[:9] + lines_of(t)[8:]), "times that rise"),
    "two files in one": (lambda t: t + t[t.index("\n") + 1 :], "times that rise"),
    # numbers
    "text": (cell(5, 2, "abc"), NUMBER),
    "overflow": (cell(5, 2, "1e999"), NUMBER),
    "empty cell": (cell(5, 2, ""), NUMBER),
    "no time": (cell(5, 1, ""), r"time: TIME \[s\]: row 4 has none; allowed: a time"),
    # columns
    "duplicate name": (cell(1, 3, FEEDBACK[0]), "names 2 columns"),
    "feedback leg missing": (cell(1, 5, "X"), r"column: 'DCL2DVS_FDK_LEG_POS_4 \[in\]' is not one"),
    "wrong unit": (renamed("POS_1 [in]", "POS_1 [mm]"), r"'DCL2DVS_FDK_LEG_POS_1 \[in\]' is not"),
    "another facility": (renamed("DCL2DVS", "X"), "channels.leg_position: column"),
    "clock in ms": (
        lambda t: re.sub(r"^[\d.]+", lambda m: str(1e3 * float(m[0])), t, flags=re.MULTILINE),
        "0.128 samples a second by unit 's' is refused",
    ),
    "beyond the stroke": (cell(5, 2, "39"), NUMBER + " within 38 in"),
    # not the text it should be
    "binary": (lambda t: bytes(range(256)) * 20, "no row of numbers"),
    "utf-16": (lambda t: t.encode("utf-16"), "run.csv: "),
}  # fmt: skip


@pytest.mark.parametrize(("change", "message"), MUTATED.values(), ids=MUTATED)
def test_broken_file_gives_one_clear_error(tmp_path, change, message):
    path = write_facility_csv(synthetic(), tmp_path / "run.csv")
    put(tmp_path, change(path.read_text()))
    with pytest.raises(ValueError, match=message) as caught:
        read_mapped(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert len(str(caught.value).splitlines()) == 1


def test_file_cut_within_a_row_is_never_read_as_a_shorter_one(tmp_path):
    whole = write_facility_csv(synthetic(), tmp_path / "run.csv").read_bytes()
    for size in range(0, whole.index(b"# cmf_mj"), 97):
        if whole[size - 1 : size] != b"\n":
            with pytest.raises(ValueError, match="run.csv: "):
                read_mapped(put(tmp_path, whole[:size]))


def test_record_that_does_not_fit_is_refused_and_nothing_written(tmp_path):
    gap = synthetic()["cap_pressure"].copy()
    gap[4, 2] = np.nan
    for channel, values, message in (
        ("cap_pressure", gap, r"cap_pressure\[4, 2\]: nan is not a finite number"),
        ("leg_position", np.zeros((N, 1)), r"leg_position: shape is \(40, 1\); allowed: \(N, 6\)"),
    ):
        channels = dict(synthetic().channels) | {channel: values}
        with pytest.raises(ValueError, match=message):
            write_facility_csv(synthetic(channels=channels), tmp_path / "run.csv")
    assert list(tmp_path.iterdir()) == []
