"""Commands that write, ended at random moments: whole files or none, and the folder is free.

After SIGINT and SIGTERM nothing half-written is left. SIGKILL lets no process clean up: what it
left begins with a full stop, ends with .part, and goes when the next run takes the folder.
"""

import json
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from command_lines import LINES, line_of
from fuzzing import commands
from lengths import examples
from PIL import Image

from cmf_mj.core.files import exclusive_folder
from cmf_mj.core.tables import read_table
from cmf_mj.record.sources import REMARK, read_source

ENDS = 1  #: How often the long search ends each command.
LONGEST = 12.0  #: Latest end after the start [s].


def test_every_command_that_writes_has_a_line() -> None:
    writing = {
        " ".join(words)
        for words, command in commands().items()
        if {"out", "file", "target"} & {option.name for option in command.params}
    }
    assert writing - {"host"} == set(LINES)


def whole(path: Path) -> bool:
    """Whether a reader of its kind reads a file to its end."""
    content = path.read_bytes()
    if path.suffix == ".csv" and REMARK.encode() in content:
        read_source(path)
    elif path.suffix in (".parquet", ".csv") and not content.startswith(b"#"):
        read_table(path)
    elif path.suffix == ".png":
        with Image.open(path) as picture:
            picture.load()
    elif path.suffix == ".json":
        json.loads(content)
    elif path.suffix == ".toml":
        tomllib.loads(content.decode())
    return content.endswith(b"\n") or path.suffix not in (".toml", ".csv", ".md")


def end(words: str, number: int, after: float, folder: Path) -> tuple[int, set[str]]:
    """Run a command, send it a signal, and look at what it left; its exit status and the names."""
    out, given = folder / "out", line_of(words, folder)
    process = subprocess.Popen(
        [sys.executable, "-m", "cmf_mj", *given],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    try:
        process.wait(after)
    except subprocess.TimeoutExpired:
        process.send_signal(number)
    _, said = process.communicate(timeout=120)
    # Python itself tells of an end while it still imports.
    assert b"Traceback" not in said or said.rstrip().endswith(b"KeyboardInterrupt"), said.decode()
    left = {path for path in out.rglob("*") if path.is_file()} if out.exists() else set()
    partial = {path for path in left if path.suffix == ".part"}
    assert not partial or number == signal.SIGKILL, partial
    # A journal is appended to; its reader drops a torn line.
    assert all(whole(path) for path in left - partial if path.suffix != ".jsonl")
    with exclusive_folder(out):
        assert not list(out.rglob(".*.part"))
    assert {path.name for path in folder.iterdir()} <= {"files", "out"}
    return process.returncode, {path.name for path in left}


@pytest.mark.slow
@pytest.mark.fuzz
@pytest.mark.parametrize("words", LINES)
def test_an_end_at_any_moment_leaves_whole_files(words: str, tmp_path: Path) -> None:
    generator = np.random.default_rng([19, *words.encode()])
    signals = generator.permutation([signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
    for number in range(examples(ENDS)):
        (folder := tmp_path / str(number)).mkdir()
        end(words, int(signals[number % 3]), generator.uniform(0.3, LONGEST), folder)
