"""The examples run and print what their heads promise."""

import re
import runpy
import sys
from pathlib import Path

import pytest

from cmf_mj import load_machine
from cmf_mj.machine.motion_limits import relative_travel

EXAMPLES = Path(__file__).parents[2] / "examples"


def printed(name: str, capsys: pytest.CaptureFixture[str]) -> str:
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    return capsys.readouterr().out


def test_every_example_is_tested() -> None:
    tested = set(re.findall(r'printed\("(\w+)"', Path(__file__).read_text(encoding="utf-8")))
    assert {path.stem for path in EXAMPLES.glob("*.py")} == tested


def test_surge_overshoots_by_half_where_heave_does_not(capsys: pytest.CaptureFixture[str]) -> None:
    text = printed("step_in_surge", capsys)
    overshoot = {dof: float(value) for dof, value in re.findall(r"(\w+): overshoot (\d+)", text)}
    assert overshoot["heave"] < 30.0 and 45.0 < overshoot["surge"] < 80.0


@pytest.mark.slow
def test_softer_law_is_slower_in_all_axes(capsys: pytest.CaptureFixture[str]) -> None:
    text = printed("law_of_your_own", capsys)
    bandwidths = [float(value) for value in re.findall(r"at ([\d.]+) Hz", text)]
    assert len(bandwidths) == 12
    for flown, softer in zip(bandwidths[::2], bandwidths[1::2], strict=True):
        assert 1.0 < softer < flown < 3.5


def test_lift_rises_by_flow_over_area(capsys: pytest.CaptureFixture[str]) -> None:
    text = printed("hydraulics_on_your_mjcf", capsys)
    risen, cap, supply = (float(value) for value in re.findall(r"([\d.]+) (?:m|bar)\b", text))
    assert risen == pytest.approx(0.180, abs=0.005)
    assert 20.0 < cap < supply < 110.0


def test_facility_follows_a_host_on_the_network(capsys: pytest.CaptureFixture[str]) -> None:
    """Where frames came in time the platform moves as asked; a busy machine stalls the host, and
    the demand then stops smoothly and joins it again, some overshoot included."""
    text = printed("host_over_udp", capsys)
    accepted, sent, late = map(int, re.findall(r"accepted: (\d+) of (\d+), (\d+) late", text)[0])
    assert 0.9 * sent <= accepted <= sent
    low, high = (float(value) for value in re.findall(r"-?\d\.\d{3}", text))
    assert low < -0.08 and 0.08 < high
    if accepted == sent and late == 0:
        assert -0.13 < low and high < 0.13


def test_identified_model_predicts_the_bandwidth(capsys: pytest.CaptureFixture[str]) -> None:
    text = printed("record_identify_close", capsys)
    fit, hertz, error = (float(value) for value in re.findall(r"-?\d+\.\d+", text))
    assert fit > 90.0 and hertz == pytest.approx(2.7, abs=0.1) and abs(error) < 2.0


def test_the_trained_policy_digs_faster_within_proof(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["dig_faster.py", "--generations", "0"])
    text = printed("dig_faster", capsys)
    law, policy = (float(value) for value in re.findall(r"after ([\d.]+) s", text))
    pressures = [float(value) for value in re.findall(r"pressure ([\d.]+) of proof", text)]
    assert "0 left" in text and policy < 0.6 * law and max(pressures) < 1.0


def test_the_crane_rises_to_its_stop_and_is_pressed_on_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """At rest F = (M + 2 m) g; on its stop pump and tank, F = A_cap Ps - A_rod Pt = 37.79 kN."""
    monkeypatch.setattr(sys, "argv", ["crane.py"])
    rows = [line.split() for line in printed("crane", capsys).splitlines()[2:]]
    table = {float(time): [float(cell) for cell in cells] for time, *cells in rows}
    assert table[0.25] == pytest.approx([0.5, 41.63, 34.61, 6860.0], rel=1e-4)
    assert table[7.0] == pytest.approx([0.7164, 76.0, 1.0, 37795.0], rel=2e-3)


@pytest.mark.parametrize("machine", ["cmf", "simona", "lab"])
def test_the_page_drives_a_machine_by_its_sine(
    machine: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """0.5 Hz in heave, 2 in on the CMF and in proportion to the travel of others, with a fade."""
    arguments = ["drive_in_browser.py", "--machine", machine, "--seconds", "4"]
    monkeypatch.setattr(sys, "argv", arguments)
    text = printed("drive_in_browser", capsys)
    assert re.search(r"http://127\.0\.0\.1:\d+", text)
    low, high = (float(value) for value in re.findall(r"-?\d\.\d{3}", text))
    size = 0.0254 * 2.0 * relative_travel(load_machine(machine), "heave")
    assert low == pytest.approx(-size, rel=0.2, abs=0.001)
    assert high == pytest.approx(size, rel=0.2, abs=0.001)


@pytest.mark.parametrize("train", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_hopper_hops_on_machines_that_differ(
    train: bool, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["hop.py", *([] if train else ["--generations", "0"])])
    text = printed("hop", capsys)
    unseen, many = (int(value) for value in re.findall(r"(\d+) of \d+ hop", text))
    assert unseen >= 9 and many >= 180
