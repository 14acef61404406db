"""Plausible mistakes in a file, on every command that reads one: refused by name, or read right.

What is read right gives the numbers of the good file. What no reader can know is `UNKNOWABLE`.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fuzz_files import make_files
from fuzzing import outcome, seams

from cmf_mj.core.errors import InputError
from cmf_mj.facility.host.stream import read_stream, unit_doubts
from cmf_mj.pilot.flight import load_flight
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.record.columns import CHANNELS, load_columns, read_mapped, write_facility_csv
from cmf_mj.record.record import Record

Cells = list[list[str]]
Change = Callable[[str], str | bytes]


def table(change: Callable[[Cells], Cells]) -> Change:
    """A change of the cells of a CSV text, its comment lines left where they are."""

    def changed(text: str) -> str:
        lines = text.splitlines()
        rows = [line for line in lines if not line.startswith("#")]
        new = [",".join(row) for row in change([row.split(",") for row in rows])]
        first = [line for line in lines[:1] if line.startswith("#")]
        last = [line for line in lines[-1:] if line.startswith("#") and len(lines) > 1]
        return "\n".join([*first, *new, *last]) + "\n"

    return changed


def column(factor: float, *names: str) -> Change:
    """The columns whose names begin so, times a factor; the checksums of the file are gone."""

    def scaled(cells: Cells) -> Cells:
        chosen = [i for i, name in enumerate(cells[0]) if name.strip('"').lower().startswith(names)]
        for row in cells[1:]:
            for i in chosen:
                row[i] = repr(float(row[i]) * factor)
        return cells

    return lambda text: table(scaled)(unsigned(text))


def unsigned(text: str) -> str:
    """The text without the checksums that tell any change, as a file of another program."""
    return "".join(line for line in text.splitlines(True) if not line.startswith("# cmf_mj {"))


LENGTHS = ("surge", "sway", "heave", "dcl2dvs_fdk_leg_pos", "dcl2dvs_dmd_leg_pos")

MISTAKES: dict[str, Change] = {
    "empty": lambda text: "",
    "header alone": table(lambda cells: cells[:1]),
    "one row": lambda text: table(lambda cells: cells[:2])(unsigned(text)),
    "a picture": lambda text: b"\x89PNG\r\n\x1a\n" + bytes(range(256)),
    "settings": lambda text: 'base = "gfd"\n[mine]\n',
    "web page": lambda text: "<!doctype html>\n<html><body>404</body></html>\n",
    "a column missing": table(lambda cells: [row[:-1] for row in cells]),
    "no header": table(lambda cells: cells[1:]),
    "units below the header": table(lambda cells: [cells[0], ["[s]"] * len(cells[0]), *cells[1:]]),
    "capitals": table(lambda cells: [[cell.title() for cell in cells[0]], *cells[1:]]),
    "blanks after commas": lambda text: table(
        lambda cells: [[row[0], *(f" {cell}" for cell in row[1:])] for row in cells]
    )(text),
    "from a spreadsheet": lambda text: "\ufeff" + text.replace("\n", "\r\n"),
    "unicode text": lambda text: text.encode("utf-16"),
    "decimal commas": lambda text: unsigned(text).replace(",", ";").replace(".", ","),
    "not a number": table(lambda cells: [*cells[:3], [*cells[3][:-1], "nan"], *cells[4:]]),
    "empty cell": table(lambda cells: [*cells[:3], [*cells[3][:-1], ""], *cells[4:]]),
    "rows reversed": lambda text: table(lambda cells: [cells[0], *cells[:0:-1]])(unsigned(text)),
    "every row twice": lambda text: table(
        lambda cells: [cells[0], *(row for row in cells[1:] for _ in range(2))]
    )(unsigned(text)),
    "time in milliseconds": column(1000.0, "time"),
    "lengths in millimetres": column(1000.0, *LENGTHS),
    "angles in degrees": column(180.0 / np.pi, "roll", "pitch", "yaw", "angular_rate"),
}

UNKNOWABLE = {
    ("stream.csv", "one row"): "a host that sends one frame",
}

FILES: dict[str, tuple[Callable[[Path], Any], tuple[str, ...]]] = {
    "facility.csv": (
        read_mapped,
        ("measure {file}", "identify {file} {file} --orders 2,1,1", "replay {file} --law velocity"),
    ),
    "stream.csv": (read_stream, ("operate {file}", "host {file} --to 127.0.0.1:9")),
    "flight.csv": (load_flight, ("fly {file}", "learn {file}")),
    "motion.csv": (load_flight, ("cue {file}",)),
}


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("good")
    make_files(folder, np.random.default_rng(1))
    time = np.arange(3840) / 128.0
    wave = 0.3 * np.sin(2.0 * np.pi * np.outer(0.1 * time**2, np.ones(6)))
    layout = {name: CHANNELS[name] for name in load_columns().channels}
    told = {"sample_rate": 128.0, "law": "velocity", "plant": "hexapod", "command": {}}
    legs = Record(time, dict.fromkeys(layout, wave), layout, told)
    write_facility_csv(legs, folder / "facility.csv")
    return folder


def numbers(thing: Any) -> list[np.ndarray]:
    """All arrays of what a reader gave."""
    parts = thing if isinstance(thing, tuple) else vars(thing).values()
    found = []
    for part in parts:
        if isinstance(part, np.ndarray):
            found.append(part)
        elif isinstance(part, dict):
            found += [v for v in part.values() if isinstance(v, np.ndarray)]
        elif isinstance(part, PilotMotion):
            found += numbers(part)
    return found


@pytest.mark.parametrize("mistake", MISTAKES)
@pytest.mark.parametrize("name", FILES)
def test_a_mistake_is_refused_by_name_or_read_right(
    name: str, mistake: str, good: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    read, lines = FILES[name]
    path, changed = tmp_path / name, MISTAKES[mistake]((good / name).read_text())
    path.write_bytes(changed if isinstance(changed, bytes) else changed.encode())
    with seams():
        ends = {line: outcome(line.format(file=path).split())[:2] for line in lines}
    for line, (how, said) in ends.items():
        if how == "exit 2":
            verdict = "refused"
            assert name in "".join(said.split()) or "allowed: " in said, (line, said)
        else:
            assert how in ("begun", "exit 0"), (line, how, said)
            try:
                verdict = judged(numbers(read(path)), numbers(read(good / name)))
            except InputError as refusal:  # where the work of the line begins
                verdict = "refused"
                assert "allowed: " in str(refusal)
        assert verdict != "wrong" or (name, mistake) in UNKNOWABLE, (line, how, said)


def judged(got: list[Any], right: list[Any]) -> str:
    """Whether what was read is that of the good file, or what is doubted aloud."""
    if len(got) == len(right) and all(
        a.shape == b.shape and np.allclose(a, b) for a, b in zip(got, right, strict=True)
    ):
        return "right"
    return "doubted" if len(got) == 5 and unit_doubts(got[1], got[2]) else "wrong"  # host frames
