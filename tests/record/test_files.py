"""Recordings: the published places, exact to the stated resolution, one clear error if broken."""

import json

import numpy as np
import pytest

from cmf_mj import Record, SingleLegs, frequency_response, signals, simulate
from cmf_mj.core import units
from cmf_mj.record.facility_csv import LAYOUT, write_facility_csv
from cmf_mj.record.reader import read_facility_csv

INCH = 0.0254  # international yard and pound agreement
N = 40
FEEDBACK = [f"DCL2DVS_FDK_LEG_POS_{i}" for i in range(1, 7)]
DEMAND = [f"DCL2DVS_DMD_LEG_POS_{i}" for i in range(1, 7)]


def synthetic(rate=128.0, samples=N, drop=(), **changes):
    """Six legs with every channel of the layout, in SI, not on the grid of any resolution."""
    random = np.random.default_rng(5)
    scale = {"m": 0.3, "m/s": 0.4, "m/s^2": 8.0, "Pa": 7e6, "1": 0.5}
    channels = {
        g.channel: random.normal(size=(samples, 6)).clip(-3, 3) * scale[g.si] for g in LAYOUT
    }
    values = {
        "time": np.arange(samples) / rate,
        "channels": {k: v for k, v in channels.items() if k not in drop},
        "units": {g.channel: g.si for g in LAYOUT if g.channel not in drop},
        "metadata": {
            "sample_rate": rate,
            "law": "velocity",
            "command": {"kind": "chirp", "dof": "heave", "settle": 0.0},
        },
    }
    return Record(**(values | changes))


@pytest.fixture(scope="module")
def run():
    command = signals.multisine("heave", 0.005, period=0.5, start=2.0, stop=20.0, seed=3)
    return simulate(SingleLegs(), "velocity", command)


def positional(header, separator=",", width=179, samples=N, line=None):
    """A file of the report's form: nothing known but places; returns its text and 12 columns."""
    values = np.arange(samples * width, dtype=float).reshape(samples, width) % 37.0 / 4.0
    rows = [separator.join(f"{x:g}" for x in row) for row in values]
    if line is not None:
        rows.insert(3, line)
    return "\n".join([header, *rows]) + "\n", values


def named(order, samples=N, separator=","):
    """Only the columns in `order`, filled with exact multiples of 1/8 in."""
    values = {name: (np.arange(samples) + i) % 24 / 8.0 for i, name in enumerate(order)}
    rows = zip(*values.values(), strict=True)
    lines = [separator.join(order), *(separator.join(f"{x:.3f}" for x in row) for row in rows)]
    return "\n".join(lines) + "\n", values


def put(folder, content, name="run.csv"):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


# The layout


def test_published_positions_lie_where_the_report_reads_them(tmp_path):
    """Appendix A: dlmread BO2..FW, Data(:,1:6) feedback and Data(:,63:68) demand, in inches."""
    record = synthetic()
    path = write_facility_csv(record, tmp_path / "run.csv")
    block = np.loadtxt(path, delimiter=",", skiprows=1, usecols=range(66, 179))
    assert block.shape == (N, 113)
    np.testing.assert_allclose(block[:, :6], record["leg_position"] / INCH, rtol=0, atol=0.5001e-6)
    np.testing.assert_allclose(
        block[:, 62:68], record["leg_reference"] / INCH, rtol=0, atol=0.5001e-6
    )


def test_published_names_head_columns_67_and_129(tmp_path):
    lines = write_facility_csv(synthetic(), tmp_path / "run.csv").read_text().splitlines()
    header = lines[0].split(",")
    assert header[66:72] == FEEDBACK and header[128:134] == DEMAND
    assert len(header) == 179


def test_rows_2_to_n_plus_1_are_the_samples_and_the_metadata_come_after(tmp_path):
    """Appendix A reads from row 2 to 'array length + 1'."""
    lines = write_facility_csv(synthetic(), tmp_path / "run.csv").read_text().splitlines()
    assert len(lines) == N + 2
    assert [i for i, line in enumerate(lines) if line.startswith("#")] == [N + 1]
    assert json.loads(lines[-1].removeprefix("# cmf_mj "))["metadata"]["law"] == "velocity"


def test_layout_groups_do_not_overlap():
    columns = [g.first + leg for g in LAYOUT for leg in range(6)]
    assert len(set(columns)) == len(columns) and 1 <= min(columns) and max(columns) <= 113


# Round trip


@pytest.mark.parametrize("decimals", [0, 3, 6, 9])
def test_round_trip_is_exact_to_the_stated_resolution(tmp_path, decimals):
    """Half of 10^-decimals in the column's unit, plus the round-off of the conversion to SI."""
    record = synthetic()
    back = read_facility_csv(write_facility_csv(record, tmp_path / "run.csv", decimals=decimals))
    assert set(back.channels) == {g.channel for g in LAYOUT}
    for g in LAYOUT:
        unit = units.factor(g.unit)
        worst = np.abs(back[g.channel] - record[g.channel]).max()
        assert worst <= 0.5 * 10.0**-decimals * unit + 4e-16 * np.abs(record[g.channel]).max(), g
        assert back.units[g.channel] == g.si
    np.testing.assert_array_equal(back.time, record.time)


def test_second_round_trip_changes_nothing(tmp_path):
    first = write_facility_csv(synthetic(), tmp_path / "run.csv")
    second = write_facility_csv(read_facility_csv(first), tmp_path / "two.csv")
    one, two = first.read_text().splitlines(), second.read_text().splitlines()
    assert one[:-1] == two[:-1]


def test_simulation_is_picked_at_128_hz(run, tmp_path):
    back = read_facility_csv(write_facility_csv(run, tmp_path / "run.csv", decimals=9))
    assert back.rate == 128.0
    np.testing.assert_array_equal(back.time, run.time[::16])
    for name in ("leg_reference", "leg_position"):
        np.testing.assert_allclose(back[name], run[name][::16], rtol=0, atol=0.51e-9 * INCH)


def test_metadata_and_command_come_back(run, tmp_path):
    back = read_facility_csv(write_facility_csv(run, tmp_path / "run.csv"))
    recorded = {"file": "run.csv", "columns": "by name", "decimals": 6}
    assert dict(back.metadata) == dict(run.metadata) | {
        "sample_rate": 128.0,
        "recording": recorded,
    }


def test_response_of_the_file_is_that_of_the_picked_run(run, tmp_path):
    """Demand lines of 1 mm peak: half of 1e-9 in moves none by more than 1e-6."""
    picked = Record(
        run.time[::16],
        {name: run[name][::16] for name in ("leg_reference", "leg_position")},
        {"leg_reference": "m", "leg_position": "m"},
        dict(run.metadata) | {"sample_rate": 128.0},
    )
    back = read_facility_csv(write_facility_csv(run, tmp_path / "run.csv", decimals=9))
    one, two = frequency_response(picked), frequency_response(back)
    np.testing.assert_array_equal(two.frequency, one.frequency)
    np.testing.assert_allclose(two.response, one.response, rtol=1e-6)


def test_start_time_is_kept(tmp_path):
    record = synthetic(time=5.0 + np.arange(N) / 128.0)
    back = read_facility_csv(write_facility_csv(record, tmp_path / "run.csv"))
    np.testing.assert_array_equal(back.time, record.time)


def test_optional_channels_may_be_missing(tmp_path):
    record = synthetic(drop=("cap_pressure", "valve_command"))
    path = write_facility_csv(record, tmp_path / "run.csv")
    assert "UNUSED_85" in path.read_text().splitlines()[0].split(",")
    assert set(read_facility_csv(path).channels) == set(record.channels)


# Files of others


HEADERS = {
    "free text": "CMF heave sweep 1 of 5",
    "empty names": "," * 178,
    "other names": ",".join(f"VAR{i}" for i in range(179)),
}


@pytest.mark.parametrize("header", HEADERS.values(), ids=HEADERS)
@pytest.mark.parametrize("separator", [",", ";", " "])
def test_file_of_the_reports_form_is_read_by_position(tmp_path, header, separator):
    text, values = positional(header, separator)
    back = read_facility_csv(put(tmp_path, text))
    np.testing.assert_allclose(back["leg_position"], values[:, 66:72] * INCH, rtol=1e-15)
    np.testing.assert_allclose(back["leg_reference"], values[:, 128:134] * INCH, rtol=1e-15)
    assert set(back.channels) == {"leg_position", "leg_reference"}
    assert back.rate == 128.0 and back.time[1] == 1.0 / 128.0
    assert back.metadata["recording"]["columns"] == "by position"
    assert back.metadata["command"] == {"kind": "recording"}


def test_block_alone_is_read_by_position(tmp_path):
    text, values = positional("the block", width=113)
    back = read_facility_csv(put(tmp_path, text))
    np.testing.assert_allclose(back["leg_reference"], values[:, 62:68] * INCH, rtol=1e-15)


def test_columns_outside_the_block_may_hold_text(tmp_path):
    text, values = positional("CMF")
    text = "\n".join(
        ("2012-04-11" + row[row.index(",") :]) if "," in row else row for row in text.split("\n")
    )
    back = read_facility_csv(put(tmp_path, text))
    np.testing.assert_allclose(back["leg_position"], values[:, 66:72] * INCH, rtol=1e-15)


@pytest.mark.parametrize("separator", [",", ";", " ", "\t"])
def test_other_order_is_read_by_name(tmp_path, separator):
    order = [*DEMAND[::-1], "COMMENT_NUMBER", *FEEDBACK]
    text, values = named(order, separator=separator)
    back = read_facility_csv(put(tmp_path, text))
    for leg in range(6):
        np.testing.assert_allclose(
            back["leg_position"][:, leg], values[FEEDBACK[leg]] * INCH, rtol=1e-15
        )
        np.testing.assert_allclose(
            back["leg_reference"][:, leg], values[DEMAND[leg]] * INCH, rtol=1e-15
        )


@pytest.mark.parametrize(
    "form", ["dcl2dvs_{}_leg_pos[{}]", '"DCL2DVS_{}_LEG_POS({})"', "DCL2DVS_{}_LEG_POS{}"]
)
def test_spelling_of_the_leg_number_does_not_matter(tmp_path, form):
    text, _ = named([*FEEDBACK, *DEMAND])
    header, rest = text.split("\n", 1)
    names = [form.format(kind, leg) for kind in ("FDK", "DMD") for leg in range(1, 7)]
    back = read_facility_csv(put(tmp_path, ",".join(names) + "\n" + rest))
    expected = read_facility_csv(put(tmp_path, header + "\n" + rest))
    np.testing.assert_array_equal(back["leg_position"], expected["leg_position"])


def test_comment_lines_are_skipped_anywhere(tmp_path):
    text, values = named([*FEEDBACK, *DEMAND])
    lines = text.splitlines()
    lines[5:5] = ["# operator: stopped for coffee", "  # 12, 13"]
    path = put(tmp_path, "\n".join(["# heave", *lines, "# end"]) + "\n")
    back = read_facility_csv(path)
    assert back.time.size == N
    np.testing.assert_allclose(back["leg_position"][:, 0], values[FEEDBACK[0]] * INCH, rtol=1e-15)


@pytest.mark.parametrize(
    "change",
    [lambda b: b.replace(b"\n", b"\r\n"), lambda b: b"\xef\xbb\xbf" + b, lambda b: b + b"\n\n"],
    ids=["crlf", "byte order mark", "empty lines at the end"],
)
def test_habits_of_other_editors_do_not_matter(tmp_path, change):
    path = write_facility_csv(synthetic(), tmp_path / "run.csv")
    first = read_facility_csv(path)
    path.write_bytes(change(path.read_bytes()))
    np.testing.assert_array_equal(read_facility_csv(path)["leg_position"], first["leg_position"])


def test_clock_in_milliseconds_is_accepted(tmp_path):
    text, _ = named(["TIME", *FEEDBACK, *DEMAND], samples=300)
    lines = text.splitlines()
    for i in range(300):
        lines[i + 1] = f"{i / 128.0:.3f}" + lines[i + 1][5:]
    assert read_facility_csv(put(tmp_path, "\n".join(lines) + "\n")).time[-1] == 299 / 128.0


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


def swapped(one, two, rows):
    def change(text):
        lines = lines_of(text)
        for row in rows:
            cells = lines[row].split(",")
            cells[one - 1], cells[two - 1] = cells[two - 1], cells[one - 1]
            lines[row] = ",".join(cells)
        return "\n".join(lines)

    return change


def without(*rows):
    return lambda text: "\n".join(x for i, x in enumerate(lines_of(text), 1) if i not in rows)


def timed(rate):
    def change(text):
        for i in range(N):
            text = cell(i + 2, 1, f"{i / rate:.7f}")(text)
        return text

    return change


def no_trailer(text):
    return "\n".join(x for x in lines_of(text) if not x.startswith("#"))


def cut_in_last_number(text):
    return no_trailer(text)[:-1]


MUTATED = {
    # truncated, missing and repeated rows
    "empty": (lambda t: "", "is empty"),
    "blank": (lambda t: " \n\n", "is empty"),
    "comments only": (lambda t: "# a\n# b\n", "has neither a header row nor samples"),
    "header only": (lambda t: t[: t.index("\n") + 1], "row 1: is a header; no samples follow"),
    "header missing": (without(1), "row 1: .* is numbers; the first row must be a header"),
    "truncated in a row": (lambda t: t[: t.index("\n", 9000) + 250], r"row \d+: has \d+ columns"),
    "truncated in half": (lambda t: t[: len(t) // 2], r"row \d+: has \d+ columns.*allowed: 179"),
    "truncated in the last number": (
        cut_in_last_number,
        r"row 41, column 179: the file ends without a line end, so that '0' may be cut off",
    ),
    "truncated between rows": (
        lambda t: "\n".join(lines_of(t)[:20]) + "\n",
        r"row 20, column 2 \(B, LAST_ROW\): '0' is refused; allowed: 1 in the last row",
    ),
    "truncated metadata": (lambda t: t[:-60], "row 42: is not valid JSON"),
    "short row": (lambda t: t.replace(lines_of(t)[6], lines_of(t)[6][:-4]), "row 7: has 177 col"),
    "long row": (lambda t: t.replace(lines_of(t)[6], lines_of(t)[6] + ",3.25"), "row 7: has 180 "
                 "columns, the last being '3.25'; allowed: 179"),
    "empty row": (lambda t: t.replace(lines_of(t)[6], ""), "row 7: has 0 columns"),
    "missing row": (without(9), r"row 9, column 1 \(A, TIME\): '0.0625000' s is 0.015625 s after"),
    "missing first row": (without(2), "row 40: is sample 39 and the last; allowed: 40"),
    "repeated row": (lambda t: "\n".join(lines_of(t)[:9] + lines_of(t)[8:]),
                     r"row 10, column 1 \(A, TIME\): '0.0546875' s is 0 s after"),
    "rows exchanged": (lambda t: "\n".join(lines_of(t)[:5] + lines_of(t)[6:4:-1] + lines_of(t)[7:]),
                       r"row 6, column 1 \(A, TIME\)"),
    "two files in one": (lambda t: t + t[t.index("\n") + 1 :], "row 83: is a second line"),
    # numbers
    "text": (cell(5, 68, "abc"), r"row 5, column 68 \(BP, DCL2DVS_FDK_LEG_POS_2\): 'abc' is ref"),
    "text in an unused column": (cell(5, 100, "x1"), r"row 5, column 100 \(CV, UNUSED_100\): 'x1'"),
    "nan": (cell(12, 129, "NaN"), r"row 12, column 129 \(DY, DCL2DVS_DMD_LEG_POS_1\): 'NaN'"),
    "inf": (cell(2, 72, "-inf"), r"row 2, column 72 \(BT, DCL2DVS_FDK_LEG_POS_6\): '-inf'"),
    "overflow": (cell(3, 73, "1e999"), r"row 3, column 73 \(BU, DCL2DVS_FDK_LEG_VEL_1\): '1e999'"),
    "empty cell": (cell(3, 70, ""), r"row 3, column 70 \(BR, DCL2DVS_FDK_LEG_POS_4\): ''"),
    "two points": (cell(3, 70, "1.2.3"), r"row 3, column 70 .*: '1\.2\.3'"),
    "hexadecimal": (cell(3, 70, "0x1A"), r"row 3, column 70 .*: '0x1A'"),
    "underscore": (cell(3, 70, "1_0"), r"row 3, column 70 .*: '1_0'"),
    "decimal commas": (
        lambda t: no_trailer(t).replace(",", ";").replace(".", ","),
        r"row 2, column 1 \(A, TIME\): '0,0000000' is refused; .* a decimal point",
    ),
    "beyond the stroke": (cell(7, 131, "38.1"),
                          r"row 7, column 131 \(EA, DCL2DVS_DMD_LEG_POS_3\): '38.1' in .*-38 in"),
    "feedback beyond the stroke": (cell(8, 67, "-250"), r"row 8, column 67 \(BO, .*'-250' in"),
    "value changed": (cell(9, 69, "1.500000"), r"column 69 \(BQ, .*_POS_3\).* changed"),
    # columns
    "columns swapped": (swapped(67, 68, range(1, N + 1)), r"column 67 \(BO, .*: swapped or"),
    "demand and feedback swapped": (swapped(67, 129, range(1, N + 1)), r"column 67 .* swapped"),
    "time swapped": (swapped(1, 67, range(1, N + 1)), r"column 1 \(A, TIME\)"),
    "names swapped": (swapped(67, 68, [0]), r"column 68 \(BP, DCL2DVS_FDK_LEG_POS_1\).* swapped"),
    "duplicate name": (cell(1, 68, FEEDBACK[0]),
                       r"row 1, column 68 \(BP, DCL2DVS_FDK_LEG_POS_1\): column 67 has that name"),
    "duplicate time": (cell(1, 3, "time"), r"row 1, column 3 \(C, TIME\): column 1 has"),
    "feedback leg missing": (cell(1, 70, "X"), "row 1: the header lacks DCL2DVS_FDK_LEG_POS_4$"),
    "optional leg missing": (cell(1, 75, "X"), "row 1: the header lacks DCL2DVS_FDK_LEG_VEL_3$"),
    "demand missing": (lambda t: t.replace("DMD_LEG", "XXX_LEG"), "lacks DCL2DVS_DMD_LEG_POS_1, "),
    "header short": (lambda t: t.replace(",UNUSED_179", "", 1), "row 2: has 179 .* allowed: 178"),
    "column lost": (lambda t: "\n".join(x.partition(",")[2] if 0 < i <= N else x
                                        for i, x in enumerate(lines_of(t))), "row 2: has 178"),
    "too few columns without names": (lambda t: positional("none", width=120)[0],
                                      "none of 120 columns .* 113 columns or at least 179"),
    # rate
    "100 Hz": (timed(100.0), r"row 3, column 1 \(A, TIME\): '0.0100000' s is 0.01 s after"),
    "130 Hz": (timed(130.0), r"row 41, column 1 \(A, .* makes the rate 130 Hz; allowed: 128"),
    "2048 Hz": (timed(2048.0), r"row 3, column 1 \(A, TIME\)"),
    "uneven": (cell(20, 1, "0.1430000"), r"row 20, column 1 \(A, TIME\): '0.1430000' s is"),
    # not the text it should be
    "binary": (lambda t: bytes(range(256)) * 20, r"row \d+: (byte|character) 0x"),
    "zeros": (lambda t: t[:500].encode() + bytes(500), "row 1: character 0x00 is not text"),
    "utf-16": (lambda t: t.encode("utf-16"), "row 1: byte 0xff is not UTF-8 text"),
    "latin-1": (lambda t: ("# 20 °C\n" + t).encode("latin-1"), "row 1: byte 0xb0 is not UTF-8"),
    "parquet": (lambda t: b"PAR1\x15\x04\x15\x90", r"row 1: (byte|character) 0x"),
    # metadata
    "metadata of another kind": (lambda t: no_trailer(t) + "# cmf_mj [1]\n", "row 42: "),
    "metadata without a field": (lambda t: t.replace('"rows": 40, ', ""), "row 42: rows: is miss"),
    "decimals out of range": (lambda t: t.replace('"decimals": 6', '"decimals": 99'),
                              "row 42: decimals: 99 is refused; allowed: a whole number f"),
}  # fmt: skip


@pytest.mark.parametrize(("change", "message"), MUTATED.values(), ids=MUTATED)
def test_broken_file_gives_one_clear_error_and_no_output(tmp_path, change, message):
    path = write_facility_csv(synthetic(), tmp_path / "run.csv")
    path.write_bytes(b"")
    text = write_facility_csv(synthetic(), path).read_text()
    put(tmp_path, change(text))
    with pytest.raises(ValueError, match=message) as caught:
        read_facility_csv(path).save(tmp_path / "out.parquet")
    assert str(caught.value).startswith(f"{path}: ")
    assert len(str(caught.value).splitlines()) == 1
    assert [each.name for each in tmp_path.iterdir()] == ["run.csv"]


def test_file_cut_anywhere_is_never_read_as_a_shorter_one(tmp_path):
    """Only a cut after the last sample leaves a whole recording; at most its metadata are lost."""
    whole = write_facility_csv(synthetic(samples=3), tmp_path / "run.csv").read_bytes()
    samples_end = whole.index(b"# cmf_mj")
    for size in [*range(0, samples_end, 17), samples_end - 1, samples_end - 2]:
        with pytest.raises(ValueError, match="run.csv: "):
            read_facility_csv(put(tmp_path, whole[:size]))
    assert read_facility_csv(put(tmp_path, whole[:samples_end])).time.size == 3


# Records the layout cannot hold


def changed(name, value, index=(4, 2)):
    values = dict(synthetic().channels)
    values[name] = values[name].copy()
    values[name][index] = value
    return synthetic(channels=values)


REFUSED = {
    "rate": (synthetic(rate=200.0), "sample_rate: 200.0 Hz is refused; allowed: a multiple of 128"),
    "slow": (synthetic(rate=64.0), "sample_rate: 64.0 Hz is refused"),
    "infinite rate": (synthetic(metadata={"sample_rate": np.inf}), "sample_rate: inf Hz is ref"),
    "no rate": (synthetic(metadata={}), "sample_rate: nan Hz is refused"),
    "time": (synthetic(time=np.arange(N) / 127.0), "time: sample 1 at .* is not at 128.0 Hz"),
    "no samples": (synthetic(samples=0), "record: has no samples"),
    "no demand": (synthetic(drop=("leg_reference",)), "channel: 'leg_reference' is not one of"),
    "nan": (changed("cap_pressure", np.nan), "cap_pressure: nan psi at sample 4, leg 3, is"),
    "stroke": (changed("leg_position", 1.0), r"leg_position: 39.37\d* in at sample 4, leg 3.*38"),
}  # fmt: skip


@pytest.mark.parametrize(("record", "message"), REFUSED.values(), ids=REFUSED)
def test_record_that_does_not_fit_is_refused_and_nothing_written(tmp_path, record, message):
    with pytest.raises(ValueError, match=message):
        write_facility_csv(record, tmp_path / "run.csv")
    assert list(tmp_path.iterdir()) == []


def test_other_number_of_legs_is_refused(tmp_path):
    record = Record(
        np.arange(2) / 128.0,
        {"leg_position": np.zeros((2, 1)), "leg_reference": np.zeros((2, 1))},
        {"leg_position": "m", "leg_reference": "m"},
        {"sample_rate": 128.0},
    )
    with pytest.raises(ValueError, match=r"leg_position: shape is \(2, 1\); allowed: \(N, 6\)"):
        write_facility_csv(record, tmp_path / "run.csv")


@pytest.mark.parametrize("decimals", [-1, 10, 2.5])
def test_decimals_out_of_range_are_refused(tmp_path, decimals):
    with pytest.raises(ValueError, match=f"decimals: {decimals} is refused; allowed: a whole"):
        write_facility_csv(synthetic(), tmp_path / "run.csv", decimals=decimals)


# Whole or not at all


def fail_half_way(file, *_, **__):
    file.write("half a he")
    raise OSError("disk full")


def test_an_interrupted_write_leaves_what_was_there(tmp_path, monkeypatch):
    for kept in (b"", write_facility_csv(synthetic(), tmp_path / "run.csv").read_bytes()):
        put(tmp_path, kept) if kept else (tmp_path / "run.csv").unlink()
        with monkeypatch.context() as broken, pytest.raises(OSError, match="disk full"):
            broken.setattr(np, "savetxt", fail_half_way)
            write_facility_csv(synthetic(samples=5), tmp_path / "run.csv")
        assert [path.read_bytes() for path in tmp_path.iterdir()] == [kept] * bool(kept)
