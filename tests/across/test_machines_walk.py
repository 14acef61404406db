"""Commands on machines, drawn from all pairs: each ends as `docs/data/machines.csv` says."""

import runpy
from pathlib import Path

import pytest
from shared import data_rows

ROOT = Path(__file__).parents[2]
WALK = runpy.run_path(str(ROOT / "scripts" / "parts" / "walk.py"))
PARTS = 3


@pytest.fixture(scope="module")
def listed() -> dict[tuple[str, str], tuple[str, str]]:
    """How each pair of command and machine ended when all were walked, and why."""
    rows = data_rows("machines")
    return {(row["command"], row["machine"]): (row["ended"], row["said"]) for row in rows}


@pytest.mark.slow
@pytest.mark.parametrize("part", range(PARTS))
def test_every_command_and_every_machine_end_as_listed(
    part: int, listed: dict[tuple[str, str], tuple[str, str]], tmp_path: Path
) -> None:
    """A third of pairs in which each kind of machine and each command is."""
    kinds = WALK["write_machines"](tmp_path)
    chosen = WALK["drawn"](kinds, len(WALK["COMMANDS"]), seed=1)[part::PARTS]
    found = {
        (p.command, p.machine): (p.ended, p.said) for p in WALK["walk"](kinds, chosen, tmp_path)
    }
    assert found == {pair: listed[pair] for pair in found} and len(found) == len(chosen)


def test_all_pairs_are_listed_and_none_is_a_defect(
    listed: dict[tuple[str, str], tuple[str, str]], tmp_path: Path
) -> None:
    kinds = WALK["write_machines"](tmp_path)
    assert listed.keys() == {(command, name) for command in WALK["COMMANDS"] for name in kinds}
    assert {ended for ended, _ in listed.values()} <= {"runs", "refused"}
    assert all((ended == "refused") == bool(reason) for ended, reason in listed.values())
