"""A short line of every command that writes results."""

from pathlib import Path

import numpy as np
from fuzz_files import make_files

from cmf_mj import SingleLegs, signals, simulate

LINES = {
    "run": "run heave_step --out {out}",
    "compare": "compare --laws velocity --dofs heave --quick --out {out}",
    "failure": "failure pump_lost --after 4 --at 1 --out {out}",
    "linearize": "linearize --out {out}",
    "modes": "modes --cabs gfd --samples 90 --rounds 2 --out {out}",
    "measure": "measure {swept} --out {out}",
    "identify": "identify {swept} {swept} --orders 2,1,1 --out {out}",
    "operate": "operate {stream} --out {out}",
    "serve": "serve --port 0 --seconds 1 --out {out}",
    "recording new": "recording new {facility} --file {out}/columns.toml",
    "replay": "replay {recording} --law model_following --out {out}",
    "fly": "fly gusts --out {out}",
    "learn": "learn gusts --trials 1 --out {out}",
    "flight": "flight gusts --file {out}/x.csv",
    "cue": "cue {motion} --out {out}",
    "omct": "omct --laws none --quick --dofs heave --out {out}",
    "study": "study ablation --laws velocity --dofs heave --quick --jobs 1 --out {out}",
    "tune": "tune --evaluations 12 --file {out}/law.toml",
    "certify": "certify velocity --cabs gfd --quick --out {out}",
    "fit": "fit {campaign} --no-effects --out {out}",
    "guide plan": "guide plan part60 --machine lab --out {out}",
    "guide run": "guide run part60 --machine lab --repetitions 1 --out {out}",
    "guide check": "guide check {campaign} --against {campaign} --out {out}",
    "campaign plan": "campaign plan --seconds 10 --out {out}",
    "report": "report --figures none --tables none --quick --out {out}",
    "report linear": "report linear --out {out}",
    "machine new": "machine new mine --file {out}/mine.toml",
    "machine build": "machine build cmf --out {out}",
    "export": "export library --out {out}",
    "play": "play heave_step --seconds 0.5 --file {out}/x.html",
}
"""Lines by the words of their commands."""


def line_of(words: str, folder: Path) -> list[str]:
    """The line of a command that reads files it finds in a folder, and writes below `out` there."""
    (source := folder / "files").mkdir()
    make_files(source, np.random.default_rng(19))
    names = {"facility": "facility.csv", "stream": "stream.csv", "motion": "motion.csv"}
    names |= {"campaign": "campaign.toml", "swept": "swept.parquet"}
    if words in ("measure", "identify"):
        chirp = signals.chirp("heave", 0.004, duration=24.0)
        simulate(SingleLegs(), "velocity", chirp, record_every=16).save(source / "swept.parquet")
    places = {name: str(source / file) for name, file in names.items()}
    recording = str(source / "run.parquet")
    return LINES[words].format(out=folder / "out", recording=recording, **places).split()
