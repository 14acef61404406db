"""Files of every kind, changed at random: read, or refused in one message that names the file."""

import json
import tomllib
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from fuzz_files import make_files
from fuzzing import below, damaged, mutated, pick, toml_bytes
from lengths import examples

import cmf_mj
from cmf_mj.control.law import load_law
from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import Loader
from cmf_mj.facility.host.stream import read_arrivals, read_stream
from cmf_mj.facility.scenario import load_scenario
from cmf_mj.facility.signal import HostFile
from cmf_mj.machine import models
from cmf_mj.machine.cab import load_cab
from cmf_mj.pilot.flight import load_flight
from cmf_mj.pilot.washout_settings import load_washout
from cmf_mj.record.columns import read_mapped
from cmf_mj.record.record import Record
from cmf_mj.report_2014.posterior.study import load_posterior
from cmf_mj.studies.settings import load_study

Read = Callable[[Path], Any]
FILES = 1000  #: Files of the long search, of settings and tables together.


def loaders() -> list[tuple[Read, dict[str, Any]]]:
    """What reads a settings file, with a table to begin from; found, not listed, where a Loader."""
    found: dict[int, Loader[Any]] = {}
    for module in walk_packages(cmf_mj.__path__, "cmf_mj."):
        if ".show" not in module.name and ".cli" not in module.name and "__" not in module.name:
            for thing in vars(import_module(module.name)).values():
                if isinstance(thing, Loader):
                    found[id(thing)] = thing
    each: list[tuple[Read, dict[str, Any]]] = []
    for load in found.values():
        table = tomllib.loads(load.shipped.read_text(encoding="utf-8"))
        if load.names:
            common = table.get("common", {})
            for name in load.names:
                base = {"base": name} if load.based else {}
                each.append((load, {**base, "mine": {**common, **table[name]}}))
        else:
            each.append((load, table))
    shipped = models.directory("scenarios").glob("*.toml")
    for path in shipped:
        each.append((load_scenario, tomllib.loads(path.read_text(encoding="utf-8"))))
    package = Path(cmf_mj.__file__).parent
    for path in sorted((package / "control").glob("laws*.toml")):
        for name, law in tomllib.loads(path.read_text(encoding="utf-8")).items():
            each.append((load_law, {name: law}))
    for path in (package / "studies" / "ready").glob("*.toml"):
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        each.append((load_posterior if "unknowns" in table else load_study, table))
    each.append((load_cab, {"base": "gfd", "mine": {"mass": 9000.0}}))
    each.append((load_washout, {"base": "simona", "mine": {}}))
    return each


def refused(read: Read, path: Path) -> str:
    """What a reader says of a file; nothing where it reads it."""
    try:
        read(path)
    except InputError as error:
        return str(error)
    return ""


def check(said: str, path: Path, what: object) -> None:
    if said:
        assert path.name in said, (what, said)
        assert len(said) < 20_000 and "Traceback" not in said, (what, said[:500])


@pytest.mark.fuzz
def test_settings_files_are_read_or_refused(tmp_path: Path) -> None:
    generator = np.random.default_rng(19)
    every = loaders()
    path, count, seen = tmp_path / "mine.toml", 0, 0
    for _ in range(examples(FILES // 2)):
        read, table = pick(generator, every)
        content = toml_bytes(table, generator)
        path.write_bytes(content)
        said = refused(read, path)
        check(said, path, content)
        count, seen = count + 1, seen + bool(said)
    assert 0.3 < seen / count < 1.0
    assert below(tmp_path) == {"mine.toml"}


def mutated_table(table: pa.Table, generator: np.random.Generator) -> pa.Table:
    """A table with a column of another kind, empty cells, odd numbers, no rows or no such name."""
    index = int(generator.integers(table.num_columns))
    name, rows = table.column_names[index], table.num_rows
    act = generator.integers(8)
    if act == 0:
        return table.remove_column(index)
    if act == 1:
        return table.append_column(name, table[index])
    if act == 2:
        return table.slice(0, int(generator.integers(3)))
    if act == 3:
        columns = list(table.column_names)
        columns[index] = str(pick(generator, ("", "time", "é", "x" * 9999, "surge")))
        return table.rename_columns(columns)
    values: Any = pick(
        generator,
        (
            pa.array(["x"] * rows),
            pa.array([None] * rows, pa.float64()),
            pa.array([[1.0]] * rows),
            pa.array([{"a": 1}] * rows),
            pa.array([0] * rows, pa.date32()),
            pa.array([0] * rows, pa.timestamp("ns")),
            pa.array([b"\xff"] * rows),
            pa.array([True] * rows),
            pa.array([2**62] * rows),
            pa.array(np.full(rows, pick(generator, (np.nan, np.inf, 1e300, -1e300, 0.0, 1e-320)))),
            pa.array(np.arange(rows) * float(pick(generator, (1e9, 1e-9, -1.0, 1e300)))),
            pa.nulls(rows),
        ),
    )
    return table.set_column(index, name, values)


def tables(folder: Path) -> Iterator[tuple[Read, Path]]:
    """What reads recordings, streams, flights and motions, with a good file of each."""
    for name, read in (
        ("run.parquet", Record.load),
        ("run.parquet", read_mapped),
        ("facility.csv", read_mapped),
        ("stream.csv", read_stream),
        ("stream.parquet", read_stream),
        ("host.parquet", read_arrivals),
        ("flight.csv", load_flight),
        ("flight.parquet", load_flight),
        ("motion.csv", load_flight),
        ("stream.csv", lambda path: HostFile(kind="host", file=str(path)).command()),
    ):
        yield read, folder / name


@pytest.mark.fuzz
def test_recordings_and_streams_are_read_or_refused(tmp_path: Path) -> None:
    generator = np.random.default_rng(19)
    (source := tmp_path / "good").mkdir()
    make_files(source, generator)
    every, seen, count = list(tables(source)), 0, examples(FILES // 2)
    for read, path in every:
        assert not refused(read, path)
    for _ in range(count):
        read, good = pick(generator, every)
        path = tmp_path / f"mine{good.suffix}"
        if good.suffix == ".parquet" and generator.random() < 0.6:
            table = pq.read_table(good)
            header = {k: v for k, v in table.schema.metadata.items() if k != b"cmf_mj_sha256"}
            if header and generator.random() < 0.4:
                key = pick(generator, sorted(header))
                header[key] = header_of(header[key], generator)
            else:
                table = mutated_table(table, generator)
            pq.write_table(table.replace_schema_metadata(header), path)
        else:
            path.write_bytes(damaged(good.read_bytes(), generator))
        said = refused(read, path)
        check(said, path, good.name)
        seen += bool(said)
    assert 0.3 < seen / count < 1.0
    assert below(tmp_path) - below(tmp_path / "good") <= {"good", "mine.csv", "mine.parquet"} | {
        f"good/{name}" for name in below(source)
    }


def header_of(raw: bytes, generator: np.random.Generator) -> bytes:
    """A header with some of its entries changed, or no JSON any more."""
    if generator.random() < 0.2:
        return damaged(raw, generator)
    return json.dumps(mutated(json.loads(raw), generator)).encode()
