"""Figures of commands: every command that draws takes their format and their size."""

from pathlib import Path

import pytest
from command_lines import line_of
from fuzzing import commands
from shared import cmf

ELSEWHERE = {"measure", "guide run", "guide check"}
"""Commands whose figures need recordings; tests/studies look at them."""

FIGURES = {
    "run": "overview",
    "compare": "bode_heave step_heave",
    "failure": "pump_lost",
    "linearize": "bode loop",
    "modes": "modes_sweep",
    "identify": "bode",
    "operate": "operation",
    "serve": "operation",
    "replay": "run_model_following",
    "fly": "operation motion perceived comparison",
    "learn": "learning",
    "cue": "motion senses",
    "omct": "omct",
    "study": "ladder",
    "certify": "certificates",
    "fit": "recordings",
    "report linear": "bode_velocity step_velocity",
}
"""What the line of each command that draws leaves."""

SLOW = {"fly", "learn", "study", "certify"}


def test_every_command_that_draws_takes_a_format() -> None:
    for words, command in commands().items():
        named = {option.name for option in command.params}
        draws = " ".join(words) in {*FIGURES, *ELSEWHERE}
        assert ("figure_format" in named) == draws, words


@pytest.mark.parametrize(
    "words", [pytest.param(w, marks=pytest.mark.slow) if w in SLOW else w for w in FIGURES]
)
def test_a_command_writes_its_figures_as_asked(
    words: str, tmp_path: Path, drawn: dict[str, set[str]]
) -> None:
    cmf(*line_of(words, tmp_path), "--figure-format", "svg")
    written = [path for path in tmp_path.rglob("*") if path.suffix in (".png", ".svg", ".pdf")]
    assert {path.stem for path in written} == set(FIGURES[words].split())
    assert set(drawn) == {path.name for path in written}
    for path in written:
        assert path.suffix == ".svg" and "<svg " in path.read_text(), path


def test_a_format_that_is_none_is_refused(tmp_path: Path) -> None:
    said = cmf("report", "linear", "--figure-format", "gif", "--out", tmp_path / "out", code=2)
    assert "figure_format: 'gif' is not one of png, svg, pdf" in said
