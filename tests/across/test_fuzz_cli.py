"""Command lines at random: every one begins its work, ends well, or is refused in one message.

The commands and their options are taken from the tree itself, so that a new one is fuzzed without
being named here. `fuzzing.SEAMS` are where work begins; a line that gets there is accepted.
"""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from fuzz_files import make_files
from fuzzing import LONGEST, SEAMS, below, commands, line, outcome, pick, seams
from lengths import examples

LINES = 200  #: Lines of the long search.


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder of the lines."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    return tmp_path


def fault(how: str, said: str, left: set[str], took: float) -> str:
    """What a line did that none may; `left` are the names that it left behind."""
    if how in ("defect", "slow") or how not in ("begun", "exit 0", "exit 2"):
        return f"{how}: {said}"
    if took > LONGEST and how != "exit 0":
        return f"took {took:.1f} s"
    if any(not name.startswith("out") for name in left):
        return f"wrote outside: {left}"
    if any(name.endswith(".part") for name in left):
        return f"left half-written: {left}"
    if how != "exit 2":
        return ""
    messages = said.count("cmf: ") + said.count("Usage: ")
    if messages != 1 or "Traceback" in said or len(said) > 6000:
        return f"{messages} messages: {said}"
    return f"refused and left {left}" if left else ""


@pytest.mark.fuzz
def test_every_line_begins_or_is_refused(folder: Path) -> None:
    generator = np.random.default_rng(19)
    files = make_files(folder, generator)
    every, before, ends = commands(), below(folder), dict[str, int]()
    with seams():
        for number in range(lines()):
            words = pick(generator, list(every)) if number >= len(every) else list(every)[number]
            given = line(words, every[words], generator, files)
            how, said, took = outcome(given)
            if how == "exit 1" and words[-1] in ("check", "flight"):  # it found what it looks for
                how = "exit 0"
            left = below(folder) - before
            assert not fault(how, said, left, took), (given, fault(how, said, left, took))
            ends[how] = ends.get(how, 0) + 1
            shutil.rmtree("out", ignore_errors=True)
    assert ends["exit 2"] > 3 and ends["begun"] > 3


def lines() -> int:
    """Every command once in the short search."""
    return len(commands()) if examples(LINES) < LINES else examples(LINES)


def test_every_seam_is_there() -> None:
    with seams():
        assert len(SEAMS) > 5
    assert len(commands()) > 25 and os.getcwd()
