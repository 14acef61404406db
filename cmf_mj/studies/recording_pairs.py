"""Whether two histories of the legs agree, and which one slip between them would explain it.

Expected e and measured m, both below f [Hz], agree as m(t) = g e(t - d): d is where their
velocities correlate best, g a least-squares gain of what moves. Of the slips (`recording_slips`),
such as two legs exchanged, the one whose mending has the least

    sum over the legs of ln(r + r0),  r = rms(m - g e),  plus a price for the slip

is taken; the price is that of two legs fitting half as badly, so that noise and dynamics make none.
Histories are (N, 6), NaN for legs that were not recorded.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import shift as shifted
from scipy.signal import butter, sosfiltfilt

from cmf_mj.studies.recording_slips import Slip, recorded_legs

Array = NDArray[np.float64]

_PRICE = 2.0 * np.log(2.0)  #: Of a slip, in ln: two legs that fit half as badly.
_CORNERS = (1.0, 2.0, 4.0, 8.0)  #: f [Hz]: the first that keeps a third of what moves.
_LONGEST_DELAY = 2.0  #: Largest delay that is looked for [s].
_LEAST_MOTION = 4.0  #: Motion, in r0, from which on something moves.
_ROUNDING = 1e-9  #: Motion that is rounding.
_SENSOR_SHARE = 0.01  #: Added to the share of forces that is not explained, for sensors.
_TINY = 1e-300  #: Added to what is divided by.


class Agreement(NamedTuple):
    """How two histories agree."""

    slip: str  #: What is wrong, in words; empty if nothing is.
    delay: float  #: d [s], NaN where nothing moves.
    cost: float  #: The sum above.
    gain: float  #: g, NaN where nothing moves.
    unexplained: float  #: Share of what moves that is not explained, before any mending.
    delay_error: float = np.nan  #: Two deviations of d by what is not explained [s].


def smooth(values: Array, rate: float, corner: float) -> Array:
    """Below a corner [Hz], without delay, (N, n)."""
    if values.shape[0] < 30 or corner >= 0.4 * rate:
        return values
    sections = butter(4, corner, fs=rate, output="sos")
    pad = min(values.shape[0] - 1, int(3.0 * rate / corner))
    return np.asarray(sosfiltfilt(sections, values, axis=0, padlen=pad))


def compare(
    expected: Array,
    measured: Array,
    rate: float,
    floor: float,
    slips: Iterable[Slip] = (),
    *,
    are_rates: bool = False,
) -> Agreement | None:
    """Compare the legs that both histories have; None if there are none.

    `floor` is r0 in the unit of both. Where one moves, the other is compared. Where they
    `are_rates` of one clock, d is 0, their means do not count, and both have to move.
    """
    legs = recorded_legs(expected) & recorded_legs(measured)
    if not legs.any():
        return None
    motion = measured[:, legs]
    enough = 0.33 * motion.std()
    corners = [corner for corner in _CORNERS if smooth(motion, rate, corner).std() > enough]
    corner = corners[0] if corners else _CORNERS[-1]
    stride = max(1, int(rate / (10.0 * corner)))
    comparison = _Comparison(legs, corner, rate, stride, floor, are_rates)
    motions = [comparison.low_pass(values).std(axis=0).max() for values in (expected, measured)]
    largest, least = max(motions), min(motions)
    moves = bool((least if are_rates else largest) > _LEAST_MOTION * floor and least > _ROUNDING)
    as_recorded = comparison.fit(Slip("", expected, measured), moves)
    fits = [comparison.fit(slip, moves) for slip in slips]
    best = min(fits, key=lambda fit: fit.cost, default=as_recorded)
    text = " or ".join(fit.slip for fit in fits if fit.cost < best.cost + 0.5 * _PRICE)
    is_dearer = best.cost + _PRICE >= as_recorded.cost
    if is_dearer or best.unexplained >= 0.5 * min(1.0, as_recorded.unexplained):
        best, text = as_recorded, ""
    agreement = best._replace(slip=text, unexplained=as_recorded.unexplained)
    return agreement if moves else agreement._replace(delay=np.nan, gain=np.nan)


class _Comparison(NamedTuple):
    """How histories are compared: some legs, below a corner."""

    legs: NDArray[np.bool_]
    corner: float  #: f [Hz].
    rate: float  #: Of the histories [Hz].
    stride: int  #: Samples of the histories to one that is compared.
    floor: float  #: r0.
    are_rates: bool  #: Whether they are rates of one clock.

    def low_pass(self, values: Array) -> Array:
        """The legs below the corner, rates about their mean."""
        low = smooth(values[:, self.legs], self.rate, self.corner)[:: self.stride]
        return low - low.mean(axis=0) if self.are_rates else low

    def fit(self, slip: Slip, moves: bool) -> Agreement:
        """Fit delay and gain to histories without a slip."""
        e, m = self.low_pass(slip.expected), self.low_pass(slip.measured)
        stride, rate = self.stride, self.rate
        delay_samples = _delay_samples(e, m, rate / stride) if moves and not self.are_rates else 0.0
        e = shifted(e, (delay_samples, 0.0), order=1, mode="nearest")
        fit = _fit_gain(e, m, self.floor, moves)
        speed = np.sqrt((abs(fit.gain) * np.gradient(e, stride / rate, axis=0)).var(axis=0).mean())
        residual = np.sqrt((m - fit.gain * e).var(axis=0).mean())
        independent = 2.0 * self.corner * m.size * stride / rate
        delay_error = float(2.0 * ((residual + _TINY) / (speed + _TINY)) / np.sqrt(independent))
        delay = delay_samples * stride / rate
        return fit._replace(slip=slip.text, delay=delay, delay_error=delay_error)


def _delay_samples(expected: Array, measured: Array, rate: float) -> float:
    """Samples d where the velocities correlate best; of two as good the fewer."""
    size, subdivision = 2 * expected.shape[0], 32
    e, m = (np.fft.rfft(np.diff(v, axis=0), size, axis=0) for v in (expected, measured))
    correlation = np.fft.irfft((e.conj() * m).sum(axis=1), size * subdivision)
    longest = int(min(_LONGEST_DELAY * rate, 0.25 * expected.shape[0]) * subdivision)
    window = np.concatenate([correlation[-longest:], correlation[: longest + 1]])
    if -window.min() > 1.5 * window.max():  # all legs have the other sign
        window = -window
    neighbour = np.maximum(np.roll(window, 1), np.roll(window, -1))
    peaks = np.flatnonzero(window >= np.maximum(neighbour, 0.97 * window.max())) - longest
    return float(peaks[np.abs(peaks).argmin()]) / subdivision if peaks.size else 0.0


def _fit_gain(e: Array, m: Array, floor: float, moves: bool) -> Agreement:
    """Fit the gain without the ends.

    About the mean legs move by the gain. The mean is met where the gain is that of a loop, which
    meets a pose that is held; else it has the gain too.
    """
    margin = e.shape[0] // 50
    inner = slice(margin, e.shape[0] - margin)
    e, m = e[inner], m[inner]
    mean = e.mean(axis=0)
    e_motion, m_motion = e - mean, m - m.mean(axis=0)
    gain = float((e_motion * m_motion).sum()) / float((e_motion**2).sum()) if moves else 1.0
    if 0.5 < abs(gain) < 2.0:
        residual = m - gain * e_motion - np.sign(gain) * mean
    else:
        residual = m - gain * e
    residual_by_leg = np.sqrt((residual**2).mean(axis=0))
    motion = np.sqrt((m_motion**2).mean()) if moves else max(np.sqrt((m**2).mean()), floor)
    unexplained = float(np.sqrt((residual**2).mean()) / motion)
    cost = float(np.log(residual_by_leg + floor).sum())
    return Agreement("", delay=0.0, cost=cost, gain=gain, unexplained=unexplained)


def explain_forces(
    parts: Array, force: Array, slips: Iterable[tuple[str, Array]]
) -> tuple[Agreement, list[str]]:
    """Find whether forces (N, 6) are sums of parts (N, 6, k), and whose mending makes them so.

    Of n forces what k unknown factors leave has the share e of all, and a hundredth is added, for
    sensors. A slip is named, that which leaves least, e', where

        ln e / e' > max(ln 1.4, 8 / n'),  n' = n (1 - r) / (1 + r)

    with r the correlation of what is left from sample to sample, so that n' forces say something
    new, and 8 for the odds of 46 slips. The second value has the exchanges that it would not name.
    """
    legs = recorded_legs(force)
    columns = parts[:, legs].reshape(-1, parts.shape[2])
    basis, sizes, _ = np.linalg.svd(columns / (np.linalg.norm(columns, axis=0) + _TINY), False)
    basis = basis[:, sizes > 1e-3 * sizes[0]]
    whole = float(np.linalg.norm(force[:, legs])) + _TINY

    def remainder(force: Array) -> tuple[float, float]:
        """Share that is left, and that below which another explanation is no chance."""
        column = force[:, legs].ravel()
        e = np.asarray(column - basis @ (basis.T @ column)).reshape(-1, legs.sum()) + 1e-9
        correlation = float((e[1:] * e[:-1]).sum() / (e**2).sum())
        independent = max((e.size - e.shape[1]) * (1.0 - correlation) / (1.0 + correlation), 0.1)
        share = float(np.linalg.norm(e)) / whole + _SENSOR_SHARE
        return share, share * float(np.exp(-max(np.log(1.4), 8.0 / independent)))

    recorded_share, better_share = remainder(force)
    mended = {text: remainder(mended_force) for text, mended_force in slips}
    least = min([recorded_share, *(share for share, _ in mended.values())])
    texts = [text for text, (share, _) in mended.items() if share < 1.2 * least]
    slip = " or ".join(texts) if least < better_share else ""
    exchanges = {text: better for text, (_, better) in mended.items() if "legs" in text}
    unnamed = [text for text, better in exchanges.items() if recorded_share > better]
    rest = recorded_share - _SENSOR_SHARE
    return Agreement(slip, np.nan, cost=recorded_share, gain=np.nan, unexplained=rest), unnamed
