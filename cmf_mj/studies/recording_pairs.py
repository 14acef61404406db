"""Whether two histories of the legs belong together, and which one slip would mend them.

Expected e and measured m, both below f [Hz], belong together as m(t) = g e(t - d): d is where their
velocities correlate best, g a least-squares gain of what moves. Of the changes that a slip makes,
such as two legs exchanged, the one with the least

    sum over the legs of ln(r + r0),  r = rms(m - g e),  plus a price for the change

is taken; the price is that of two legs fitting half as badly, so that noise and dynamics make none.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

Array = NDArray[np.float64]

Changes = Mapping[str, Callable[[], Array]]  #: What is wrong, in words, and the history without it.

_PRICE = 2.0 * np.log(2.0)
_CORNERS = (1.0, 2.0, 4.0, 8.0)  #: f [Hz]: the first that keeps a third of what moves.
_LONGEST = 2.0  #: Largest delay that is looked for [s].
_MOVES = 4.0  #: Motion, in r0, from which on something moves.


class Agreement(NamedTuple):
    """How two histories belong together."""

    slip: str  #: What is wrong, in words; empty if nothing is.
    delay: float  #: d [s], NaN where nothing moves.
    gain: float  #: g, NaN where nothing moves.
    left: float  #: Share of what moves that is not explained, before any change.
    unseen: tuple[str, ...]  #: Changes that would not have mattered.


def smooth(values: Array, rate: float, corner: float) -> Array:
    """Below a corner [Hz], without delay, (N, n)."""
    if values.shape[0] < 30 or corner >= 0.4 * rate:
        return values
    sections = butter(4, corner, fs=rate, output="sos")
    pad = min(values.shape[0] - 1, int(3.0 * rate / corner))
    return np.asarray(sosfiltfilt(sections, values, axis=0, padlen=pad))


def corner_of(values: Array, rate: float) -> float:
    """The first corner that keeps a third of what moves [Hz]."""
    moves = values.std()
    fits = (f for f in _CORNERS if smooth(values, rate, f).std() > 0.33 * moves)
    return next(fits, _CORNERS[-1])


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
    """D [s]: where the velocities correlate best, whatever their sign."""
    size, fine = 2 * expected.shape[0], 8
    e, m = (np.fft.rfft(np.diff(v, axis=0), size, axis=0) for v in (expected, measured))
    found = np.abs(np.fft.irfft((e.conj() * m).sum(axis=1), size * fine))
    most = int(min(_LONGEST * rate, 0.25 * expected.shape[0]) * fine)
    near = np.concatenate([found[-most:], found[: most + 1]])
    frames = np.arange(-most, most + 1)
    best = np.flatnonzero(near >= 0.97 * near.max())
    peak = [k for k in best if near[k] == near[max(k - fine, 0) : k + fine + 1].max()]
    return float(frames[min(peak, key=lambda k: abs(frames[k]))]) / fine / rate


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
    corner = corner_of(measured, rate)
    every = max(1, int(rate / (10.0 * corner)))

    def ready(values: Array) -> Array:
        low = smooth(values, rate, corner)[::every]
        return low - low.mean(axis=0) if centred else low

    slow = rate / every
    e, m = ready(expected), ready(measured)
    moves = min(e.std(axis=0).max(), m.std(axis=0).max()) > _MOVES * floor
    frames = delay_of(e, m, slow) * slow if shift and moves else 0.0
    fitted = [_fit(_shifted(e, frames), m, floor, moves)]
    ways: list[tuple[str, float, float, float]] = [("", *fitted[0])]
    for said, change in (changes or {}).items():
        cost, gain, left = _fit(_shifted(e, frames), ready(change()), floor, moves)
        ways.append((said, cost + _PRICE, gain, left))
    for said, change in (expectations or {}).items():
        other = ready(change())
        own = delay_of(other, m, slow) * slow if shift and moves else 0.0
        cost, gain, left = _fit(_shifted(other, own), m, floor, moves)
        ways.append((said, cost + _PRICE, gain, left))
    ways.sort(key=lambda way: way[1])
    said, cost, gain, _ = ways[0]
    alike = [way[0] for way in ways if way[0] and way[1] < cost + 0.5 * _PRICE]
    base = fitted[0][0]
    unseen = tuple(way[0] for way in ways if way[0] and way[1] - _PRICE - base < _PRICE)
    delay = frames / slow if moves else np.nan
    gain = gain if moves else np.nan
    return Agreement(" or ".join(alike) if said else "", delay, gain, fitted[0][2], unseen)


def _fit(e: Array, m: Array, floor: float, moves: bool) -> tuple[float, float, float]:
    """Cost, gain, and the share not explained."""
    inside = slice(e.shape[0] // 50, e.shape[0] - e.shape[0] // 50)
    e, m = e[inside], m[inside]
    still, parts = e - e.mean(axis=0), m - m.mean(axis=0)
    power = float((still**2).sum())
    gain = float((still * parts).sum()) / power if moves and power > 0.0 else 1.0
    apart = m - (gain * still + np.sign(gain) * e.mean(axis=0))
    if abs(gain) < 0.5 or abs(gain) > 2.0:
        apart = m - gain * e
    rms = np.sqrt((apart**2).mean(axis=0))
    whole = np.sqrt((parts**2).mean()) if moves else np.sqrt((m**2).mean())
    left = float(np.sqrt((apart**2).mean()) / max(whole, floor))
    return float(np.log(rms + floor).sum()), gain, left


class Halves(NamedTuple):
    """How the response of the first half differs from that of the second."""

    change: float  #: Median over the lines of |H1 - H2| over their mean size.
    error: float  #: What noise makes of it.
    lines: int  #: Lines that both halves have.


def halves(expected: Array, measured: Array, rate: float, least: int = 4) -> Halves | None:
    """Responses of the two halves at the lines both drive; None where they drive other motions."""
    corner = min(10.0, 0.3 * rate)
    size = int(max(2.0, expected.shape[0] / rate / 12.0) * rate)
    hop, window = size // 2, np.hanning(size)[:, None]
    found, axes = [], []
    frequency = np.fft.rfftfreq(size, 1.0 / rate)
    used = (frequency > 1.5 / (size / rate)) & (frequency < corner)
    middle = expected.shape[0] // 2
    for part in (slice(0, middle), slice(middle, None)):
        e, m = (np.gradient(v[part], axis=0) for v in (expected, measured))
        starts = range(0, e.shape[0] - size + 1, hop)
        if len(starts) < 3:
            return None
        x, y = (
            np.array([np.fft.rfft(window * v[k : k + size], axis=0)[used] for k in starts])
            for v in (e, m)
        )
        sxx, syy = (np.abs(v) ** 2 for v in (x, y))
        sxy = (x.conj() * y).sum(axis=(0, 2))
        sxx, syy = sxx.sum(axis=(0, 2)), syy.sum(axis=(0, 2))
        coherence = np.abs(sxy) ** 2 / np.maximum(sxx * syy, 1e-300)
        found.append((sxx, sxy / np.maximum(sxx, 1e-300), coherence, len(starts)))
        covariance = e.T @ e
        axes.append(covariance / max(np.linalg.norm(covariance), 1e-300))
    (p1, h1, c1, n), (p2, h2, c2, _) = found
    good = (p1 > 0.01 * p1.max()) & (p2 > 0.01 * p2.max()) & (np.minimum(c1, c2) > 0.8)
    good &= (p1 < 9.0 * p2) & (p2 < 9.0 * p1)
    if good.sum() < least or float((axes[0] * axes[1]).sum()) < 0.9:
        return None
    size_of = 0.5 * (np.abs(h1) + np.abs(h2))[good]
    error = np.sqrt((1.0 / c1 - 1.0 + 1.0 / c2 - 1.0)[good] / n)
    change = np.abs(h1 - h2)[good] / size_of
    return Halves(float(np.median(change)), float(np.median(error)), int(good.sum()))


def runs(mask: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """First and one past the last of each run."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    yield from ((int(a), int(b)) for a, b in edges.reshape(-1, 2))
