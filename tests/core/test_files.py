"""What a folder of one run clears of others, and what tables keep of numbers and names."""

import os
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from cmf_mj.core.errors import InputError
from cmf_mj.core.files import exclusive_folder
from cmf_mj.core.tables import read_table, write_table


def test_only_half_written_files_of_processes_that_ended_go(tmp_path: Path) -> None:
    """At the start and at the end of a run, in the folder and in one below it."""
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    (tmp_path / "a").mkdir()
    names = [f".table.csv.{ended.pid}.part", f".table.csv.{os.getppid()}.part", ".my.notes.part"]
    begun = [folder / name for folder in (tmp_path, tmp_path / "a") for name in names]
    for again in (True, False):
        for path in begun:
            path.write_text("half")
        with exclusive_folder(tmp_path):
            if again:
                assert [path.name for path in begun if path.exists()] == 2 * names[1:]
                begun[0].write_text("half")
        assert [path.name for path in begun if path.exists()] == 2 * names[1:]


def test_csv_keeps_every_digit_of_doubles_but_no_types_and_capitals(tmp_path: Path) -> None:
    third = pa.array([1.0 / 3.0, 2.0], pa.float64())
    table = pa.table(
        {"Time [S]": third, "n": third.cast(pa.float32()), "one": pa.array([1.0, 2.0])}
    )
    back = read_table(write_table(table, tmp_path / "x.csv"))
    assert back["time [S]"].to_pylist() == third.to_pylist()
    assert [str(kind) for kind in back.schema.types] == ["double", "double", "int64"]
    assert read_table(write_table(table, tmp_path / "x.parquet")).equals(table)


@pytest.mark.parametrize(("owner", "name"), [(Path, "mkdir"), (os, "open")])
def test_a_refused_run_leaves_the_folder_of_a_faster_one(
    owner: Any, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other takes a new folder just before this run makes it, or between that and its lock."""
    out, real = tmp_path / "new", getattr(owner, name)

    def late(*arguments: Any, **keywords: Any) -> Any:
        monkeypatch.undo()
        other.enter_context(exclusive_folder(out))
        return real(*arguments, **keywords)

    monkeypatch.setattr(owner, name, late)
    with ExitStack() as other:
        with pytest.raises(InputError, match="another run writes to it"), exclusive_folder(out):
            pass
        assert out.is_dir()


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_what_is_no_file_is_named_once(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"d.{ending}"
    with pytest.raises(InputError) as missing:
        read_table(path)
    path.mkdir()
    with pytest.raises(InputError) as folder:
        read_table(path)
    assert str(missing.value) == f"{path}: cannot be read: there is no such file"
    assert str(folder.value).startswith(f"{path}: cannot be read: it is a folder")
