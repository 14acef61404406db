"""Full-scale noise on every valve, drives into the stops, and the errors beyond the bounds."""

from functools import cache

import numpy as np
import pytest
from hydraulic_equations import changed, leakage, port_flows
from scipy import optimize

from cmf_mj import Hexapod, Record, SingleLegs
from cmf_mj.facility.simulate import drive
from cmf_mj.plant.hydraulics import ENERGIES
from cmf_mj.plant.parameters import HydraulicParameters
from cmf_mj.plant.plant import Plant

PLANTS = {"hexapod": Hexapod, "single_legs": SingleLegs}
HALF = 38 * 0.0254
VACUUM = -101325.0


@cache
def plant_of(kind: str, hydraulics: str) -> Plant:
    return PLANTS[kind](hydraulics=hydraulics)


def noise(seed: int, hold: int, frames: int = 10_000) -> np.ndarray:
    """Full-scale commands on six valves: +-1 or evenly spread, each held for some frames."""
    rng = np.random.default_rng(seed)
    drawn = rng.uniform(-1.0, 1.0, (-(-frames // hold), 6))
    if seed % 2:
        drawn = np.sign(drawn)
    return np.repeat(drawn, hold, axis=0)[:frames]


def check(record: Record, proof: float) -> None:
    for name, values in record.channels.items():
        assert np.isfinite(values).all(), name
    pressures = np.stack([record["cap_pressure"], record["rod_pressure"]])
    assert pressures.min() > VACUUM
    assert pressures.max() < proof
    assert record["return_pressure"].min() > VACUUM
    assert np.abs(record["leg_extension"]).max() < HALF + 0.05
    assert np.abs(record["leg_velocity"]).max() < 3.0  # runs away nowhere: full speed is 0.9 m/s


@pytest.mark.parametrize(
    "chunk", [pytest.param(c, marks=pytest.mark.slow) if c > 2 else c for c in range(20)]
)
def test_noise_keeps_the_state_within_its_bounds(chunk: int) -> None:
    """200 seeds of 10 000 frames, held 1, 20 or 200 frames, on both plants, with and without
    losses. Every frame is checked by the run itself, every 4th here."""
    for seed in range(10 * chunk, 10 * chunk + 10):
        hold = (1, 20, 200)[seed % 3]
        sets = ("hardware", "lossy") if seed // 3 % 2 else ("lossy", "hardware")
        for kind, hydraulics in zip(PLANTS, sets, strict=True):
            machine = plant_of(kind, hydraulics)
            record = drive(machine, noise(seed, hold), record_every=4)
            check(record, machine.parameters.proof_pressure.si)
            assert np.ptp(record["leg_extension"]) > 0.01


# Stops


@pytest.mark.parametrize("kind", sorted(PLANTS))
@pytest.mark.parametrize("hydraulics", ["report", "hardware", "lossy"])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_drive_into_the_stops_ends_there(kind: str, hydraulics: str, sign: float) -> None:
    """8 s of full opening: pressures stay below proof, each rebound is smaller than the one before,
    and in the end all stand at the stops with the pressure of the ports, at rest."""
    machine = PLANTS[kind](hydraulics=hydraulics)
    record = drive(machine, np.full((8 * 2048, 6), sign), record_every=1)
    check(record, machine.parameters.proof_pressure.si)
    x = record["leg_extension"] * sign
    met = int(np.argmax(x.max(axis=1) > HALF - 0.1))
    assert met > 0
    swings = [np.ptp(x[met + k * 2048 : met + (k + 1) * 2048], axis=0).max() for k in (1, 2, 3)]
    assert swings[2] < 0.01
    assert swings[2] <= swings[1] + 1e-6
    assert np.abs(x[-1] - HALF).max() < 0.01
    assert np.abs(record["leg_velocity"][-512:]).max() < 2e-3
    fed, opposite = ("cap", "rod") if sign > 0 else ("rod", "cap")
    supply = record["supply_pressure"][-1]
    assert np.abs(record[f"{fed}_pressure"][-1] / supply - 1.0).max() < 0.03
    # The other chamber passes the leakage out through valve and cushion.
    p, low = machine.parameters, record["return_pressure"][-1]
    for leg in range(6):
        high = record[f"{fed}_pressure"][-1, leg]
        at = record["leg_extension"][-1, leg]

        def excess(q: float, high: float = high, at: float = at) -> float:
            pair = (high, q) if sign > 0 else (q, high)
            out = port_flows(p, 0.999 * sign, *pair, at, supply, low)[1 if sign > 0 else 0]
            bearing = p.bearing_leakage.si * (q - low) if sign > 0 else 0.0
            return leakage(p) * (high - q) - bearing + out

        expected = optimize.brentq(excess, low, high)
        assert record[f"{opposite}_pressure"][-1, leg] == pytest.approx(expected, rel=3e-2, abs=1e4)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_cushions_soften_the_stop(sign: float) -> None:
    """A single leg meets its stop at less than half the speed, without bounce."""
    speeds = {}
    for length in (0.0, 3.0):
        machine = SingleLegs(changed("hardware", cushion_length=length))
        record = drive(machine, np.full((5 * 2048, 6), sign))
        x = record["leg_extension"][:, 0] * sign
        met = int(np.argmax(x > HALF - 1e-3))
        assert met > 0
        speeds[length] = abs(record["leg_velocity"][met, 0])
        check(record, machine.parameters.proof_pressure.si)
    assert speeds[3.0] < 0.5 * speeds[0.0]


def test_bouncing_on_the_stops_makes_no_energy() -> None:
    """Valves shut half-way into the stop and no leakage: energy of the rest of the run comes from
    nowhere, so the swing never grows. Work the pistons do back and forth ends as it began."""
    machine = SingleLegs(changed("hardware", leak_rate=0.0))
    frames = 6 * 2048
    commands = np.ones((frames, 6))
    commands[round(1.2 * 2048) :] = 0.0
    record = drive(machine, commands)
    x, late = record["leg_extension"][:, 0], round(2.2 * 2048)
    swings = [np.ptp(x[late + k * 1024 : late + (k + 1) * 1024]) for k in range(7)]
    assert all(
        after <= before * (1 + 1e-6) + 1e-9
        for before, after in zip(swings[:-1], swings[1:], strict=True)
    )
    given = record["energy"][late:, ENERGIES.index("valves")]
    assert np.ptp(given) < 1.0


# Errors


def left(hydraulics: HydraulicParameters, commands: np.ndarray) -> str:
    with pytest.raises(FloatingPointError) as caught:
        drive(Hexapod("gfd", hydraulics), commands)
    return str(caught.value)


def test_a_chamber_beyond_proof_pressure_names_leg_time_and_value() -> None:
    message = left(changed("hardware", proof_pressure=1700.0), noise(0, 200))
    assert message.startswith("hexapod: leg_")
    assert "beyond the proof pressure of 1.172e+07 Pa (cap " in message
    assert message.endswith(" s") and " at " in message


def test_a_chamber_below_vacuum_names_leg_time_and_value() -> None:
    """Without gas nothing keeps a chamber that is pulled open above vacuum."""
    commands = np.tile(np.sign(np.sin(np.arange(4 * 2048) / 260.0))[:, None], (1, 6))
    message = left(changed("hardware", cavitation_gas=0.0), commands)
    assert "hexapod: leg_" in message and "has a chamber below vacuum (cap " in message
    assert "cavitation_gas sets a floor" in message


def test_a_leg_beyond_its_stops_names_leg_time_and_value() -> None:
    """Stops taken off the machine: the model's, not the hydraulics'."""
    machine = SingleLegs()
    machine.model.jnt_limited[:] = 0
    with pytest.raises(FloatingPointError) as caught:
        drive(machine, np.tile([0, 0, 1.0, 0, 0, 0], (8 * 2048, 1)))
    message = str(caught.value)
    assert "single_legs: leg_3 is at 1.0" in message
    assert "beyond its stops at +-0.9652 m at " in message


def test_a_state_that_is_not_finite_names_leg_and_time() -> None:
    machine = SingleLegs()
    machine.neutral[4] = np.nan
    with pytest.raises((FloatingPointError, ValueError), match="leg_5|leg 5"):
        drive(machine, np.zeros((16, 6)))


@pytest.mark.parametrize(
    ("valves", "message"),
    [
        (np.zeros((4, 5)), r"valves: shape is \(4, 5\); allowed: \(N, 6\)"),
        (np.zeros((0, 6)), "valves: has no rows; allowed: at least one"),
        (np.full((4, 6), 1.5), "valves: 1.5 of leg 1 in row 0 is not between -1 and 1"),
        (np.full((4, 6), np.nan), r"valves\[0, 0\]: nan is not a finite number"),
    ],
)
def test_commands_out_of_range_are_refused(valves: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        drive(SingleLegs(), valves)
