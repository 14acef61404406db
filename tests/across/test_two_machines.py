"""The page that shows two machines side by side says what the models give."""

import runpy
from pathlib import Path

import pytest

from cmf_mj import load_machine
from cmf_mj.studies.machine_check import check_machine

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "explanation" / "two_machines.md").read_text("utf-8")
SCRIPT = ROOT / "scripts" / "parts" / "compare.py"
NAMES = ["cmf", "simona"]


def test_sizes_envelope_and_modes_on_the_page_are_those_of_the_machines() -> None:
    script = runpy.run_path(str(SCRIPT))
    checks = [check_machine(load_machine(name), poses=script["POSES"]) for name in NAMES]
    for name in ("sizes", "envelopes", "modes"):
        assert script[name](checks).markdown().strip() in PAGE, name
    assert script["capacity"](NAMES).markdown().strip() in PAGE


@pytest.mark.slow
def test_bandwidths_on_the_page_are_those_of_the_laws() -> None:
    assert runpy.run_path(str(SCRIPT))["bandwidths"](NAMES).markdown().strip() in PAGE
