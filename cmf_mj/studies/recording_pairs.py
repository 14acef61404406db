"""Whether two histories of the legs belong together, and which one slip would mend them.

Expected e and measured m, both below f [Hz], belong together as m(t) = g e(t - d): d is where their
velocities correlate best, g a least-squares gain of what moves. Of the slips, such as two legs
exchanged, the one whose mending has the least

    sum over the legs of ln(r + r0),  r = rms(m - g e),  plus a price for the slip

is taken; the price is that of two legs fitting half as badly, so that noise and dynamics make none.
Histories are (N, 6), NaN for legs that were not recorded.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import shift as shifted
from scipy.signal import butter, csd, sosfiltfilt, welch

from cmf_mj.core.units import factor
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.machine.machine import Machine
from cmf_mj.record.sources import runs

Array = NDArray[np.float64]
Slip = tuple[str, Array, Array]  #: What is wrong, in words; expected and measured without it.

LENGTHS = {name: factor(name) for name in ("m", "ft", "in", "mm", "cm")}
PRESSURES_IN = {name: factor(name) for name in ("Pa", "psi", "bar", "kPa", "MPa")}

_PRICE = 2.0 * np.log(2.0)
_CORNERS = (1.0, 2.0, 4.0, 8.0)  #: f [Hz]: the first that keeps a third of what moves.
_LONGEST = 2.0  #: Largest delay that is looked for [s].
_LINES = 4  #: Least lines that both halves drive.
_MOVES = 4.0  #: Motion, in r0, from which on something moves.
_STILL = 1e-9  #: Motion that is rounding.
_CREEP = 1e-3  #: Speed from which on a leg moves [m/s].
_CLIPS, _FLAT = 2, 4  #: Runs at the limit, and samples of a run, from which a sensor is clipped.
_TINY = 1e-300  #: Added to what is divided by.


class Agreement(NamedTuple):
    """How two histories belong together."""

    slip: str  #: What is wrong, in words; empty if nothing is.
    delay: float  #: d [s], NaN where nothing moves.
    cost: float  #: The sum above.
    gain: float  #: g, NaN where nothing moves.
    left: float  #: Share of what moves that is not explained, before any mending.
    doubt: float = np.nan  #: Two deviations of d by what is not explained [s].


def agree(
    expected: Array,
    measured: Array,
    rate: float,
    floor: float,
    slips: Iterable[Slip] = (),
    *,
    rates: bool = False,
) -> Agreement | None:
    """Compare the legs that both histories have; None if there are none.

    `floor` is r0 in the unit of both. Where one moves, the other is asked for its part. `rates` are
    of one clock: d is 0, their means do not count, and both have to move.
    """
    legs = there(expected) & there(measured)
    if not legs.any():
        return None
    moving = measured[:, legs].std()
    kept = (f for f in _CORNERS if smooth(measured[:, legs], rate, f).std() > 0.33 * moving)
    corner = next(kept, _CORNERS[-1])
    every = max(1, int(rate / (10.0 * corner)))
    spacing = every / rate

    def below_corner(values: Array) -> Array:
        low = smooth(values[:, legs], rate, corner)[::every]
        return low - low.mean(axis=0) if rates else low

    moved = [below_corner(values).std(axis=0).max() for values in (expected, measured)]
    moves = bool((min if rates else max)(moved) > _MOVES * floor and min(moved) > _STILL)

    def fit(slip: str, expected: Array, measured: Array) -> Agreement:
        e, m = below_corner(expected), below_corner(measured)
        late = _delay(e, m, rate / every) if moves and not rates else 0.0
        e = shifted(e, (late, 0.0), order=1, mode="nearest")
        cost, gain, left = _fit(e, m, floor, moves)
        apart, speed = m - gain * e, abs(gain) * np.gradient(e, spacing, axis=0)
        sizes = (np.sqrt(one.var(axis=0).mean()) + _TINY for one in (apart, speed))
        doubt = float(2.0 * np.divide(*sizes) / np.sqrt(2.0 * corner * m.size * every / rate))
        return Agreement(slip, late * every / rate, cost, gain, left, doubt)

    base, mended = fit("", expected, measured), [fit(*slip) for slip in slips]
    best = min(mended, key=lambda one: one.cost, default=base)
    slip = " or ".join(one.slip for one in mended if one.cost < best.cost + 0.5 * _PRICE)
    if best.cost + _PRICE >= base.cost or best.left >= 0.5 * min(1.0, base.left):
        best, slip = base, ""
    known = best._replace(slip=slip, left=base.left)
    return known if moves else known._replace(delay=np.nan, gain=np.nan)


def there(values: Array) -> NDArray[np.bool_]:
    """Which legs were recorded, (6,)."""
    return np.asarray(~np.isnan(values).all(axis=0))


def smooth(values: Array, rate: float, corner: float) -> Array:
    """Below a corner [Hz], without delay, (N, n)."""
    if values.shape[0] < 30 or corner >= 0.4 * rate:
        return values
    sections = butter(4, corner, fs=rate, output="sos")
    pad = min(values.shape[0] - 1, int(3.0 * rate / corner))
    return np.asarray(sosfiltfilt(sections, values, axis=0, padlen=pad))


def _delay(expected: Array, measured: Array, rate: float) -> float:
    """Samples d where the velocities correlate best; of two as good the fewer."""
    size, fine = 2 * expected.shape[0], 32
    e, m = (np.fft.rfft(np.diff(v, axis=0), size, axis=0) for v in (expected, measured))
    found = np.fft.irfft((e.conj() * m).sum(axis=1), size * fine)
    most = int(min(_LONGEST * rate, 0.25 * expected.shape[0]) * fine)
    near = np.concatenate([found[-most:], found[: most + 1]])
    if -near.min() > 1.5 * near.max():  # all legs have the other sign
        near = -near
    high = near >= np.maximum(np.maximum(np.roll(near, 1), np.roll(near, -1)), 0.97 * near.max())
    peaks = np.flatnonzero(high) - most
    return float(peaks[np.abs(peaks).argmin()]) / fine if peaks.size else 0.0


def _fit(e: Array, m: Array, floor: float, moves: bool) -> tuple[float, float, float]:
    """Cost, gain, and the share not explained, without the ends.

    About the mean legs move by the gain. The mean is met where the gain is that of a loop, which
    meets a pose that is held; else it has the gain too.
    """
    ends = e.shape[0] // 50
    e, m = e[ends : e.shape[0] - ends], m[ends : e.shape[0] - ends]
    mean = e.mean(axis=0)
    e_about, m_about = e - mean, m - m.mean(axis=0)
    gain = float((e_about * m_about).sum()) / float((e_about**2).sum()) if moves else 1.0
    loop = 0.5 < abs(gain) < 2.0
    apart = m - gain * (e_about if loop else e) - loop * np.sign(gain) * mean
    rms, whole = np.sqrt((apart**2).mean(axis=0)), np.sqrt(((m_about if moves else m) ** 2).mean())
    left = float(np.sqrt((apart**2).mean()) / (whole if moves else max(whole, floor)))
    return float(np.log(rms + floor).sum()), gain, left


def _exchanged(values: Array) -> Iterator[tuple[str, list[int]]]:
    """Each two of the recorded legs, and the order of legs that exchanges them."""
    for i, j in combinations(np.flatnonzero(there(values)).tolist(), 2):
        order = [*range(values.shape[1])]
        order[i], order[j] = j, i
        yield f"legs {i + 1} and {j + 1} are exchanged", order


def swaps(expected: Array, measured: Array) -> Iterator[Slip]:
    """Two measured legs exchanged, or one with the other sign."""
    for said, order in _exchanged(measured):
        yield said, expected, measured[:, order]
    for leg in np.flatnonzero(there(measured)):
        sign = np.where(np.arange(measured.shape[1]) == leg, -1.0, 1.0)
        yield f"leg {leg + 1} has the other sign", expected, measured * sign


def pose_slips(pose: Array, measured: Array, machine: Machine) -> Iterator[Slip]:
    """One slip in the pose [m, rad], (N, 6), that the expected legs come from."""
    turns, same = np.repeat([0.0, 1.0], 3), [0, 1, 2, 3, 4, 5]
    signs = zip(DOFS, 1.0 - 2.0 * np.eye(6), strict=True)
    slips = [
        *((f"{dof} has the other sign", sign, same) for dof, sign in signs),
        ("the pose is z up", np.array([1.0, -1, -1, 1, -1, -1]), same),
        ("surge and sway are exchanged", np.ones(6), [1, 0, 2, 3, 4, 5]),
        ("roll and pitch are exchanged", np.ones(6), [0, 1, 2, 4, 3, 5]),
    ]
    others = [("lengths", "m", name, 1.0 - turns) for name in LENGTHS if name != "m"]
    for what, si, name, on in (*others, ("angles", "rad", "deg", turns)):
        size = factor(name) ** on
        slips += [(f"its {what} are in {name} where the map says {si}", size, same)]
        slips += [(f"its {what} are in {si} where the map says {name}", 1.0 / size, same)]
    for said, size, order in slips:
        yield said, pose_to_legs(pose[:, order] * size, machine), measured


def pressure_slips(cap: Array, rod: Array, areas: Array) -> Iterator[tuple[str, Array]]:
    """Forces without one slip in the pressures [Pa]; `areas` of cap and rod, (2, 6)."""
    yield "cap and rod are exchanged", areas[0] * rod - areas[1] * cap
    push, pull = areas[0] * cap, areas[1] * rod
    for said, order in _exchanged(push - pull):
        p, q = areas[0] * cap[:, order], areas[1] * rod[:, order]
        yield f"cap_pressure of {said}", p - pull
        yield f"rod_pressure of {said}", push - q
        yield f"both pressures of {said}", p - q


def last_way(rates: Array) -> Array:
    """Which way each leg moves or moved last by its rate [m/s], (N, 6): 1, -1, 0 before it does."""
    moves = np.abs(rates) > _CREEP
    rows = np.where(moves, np.arange(len(rates))[:, None], 0)
    return np.take_along_axis(np.sign(rates) * moves, np.maximum.accumulate(rows), axis=0)


def borne(
    parts: Array, force: Array, slips: Iterable[tuple[str, Array]]
) -> tuple[Agreement, list[str]]:
    """Whether forces (N, 6) are sums of parts (N, 6, k), and which slip's mending makes them so.

    Of n forces what k unknown factors leave has the share e of all, and a hundredth is added, for
    sensors. A slip is named, that which leaves least, e', where

        ln e / e' > max(ln 1.4, 8 / n'),  n' = n (1 - r) / (1 + r)

    with r the correlation of what is left from sample to sample, so that n' forces say something
    new, and 8 for the odds of 46 slips. The second value has the exchanges that it would not name.
    """
    legs = there(force)
    rows = parts[:, legs].reshape(-1, parts.shape[2])
    sides, sizes, _ = np.linalg.svd(rows / (np.linalg.norm(rows, axis=0) + _TINY), False)
    sides = sides[:, sizes > 1e-3 * sizes[0]]
    whole = float(np.linalg.norm(force[:, legs])) + _TINY

    def left(values: Array) -> tuple[float, float]:
        """Share, and that of what a better slip may leave."""
        column = values[:, legs].ravel()
        e = np.asarray(column - sides @ (sides.T @ column)).reshape(-1, legs.sum()) + 1e-9
        again = float((e[1:] * e[:-1]).sum() / (e**2).sum())
        new = max((e.size - e.shape[1]) * (1.0 - again) / (1.0 + again), 0.1)
        share = float(np.linalg.norm(e)) / whole + 0.01
        return share, share * float(np.exp(-max(np.log(1.4), 8.0 / new)))

    ways = {said: left(one) for said, one in (("", force), *slips)}
    (own, below), least = ways[""], min(share for share, _ in ways.values())
    named = [said for said, (share, _) in ways.items() if share < 1.2 * least]
    slip = " or ".join(named) if least < below else ""
    alike = [said for said, (_, other) in ways.items() if "legs" in said and own > other]
    return Agreement(slip, np.nan, own, np.nan, own - 0.01), alike


def slipped(gain: float, sizes: Mapping[str, float]) -> str:
    """What a gain says that no machine has: a unit that is another."""
    if not np.isfinite(gain) or 0.4 < gain < 2.0:
        return ""
    if gain < 0.0:
        return "all legs have the other sign"
    likely = mistaken(sizes, lambda factor: abs(np.log(gain * factor)) < 0.12)
    return f"is {gain:.3g} of what is expected: {likely or 'its scale is another'}"


def mistaken(sizes: Mapping[str, float], mends: Callable[[float], bool], stated: str = "") -> str:
    """Units for others, the map's where `stated`, by whose factor a channel would be right."""
    return " or ".join(
        f"the file has {one} where the map says {other}"
        for one, other in permutations(sizes, 2)
        if mends(sizes[one] / sizes[other]) and stated in ("", other)
    )


def halves(expected: Array, measured: Array, rate: float) -> tuple[float, float] | None:
    """Change of the response from half to half, and its error by the noise.

    Medians over the lines that both drive; None where they drive other lines or motions.
    """
    legs, middle = there(expected) & there(measured), expected.shape[0] // 2
    size = int(max(2.0, expected.shape[0] / rate / 12.0) * rate)
    parts = (middle - size) // (size // 2) + 1
    if parts < 3:
        return None
    how = {"fs": rate, "nperseg": size, "detrend": False, "axis": 0}
    found, axes = [], []
    for half in (slice(0, middle), slice(middle, 2 * middle)):
        e, m = (np.gradient(v[half, legs], axis=0) for v in (expected, measured))
        lines, sxx = welch(e, **how)
        spectra = (sxx, welch(m, **how)[1], csd(e, m, **how)[1])
        used = (lines > 1.5 / (size / rate)) & (lines < min(10.0, 0.3 * rate))
        sxx, syy, sxy = (one[used].sum(axis=1) + _TINY for one in spectra)
        found.append((sxx.real, sxy / sxx, np.abs(sxy) ** 2 / (sxx * syy) + 1e-12))
        axes.append(e.T @ e / (np.linalg.norm(e.T @ e) + _TINY))
    (p1, h1, c1), (p2, h2, c2) = found
    good = (np.minimum(p1 / p1.max(), p2 / p2.max()) > 0.01) & (np.minimum(c1, c2) > 0.8)
    good &= (p1 < 9.0 * p2) & (p2 < 9.0 * p1)
    if good.sum() < _LINES or float((axes[0] * axes[1]).sum()) < 0.9:
        return None
    error = np.sqrt((1.0 / c1 + 1.0 / c2 - 2.0) / parts)
    change = 2.0 * np.abs(h1 - h2) / (np.abs(h1) + np.abs(h2))
    return float(np.median(change[good])), float(np.median(error[good]))


def clipped(values: Array, step: float) -> tuple[float, int] | None:
    """The limit at which a column stays while it comes and goes at speed, and the samples there."""
    for limit in (np.nanmax(values), np.nanmin(values)):
        found = []
        for first, end in runs(values == limit):
            if end - first >= _FLAT and first >= 2 and end + 2 <= values.size:
                slopes = (values[first - 2] - limit, values[end + 1] - limit)
                # A parabola through its quantised peak comes in at 4 steps over the run's samples.
                over = 0.5 * min(abs(s) for s in slopes) * (end - first) / 4.0
                if over > 4.0 * step and over > 0.02 * np.nanstd(values):
                    found.append(end - first)
        if len(found) >= _CLIPS:
            return float(limit), int(sum(found))
    return None


def stuck(values: Array, leg: int, rate: float) -> tuple[int, int] | None:
    """Longest run of one value of a leg, in histories (N, 6), in which most other legs move."""
    still = runs(np.append(np.diff(values[:, leg]) == 0.0, False))
    first, end = max(still, key=lambda run: run[1] - run[0], default=(0, 0))
    others = np.delete(values, leg, axis=1)[:, np.delete(there(values), leg)]
    if not max(0.5 * rate, 20) <= end - first < 0.98 * len(values) or others.shape[1] < 2:
        return None
    moved = np.nanstd(others[first : end + 1], axis=0) / (np.nanstd(others, axis=0) + _TINY)
    return (first, end + 1) if np.median(moved) > 0.3 else None
