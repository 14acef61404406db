"""Whether two histories of the legs belong together, and which one slip would mend them.

Expected e and measured m, both below f [Hz], belong together as m(t) = g e(t - d): d is where their
velocities correlate best, g a least-squares gain of what moves. Of the changes that a slip makes,
such as two legs exchanged, the one with the least

    sum over the legs of ln(r + r0),  r = rms(m - g e),  plus a price for the change

is taken; the price is that of two legs fitting half as badly, so that noise and dynamics make none.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from cmf_mj.core.units import factor
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import leg_jacobian, legs_to_pose, pose_to_legs
from cmf_mj.machine.machine import Machine
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.record.record import Record

Array = NDArray[np.float64]

Changes = Mapping[str, Callable[[], Array]]  #: What is wrong, in words, and the history without it.

_PRICE = 2.0 * np.log(2.0)
_CORNERS = (1.0, 2.0, 4.0, 8.0)  #: f [Hz]: the first that keeps a third of what moves.
_LONGEST = 2.0  #: Largest delay that is looked for [s].
_LINES = 4  #: Least lines that both halves drive.
_MOVES = 4.0  #: Motion, in r0, from which on something moves.


LENGTHS = {name: factor(name) for name in ("m", "ft", "in", "mm", "cm")}
PRESSURES_IN = {name: factor(name) for name in ("Pa", "psi", "bar", "kPa", "MPa")}
_SIGNS = 1.0 - 2.0 * np.eye(6)
_CLIPS, _FLAT = 2, 4  #: Runs at the limit, and samples of a run, from which a sensor is clipped.
"""Units by their size; signs of one axis reversed; runs and samples that make a clip."""


class Agreement(NamedTuple):
    """How two histories belong together."""

    slip: str  #: What is wrong, in words; empty if nothing is.
    delay: float  #: d [s], NaN where nothing moves.
    gain: float  #: g, NaN where nothing moves.
    left: float  #: Share of what moves that is not explained, before any change.
    unseen: tuple[str, ...]  #: Changes that would not have mattered.


class _Way(NamedTuple):
    """A change and how well histories agree with it."""

    said: str
    delay: float
    cost: float
    gain: float
    left: float


def smooth(values: Array, rate: float, corner: float) -> Array:
    """Below a corner [Hz], without delay, (N, n)."""
    if values.shape[0] < 30 or corner >= 0.4 * rate:
        return values
    sections = butter(4, corner, fs=rate, output="sos")
    pad = min(values.shape[0] - 1, int(3.0 * rate / corner))
    return np.asarray(sosfiltfilt(sections, values, axis=0, padlen=pad))


def exchanged(values: Array, legs: Sequence[int], what: str = "") -> dict[str, Callable[[], Array]]:
    """Histories with two legs exchanged."""
    made: dict[str, Callable[[], Array]] = {}
    for i, j in combinations(range(len(legs)), 2):
        order = np.arange(len(legs))
        order[[i, j]] = j, i
        made[f"{what}legs {legs[i]} and {legs[j]} are exchanged"] = partial(
            np.take, values, order, 1
        )
    return made


def swaps(values: Array, legs: Sequence[int]) -> dict[str, Callable[[], Array]]:
    """Histories with two legs exchanged, or one with the other sign."""
    signs = 1.0 - 2.0 * np.eye(len(legs))
    turned = {
        f"leg {leg} has the other sign": partial(np.multiply, values, sign)
        for leg, sign in zip(legs, signs, strict=True)
    }
    return exchanged(values, legs) | turned


def _shifted(values: Array, frames: float) -> Array:
    at = np.arange(values.shape[0]) - frames
    return np.column_stack([np.interp(at, np.arange(values.shape[0]), one) for one in values.T])


def delay_of(expected: Array, measured: Array, rate: float) -> float:
    """Delay d [s]: where the velocities correlate best; of two as good the shorter one."""
    size, fine = 2 * expected.shape[0], 32
    e, m = (np.fft.rfft(np.diff(v, axis=0), size, axis=0) for v in (expected, measured))
    found = np.fft.irfft((e.conj() * m).sum(axis=1), size * fine)
    most = int(min(_LONGEST * rate, 0.25 * expected.shape[0]) * fine)
    near = np.concatenate([found[-most:], found[: most + 1]])
    if -near.min() > 1.5 * near.max():  # all legs have the other sign
        near = -near
    peaks = np.flatnonzero((near >= 0.97 * near.max()) & (near >= np.roll(near, 1)))
    peaks = peaks[near[peaks] >= np.roll(near, -1)[peaks]] - most
    return float(peaks[np.abs(peaks).argmin()]) / fine / rate if peaks.size else 0.0


def agree(
    expected: Array,
    measured: Array,
    rate: float,
    floor: float,
    changes: Changes | None = None,
    expectations: Changes | None = None,
    *,
    shift: bool = True,
    centred: bool = False,
) -> Agreement:
    """Compare (N, n) histories; `changes` are of what is measured, `expectations` of the other."""
    moving = measured.std()
    kept = (f for f in _CORNERS if smooth(measured, rate, f).std() > 0.33 * moving)
    corner = next(kept, _CORNERS[-1])
    every = max(1, int(rate / (10.0 * corner)))
    slow = rate / every

    def ready(values: Array) -> Array:
        low = smooth(values, rate, corner)[::every]
        return low - low.mean(axis=0) if centred else low

    e, m = ready(expected), ready(measured)
    moves = bool(min(e.std(axis=0).max(), m.std(axis=0).max()) > _MOVES * floor)

    def fit(said: str, e: Array, m: Array) -> _Way:
        delay = delay_of(e, m, slow) if shift and moves else 0.0
        return _Way(said, delay, *_fit(_shifted(e, delay * slow), m, floor, moves))

    base = fit("", e, m)
    ways = [fit(said, e, ready(change())) for said, change in (changes or {}).items()]
    ways += [fit(said, ready(change()), m) for said, change in (expectations or {}).items()]
    best = min(ways, key=lambda way: way.cost, default=base)
    unseen = tuple(way.said for way in ways if abs(way.cost - base.cost) < 0.5 * _PRICE)
    said = ""
    if best.cost + _PRICE < base.cost and best.left < 0.5 * min(1.0, base.left):
        said = " or ".join(way.said for way in ways if way.cost < best.cost + 0.5 * _PRICE)
    else:
        best = base
    known = (best.delay, best.gain) if moves else (np.nan, np.nan)
    return Agreement(said, *known, base.left, unseen)


def _fit(e: Array, m: Array, floor: float, moves: bool) -> tuple[float, float, float]:
    """Cost, gain, and the share not explained."""
    inside = slice(e.shape[0] // 50, e.shape[0] - e.shape[0] // 50)
    e, m = e[inside], m[inside]
    still, parts = e - e.mean(axis=0), m - m.mean(axis=0)
    gain = float((still * parts).sum()) / float((still**2).sum()) if moves else 1.0
    usual = 0.5 < abs(gain) < 2.0  # a loop's: a pose that is held is met
    apart = m - gain * (still if usual else e) - usual * np.sign(gain) * e.mean(axis=0)
    rms, whole = np.sqrt((apart**2).mean(axis=0)), np.sqrt(((parts if moves else m) ** 2).mean())
    left = float(np.sqrt((apart**2).mean()) / max(whole, floor))
    return float(np.log(rms + floor).sum()), gain, left


def halves(expected: Array, measured: Array, rate: float) -> tuple[float, float] | None:
    """Change of the response from half to half, and its error by the noise.

    Medians over the lines that both drive; None where they drive other lines or motions.
    """
    size = int(max(2.0, expected.shape[0] / rate / 12.0) * rate)
    frequency, window = np.fft.rfftfreq(size, 1.0 / rate), np.hanning(size)[:, None]
    used = (frequency > 1.5 / (size / rate)) & (frequency < min(10.0, 0.3 * rate))
    middle, found, axes = expected.shape[0] // 2, [], []
    for part in (slice(0, middle), slice(middle, None)):
        e, m = (np.gradient(v[part], axis=0) for v in (expected, measured))
        starts = range(0, e.shape[0] - size + 1, size // 2)
        if len(starts) < 3:
            return None
        x, y = (
            np.array([np.fft.rfft(window * v[k : k + size], axis=0)[used] for k in starts])
            for v in (e, m)
        )
        sxx, syy = ((np.abs(v) ** 2).sum(axis=(0, 2)) + 1e-300 for v in (x, y))
        sxy = (x.conj() * y).sum(axis=(0, 2))
        found.append((sxx, sxy / sxx, np.abs(sxy) ** 2 / (sxx * syy) + 1e-12))
        axes.append(e.T @ e / (np.linalg.norm(e.T @ e) + 1e-300))
    (p1, h1, c1), (p2, h2, c2) = found
    good = (np.minimum(p1 / p1.max(), p2 / p2.max()) > 0.01) & (np.minimum(c1, c2) > 0.8)
    good &= (p1 < 9.0 * p2) & (p2 < 9.0 * p1)
    if good.sum() < _LINES or float((axes[0] * axes[1]).sum()) < 0.9:
        return None
    error = np.sqrt((1.0 / c1 + 1.0 / c2 - 2.0) / len(starts))
    change = 2.0 * np.abs(h1 - h2) / (np.abs(h1) + np.abs(h2))
    return float(np.median(change[good])), float(np.median(error[good]))


def runs(mask: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """First and one past the last of each run."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    yield from ((int(a), int(b)) for a, b in edges.reshape(-1, 2))


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


def slipped(gain: float, sizes: Mapping[str, float], *, loose: bool = False) -> str:
    """What a gain says that no machine has: a unit that is another."""
    if not np.isfinite(gain) or (loose and gain > 0.0) or 0.4 < gain < 2.0:
        return ""
    if gain < 0.0:
        return "all legs have the other sign"
    likely = [
        f"the file has {one} where the map says {other}"
        for one, other in permutations(sizes, 2)
        if abs(np.log(gain * sizes[one] / sizes[other])) < 0.12
    ]
    return f"is {gain:.3g} of what is expected: {' or '.join(likely) or 'its scale is another'}"


def pose_slips(pose: Array, machine: Machine) -> dict[str, Callable[[], Array]]:
    """Legs of the demand with one slip in its pose."""
    turns, same = np.repeat([0.0, 1.0], 3), [0, 1, 2, 3, 4, 5]
    slips = [
        (f"{dof} has the other sign", sign, same) for dof, sign in zip(DOFS, _SIGNS, strict=True)
    ]
    slips += [("the pose is z up", np.array([1.0, -1, -1, 1, -1, -1]), same)]
    slips += [("surge and sway are exchanged", np.ones(6), [1, 0, 2, 3, 4, 5])]
    slips += [("roll and pitch are exchanged", np.ones(6), [0, 1, 2, 4, 3, 5])]
    others = [("lengths", "m", name, 1.0 - turns) for name in LENGTHS if name != "m"]
    for what, si, name, on in (*others, ("angles", "rad", "deg", turns)):
        size = factor(name) ** on
        slips += [(f"its {what} are in {name} where the map says {si}", size, same)]
        slips += [(f"its {what} are in {si} where the map says {name}", 1.0 / size, same)]
    return {
        said: partial(lambda size, order: pose_to_legs(pose[:, order] * size, machine), size, order)
        for said, size, order in slips
    }


def pressure_slips(
    p: Array, q: Array, areas: tuple[Array, Array], legs: list[int]
) -> dict[str, Callable[[], Array]]:
    """Forces with one slip in the pressures of cap and rod."""
    ac, ar = areas
    made: dict[str, Callable[[], Array]] = {"cap and rod are exchanged": lambda: ac * q - ar * p}
    for what, first, second in (
        ("cap_pressure of ", True, False),
        ("rod_pressure of ", False, True),
        ("both pressures of ", True, True),
    ):
        caps = exchanged(p, legs, what) if first else {}
        rods = exchanged(q, legs, what) if second else {}
        for said in caps or rods:
            made[said] = partial(_net, areas, caps.get(said, lambda: p), rods.get(said, lambda: q))
    return made


def _net(areas: tuple[Array, Array], cap: Callable[[], Array], rod: Callable[[], Array]) -> Array:
    return areas[0] * cap() - areas[1] * rod()


class Dynamics:
    """Forces that legs need by the data sheet: weight in the pose, and inertia."""

    def __init__(self, plant: Hexapod, positions: Array, rate: float) -> None:
        """Place the machine in the mean pose of its positions [m], (N, 6)."""
        self.every = max(1, positions.shape[0] // 200)
        self.rate, self.machine = rate, plant.machine
        plant.start(legs_to_pose(positions.mean(axis=0), plant.machine))
        self.pose = legs_to_pose(positions.mean(axis=0), plant.machine)
        self.load = plant.static_load()
        self.wrench = leg_jacobian(self.pose, plant.machine).T @ self.load
        self.inertia = plant.reflected_mass(self.pose)

    def of(self, positions: Array) -> Array:
        """Forces [N] of positions [m], both (N, 6)."""
        poses = legs_to_pose(smooth(positions, self.rate, 1.0)[:: self.every], self.machine)
        some = [np.linalg.solve(leg_jacobian(one, self.machine).T, self.wrench) for one in poses]
        at = np.arange(positions.shape[0]) / self.every
        static = [np.interp(at, np.arange(len(some)), one) for one in np.transpose(some)]
        velocity = np.gradient(positions, 1.0 / self.rate, axis=0)
        return np.transpose(static) + np.gradient(velocity, 1.0 / self.rate, axis=0) @ self.inertia


def turned(dynamics: Dynamics, change: Callable[[], Array], i: int, j: int) -> Array:
    """Forces that legs exchanged in all channels would need, in the recording's order."""
    order = np.arange(6)
    order[[i, j]] = j, i
    return dynamics.of(change())[:, order]


def legs_there(values: Array) -> NDArray[np.bool_]:
    """Which legs were recorded, (6,)."""
    return np.asarray(~np.isnan(values).all(axis=0))


def whole_legs(record: Record, channel: str) -> tuple[Array, list[int]] | None:
    """A channel of the legs that were recorded, gaps bridged, and their numbers."""
    if channel not in record.channels:
        return None
    values = np.atleast_2d(record[channel].T).T
    there = np.flatnonzero(legs_there(values))
    if not there.size:
        return None
    at = np.arange(values.shape[0])
    made = [np.interp(at, at[ok], values[ok, k]) for k in there for ok in [~np.isnan(values[:, k])]]
    return np.column_stack(made), [int(k) + 1 for k in there]


def shared_legs(
    one: tuple[Array, list[int]], other: tuple[Array, list[int]]
) -> tuple[Array, Array, list[int]]:
    """Both for the legs that both have."""
    legs = sorted(set(one[1]) & set(other[1]))
    return (*(v[:, [k.index(leg) for leg in legs]] for v, k in (one, other)), legs)  # type: ignore[return-value]
