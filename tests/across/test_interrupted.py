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
from fuzz_files import make_files
from fuzzing import commands
from lengths import examples
from PIL import Image

from cmf_mj.core.files import claimed, read_table

ENDS = 1
"""How often the long search ends each command."""
LONGEST = 12.0
"""Latest end after the start [s]."""

LINES = {
    "run": "run heave_step --out {out}",
    "compare": "compare --laws velocity --dofs heave --quick --out {out}",
    "failure": "failure pump_lost --after 2 --at 1 --out {out}",
    "capacity": "capacity sine --quick --dofs heave --out {out}",
    "linearize": "linearize --out {out}",
    "modes": "modes --cabs gfd --samples 90 --rounds 2 --points 3 --out {out}",
    "measure": "measure {facility} --out {out}",
    "identify": "identify {facility} {facility} --orders 2,1,1 --method arx --out {out}",
    "operate": "operate {stream} --out {out}",
    "serve": "serve --port 0 --seconds 1 --out {out}",
    "replay": "replay {recording} --law velocity --out {out}",
    "fly": "fly gusts --no-delay --out {out}",
    "learn": "learn gusts --trials 1 --out {out}",
    "flight": "flight gusts --file {out}/x.csv",
    "cue": "cue {motion} --share 0.8 --out {out}",
    "omct": "omct --laws none --quick --dofs heave --out {out}",
    "study": "study ablation --quick --jobs 1 --out {out}",
    "tune": "tune --evaluations 12 --file {out}/law.toml",
    "certify": "certify velocity --cabs gfd --quick --out {out}",
    "report calibrate": "report calibrate report --quick --samples 2 --out {out}",
    "report": "report --figures none --tables none --quick --out {out}",
    "report linear": "report linear --out {out}",
    "machine new": "machine new mine --file {out}/mine.toml",
    "machine show": "machine show cmf --file {out}/x.png",
    "machine build": "machine build cmf --out {out}",
    "export": "export library --out {out}",
    "video": "video heave_step --seconds 0.5 --file {out}/x.gif",
}
"""A short line of every command that writes results, by its words."""


def test_every_command_that_writes_has_a_line() -> None:
    """The studio writes when a user asks."""
    writing = {
        " ".join(words)
        for words, command in commands().items()
        if {"out", "file", "target"} & {option.name for option in command.params}
    }
    assert writing - {"host"} == set(LINES)


def whole(path: Path) -> bool:
    """Whether a reader of its kind reads a file to its end."""
    content = path.read_bytes()
    if path.suffix in (".parquet", ".csv") and not content.startswith(b"#"):
        read_table(path)
    elif path.suffix in (".png", ".gif"):
        with Image.open(path) as picture:
            picture.load()
    elif path.suffix == ".json":
        json.loads(content)
    elif path.suffix == ".toml":
        tomllib.loads(content.decode())
    return content.endswith(b"\n") or path.suffix not in (".toml", ".csv", ".md")


def end(words: str, number: int, after: float, folder: Path) -> tuple[int, set[str]]:
    """Run a command, send it a signal, and look at what it left; its exit status and the names."""
    generator = np.random.default_rng(19)
    (source := folder / "files").mkdir()
    make_files(source, generator)
    names = {"facility": "facility.csv", "stream": "stream.csv", "motion": "motion.csv"}
    places = {name: str(source / file) for name, file in names.items()}
    out = folder / "out"
    given = LINES[words].format(out=out, recording=source / "run.parquet", **places).split()
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
    with claimed(out):
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
