"""Flows of one actuator and their slopes, and what a valve closed on average does to a signal.

The flows are those of `cmf_mj.plant`: orifices behind hoses, piston and bearing leakage, without
cushions.
The slope of a port's flow with the opening differs for opening one way or the other,

    dq_cap / de = k A_cap phi(Ps - p_cap)  (e > 0),    k A_cap phi(p_cap - Pt)  (e < 0)

**Describing function of a closed valve.** The flow into a chamber has a kink at the closed valve,
q = s+ e for e > 0 and s- e for e < 0, whatever the amplitude. To a signal e of mean m it answers
with the gain

    f s+ + (1 - f) s-,    f = P(e > 0)                                     Gaussian e
                          f = 1/2 + (asin r + r sqrt(1 - r^2)) / pi        e = U (r + sin)

(Bussgang's theorem; the fundamental). The mean is not free. A leg that goes nowhere must neither
gather nor lose oil on average; with S the slope of the flows into both chambers together,

    S+ <e+> = S- <e->

so that the valve is open longer, or further, to the side where it changes the oil less. A mean of
the slopes with f = 1/2 would have the leg drift; at 610 psi of 1500 the share is 0.41.
"""

from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special

from cmf_mj.core.errors import InputError, check_name
from cmf_mj.plant.hydraulics import Hydraulics
from cmf_mj.plant.valve import opening, orifice

Excitation = Literal["noise", "sine", "mean"]
"""Signal at the valves: Gaussian (nearly a multisine), or one sine; `mean` is f = 1/2."""

_LARGEST_MEAN = 8.0  #: Over the standard deviation, in the search for the mean of the signal.


def outward_share(ratio: float, excitation: Excitation = "noise") -> float:
    """Share f of the slopes to e > 0, for `ratio` = <e+> / <e-> = S- / S+, greater than 0.

    It is 0 or 1 for ratios that a mean of eight deviations does not reach.
    """
    if not 0.0 < ratio < np.inf:
        raise InputError(f"ratio: {ratio} must be greater than 0 and finite")
    check_name("excitation", excitation, get_args(Excitation))
    if excitation == "mean":
        return 0.5
    if excitation == "sine":
        mean = optimize.brentq(lambda r: _sine_part(r) - ratio * _sine_part(-r), -1.0, 1.0)
        return float(0.5 + (np.arcsin(mean) + mean * np.sqrt(1.0 - mean**2)) / np.pi)

    def surplus(mean: float) -> float:
        return _normal_part(mean) - ratio * _normal_part(-mean)

    if surplus(-_LARGEST_MEAN) > 0.0 or surplus(_LARGEST_MEAN) < 0.0:
        return float(ratio > 1.0)
    return float(special.ndtr(optimize.brentq(surplus, -_LARGEST_MEAN, _LARGEST_MEAN)))


def _normal_part(mean: float) -> float:
    """<max(e, 0)> of a Gaussian e of unit variance."""
    return float(np.exp(-0.5 * mean**2) / np.sqrt(2.0 * np.pi) + mean * special.ndtr(mean))


def _sine_part(mean: float) -> float:
    """Pi <max(e, 0)> of e = mean + sin."""
    return float(np.sqrt(1.0 - mean**2) + mean * (0.5 * np.pi + np.arcsin(mean)))


CAP, ROD, DRAWN, RETURNED = range(4)  #: Rows: flows into chambers, from supply, to return.
HIGH, LOW = 2, 3  #: Columns of pressure slopes: cap, rod, supply and return manifold.

Matrix = NDArray[np.float64]


class Slopes(NamedTuple):
    """Flows of an actuator [m^3/s] and their slopes, rows as `CAP` to `RETURNED`."""

    flow: Matrix  #: (4,).
    pressure: Matrix  #: With the pressures of cap, rod, supply and return [m^3/s/Pa], (4, 4).
    opening: Matrix  #: With the openings of both valves [m^3/s], (4, 2).


class PathFlow(NamedTuple):
    """Flow through an orifice behind a hose."""

    flow: float
    by_drop: float  #: Slope with the pressure drop.
    by_gain: float  #: Slope with the orifice's gain.


def path_flow(gain: float, hose: float, laminar: float, drop: float) -> PathFlow:
    """Flow q = G phi(dp; s + R G) and its slopes; phi falls by phi / root with s + R G."""
    resistance = laminar + hose * gain
    phi, slope = orifice(drop, resistance)
    root = np.sqrt(resistance**2 + 4.0 * abs(drop))
    return PathFlow(gain * phi, gain * slope, phi * (1.0 - hose * gain / root))


def port_slopes(
    hydraulics: Hydraulics, leg: int, spools: Matrix, pressures: Matrix, outward: float = 0.5
) -> Slopes:
    """Flows and slopes of one actuator.

    `spools` are the positions of its two spools, fractions, (2,), `pressures` those of cap, rod,
    supply and return [Pa], (4,), `outward` is the `outward_share` of a closed valve.
    """
    cylinder, valves = hydraulics.cylinder[leg], hydraulics.valve[leg]
    # Gains of the four paths, cap in, cap out, rod in, rod out, and their slopes with the openings.
    gains, gain_slopes = np.zeros(4), np.zeros((4, 2))
    for index, spool in enumerate(spools):
        valve, spool_opening = valves[index], opening(valves[index], spool)
        outward_gains = np.array([valve.cap_gain, 0.0, 0.0, valve.rod_gain])
        inward_gains = np.array([0.0, valve.cap_gain, valve.rod_gain, 0.0])
        gains += max(spool_opening, 0.0) * outward_gains + max(-spool_opening, 0.0) * inward_gains
        share = outward if spool_opening == 0.0 else float(spool_opening > 0.0)
        gain_slopes[:, index] = share * outward_gains - (1.0 - share) * inward_gains
    cap, rod, high, low = pressures
    laminar, throttle = hydraulics.laminar, cylinder.cap_throttle
    supply_hose, return_hose = cylinder.supply_hose, cylinder.return_hose
    paths = (
        path_flow(gains[0], supply_hose + throttle, laminar, high - cap),
        path_flow(gains[1], return_hose + throttle, laminar, cap - low),
        path_flow(gains[2], supply_hose, laminar, high - rod),
        path_flow(gains[3], return_hose, laminar, rod - low),
    )
    # What each path, and each of the two leakages, adds to the rows; drops by pressures.
    to_rows = np.array([[1, -1, 0, 0], [0, 0, 1, -1], [1, 0, 1, 0], [0, 1, 0, 1]], dtype=float)
    drops = np.array([[-1, 0, 1, 0], [1, 0, 0, -1], [0, -1, 1, 0], [0, 1, 0, -1]], dtype=float)
    leak_to_rows = np.array([[-1.0, 1.0, 0.0, 0.0], [0.0, -1.0, 0.0, 1.0]]).T
    leak_drops = np.array([[1.0, -1.0, 0.0, 0.0], [0.0, 1.0, 0.0, -1.0]])
    conductance = np.array([cylinder.leakage, cylinder.bearing_leakage])
    flows = np.array([path.flow for path in paths])
    by_drop, by_gain = (
        to_rows * np.array(slopes)
        for slopes in ([path.by_drop for path in paths], [path.by_gain for path in paths])
    )
    return Slopes(
        flow=to_rows @ flows + leak_to_rows @ (conductance * (leak_drops @ pressures)),
        pressure=by_drop @ drops + (leak_to_rows * conductance) @ leak_drops,
        opening=by_gain @ gain_slopes,
    )
