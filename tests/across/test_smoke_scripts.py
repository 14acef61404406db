"""Every script runs from another folder and answers its question."""

import argparse
import hashlib
import json
import os
import runpy
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


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


@pytest.mark.slow
def test_bench_prints_json_with_a_ratio(tmp_path: Path) -> None:
    figures = json.loads(run("bench.py", "--seconds", "2", "--repeat", "2", cwd=tmp_path))
    assert 0.0 < figures["headless_us"] < figures["drawn_us"]
    assert 1.0 < figures["frame_over_headless"]
    assert 0.0 < figures["frame_over_drawn"] < figures["frame_over_headless"]
    assert 0.0 < figures["outside"] < 1.0
    frames = 1e6 / 2048 / figures["frame_us"]
    assert figures["real_time_factor"] == pytest.approx(frames, rel=1e-2)
    assert figures["speed_up_two_threads"] > 0.0


@pytest.mark.slow
def test_bench_compares_flights_and_studies(tmp_path: Path) -> None:
    arguments = ("--seconds", "1", "--repeat", "1", "--flight", "--study")
    figures = json.loads(run("bench.py", *arguments, cwd=tmp_path))
    assert 1.0 < figures["flight"] < 12.0
    assert figures["flight_real_time_factor"] > 0.0
    assert figures["study_case_s"] > 0.0
    assert 0.0 < figures["study_two_processes"] < 2.0


def test_update_docs_takes_tables_and_figures_of_studies(tmp_path: Path) -> None:
    root = tmp_path / "checkout"
    shutil.copytree(SCRIPTS.parent / "docs", root / "docs")
    shutil.copy(SCRIPTS.parent / "README.md", root)
    results = tmp_path / "out"
    for name in ("machines/sizes.md", "omct/omct.csv", "ablation/ladder.png"):
        (results / name).parent.mkdir(parents=True, exist_ok=True)
        (results / name).write_text(f"new {name}")
    (results / "report").mkdir()
    (results / "report/agreement.md").write_text("# Title\n\n| new |\n| --- |\n\ncaption\n")
    run("update_docs.py", "--results", str(results), "--root", str(root), cwd=tmp_path)
    page = (root / "docs" / "explanation" / "two_machines.md").read_text()
    assert "<!-- table: machines/sizes -->\n\nnew machines/sizes.md\n" in page
    page = (root / "docs" / "explanation" / "paper.md").read_text()
    assert "<!-- table: report/agreement -->\n\n| new |\n| --- |\n\n<!-- end -->" in page
    assert (root / "docs/data/omct.csv").read_text() == "new omct/omct.csv"
    listed = tomllib.loads((root / "docs/data/files.toml").read_text())["omct"]
    assert listed["sha256"] == hashlib.sha256(b"new omct/omct.csv").hexdigest()
    assert (root / "docs" / "images" / "ladder.png").read_text() == "new ablation/ladder.png"
    before = (SCRIPTS.parent / "docs" / "how_to" / "scenarios.md").read_text()
    assert (root / "docs" / "how_to" / "scenarios.md").read_text() == before


@pytest.mark.slow
@pytest.mark.parametrize("model", [["--cab", c] for c in ("gfd", "rfd", "ifd")] + [["--excavator"]])
def test_figures_of_the_model_draws_each_machine(model: list[str], tmp_path: Path) -> None:
    """Off-screen, in software: the picture is neither empty nor of one colour."""
    arguments = ("--out", "machine.png", "--width", "320", "--height", "240")
    run("figures.py", "model", *model, *arguments, cwd=tmp_path)
    picture = matplotlib.image.imread(tmp_path / "machine.png")
    assert picture.shape[:2] == (240, 320)
    assert picture[..., :3].reshape(-1, 3).std(axis=0).min() > 0.05


def test_limits_draws_its_figure(tmp_path: Path) -> None:
    limits = '[leg]\nvelocity = {value = 12.0, unit = "in/s", status = "assumed", source = "test"}'
    (tmp_path / "slow.toml").write_text(limits)
    run("figures.py", "limits", "--out", "shipped.png", cwd=tmp_path)
    run("figures.py", "limits", "--limits", "slow.toml", "--out", "slow.png", cwd=tmp_path)
    shipped, slow = (matplotlib.image.imread(tmp_path / f"{n}.png") for n in ("shipped", "slow"))
    assert shipped.shape == slow.shape
    assert shipped[..., :3].reshape(-1, 3).std(axis=0).min() > 0.05
    assert np.abs(shipped - slow).max() > 0.5


def test_rotation_draws_where_acceleration_feedback_is_stable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a coarse grid; the zero line is that of stability, and rises with opposing gain."""
    draw = runpy.run_path(str(SCRIPTS / "figures.py"))["rotation"]
    known = draw.__globals__
    monkeypatch.setitem(known, "HEIGHTS", np.linspace(0.0, 1.5, 6))
    monkeypatch.setitem(known, "GAINS", np.linspace(-0.12, 0.06, 10))
    draw(argparse.Namespace(out=tmp_path / "rotation.png"))
    picture = matplotlib.image.imread(tmp_path / "rotation.png")
    assert picture[..., :3].reshape(-1, 3).std(axis=0).min() > 0.05
    stable = known["least_damping"]("gfd", 2.485) > 0.0
    assert stable[:, 0].all() and not stable[:, -1].any()
    first = stable.sum(axis=1)
    assert (np.diff(first) <= 0).all() and first[0] > first[-1]


@pytest.mark.slow
def test_excavator_digs_and_obeys_a_lever(tmp_path: Path) -> None:
    text = run("excavator.py", "--out", "dig", cwd=tmp_path)
    assert "supply 320 bar, least 279 bar; pump at most 368 l/min" in text
    assert (tmp_path / "dig" / "excavator.parquet").is_file()
    picture = matplotlib.image.imread(tmp_path / "dig" / "excavator.png")
    assert picture[..., :3].reshape(-1, 3).std(axis=0).min() > 0.05
    text = run("excavator.py", "--lever=50,0,0", "--seconds", "1", cwd=tmp_path)
    raised = next(line for line in text.splitlines() if line.startswith("boom_cylinder"))
    assert raised.split()[1] == "2.67"
    assert float(raised.split()[3]) > 2.8
    assert (tmp_path / "out" / "excavator" / "excavator.png").is_file()


@pytest.mark.slow
def test_runs_of_the_facility_draw_their_figures(tmp_path: Path) -> None:
    told = run("figures.py", "lurch", "--wait", "1", "--out", "lurch.png", cwd=tmp_path)
    assert "with the trigger" in told
    run("figures.py", "cycle", "--seconds", "3", "--out", "cycle.png", cwd=tmp_path)
    for name in ("lurch.png", "cycle.png"):
        picture = matplotlib.image.imread(tmp_path / name)
        assert picture[..., :3].reshape(-1, 3).std(axis=0).min() > 0.05


@pytest.mark.slow
def test_update_docs_takes_tables_from_studies_and_data(tmp_path: Path) -> None:
    """On a copy of the pages: a study's table goes in, the ledger comes from the data."""
    source = SCRIPTS.parent
    shutil.copytree(source / "docs", tmp_path / "docs")
    shutil.copy(source / "README.md", tmp_path)
    ledger = tmp_path / "docs" / "reference" / "ledger.md"
    shipped = ledger.read_text(encoding="utf-8")
    ledger.write_text(shipped.replace("## 3.", "## 33."), encoding="utf-8")
    study = tmp_path / "out" / "fit" / "report"
    study.mkdir(parents=True)
    (study / "stated.csv").write_text("evidence,x\na,1\n", encoding="utf-8")
    run("update_docs.py", "--root", str(tmp_path), cwd=tmp_path)
    assert ledger.read_text(encoding="utf-8") == shipped
    data = tmp_path / "docs" / "data"
    assert (data / "calibration_report_rows.csv").read_text() == "evidence,x\na,1\n"


@pytest.mark.slow
def test_fuzz_flights_breaks_nothing(tmp_path: Path) -> None:
    text = run("flights.py", "fuzz", "--count", "8", "--seconds", "1.5", cwd=tmp_path)
    told = json.loads(text)
    assert told["flights"] == 8 and told["broken"] == []
    assert 0.0 < told["largest_leg_use"] < 1.05


@pytest.mark.slow
def test_fly_laws_counts_limit_cycles(tmp_path: Path) -> None:
    told = run(
        "laws.py", "fly", "--laws", "modal_plan", "--flights", "", "--streams", "2", cwd=tmp_path
    )
    assert "0 of 2" in told
    assert (tmp_path / "out" / "flights" / "flights.md").read_text(encoding="utf-8") in told


@pytest.mark.slow
def test_ablate_modal_law_says_what_feed_forward_is_worth(tmp_path: Path) -> None:
    """With the gains for the plan and no plan the machine rings on."""
    arguments = ("--dofs", "surge", "--only", "all,no feed-forward", "--out", "a")
    run("laws.py", "ablate", *arguments, cwd=tmp_path)
    lines = (tmp_path / "a" / "ablation.md").read_text(encoding="utf-8").splitlines()[2:]
    whole, without = ([cell.strip() for cell in line.split("|")] for line in lines)
    assert float(whole[2]) > 5.0
    assert without[2] == "unstable"
