"""Static checks: locked valves hold, leakage sinks the platform, loads short of stall move."""

import numpy as np
import pytest
from hydraulic_equations import areas, changed, leakage

from cmf_mj import Hexapod, SingleLegs
from cmf_mj.core import units
from cmf_mj.facility.simulate import drive

MINUTE = np.zeros((60 * 2048, 6))


def test_locked_valves_hold_the_heaviest_platform() -> None:
    """35 950 lbm, valves shut, no leakage: less than 1 micrometre in a minute; 0.02 um is met, the
    soft gimbals taking up the load."""
    record = drive(Hexapod("ifd", changed("hardware", leak_rate=0.0)), MINUTE, record_every=256)
    creep = np.abs(record["leg_extension"] - record["leg_extension"][0]).max()
    assert creep < 0.1e-6
    moved = np.abs(record["platform_pose"] - record["platform_pose"][0])
    assert moved.max() < 0.1e-6


def test_a_leaking_bearing_lifts_the_platform_until_the_rod_chamber_is_empty() -> None:
    """Tight pistons: the rod chamber drains through the bearing, the cap takes over its force.

    dp_cap = (Ar/Ac) dp_rod, and the cap's oil expands: the leg ends higher by
    h (p_start - p_end) / beta of the cap; on the way p_rod falls by exp(-t / T),
    T = (Ar h / (beta B)) (1 + Ar/Ac). Both to 2 %, with the legs' own loads.
    """
    p = changed("hardware", leak_rate=0.0, bearing_leakage=0.0007)
    machine = Hexapod("ifd", p)
    record = drive(machine, MINUTE[: 40 * 2048], record_every=64)
    cap_area, rod_area = areas(p)
    half, beta = p.half_stroke.si, p.bulk_modulus.si
    rod, cap = record["rod_pressure"], record["cap_pressure"]
    time_constant = rod_area * half / (beta * p.bearing_leakage.si) * (1 + rod_area / cap_area)
    for seconds in (1.0, 3.0):
        row = round(seconds * record.rate)
        expected = rod[0] * np.exp(-seconds / time_constant)
        np.testing.assert_allclose(rod[row], expected, rtol=3e-2)
    risen = record["leg_extension"][-1] - record["leg_extension"][0]
    final = machine.static_load() / cap_area
    np.testing.assert_allclose(cap[-1], final, rtol=2e-3)
    np.testing.assert_allclose(risen, half * (cap[0] - final) / beta, rtol=2e-2)
    assert (risen > 1e-3).all()


@pytest.mark.parametrize("kind", ["hexapod", "single_legs"])
@pytest.mark.parametrize("rate", [1.614, 15.0])
def test_leakage_of_piston_and_bearing_sinks_a_leg_at_the_computed_speed(
    kind: str, rate: float
) -> None:
    """Steadily, with piston leakage L and bearing leakage B, v downwards:

        Ac v = L (pc - pr),  Ar v = L (pc - pr) - B pr,  F = Ac pc - Ar pr
        v = B F / ((Ac - Ar)^2 + B Ac^2 / L)

    and B F / (Ac - Ar)^2 for a wide-open piston. 2 % is asked: flows count content, 0.6 %.
    """
    p = changed("hardware", leak_rate=rate, bearing_leakage=0.0007)
    machine = Hexapod("ifd", p) if kind == "hexapod" else SingleLegs(p)
    record = drive(machine, MINUTE[: 30 * 2048], record_every=64)
    cap_area, rod_area = areas(p)
    b = p.bearing_leakage.si
    first, last = round(10 * record.rate), record.time.size - 1
    x = record["leg_extension"]
    speed = (x[first] - x[last]) / (record.time[last] - record.time[first])
    load = 0.5 * (record["leg_force"][first] + record["leg_force"][last])
    expected = b * load / ((cap_area - rod_area) ** 2 + b * cap_area**2 / leakage(p))
    np.testing.assert_allclose(speed, expected, rtol=2e-2)
    assert (speed > 1e-5).all()


@pytest.mark.parametrize("load", [-0.9, -0.5, 0.2, 0.9])
def test_a_leg_moves_under_any_load_short_of_stall(load: float) -> None:
    """Stall force Ac Ps = 35 637 lbf pushing, Ar Ps = 17 948 lbf pulling: at 90 % of it the leg
    still extends (retracts), at a speed of the square root of what is left of the force.

    Both ports carry the same leg speed, so both have the drop d: d (Ac + Ar) is the force left, and
    v = leg_speed sqrt(d / (Ps / 2)). 1.5 %: laminar share, compression, the start.
    """
    p = changed("hardware", supply="constant", leak_rate=0.0)
    cap_area, rod_area = areas(p)
    supply = p.supply_pressure.si
    assert cap_area * supply / units.POUND_FORCE == pytest.approx(35637, rel=1e-4)
    assert rod_area * supply / units.POUND_FORCE == pytest.approx(17948, rel=1e-4)
    stall = cap_area * supply if load > 0 else rod_area * supply
    sign = 1.0 if load > 0 else -1.0
    machine = SingleLegs(p, static_load=load * stall)
    record = drive(machine, np.full((4096, 6), 0.3 * sign), record_every=16)
    x, t = record["leg_extension"][:, 0], record.time
    speed = sign * (x[-1] - x[-128]) / (t[-1] - t[-128])
    left = (stall - abs(load) * stall) / (cap_area + rod_area)
    expected = 0.3 * p.leg_speed.si * np.sqrt(left / (supply / 2))
    assert speed == pytest.approx(expected, rel=1.5e-2)
