"""One bit of a file flips: the same content comes back, or one clear error; never other numbers.

The oracle is the content before the damage. Records, sessions of a host,
flights and the journals of studies each have 200 bits flipped, one at a time, at
seeded places.
"""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from cmf_mj import InputError
from cmf_mj.control.dcu.play import Arrivals
from cmf_mj.core.tables import write_parquet
from cmf_mj.facility.host.stream import read_arrivals, write_arrivals
from cmf_mj.pilot.flight import Flight, load_flight
from cmf_mj.record.record import Record
from cmf_mj.studies.engine import JOURNAL, SPECIFICATION, Journal

FLIPS = 200
GENERATOR = np.random.default_rng(19)


def record() -> Record:
    rows = 64
    legs = {n: GENERATOR.normal(0.0, 0.1, (rows, 6)) for n in ("leg_position", "leg_reference")}
    metadata = {"sample_rate": 128.0, "law": "velocity", "gains": {"output": [1.5, -2.25e-7]}}
    return Record(np.arange(rows) / 128.0, legs, dict.fromkeys(legs, "m"), metadata)


def arrivals() -> Arrivals:
    number = np.arange(32)
    values = GENERATOR.normal(size=(32, 3, 6))
    return Arrivals(26 * number, number, number / 80.0, values)


def content(thing: Record | Arrivals | Flight) -> Any:
    """Everything that a reader gives, to the bit."""
    if isinstance(thing, Record):
        arrays, rest = dict(thing.channels) | {"time": thing.time}, [thing.units, thing.metadata]
    elif isinstance(thing, Flight):
        arrays, rest = {**thing.motion.columns(), **thing.others}, [thing.origin.model_dump()]
    else:
        arrays, rest = thing._asdict(), []
    return [(n, v.dtype, v.shape, v.tobytes()) for n, v in arrays.items()], json.dumps(rest)


def flipped(path: Path, generator: np.random.Generator) -> Iterator[int]:
    """Flip a bit of a file, and put it back after what is done with it."""
    whole = path.read_bytes()
    for place in generator.integers(0, 8 * len(whole), FLIPS):
        damaged = bytearray(whole)
        damaged[place // 8] ^= 1 << place % 8
        path.write_bytes(damaged)
        yield int(place)
    path.write_bytes(whole)


@pytest.mark.parametrize(
    ("name", "write", "read"),
    [
        ("run.parquet", lambda path: record().save(path), Record.load),
        ("host.parquet", lambda path: write_arrivals(arrivals(), path), read_arrivals),
        ("flight.parquet", lambda path: load_flight("gusts").save(path), load_flight),
    ],
    ids=["record", "host", "flight"],
)
def test_a_flipped_bit_gives_no_other_numbers(
    tmp_path: Path, name: str, write: Callable[[Path], Path], read: Callable[[Path], Any]
) -> None:
    def seen() -> Any:
        return content(read(path))

    path = write(tmp_path / name)
    before, refused = seen(), 0
    for place in flipped(path, np.random.default_rng(2014)):
        try:
            after = seen()
        except InputError as error:
            assert name in str(error) and "\n" not in str(error).strip()
            refused += 1
        else:
            assert after == before, f"bit {place}"
    assert seen() == before
    assert refused > FLIPS / 3


def test_a_flipped_bit_of_a_journal_runs_a_task_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = {"title": "test", "draws": 3}
    rows = [[{"dof": "heave", "gain": float(v)}] for v in GENERATOR.normal(size=12)]
    journal = Journal(tmp_path, study)
    for number, row in enumerate(rows):
        journal.add(number, row)
    path = tmp_path / JOURNAL
    again = 0
    for place in flipped(path, np.random.default_rng(2014)):
        kept = Journal(tmp_path, study).results
        assert all(rows[number] == row for number, row in kept.items()), f"bit {place}"
        assert len(kept) >= len(rows) - 2
        said = capsys.readouterr().err
        torn = place // 8 == path.stat().st_size - 1
        assert ("lines are damaged; their tasks run again" in said) or torn
        again += len(rows) - len(kept)
        assert Journal(tmp_path, study).results == kept
        assert not capsys.readouterr().err
    assert again >= FLIPS
    specification = tmp_path / SPECIFICATION
    for _ in flipped(specification, np.random.default_rng(2014)):
        try:
            assert Journal(tmp_path, study).results.keys() == set(range(len(rows)))
        except InputError as error:
            assert "study" in str(error)


def test_a_header_that_fits_no_record_names_its_field(tmp_path: Path) -> None:
    """A header of ours with correct checksums, and fields that are wrong, missing or odd."""
    path = tmp_path / "mine.parquet"
    table = pa.table({"time": [0.0, 1.0], "gap": [0.0, 1.0]})
    good = {"units": {"gap": "m"}, "widths": {"gap": 0}, "metadata": {}}
    for change, said in (
        ({"units": {"gap": 3}}, "header cmf_mj: units.gap: 3 is refused"),
        ({"widths": {"gap": -1}}, "header cmf_mj: widths.gap: -1 is refused"),
        ({"widths": {"other": 2}}, "other_1: column is missing"),
        ({"units": {}}, "units: every channel needs one unit; check gap"),
        ({"metadata": None}, "header cmf_mj: metadata: None is refused"),
        ({"more": 1}, "header cmf_mj: more: is not a known field; allowed: metadata, units"),
    ):
        write_parquet(table, path, ("cmf_mj", good | change))
        with pytest.raises(InputError, match=f"mine.parquet: {said}"):
            Record.load(path)
    write_parquet(table, path, ("cmf_mj", good))
    with pytest.raises(InputError, match="sample_rate: nan Hz is refused"):
        Record.load(path).rate  # noqa: B018
    pq.write_table(table.replace_schema_metadata({"cmf_mj": "{" * 3000}), path)
    with pytest.raises(InputError, match="mine.parquet: header cmf_mj: is not valid JSON"):
        Record.load(path)


def test_a_table_changed_by_others_is_refused_until_its_checksum_goes(tmp_path: Path) -> None:
    path = record().save(tmp_path / "run.parquet")
    table = pq.read_table(path)
    pq.write_table(table.set_column(1, table.column_names[1], pa.array(np.ones(64))), path)
    with pytest.raises(InputError, match="run.parquet: is damaged or changed"):
        Record.load(path)
