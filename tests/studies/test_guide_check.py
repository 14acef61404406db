"""Masters that are read, and the statistics of what has changed."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import tomlkit
from guide_files import SHORT, written
from scipy import stats
from shared import cmf

from cmf_mj.core.errors import InputError
from cmf_mj.record.record import Record
from cmf_mj.studies import guide_check
from cmf_mj.studies.guide import FILE, load_guide, make_bench, make_head, run_guide
from cmf_mj.studies.guide_check import (
    SIGNATURE,
    _compare_measure,
    compare,
    compare_signatures,
    enough_repetitions,
    load_master,
    smallest_change,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A master and a check of the laboratory's machine, as they are on disk."""
    where = tmp_path_factory.mktemp("guides")
    on = make_bench(load_guide(written(where, SHORT)), "lab")
    for name, seed in (("master", 0), ("new", 7)):
        run_guide(on, make_head(on, machine="lab"), where / name, seed=seed)
    return where


def edited(folder: Path, name: str, target: Path, **changes: object) -> Path:
    """A copy of a folder with its head changed."""
    shutil.copytree(folder / name, target)
    head = tomlkit.parse((target / FILE).read_text()).unwrap() | changes
    (target / FILE).write_text(tomlkit.dumps({k: v for k, v in head.items() if v is not None}))
    return target


def test_the_smallest_change_is_found_with_its_power() -> None:
    """Drawn: 20 000 masters and checks; and for many repetitions that of the normal law."""
    level, draw = 0.01, np.random.default_rng(3)

    def found(size: float, n: int, m: int) -> float:
        old, new = draw.normal(size=(20000, n)), size + draw.normal(size=(20000, m))
        spread = old.std(axis=1, ddof=1) * np.sqrt(1.0 / n + 1.0 / m)
        t = (new.mean(axis=1) - old.mean(axis=1)) / spread
        return float(np.mean(np.abs(t) > stats.t.isf(level / 2.0, n - 1)))

    assert found(smallest_change(5, 2, level, 4), 5, 2) == pytest.approx(0.9, abs=0.01)
    takes = int(enough_repetitions(2.0, level, 1.0, power=0.8))
    assert found(2.0, takes - 1, takes - 1) < 0.8 < found(2.0, takes, takes)
    assert enough_repetitions(1e-6, level, 1.0) == np.inf
    normal = (stats.norm.isf(level / 2.0) + stats.norm.isf(0.1)) * np.sqrt(2.0 / 5000)
    assert smallest_change(5000, 5000, level, 4999) == pytest.approx(normal, rel=0.01)
    wide = stats.t.isf(5e-7, 1) * stats.norm.isf(0.05)  # so large is e |z| 90 times of 100
    assert smallest_change(2, 2, 1e-6, 1) == pytest.approx(wide, rel=1e-3)


def test_a_measure_that_has_not_changed_is_alarmed_at_its_level() -> None:
    draw, level = np.random.default_rng(4), 0.05
    alarms = sum(
        _compare_measure("t", "m", *np.split(draw.normal(size=7), [5]), level, np.nan).verdict
        == "changed"
        for _ in range(3000)
    )
    assert stats.binom.cdf(alarms, 3000, level) > 1e-3
    assert stats.binom.sf(alarms, 3000, level) > 1e-3
    none, some = np.full(20, np.nan), np.linspace(1.0, 1.1, 20)
    for old, new in ((none, some), (some, none)):  # a phase that grazes has a bandwidth by chance
        assert _compare_measure("t", "m", old[:6], new[:1], 1e-3, np.nan).verdict == "as before"
        assert _compare_measure("t", "m", old, new, 1e-3, np.nan).verdict == "changed"
    row = _compare_measure("t", "m", np.array([1.0, 1.1, 0.9]), np.array([1.0]), level, 0.5)
    assert row.verdict == "beyond its limit"


def test_a_measure_of_some_repetitions_is_judged_by_them_and_a_dead_channel_hides_none() -> None:
    nan, sound = np.nan, np.array([1.0, 1.1, 0.9, 1.0])
    assert (
        _compare_measure("t", "m", sound, np.array([50.0, nan]), 0.01, 2.0).verdict
        == "beyond its limit"
    )
    assert (
        _compare_measure("t", "m", np.append(sound, nan), sound + 50.0, 0.01, nan).verdict
        == "changed"
    )
    assert (
        _compare_measure("t", "m", np.append(sound, nan), sound, 0.01, nan).verdict == "as before"
    )
    off, spread = np.array([[[0.0]], [[100.0]]]), np.array([[[0.0]], [[1.0]]])
    assert guide_check.SignatureChange(off, spread, np.array([[3.0]])).least_likely() == (
        100.0,
        3.0,
    )


def test_recordings_of_another_rate_are_refused(folder: Path) -> None:
    """Their accelerations are compared sample by sample."""
    master, new = (load_master(folder / name) for name in ("master", "new"))

    def halved(one: Record) -> Record:
        channels = {name: values[::2] for name, values in one.channels.items()}
        known = dict(one.metadata) | {"sample_rate": one.rate / 2.0}
        return Record(one.time[::2], channels, one.units, known)

    slow = {name: [halved(one) for one in records] for name, records in new.records.items()}
    with pytest.raises(InputError, match=r"new: \w+: has 128 samples a second; the master's 256"):
        compare(master, new._replace(records=slow))


def test_legs_that_move_together_by_chance_alarm_no_more_than_stated(folder: Path) -> None:
    """White noise that all six legs share, 400 masters of five and checks of one, at 5 %."""
    master, draw, level = load_master(folder / "master"), np.random.default_rng(5), 0.05
    like = master.records["all"][0]

    def noise() -> Record:
        wave = np.repeat(draw.normal(size=(like.time.size, 1)), 6, axis=1)
        channels = {"leg_position": wave}
        return Record(like.time, channels, {"leg_position": "m"}, like.metadata)

    alarms = 0
    for _ in range(400):
        old, new = [noise() for _ in range(5)], [noise()]
        pair = (master._replace(records={"all": records}) for records in (old, new))
        one = compare_signatures(*pair, "all")
        off, degrees = one.least_likely()
        alarms += off > stats.t.isf(level / one.difference.size / 2.0, degrees)
    assert stats.binom.sf(alarms, 400, level) > 1e-3


def test_a_share_is_sought_of_what_has_a_size_of_its_own() -> None:
    """5 % of 8 Hz; half a decibel of a peak, which may be next to nothing."""
    old, now = np.array([7.9, 8.1, 8.0]), np.array([8.0, 8.0])
    for name, sought in (("surge -90 deg [Hz]", 0.4), ("surge peak [dB]", 0.5)):
        row = guide_check._compare_measure("test", name, old, now, 1e-3, float("nan"))
        assert row.sought == pytest.approx(sought)


def test_nothing_has_changed(folder: Path) -> None:
    rows = compare(load_master(folder / "master"), load_master(folder / "new"))
    assert {row.verdict for row in rows} == {"as before"}
    named = {row.measure: row for row in rows}
    assert np.isnan(named.pop("repeatability [g]").repetitions)
    assert named["heave peak [dB]"].sought == 0.5
    assert named["surge peak [dB]"].sought == 0.2
    assert named[SIGNATURE].sought == 1e4
    for row in named.values():  # three of each were recorded
        assert (row.repetitions <= 3) == (row.found <= row.sought)
    assert {row.repetitions <= 3 for row in named.values()} == {True, False}


def test_an_older_master_is_read_and_what_was_left_out_is_said(
    folder: Path, tmp_path: Path
) -> None:
    old = edited(folder, "master", tmp_path / "old", version=None, digests=None)
    aside = edited(folder, "new", tmp_path / "aside", left_out={"all.2": "somebody walked in"})
    assert len(load_master(aside).records["all"]) == 2
    again = load_master(old)
    assert compare(again, load_master(aside))
    assert dict(again.head.digests) == dict(load_master(folder / "master").head.digests)
    cut = edited(folder, "new", tmp_path / "cut", left_out={"all": "pump tripped"})
    for file in cut.glob("all.*"):
        file.unlink()
    (row,) = compare(load_master(folder / "master"), load_master(cut))
    assert row.verdict == "left out: pump tripped"


def test_a_master_beside_itself_is_as_before_and_one_recording_has_no_spread(
    folder: Path, tmp_path: Path
) -> None:
    master = load_master(folder / "master")
    rows = compare(master, master)
    assert {row.verdict for row in rows} == {"as before"}
    one = load_master(edited(folder, "new", tmp_path / "one", left_out={"all.1": "", "all.2": ""}))
    assert all(np.isnan(row.found) for row in compare(one, one))
    with pytest.raises(InputError, match="all: one recording; allowed: at least 2"):
        compare(one, master)


def test_a_recording_that_begins_late_is_aligned(folder: Path, tmp_path: Path) -> None:
    """A recorder that was started 0.5 s early: the same numbers to the bit."""
    late = edited(folder, "new", tmp_path / "late", simulated=False, digests=None)
    for file in late.glob("all.*.parquet"):
        record = Record.load(file)
        rows = np.concatenate([np.zeros(128, int), np.arange(record.time.size)])
        channels = {name: value[rows] for name, value in record.channels.items()}
        time = np.arange(rows.size) / record.rate
        file.unlink()
        Record(time, channels, record.units, record.metadata).save(file)
    one, other = load_master(late), load_master(folder / "new")
    mean = other.accelerations("all")[0]
    mine, theirs = (list(each.measure_test("all", mean).values()) for each in (one, other))
    np.testing.assert_array_equal(mine, theirs)


def test_wrong_folders_and_recordings_are_refused_in_a_sentence(
    folder: Path, tmp_path: Path
) -> None:
    master = load_master(folder / "master")
    with pytest.raises(InputError, match=f"holds no {FILE}; allowed"):
        load_master(tmp_path)
    lost = edited(folder, "new", tmp_path / "lost")
    for file in lost.glob("all.*"):
        file.unlink()
    with pytest.raises(InputError, match="all: no recordings; allowed: recordings of every test"):
        load_master(lost)
    other = edited(folder, "new", tmp_path / "other", law="original", digests=None)
    with pytest.raises(InputError, match="law is 'original'; the master's is"):
        compare(master, load_master(other))
    guide = SHORT.replace("period = 4.0", "period = 2.0")
    short = make_bench(load_guide(written(tmp_path, guide)), "lab")
    run_guide(short, make_head(short, machine="lab"), tmp_path / "short", repetitions=1)
    with pytest.raises(InputError, match="its guide has other tests"):
        compare(master, load_master(tmp_path / "short"))
    file = (tmp_path / "short" / "all.1.parquet").read_bytes()
    mixed = edited(folder, "new", tmp_path / "mixed", digests=None)
    (mixed / "all.1.parquet").write_bytes(file)
    with pytest.raises(InputError, match=r"all\.1\.parquet: ends after 5\.0 s; the test takes 9"):
        load_master(mixed)
    forged = edited(folder, "new", tmp_path / "forged", digests={"all.1.parquet": "00000000"})
    with pytest.raises(InputError, match=r"digest: \w+ is not the 00000000"):
        load_master(forged)
    said = cmf("guide", "check", tmp_path, "--against", tmp_path, code=2)
    assert f"holds no {FILE}" in " ".join(said.split())


def test_a_guide_is_run_checked_and_drawn_from_the_command_line(
    folder: Path, tmp_path: Path, drawn: dict[str, set[str]]
) -> None:
    cmf("guide", "run", folder / "mine.toml", "--recordings", folder / "master")
    page = (folder / "master" / "guide.html").read_text()
    assert page.count("<table>") == 4
    assert '<img src="all.png" alt="all" />' in page
    out = ("--against", folder / "master", "--out", tmp_path / "out")
    assert "as before" in cmf("guide", "check", folder / "new", *out)
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"all.png", "all_bode.png", "measures.csv", "guide.html"}
    assert {"surge", "surge, now"} <= drawn["all_bode.png"] and "all.png" in drawn
