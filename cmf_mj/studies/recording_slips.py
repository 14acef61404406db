"""Slips that recordings have: exchanged columns, signs, units, sensors that stop or clip.

A slip of two histories is what is wrong, in words, with both histories as they would be without it.
Which one explains a recording is for `recording_pairs` to say. Histories are (N, 6), NaN for legs
that were not recorded.
"""

from collections.abc import Callable, Iterator, Mapping
from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.units import factor
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.machine.machine import Machine
from cmf_mj.record.sources import true_runs

Array = NDArray[np.float64]

LENGTH_UNITS = {name: factor(name) for name in ("m", "ft", "in", "mm", "cm")}
PRESSURE_UNITS = {name: factor(name) for name in ("Pa", "psi", "bar", "kPa", "MPa")}

_CLIPPED_RUNS, _CLIPPED_SAMPLES = 2, 4  #: Least runs at a clipped sensor's limit, of samples each.


class Slip(NamedTuple):
    """What may be wrong between two histories, and both as they would be without it."""

    text: str
    expected: Array
    measured: Array


def recorded_legs(values: Array) -> NDArray[np.bool_]:
    """Which legs were recorded, (6,)."""
    return np.asarray(~np.isnan(values).all(axis=0))


def _leg_exchanges(values: Array) -> Iterator[tuple[str, list[int]]]:
    """Each two of the recorded legs in words, and the order of legs that exchanges them."""
    for i, j in combinations(np.flatnonzero(recorded_legs(values)).tolist(), 2):
        order = [*range(values.shape[1])]
        order[i], order[j] = j, i
        yield f"legs {i + 1} and {j + 1} are exchanged", order


def leg_slips(expected: Array, measured: Array) -> Iterator[Slip]:
    """Two measured legs exchanged, or one with the other sign."""
    for text, order in _leg_exchanges(measured):
        yield Slip(text, expected, measured[:, order])
    for leg in np.flatnonzero(recorded_legs(measured)):
        sign = np.where(np.arange(measured.shape[1]) == leg, -1.0, 1.0)
        yield Slip(f"leg {leg + 1} has the other sign", expected, measured * sign)


def pose_slips(pose: Array, measured: Array, machine: Machine) -> Iterator[Slip]:
    """One slip in the pose [m, rad], (N, 6), that the expected legs come from."""

    def mended(text: str, pose: Array) -> Slip:
        return Slip(text, pose_to_legs(pose, machine), measured)

    for dof, sign in zip(DOFS, 1.0 - 2.0 * np.eye(6), strict=True):
        yield mended(f"{dof} has the other sign", pose * sign)
    yield mended("the pose is z up", pose * np.array([1.0, -1, -1, 1, -1, -1]))
    yield mended("surge and sway are exchanged", pose[:, [1, 0, 2, 3, 4, 5]])
    yield mended("roll and pitch are exchanged", pose[:, [0, 1, 2, 4, 3, 5]])
    is_angle = np.repeat([False, True], 3)
    for unit in (*(name for name in LENGTH_UNITS if name != "m"), "deg"):
        kind, si = ("angles", "rad") if unit == "deg" else ("lengths", "m")
        size = np.where(is_angle == (unit == "deg"), factor(unit), 1.0)
        yield mended(f"its {kind} are in {unit} where the map says {si}", pose * size)
        yield mended(f"its {kind} are in {si} where the map says {unit}", pose * (1.0 / size))


def pressure_slips(
    cap: Array, rod: Array, cap_area: Array, rod_area: Array
) -> Iterator[tuple[str, Array]]:
    """One slip in the pressures [Pa], and the forces without it; areas are (6,) [m^2]."""
    yield "cap and rod are exchanged", cap_area * rod - rod_area * cap
    push, pull = cap_area * cap, rod_area * rod
    for text, order in _leg_exchanges(push - pull):
        other_push, other_pull = cap_area * cap[:, order], rod_area * rod[:, order]
        yield f"cap_pressure of {text}", other_push - pull
        yield f"rod_pressure of {text}", push - other_pull
        yield f"both pressures of {text}", other_push - other_pull


def scale_slip_text(gain: float, unit_factors: Mapping[str, float]) -> str:
    """The sign or unit that is wrong where a gain is one that no machine has, else nothing."""
    if not np.isfinite(gain) or 0.4 < gain < 2.0:
        return ""
    if gain < 0.0:
        return "all legs have the other sign"
    likely = unit_slips_text(unit_factors, lambda scale: abs(np.log(gain * scale)) < 0.12)
    return f"is {gain:.3g} of what is expected: {likely or 'its scale is another'}"


def unit_slips_text(
    unit_factors: Mapping[str, float], mends: Callable[[float], bool], map_unit: str = ""
) -> str:
    """Units of a file that differ from the map's and whose factor `mends` a channel, in words.

    With a `map_unit` only slips from it are named.
    """
    return " or ".join(
        f"the file has {file_unit} where the map says {other_unit}"
        for file_unit, other_unit in permutations(unit_factors, 2)
        if mends(unit_factors[file_unit] / unit_factors[other_unit])
        and map_unit in ("", other_unit)
    )


def length_slip_text(values: Array, machine: Machine, map_unit: str) -> str:
    """Why lengths [m] are beyond the stroke: from gimbal to gimbal, or in units that fit a leg."""
    least, largest = float(np.nanmin(values)), float(np.nanmax(values))
    longest = float(machine.geometry.neutral.max()) + machine.half_stroke

    def fits_gimbals(scale: float, slack: float = 1.02) -> bool:
        return machine.retracted < slack * scale * least and scale * largest < slack * longest

    def fits_stroke(scale: float) -> bool:
        return 0.02 < scale * max(largest, -least) / machine.half_stroke < 1.02

    if fits_gimbals(1.0, 1.5):
        first_mean, neutral = np.nanmean(values[0]), longest - machine.half_stroke
        text = (
            "from gimbal to gimbal? State `offset`, what the file shows at neutral: its first row"
        )
        return f"{text} has {first_mean:.5g} m, the data sheet {neutral:.5g} m"
    if unit_text := unit_slips_text(LENGTH_UNITS, fits_gimbals, map_unit):
        return f"{unit_text}, from gimbal to gimbal: state `offset` too"
    return unit_slips_text(LENGTH_UNITS, fits_stroke, map_unit)


def find_clipping(values: Array, step: float) -> tuple[float, int] | None:
    """The limit at which a column stays while it comes and goes at speed, and samples there."""
    for limit in (np.nanmax(values), np.nanmin(values)):
        lengths = []
        for first, end in true_runs(values == limit):
            length = end - first
            if length >= _CLIPPED_SAMPLES and first >= 2 and end + 2 <= values.size:
                slope = min(abs(values[first - 2] - limit), abs(values[end + 1] - limit))
                # A parabola through its quantised peak comes in at 4 steps over the run's samples.
                excess = 0.5 * slope * length / 4.0
                if excess > 4.0 * step and excess > 0.02 * np.nanstd(values):
                    lengths.append(length)
        if len(lengths) >= _CLIPPED_RUNS:
            return float(limit), int(sum(lengths))
    return None


def find_frozen_span(values: Array, leg: int, rate: float) -> slice | None:
    """Longest span of one value of a leg, in histories (N, 6), in which most other legs move."""
    is_still = np.append(np.diff(values[:, leg]) == 0.0, False)
    first, end = max(true_runs(is_still), key=lambda run: run[1] - run[0], default=(0, 0))
    others = np.delete(values, leg, axis=1)[:, np.delete(recorded_legs(values), leg)]
    if not max(0.5 * rate, 20) <= end - first < 0.98 * len(values) or others.shape[1] < 2:
        return None
    whole = np.nanstd(others, axis=0) + 1e-300
    moved = np.nanstd(others[first : end + 1], axis=0) / whole
    return slice(first, end + 1) if np.median(moved) > 0.3 else None
