"""The plant against Exudyn, and the second hydraulics against closed forms."""

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from crosscheck import foreign
from crosscheck.hydraulics import Circuit, make_circuit
from crosscheck.machine import Machine, Spring
from crosscheck.recordings import recorded
from crosscheck.verification import Verification, distance, in_mujoco, valve_sines, verify
from scipy import linalg
from shared import data_rows, rows_of

from cmf_mj import Hexapod, Run, load_hydraulics
from cmf_mj.core import units
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.signal import ValveCommands
from cmf_mj.machine import models
from cmf_mj.machine.kinematics import pose_jacobian
from cmf_mj.plant import cylinder
from cmf_mj.plant.parameters import HydraulicParameters
from cmf_mj.plant.yielding import Floor, on_floor
from cmf_mj.signals.signal import as_plain
from cmf_mj.studies.diagnosis import moved_machine, numbers_of

SCRIPT = Path(__file__).resolve().parents[1] / "crosscheck"
TARGET = 2e-6  #: Largest difference of a leg extension that counts as agreement [m].
SECONDS = 0.5


def altered(name: str, factor: float) -> HydraulicParameters:
    report = load_hydraulics("report")
    quantity = getattr(report, name)
    return report.model_copy(
        update={name: quantity.model_copy(update={"value": factor * quantity.value})}
    )


@pytest.fixture(scope="module")
def compared() -> Verification:
    return verify(seconds=SECONDS, parts=(1, 2, 4))


@pytest.fixture(scope="module")
def circuit() -> Circuit:
    return make_circuit(load_hydraulics("report"))


def errors(compared: Verification, engine: str) -> list[float]:
    return [run.extension_error for run in compared.runs if run.engine == engine]


def test_both_engines_agree_within_two_micrometres(compared: Verification) -> None:
    # A leg 2 um off between closed valves is this far off in pressure: beta / h per metre.
    report = load_hydraulics("report")
    allowed = TARGET * report.bulk_modulus.si / report.half_stroke.si
    assert compared.travel > 1e4 * TARGET
    for run in compared.runs:
        assert run.extension_error < TARGET, run
        assert run.pressure_error < allowed, run
    assert compared.extension_uncertainty < 0.05 * TARGET


def test_step_errors_fall_with_order_two(compared: Verification) -> None:
    exudyn, mujoco = errors(compared, "exudyn"), errors(compared, "mujoco")
    assert exudyn[0] / exudyn[1] == pytest.approx(4.0, rel=0.1)
    assert exudyn[1] / exudyn[2] == pytest.approx(4.0, rel=0.1)
    assert mujoco[0] / mujoco[1] > 3.0


def test_the_comparison_would_see_a_small_mistake() -> None:
    valves = valve_sines(SECONDS)
    right = in_mujoco(valves, 1.0 / 2048.0, "gfd", load_hydraulics("report"))
    for name, factor in (("bulk_modulus", 1.002), ("leak_rate", 1.02), ("leg_speed", 1.0002)):
        wrong = in_mujoco(valves, 1.0 / 2048.0, "gfd", altered(name, factor))
        assert distance(wrong, right)[0] > TARGET, name


@pytest.mark.parametrize("cab", sorted(models.CABS))
def test_exudyn_has_the_reflected_mass_and_stays_at_rest(cab: str) -> None:
    plant = Hexapod(cab, "report")
    machine = Machine(plant)
    mass = plant.reflected_mass()
    np.testing.assert_allclose(machine.reflected_mass(), mass, rtol=0.0, atol=1e-9 * mass.max())
    still = machine.run(np.zeros((205, 6)), 1.0 / 2048.0)
    assert np.abs(still.extension).max() < 1e-12
    start = np.broadcast_to(plant.start().pressure, still.pressure.shape)
    np.testing.assert_allclose(still.pressure, start, rtol=1e-9)


def test_a_machine_starts_every_run_anew() -> None:
    machine = Machine(Hexapod("rfd", "report"))
    valves = valve_sines(0.02)
    first = machine.run(valves, 1.0 / 2048.0)
    again = machine.run(valves, 1.0 / 2048.0)
    np.testing.assert_array_equal(first.extension, again.extension)
    np.testing.assert_array_equal(first.pressure, again.pressure)


def in_heave(
    floor: Spring | None = None, mounts: Spring | None = None
) -> tuple[np.ndarray, float, float, float, float]:
    """Heave after a short opening of all valves (N,), then masses and springs of the heave mode.

    These are the reflected mass, the momentum per speed on a fixed floor, the whole mass, and the
    spring of the oil, that of a leg times the square of legs over heave.
    """
    plant, valves = foreign.data_sheet(), np.zeros((4096, 6))
    valves[10:14] = 0.2
    found = Machine(plant, floor=floor, mounts=mounts).run(valves, 1.0 / 2048.0)
    legs = pose_jacobian(np.zeros(6), plant.machine)[:, 2]
    mass = float(legs @ plant.reflected_mass() @ legs)
    plant.start()
    momentum = float(np.abs(plant.static_load() @ legs) / STANDARD_GRAVITY)
    stiffness = cylinder.stiffness(
        plant.hydraulics.cylinder, plant.hydraulics.oil.bulk_modulus, np.zeros(6)
    )
    spring = float(legs @ (stiffness * legs))
    total = float(plant.model.body_mass.sum())
    return found.extension[1024:].mean(axis=1), mass, momentum, total, spring


def peak(history: np.ndarray, near: float) -> float:
    """Frequency of the largest line of a history at 2048 Hz within a tenth of one [Hz]."""
    slow = np.polyval(np.polyfit(np.arange(history.size), history, 2), np.arange(history.size))
    lines = np.abs(np.fft.rfft((history - slow) * np.hanning(history.size), 2**18))
    frequency = np.fft.rfftfreq(2**18, 1.0 / 2048.0)
    lines[np.abs(frequency - near) > 0.1 * near] = 0.0
    inside = np.argmax(lines)
    assert lines[inside] > max(lines[inside - 1], lines[inside + 1]), "no peak, but an edge"
    return float(frequency[inside])


@pytest.mark.slow
def test_a_floor_adds_the_modes_of_two_masses_on_two_springs() -> None:
    # T = (m + M) w'^2 / 2 + S w' h' + M_h h'^2 / 2,  U = k w^2 / 2 + K_h h^2 / 2.
    floor = Spring(stiffness=3.2e7, mass=2000.0)
    heave, mass, momentum, total, spring = in_heave(floor=floor)
    masses = np.array([[floor.mass + total, momentum], [momentum, mass]])
    squares = linalg.eigh(np.diag([floor.stiffness, spring]), masses, eigvals_only=True)
    for expected in np.sqrt(squares) / (2.0 * np.pi):
        assert peak(heave, expected) == pytest.approx(expected, rel=0.01)


def test_a_floor_here_moves_pressures_as_there() -> None:
    """Within 2 % of what the floor does to them."""
    plant, valves = foreign.data_sheet(), np.zeros((512, 6))
    valves[20:60], valves[60:100] = 0.03, -0.03
    valves[200:240] = 0.03 * np.array([1.0, 1.0, -0.5, -0.5, -0.5, -0.5])
    there = Spring(stiffness=3.2e7, damping=1.5e4, mass=2000.0)
    whole = float(plant.model.body_mass.sum()) + there.mass
    ratio = there.damping / (2.0 * np.sqrt(there.stiffness * whole))
    floored = on_floor(plant, Floor(there.mass, there.stiffness, ratio))
    source = ValveCommands(valves)
    ours = [
        Run(plant=one, electronics=None, law=None, source=source, command_delay=0).record()
        for one in (plant, floored)
    ]
    theirs = [
        Machine(plant, floor=one).run(valves, 1.0 / 2048.0).pressure[:-1] for one in (None, there)
    ]
    for channel, name in enumerate(("cap_pressure", "rod_pressure")):
        moved = np.std((theirs[1] - theirs[0])[..., channel])
        assert moved > 10.0 * np.std(ours[0][name] - theirs[0][..., channel])
        assert np.std(ours[1][name] - theirs[1][..., channel]) < 0.02 * moved


@pytest.mark.slow
def test_mounts_are_springs_in_series_with_the_oil() -> None:
    # Of a leg with mounts k, u the way of the barrel m, s that of the piston: T = M (u + s)'^2 / 2
    # + m u'^2 / 2, U = k u^2 / 2 + K s^2 / 2, in heave the sum of six such legs.
    mounts = Spring(stiffness=2e7)
    heave, mass, _, _, spring = in_heave(mounts=mounts)
    legs = pose_jacobian(np.zeros(6), Hexapod(machine="lab").machine)[:, 2]
    share = float(legs @ legs)
    masses = np.array([[mass / share + 14.0, mass / share], [mass / share, mass / share]])
    springs = np.diag([mounts.stiffness, spring / share])
    expected = np.sqrt(linalg.eigh(springs, masses, eigvals_only=True)[0]) / (2.0 * np.pi)
    assert expected < 0.9 * np.sqrt(spring / mass) / (2.0 * np.pi)
    assert peak(heave, expected) == pytest.approx(expected, rel=0.01)


def test_nothing_passes_within_the_overlap(circuit: Circuit) -> None:
    still, middle = np.zeros(1), np.full((2, 1), 0.5 * circuit.supply)
    lapped = circuit._replace(overlap=0.02)
    for opening, left in ((0.015, 0.0), (-0.02, 0.0), (0.05, 0.03), (-0.05, -0.03)):
        rate = lapped.rates(middle, still, still, np.array([opening]))
        expected = circuit.rates(middle, still, still, np.array([left]))
        np.testing.assert_allclose(rate, expected, rtol=1e-12)


@pytest.mark.parametrize("kind", ("", "friction", "seal", "valve gain"))
def test_a_closed_loop_is_recorded_as_ours(kind: str) -> None:
    """Through the same sensors and law the engines part by less than 0.2 % of what moves.

    So they do with numbers moved that move pressures by 0.8 % and more.
    """
    plant = foreign.data_sheet()
    chosen = [one for one in numbers_of(plant) if kind and one.name.startswith(kind)]
    moved = {one: 2.0 for one in chosen if one.name[-1] not in "25"}
    plant = moved_machine(plant, ElectronicsSettings(), moved)["plant"]
    time = np.arange(1024) / 2048.0
    poses = np.zeros((1024, 6))
    poses[:, 0] = 0.01 * np.sin(4.0 * np.pi * time) ** 3
    how = {"electronics": "noisy", "record_every": 8}
    run = Run(plant=plant, law="original", source=poses, **how)
    ours, theirs = run.record(), recorded(run, Machine(plant))
    np.testing.assert_array_equal(theirs["leg_reference"], ours["leg_reference"])
    for name in ("leg_position", "cap_pressure", "rod_pressure"):
        apart = theirs[name] - ours[name]
        assert np.std(apart) < 2e-3 * np.std(ours[name] - ours[name].mean(axis=0)), name
    np.testing.assert_allclose(theirs["valve_command"], ours["valve_command"], atol=0.002)
    step = np.diff(np.unique(ours["leg_position"])).min()
    assert np.ptp(ours["leg_position"]) > 500.0 * step, "coarse sensors would hide a difference"


def test_a_hidden_machine_has_the_true_numbers() -> None:
    sheet, plant = foreign.data_sheet(), foreign.hidden(foreign.LACKING["overlap"])
    assert plant.parameters.overlap.si == pytest.approx(0.02)
    speed = plant.parameters.leg_speed.si / sheet.parameters.leg_speed.si
    mass = plant.cab_parameters.mass.si / sheet.cab_parameters.mass.si
    truth = foreign.TRUTH["leg_speed"], foreign.TRUTH["mass"]
    assert (speed, mass) == pytest.approx(truth)


def test_machines_with_what_the_model_lacks_are_doubted_by_name() -> None:
    """As docs/data says of recordings of this engine: `tests/crosscheck/foreign.py`."""
    rows = {row["lacking"]: row for row in data_rows("foreign_machines")}
    assert rows.pop("none")["explained"] == "yes"
    named = {
        "floor": "a floor that yields",
        "legs": "legs that yield",
        "overlap": "valve overlap",
    }
    assert rows.keys() == named.keys()
    for lacking, row in rows.items():
        assert row["explained"] == "no"
        assert row["gains"].startswith(named[lacking])
        inside, _, numbers = row["held"].partition(" of ")
        assert int(inside) > 0.8 * int(numbers)


def test_changes_are_found_and_named_rightly() -> None:
    """As docs/data says of recordings of this engine: `tests/crosscheck/foreign_guides.py`."""
    rows = data_rows("foreign_guides")
    assert all((row["found"] == "True") == bool(row["changed"]) for row in rows)
    changes = [row for row in rows if row["changed"]]
    assert sum(row["named"] == row["changed"] for row in changes) > 0.8 * len(changes)


def test_what_changes_on_the_way_is_recorded() -> None:
    """A scenario's motion that begins later: the demand is that of the simulation, bit for bit."""
    sine = {"kind": "sine", "dof": "heave", "amplitude": 0.01, "frequency": 10.0, "cycles": 1}
    run = Run(
        plant=foreign.data_sheet(),
        law="original",
        change=as_plain([{"at": 0.02, "fade": 0.0, "signal": [sine]}]),
        duration=0.125,
    )
    theirs = recorded(run, Machine(run.plant))
    assert np.ptp(theirs["leg_reference"]) > 0.005
    np.testing.assert_array_equal(theirs["leg_reference"], run.record()["leg_reference"])


def test_matched_ports_give_the_leg_speed_at_half_the_supply(circuit: Circuit) -> None:
    # 0.28 in/s per per cent with 750 psi across each port: nothing is left to raise a pressure.
    middle = np.full((2, 1), 750.0 * units.PSI)
    for share in (-0.4, 0.1, 1.0):
        speed = np.array([100.0 * share * 0.28 * units.INCH])
        rate = circuit.rates(middle, np.array([0.3]), speed, np.array([share]))
        closed = circuit.rates(middle, np.array([0.3]), speed, np.array([0.0]))
        assert (np.abs(rate) < 1e-9 * np.abs(closed)).all()


def test_a_held_leg_relaxes_at_the_leak_rate(circuit: Circuit) -> None:
    # dF/dt = -lambda dF for the force of a small displacement at neutral, 1.614 1/s.
    stiffness = circuit.bulk_modulus / circuit.half_stroke
    pressed = 1e-6 * stiffness * np.array([[-1.0], [1.0]])
    middle = 0.5 * circuit.supply
    still = np.zeros(1)
    rate = circuit.rates(middle + pressed, still, still, still)
    assert circuit.forces(rate) / circuit.forces(pressed) == pytest.approx(-1.614, rel=2e-3)


def test_spools_are_the_exact_answer_of_two_lags(circuit: Circuit) -> None:
    # Step answer of a b / ((s + a)(s + b)).
    a, b = 3.0 * units.HERTZ, 75.0 * units.HERTZ
    drive, spools = np.zeros(6), [np.zeros((1, 6))]
    for _ in range(100):
        drive, rows = circuit.spools(drive, spools[-1][-1], np.full(6, 0.5), 4)
        spools.append(rows)
    time = np.arange(401) / (4 * 2048)
    answer = 0.5 * (1.0 - (b * np.exp(-a * time) - a * np.exp(-b * time)) / (b - a))
    expected = np.tile(answer[:, None], 6)
    np.testing.assert_allclose(np.concatenate(spools), expected, rtol=0.0, atol=1e-13)


def test_losses_bad_steps_and_torn_chambers_are_refused(circuit: Circuit) -> None:
    with pytest.raises(ValueError, match="'hardware' must have a constant supply"):
        Machine(Hexapod("gfd", "hardware"))
    report = load_hydraulics("report")
    biased = report.null_bias.model_copy(update={"value": 1.0})
    with pytest.raises(ValueError, match="null_bias: 1 % must be 0"):
        make_circuit(report.model_copy(update={"null_bias": biased}))
    machine = Machine(Hexapod("gfd", "report"))
    with pytest.raises(ValueError, match="step: 0.0003 s must be 1/2048 s over a whole number"):
        machine.run(np.zeros((4, 6)), 3e-4)
    with pytest.raises(ValueError, match="falls to -5 Pa"):
        circuit.check(np.full((1, 6, 2), -5.0), np.zeros((1, 6)))
    with pytest.raises(ValueError, match="reaches 0.9500 m"):
        circuit.check(np.ones((1, 6, 2)), np.full((1, 6), 0.95))


def test_without_exudyn_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "exudyn", None)
    with pytest.raises(ImportError, match=r"cmf-mj\[verification\]"):
        Machine(Hexapod("gfd", "report"))


def test_the_script_writes_table_data_and_figure(
    tmp_path: Path,
    drawn: dict[str, set[str]],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    options = ["--seconds", "0.02", "--finest", "4", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", ["crosscheck", *options])
    runpy.run_path(str(SCRIPT), run_name="__main__")
    assert "leg error [um]" in capsys.readouterr().out
    rows = rows_of(tmp_path / "work_precision.csv")
    assert [(row["engine"], round(1.0 / float(row["step_s"]))) for row in rows] == [
        (engine, parts * 2048) for engine in ("mujoco", "exudyn") for parts in (1, 2, 4)
    ]
    assert (tmp_path / "work_precision.md").read_text().count("\n|") == 8
    assert set(drawn) == {"work_precision.png"}
    monkeypatch.setattr(sys, "argv", ["crosscheck", "--finest", "6"])
    with pytest.raises(SystemExit, match="2"):
        runpy.run_path(str(SCRIPT), run_name="__main__")
    assert "finest: 6 must be a power of two" in capsys.readouterr().err
