"""Every script runs from another folder and answers its question."""

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"


def run(script: str, *arguments: str, cwd: Path) -> str:
    environment = os.environ | {"MUJOCO_GL": os.environ.get("MUJOCO_GL", "egl")}
    result = subprocess.run(
        [sys.executable, str(SCRIPTS / script), *arguments],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_compare_rotational_covers_rotation_on_both_plants(tmp_path: Path) -> None:
    run("compare_rotational.py", "--quick", "--no-records", "--out", "rotation", cwd=tmp_path)
    with (tmp_path / "rotation" / "comparison.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 18
    assert {row["dof"] for row in rows} == {"roll", "pitch", "yaw"}
    assert {row["law"] for row in rows} == {
        "position_error_rate",
        "acceleration",
        "acceleration_opposing",
    }
    assert not (tmp_path / "rotation" / "records").exists()


def test_compare_model_reference_draws_the_adaptation(tmp_path: Path) -> None:
    laws = ("--laws", "model_following", "model_reference_adaptive")
    run(
        "compare_model_reference.py",
        "--quick",
        "--dofs",
        "heave",
        *laws,
        "--out",
        "m",
        cwd=tmp_path,
    )
    with (tmp_path / "m" / "comparison.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["law"], row["dof"]) for row in rows] == [(law, "heave") for law in laws[1:]]
    picture = matplotlib.image.imread(tmp_path / "m" / "adaptation.png")
    assert picture[..., :3].reshape(-1, 3).std(axis=0).min() > 0.05


def test_bench_prints_json_with_a_ratio(tmp_path: Path) -> None:
    figures = json.loads(run("bench.py", "--seconds", "2", "--repeat", "2", cwd=tmp_path))
    least = figures["frame_us"] / figures["bare_us"]
    assert figures["ratio_of_least"] == pytest.approx(least, rel=1e-2)
    assert figures["ratio"] > 0.0
    assert figures["real_time_factor"] > 0.0
    assert figures["speed_up_two_threads"] > 0.0


@pytest.mark.parametrize("cab", ["gfd", "rfd", "ifd"])
def test_render_model_draws_each_cab(cab: str, tmp_path: Path) -> None:
    """Off-screen, in software: the picture is neither empty nor of one colour."""
    arguments = ("--cab", cab, "--out", "cab.png", "--width", "320", "--height", "240")
    run("render_model.py", *arguments, cwd=tmp_path)
    picture = matplotlib.image.imread(tmp_path / "cab.png")
    assert picture.shape[:2] == (240, 320)
    assert picture[..., :3].reshape(-1, 3).std(axis=0).min() > 0.05


def test_show_limits_draws_its_figure(tmp_path: Path) -> None:
    limits = '[leg]\nvelocity = {value = 12.0, unit = "in/s", status = "assumed", source = "test"}'
    (tmp_path / "slow.toml").write_text(limits)
    run("show_limits.py", "--out", "shipped.png", cwd=tmp_path)
    run("show_limits.py", "--limits", "slow.toml", "--out", "slow.png", cwd=tmp_path)
    shipped, slow = (matplotlib.image.imread(tmp_path / f"{n}.png") for n in ("shipped", "slow"))
    assert shipped.shape == slow.shape
    assert shipped[..., :3].reshape(-1, 3).std(axis=0).min() > 0.05
    assert np.abs(shipped - slow).max() > 0.5
