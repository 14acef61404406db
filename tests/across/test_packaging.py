"""The wheel works outside the checkout, models and data inside it."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

USE = """
import pathlib, cmf_mj, cmf_mj.machine.models, numpy as np
assert cmf_mj.__file__.startswith({site!r}), cmf_mj.__file__
assert str(cmf_mj.machine.models.directory()).startswith({site!r})
for cab in cmf_mj.machine.models.CABS:
    plant = cmf_mj.Hexapod(cab)
from cmf_mj.pilot.flight import flight_names, load_flight
assert all(load_flight(name).motion.rate > 79.0 for name in flight_names()), flight_names()
assert len(flight_names()) == 7
record = cmf_mj.simulate(plant, "velocity", np.zeros((20, 6)))
assert record["leg_position"].shape == (20, 6)
from cmf_mj.facility.scenario import load_scenario, scenario_names
from cmf_mj.facility.signal_session import SignalSession
assert len(scenario_names()) >= 12
run = SignalSession(load_scenario("heave_sine"))
run.run(20)
assert run.frame == 20
assert (pathlib.Path(cmf_mj.__file__).parent / "py.typed").is_file()
for name in ("README.md", "LICENSE", "CHANGELOG.md", "cmf_hexapod.png"):
    assert cmf_mj.machine.models.model_path(name).is_file()
print(len(cmf_mj.law_names()))
"""


def test_an_installed_wheel_works_outside_the_checkout(tmp_path: Path) -> None:
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)],
        cwd=ROOT,
        check=True,
        capture_output=True,
        env=os.environ | {"CMF_MJ_PAGES": "https://example.org/raw/"},
    )
    (wheel,) = tmp_path.glob("*.whl")
    site = tmp_path / "site"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    (metadata,) = site.glob("*.dist-info/METADATA")
    assert "](https://example.org/raw/docs/images/gallery_machine.png)" in metadata.read_text(
        "utf-8"
    )
    result = subprocess.run(
        [sys.executable, "-c", USE.format(site=str(site))],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(site), "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert int(result.stdout) >= 10
