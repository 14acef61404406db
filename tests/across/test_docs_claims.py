"""What pages and sentences claim, against the data, the models and the contracts they speak of."""

import re
import shlex
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fuzzing import commands
from shared import chirp_bandwidths, data_rows
from shared import printed as printed_row

from cmf_mj import (
    Hexapod,
    Linear,
    SingleLegs,
    attach_hydraulics,
    bandwidths,
    frequency_response,
    load_cab,
    load_hydraulics,
    load_law,
    pose_to_legs,
    signals,
    simulate,
)
from cmf_mj.analysis.frequency_response import rounds_response
from cmf_mj.analysis.linear.poles import least_damped_mode
from cmf_mj.analysis.measures import measure_loop
from cmf_mj.analysis.step_response import step_metrics
from cmf_mj.core import units
from cmf_mj.machine import models
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import geometry_about
from cmf_mj.pilot.perception import load_senses, otolith_response
from cmf_mj.signals.composite import seven_sines, waypoints
from cmf_mj.studies.asymptotes import asymptotes

ROOT = Path(__file__).resolve().parents[2]
FILES = ("changes", "gains", "unknowns", "evidence")
TABLES = ROOT / "docs" / "reference" / "data.md"


def read(page: str | Path) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def shares(text: str) -> np.ndarray:
    """Share of machines and the ends of its interval, 98 % (94 to 100)."""
    middle, low, high = re.fullmatch(r"(\d+) % \((\d+) to (\d+)\)", text).groups()  # type: ignore[union-attr]
    return np.array([float(low), float(middle), float(high)]) / 100.0


def span(text: str) -> np.ndarray:
    middle, low, high = re.fullmatch(r"(\S+) \((\S+) to (\S+)\)", text).groups()  # type: ignore[union-attr]
    return np.array([float(low), float(middle), float(high)])


def test_what_is_robust_in_rotation_is_so_in_its_data() -> None:
    """With each part of the evidence left out; the best gain is the one of the advice."""
    stability = data_rows("rotation_stability")
    for law, unstable in (("acceleration_d2", True), ("modal_plan", False)):
        for row in (row for row in stability if row["law"] == law):
            without = np.array(
                [shares(value) for name, value in row.items() if name.startswith("without")]
            )
            right = without if unstable else 1.0 - without[:, ::-1]
            assert np.all(right[:, 1] > 0.95) and np.all(right[:, 0] > 0.85)
    gains, evidence = data_rows("rotation_gains"), data_rows("rotation_evidence")
    sure = [row for row in gains if shares(row["stable with every cab"])[1] >= 0.95]
    best = max(sure, key=lambda row: span(row["least damping ratio"])[1])
    assert (best["gain [%/(in/s²)]"], best["filter"]) == ("-0.08", "2.48 Hz")
    (held,) = (row for row in evidence if row["observation"].startswith("velocity_integral"))
    assert held["inside"] == "yes"


def test_the_plant_agrees_as_far_as_the_page_says() -> None:
    """Most numbers left out within 90 %, none beyond 99.5 %, no median at a bound, one sign."""
    of_plants = data_rows("effects_left_out")
    left = {r["number"]: float(r["rank"]) for r in of_plants if r["plant"] == "none"}
    ranks = list(left.values())
    assert 0.8 <= np.mean([0.05 <= rank <= 0.95 for rank in ranks]) <= 0.97
    assert all(0.0025 <= rank <= 0.9975 for rank in ranks)
    average = [row for row in of_plants if row["plant"] == "average"]
    for column, inside in (("rank", 11), ("recording left out", 11)):
        held = sum(0.05 <= float(row[column]) <= 0.95 for row in average)
        assert (len(average), held) == (12, inside)
    least = sorted(left, key=lambda name: -abs(left[name] - 0.5))[:2]
    assert least == ["pair_damping", "velocity_phase_bandwidth_hz"]
    (none,) = (row for row in data_rows("effects") if row["plant"] == "none")
    assert float(none["nearest to a bound"]) > 0.05
    signs: dict[str, set[float]] = {}
    for row in data_rows("effects_verdicts"):
        change = span(row["pair against position_error_rate"])
        signs.setdefault(row["law"], set()).add(float(np.sign(change[1])))
    assert signs["acceleration"] == signs["acceleration_eq_3_6"] == {-1.0}
    assert signs["acceleration_opposing"] == {1.0}
    assert "Within the report's own" in read("docs/explanation/acceleration_in_rotation.md")


def test_every_printed_interval_has_its_ends_in_order() -> None:
    files = (ROOT / "docs" / "data" / f"rotation_{name}.csv" for name in FILES)
    texts = "".join(file.read_text(encoding="utf-8") for file in files).replace(" %", "")
    intervals = re.findall(r"[^\s,]+ \(\S+ to \S+\)", texts)
    assert len(intervals) > 100
    for text in intervals:
        assert (np.diff(span(text)) >= 0.0).all(), text


def test_contributing_has_the_layers_of_the_contract() -> None:
    contracts = tomllib.loads(read("pyproject.toml"))["tool"]["importlinter"]["contracts"]
    (layers,) = (one["layers"] for one in contracts if one["type"] == "layers")
    (order,) = re.findall(r"^`(cli > .*)`\.$", read("CONTRIBUTING.md"), re.MULTILINE)
    assert order.split(" > ") == layers


@pytest.mark.parametrize("cab", ["gfd", "rfd", "ifd"])
def test_amplitude_md_has_the_limits_of_unit_gain(cab: str) -> None:
    """Valve, drive of 2000 %/s and stall, the load at rest taken off, to one decimal."""
    text = read("docs/explanation/amplitude.md")
    cells = re.findall(rf"^\|.*\| {cab.upper()} \| (.*) \|$", text, re.MULTILINE)
    plant, frequency = Hexapod(cab), np.geomspace(1.0, 30.0, 20_000)
    s = 2j * np.pi * frequency[:, None]
    for i, dof in enumerate(DOFS):
        one = asymptotes(plant, dof)
        lags = np.prod([1.0 + s / corner for corner in one.corners], axis=0)
        spring = one.stiffness * s / (s + one.leak_rate)
        flow = np.abs(lags * s * (one.column + s**2 * (one.mass @ one.column) / spring))
        amplitude = 0.33 * units.INCH if i < 3 else np.radians(0.2)
        valve = amplitude * (flow / one.speed).max(axis=1)
        rate = np.abs(s[:, 0])
        used = valve, rate * 100.0 * valve / 2000.0, rate**2 * amplitude / one.acceleration
        for row, limit in zip(cells, used, strict=True):
            at = float(frequency[np.argmax(limit >= 1.0)])
            assert float(row.split(" | ")[i]) == pytest.approx(at, abs=0.051), (dof, row)


def test_capacity_md_has_the_regions_of_the_envelope() -> None:
    """Where Table 2-1 ends to bind, and between which frequencies the stall force does (GFD)."""
    plant, page = Hexapod("gfd"), read("docs/how_to/capacity.md")
    frequency, ends, stalls = np.geomspace(0.1, 10.0, 5001), {}, {}
    for dof in DOFS:
        limits = asymptotes(plant, dof)
        every = [limits.velocities(hertz) for hertz in frequency]
        binding = np.array([min(one, key=one.__getitem__) for one in every])
        ends[dof] = frequency[np.argmax(binding != "displacement")]
        stalls[dof] = frequency[binding == "stall_force"]
    others = [ends[dof] for dof in DOFS if dof not in ("heave", "yaw")]
    first = max(ends["heave"], ends["yaw"])
    said = f"Below {first:.2f} Hz** (heave, yaw) or {min(others):.2f} to {max(others):.2f} Hz"
    assert said in page
    surge, sway = (f"{stalls[d].min():.1f} to {stalls[d].max():.1f} Hz" for d in ("surge", "sway"))
    assert f"From {surge} in surge and {sway} in sway" in page


def test_a_tenth_of_g_is_as_far_above_the_thresholds_as_fly_md_says() -> None:
    """Otoliths' gain from rest to 10 Hz, over the thresholds along z and x."""
    senses, frequency = load_senses(), np.geomspace(1e-4, 10.0, 2001)
    gain = np.abs(otolith_response(senses.otoliths)(2j * np.pi * frequency))
    over = 0.1 * units.STANDARD_GRAVITY * gain[:, None] / senses.thresholds.si[:3]
    said = f"it is {over.min():.1f} to {over.max():.1f} times the thresholds"
    assert said in read("docs/how_to/fly.md")


def test_modal_plan_is_as_fast_as_the_pages_say() -> None:
    """The slowest nominal row of the data, rounded down."""
    nominal = re.findall(
        r"^nominal,\w+,.*? of 24,([\d.]+),", read("docs/data/modal_plan_accept.csv"), re.M
    )
    said = np.floor(10.0 * min(float(value) for value in nominal)) / 10.0
    assert len(nominal) == 3
    for page in ("laws.md", "paper.md"):
        text = re.sub(r"\s*<!--.*?-->\s*", " ", read(f"docs/explanation/{page}"), flags=re.S)
        assert f"-90 deg at {said:g} Hz or more" in " ".join(text.split())


def test_the_boom_without_pressures_ends_in_the_limit_cycle_of_any_model_md() -> None:
    """From under 1 mm at the end of the lift to 9 mm peak to peak at 2.0 Hz; with them it rests."""
    names = ("boom_cylinder", "stick_cylinder", "bucket_cylinder")
    files = (models.model_path(f"excavator{end}") for end in (".xml", "_hydraulics.toml"))
    spec, oil = files
    digger = attach_hydraulics(spec, names, oil, payload=["load"])
    lengths = np.array([[2.673, 3.038, 2.667], *[[2.80, 2.90, 2.70]] * 2])
    path = waypoints([0.0, 3.0, 16.0], lengths - digger.neutral)
    law = load_law(models.model_path("excavator_laws.toml"))
    bare = law.direct_gain.model_copy(update={"cap_pressure": 0.0, "rod_pressure": 0.0})
    for one, least, most in (
        (law, 0.0, 0.2),
        (law.model_copy(update={"direct_gain": bare}), 8.5, 9.5),
    ):
        run = simulate(digger, one, path, legs=True, start=digger.configuration(path[0]))
        swing = 1e3 * run["leg_extension"][:, 0]
        late = swing[run.time >= 12.0]
        assert np.ptp(swing[(run.time >= 3.0) & (run.time < 4.0)]) < 1.0
        assert least <= np.ptp(late) <= most
    crossings = np.flatnonzero(np.diff(np.sign(late - late.mean())) > 0)
    assert 2048.0 / np.diff(crossings).mean() == pytest.approx(2.0, abs=0.05)
    page = read("docs/how_to/any_model.md").replace("\n", " ")
    assert "a limit cycle of 9 mm peak to peak at 2.0 Hz" in page


def test_chirp_and_multisine_agree_in_small_motion_as_data_md_says() -> None:
    """Surge, farthest off, at a hundredth of 0.33 in; at a tenth it is still 0.8 % below."""
    plant, size = Hexapod("gfd"), 0.01 * 0.33 * units.INCH
    swept, lines = (
        bandwidths(frequency_response(simulate(plant, "velocity", signal("surge", size))))
        for signal in (signals.chirp, signals.multisine)
    )
    assert swept.phase_hz == pytest.approx(lines.phase_hz, rel=4e-3)
    assert swept.gain_hz == pytest.approx(lines.gain_hz, rel=4e-3)
    assert "are a multisine's within 0.4 %" in read(TABLES)


@pytest.mark.parametrize(("dof", "percent"), [("heave", 1), ("surge", 8)])
def test_excitations_agree_as_far_as_measuring_md_says(dof: str, percent: int) -> None:
    """The farthest apart: the facility's rounds about -90 deg, a multisine of small swings."""
    plant, size = Hexapod("gfd"), 0.33 * units.INCH
    rounds = [
        simulate(plant, "velocity", seven_sines(dof, size, n), record_every=16) for n in (2, 3)
    ]
    small = signals.multisine(dof, size, spectrum="acceleration")
    least = bandwidths(rounds_response(rounds, dof)).phase_hz
    most = bandwidths(frequency_response(simulate(plant, "velocity", small), dof)).phase_hz
    assert least < most <= (1.0 + percent / 100.0) * least
    assert f"{percent} % in {dof}" in read("docs/how_to/measuring.md")


def test_force_feedback_rings_at_25_hz_with_oil_as_stiff_as_deviations_md_says() -> None:
    page = read("docs/explanation/deviations.md").replace("\n", " ")
    (times,) = re.findall(r"25 Hz needs oil (\S+) times as stiff", page)
    oil = load_hydraulics("report")
    bulk = oil.bulk_modulus.model_copy(update={"value": float(times) * oil.bulk_modulus.value})
    stiff = Linear(SingleLegs(oil.model_copy(update={"bulk_modulus": bulk})))
    poles = stiff.loop("force", "leg_1").poles()
    assert least_damped_mode(poles, 200.0, lowest_hz=4.0)[1] == pytest.approx(25.0, abs=0.2)


def test_lines_and_manifolds_cost_what_hydraulics_md_says() -> None:
    """The rise of a heave step of 30 in, the busiest valve of a sine of 24 in/s once it repeats."""
    page = read("docs/explanation/hydraulics.md").replace("\n", " ")
    oil, rises, shares = load_hydraulics("hardware"), [], []
    sine = signals.sine("heave", 24.0 * units.INCH / (0.5 * np.pi), 0.25, cycles=3)
    for supply in (oil, oil.model_copy(update={"supply": "constant"})):
        plant = Hexapod("gfd", supply)
        step = simulate(plant, "velocity", signals.step("heave", 30.0 * units.INCH))
        rises.append(step_metrics(step, "heave").rise_time)
        run = simulate(plant, "velocity", sine)
        within = (run.time > 4.0) & (run.time < 8.0)
        shares.append(100.0 * np.abs(run["valve_command"][within]).max())
    assert f"rises in {rises[0]:.3f} s for {rises[1]:.3f}" in page
    assert f"takes {shares[0]:.1f} % of the valves for {shares[1]:.1f} %" in page


def unknown_in(line: str, known: dict[tuple[str, ...], Any]) -> list[str]:
    """What a command line names that there is not: its command, or options of it."""
    words = shlex.split(line, comments=True)
    depths = [n for n in range(1, len(words) + 1) if tuple(words[:n]) in known]
    if not depths:
        return words[:1]
    parameters = known[tuple(words[: depths[-1]])].params
    options = {"--help"}.union(*([*one.opts, *one.secondary_opts] for one in parameters))
    return [word for word in words if word.startswith("--") and word.split("=")[0] not in options]


def test_commands_of_the_pages_exist_with_their_options() -> None:
    """Each line `cmf ...` of a listing, and in a sentence."""
    names, known = ("README.md", "CONTRIBUTING.md", "models/README.md"), commands()
    pages = [*(ROOT / name for name in names), *(ROOT / "docs").rglob("*.md")]
    lines = [
        (page.name, "".join(found))
        for page in pages
        for found in re.findall(r"^cmf ([a-z].*)$|`cmf ([a-z][^`]*)`", read(page), re.M)
    ]
    assert len(lines) > 150
    assert [one for one in lines if unknown_in(one[1], known)] == []
    assert unknown_in("compare --laws velocity --swift", known) == ["--swift"]
    assert unknown_in("compete --laws velocity", known) == ["compete"]


def test_leg_speed_and_drive_lag_move_the_bandwidth_as_the_page_says() -> None:
    """Central differences of ln -90 deg in heave over ln of each number; leakage hardly counts."""
    oil, page = load_hydraulics("report"), read("docs/explanation/credibility.md")

    def width(law: str, name: str, factor: float) -> float:
        number = getattr(oil, name)
        changed = number.model_copy(update={"value": factor * number.value})
        loop = Linear(SingleLegs(oil.model_copy(update={name: changed}))).loop(law, "leg_1")
        return measure_loop(loop, frequencies=np.geomspace(0.4, 15.0, 400)).phase_bandwidth_hz

    def moved(law: str, name: str) -> float:
        return float(50.0 * np.log(width(law, name, 1.01) / width(law, name, 0.99)))

    speed, lag, leak = (
        moved("position_error_rate", name) for name in ("leg_speed", "drive_lag", "leak_rate")
    )
    assert f"1 % of leg speed moves it by {speed:.2f} %, of drive lag by {lag:.2f} %" in page
    assert abs(leak) < 0.05
    speed, lag, oil_too = (
        moved("acceleration_d2", name) for name in ("leg_speed", "drive_lag", "bulk_modulus")
    )
    assert f"(`acceleration_d2` {speed:.1f} and {lag:.1f})" in page
    assert "`acceleration_d2`: the oil" in page and abs(oil_too) > 0.2


@pytest.mark.parametrize(
    ("law", "dof", "table", "sentence"),
    [
        ("original", "heave", "3-5", "of the original law {:.1f} % above Table 3-5"),
        ("position_error_rate", "roll", "D-1", "in roll {:.1f} % below Table D-1"),
    ],
)
def test_report_md_has_the_bandwidths_nearest_to_their_limit(
    law: str, dof: str, table: str, sentence: str
) -> None:
    found = chirp_bandwidths("single_legs", law, dof, hydraulics="report").phase_hz
    off = abs(found / printed_row(table, law, dof=dof).phase_bandwidth_hz - 1.0)
    assert sentence.format(100.0 * off) in read("docs/explanation/report.md")


def test_a_tilt_about_the_centre_of_mass_moves_legs_as_limits_md_says() -> None:
    """About any level axis, with the cab farthest off."""
    turns = np.linspace(0.0, 2.0 * np.pi, 121)
    tilts = np.zeros((turns.size, 6))
    tilts[:, 3:5] = np.radians(1.0) * np.column_stack([np.cos(turns), np.sin(turns)])
    apart = []
    for cab in map(load_cab, models.CABS):
        parts = (cab, cab.platform)
        place, mass = [p.centre_of_mass.si for p in parts], [p.mass.si for p in parts]
        centre = np.average(place, axis=0, weights=mass) * [1.0, -1.0, -1.0]
        apart.append(
            np.abs(pose_to_legs(tilts) - pose_to_legs(tilts, geometry_about(centre))).max()
        )
    assert f"1 deg differ by up to {1e3 * max(apart):.0f} mm" in read("docs/explanation/limits.md")


def test_intervals_of_hidden_machines_hold_as_often_as_the_page_says() -> None:
    known = [row for row in data_rows("hidden_machines") if row["identifiable"] == "True"]
    held = sum(row["holds"] == "True" for row in known)
    assert 0.85 <= held / len(known) <= 0.95
    said = f"On twenty [hidden machines](../data/hidden_machines.csv) {held} of {len(known)} "
    assert said in read("docs/tutorials/recordings_to_a_law.md")
    assert len({row["machine"] for row in known}) == 20


def test_laws_of_hidden_machines_do_what_the_page_says() -> None:
    lines = [
        {k: v if k == "machine" else float(v) for k, v in r.items()}
        for r in data_rows("hidden_laws")
    ]
    ratio = np.array([line["ratio"] for line in lines])
    assert len(lines) == 20 and 0.99 < np.median(ratio) < 1.01
    assert 1.165 < ratio.max() < 1.175 and ratio.min() > 0.83
    assert max(line["spread truth"] for line in lines) > 0.17
    assert sum(line["largest off, of the box"] <= 1.0 for line in lines) == 19
    assert all(
        line[f"least damping on the truth, {law}"] > 0.0
        for line in lines
        for law in ("recorded", "tuned")
    )
    for line in lines:
        proven = {k: v for k, v in line.items() if k.endswith("proven")}
        assert min(v for k, v in proven.items() if k.startswith("recorded")) > 1.0
        assert (min(proven.values()) < 1.0) == str(line["machine"]).startswith("lab")
    lab = [line for line in lines if str(line["machine"]).startswith("lab")]
    assert f"{min(one['tuned, none: broken'] for one in lab):.2f}" == "0.07"


def test_acceleration_feedback_stays_below_the_bandwidths_hoped_for() -> None:
    """In rotation, 95 % of machines; the advised law damps the pair more than the law flown."""
    every = [row for row in data_rows("averaged_laws") if row["law"].startswith("acceleration")]
    turning = [row for row in every if row["number"] in ("roll", "pitch", "yaw")]
    widths = [span(row["averaged"]) for row in turning if row["averaged"] != "-"]
    assert len(widths) > 20
    assert max(width[2] for width in widths) < 4.7
    pair = {(r["law"], r["cab"]): span(r["all evidence"])[1] for r in data_rows("rotation_changes")}
    for cab in ("gfd", "rfd", "ifd"):
        assert pair["acceleration_compensated", cab] > pair["velocity", cab]
