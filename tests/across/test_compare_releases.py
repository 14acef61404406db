"""A release over the last one: what differs is found, explained or not, and drawn."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
sys.path.insert(0, str(SCRIPTS))

import check_versions  # noqa: E402
import compare_releases as script  # noqa: E402

TIME = np.arange(100) / 100.0
WAVE = np.sin(2.0 * np.pi * TIME)  # spans 2


def saved(folder: Path, **columns: np.ndarray) -> None:
    folder.mkdir(parents=True)
    pq.write_table(pa.table({"time": TIME, **columns}), folder / "record.parquet")


def pair(tmp_path: Path, share: float) -> list[script.Difference]:
    """Leg 2 moves a hundredth as far as leg 1, and differs by a share of the span of leg 1."""
    for name, error in (("base", 0.0), ("head", share)):
        second = 0.01 * WAVE + 2.0 * error * (TIME == 0.5)
        saved(tmp_path / name / "sine", leg_extension_1=WAVE, leg_extension_2=second, other=TIME)
    return list(script.differences("sine", tmp_path / "base", tmp_path / "head"))


@pytest.mark.parametrize("share", [0.0, 1e-4, 0.02])
def test_a_difference_is_a_share_of_what_the_channel_spans(tmp_path: Path, share: float) -> None:
    (found,) = pair(tmp_path, share)
    assert found.channel == "leg_extension"
    assert found.share == pytest.approx(share, rel=1e-9)


def test_a_history_that_is_gone_differs_without_bound(tmp_path: Path) -> None:
    saved(tmp_path / "base" / "sine", leg_extension_1=WAVE, supply_pressure=WAVE)
    saved(tmp_path / "head" / "sine", leg_extension_1=WAVE[:50].repeat(2))
    sides = tmp_path / "base", tmp_path / "head"
    found = {d.channel: d.share for d in script.differences("sine", *sides)}
    assert found["supply_pressure"] == np.inf


CHANGE: dict[str, Any] = {"base": "v1", "cases": ["si*"], "channels": ["leg_*"], "why": "Oil."}


def test_what_is_explained_is_said_and_what_explains_nothing_is_found(tmp_path: Path) -> None:
    found = pair(tmp_path, 0.02)
    (explained,), unused = script.explain(found, [CHANGE, {**CHANGE, "cases": ["step"]}])
    assert explained.why == "Oil." and unused == {1}
    (open_,), unused = script.explain(found, [{**CHANGE, "channels": ["valve_command"]}])
    assert open_.why == "" and unused == {0}
    (small,), unused = script.explain([found[0]._replace(share=5e-4)], [CHANGE])
    assert small.why == "" and unused == {0}


def test_the_page_names_what_nobody_has_explained(tmp_path: Path) -> None:
    found = pair(tmp_path, 0.02)
    page = script.text(found, "v1", "release.png")
    assert "| sine | 2 % | leg_extension | **not explained** |" in page
    (explained,), _ = script.explain(found, [CHANGE])
    assert "| sine | 2 % | leg_extension | Oil. |" in script.text([explained], "v1", "release.png")


def test_the_lowest_versions_are_those_of_the_dependencies_and_extras() -> None:
    text = 'dependencies = ["numpy>=2.1", "mujoco>=3.17,<5,!=4.0.0"]\n'
    text += "[project.optional-dependencies]\n"
    text += "\n".join(f'{extra} = ["{extra}-of[more]>=1.2.3"]' for extra in check_versions.EXTRAS)
    pins = check_versions.lowest("[project]\n" + text)
    assert pins[:2] == ["numpy==2.1", "mujoco==3.17"]
    assert pins[2:] == [f"{extra}-of==1.2.3" for extra in check_versions.EXTRAS]
