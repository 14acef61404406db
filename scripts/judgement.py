"""Washouts judged by numbers, on drives and flights, and tuned on them.

python scripts/judgement.py predictive --workspace 0.22   writes out/cue/washout.toml

`judge` measures a cueing; `search` tunes any family by covariance matrix adaptation of gains,
corners or sizes, with the cost

    J = mean over manoeuvres of rms e / theta (1 + 5 beyond),    times (1 + 5 too much)

e the error sensed, theta its thresholds, `beyond` the largest share of any limit above 1, `too
much` the mean workspace above the one allowed, over it.
"""

import argparse
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import validated
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.pilot.cueing import Cue, cue
from cmf_mj.pilot.drives import DRIVES
from cmf_mj.pilot.flight import load_flight
from cmf_mj.pilot.washout_settings import WashoutSettings, load_washout, save_washout

TUNED = (*DRIVES, "turn")
"""Drives and flights to tune on."""
_SHORTEST = 0.1  #: Of what counts as a false cue, and of the gap between two [s].


class Judgement(NamedTuple):
    """Objective measures of a cueing; forces and rates as sensed, less those of the start."""

    force_error: float  #: Root mean square of the specific force's error vector [m/s^2].
    rate_error: float  #: Likewise of the angular rate [rad/s].
    force_shape: float  #: Correlation of the specific forces, the three axes as one vector.
    force_scale: float  #: Least-squares factor from the aircraft's specific force.
    false_cues: int  #: Number, however short.
    lasting: int  #: Number of those of at least 0.1 s, where a gap of less ends none.
    false_rms: float  #: Root mean square of false cues over their thresholds.
    mismatch: float
    """Mean of 0.66 lateral and 0.34 longitudinal specific force missed, unsensed [m/s^2]: what the
    continuous rating of Kolff and others low-passes, which leaves the mean as it is."""
    tilting: float  #: Share of the time with a roll or pitch rate error above its threshold.
    workspace: float  #: Root mean square of the legs over their working travel.
    travel: float  #: Largest share of the travel of legs and pose.
    limited: int  #: Frames that the limits held back.


def _stretches(false: NDArray[np.bool_], gap: int = 1) -> NDArray[np.int_]:
    """Begin and end of each run of true values, gaps below `gap` samples closed, (K, 2)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], false.astype(int), [0]]))).reshape(-1, 2)
    apart = edges[1:, 0] - edges[:-1, 1] >= gap
    first = np.ones(len(edges), dtype=bool)
    last = first.copy()
    first[1:] = last[:-1] = apart
    return np.column_stack([edges[first, 0], edges[last, 1]])


def judge(cued: Cue) -> Judgement:
    """Measure a cueing.

    A false cue is a time in which the simulator's force along an axis is sensed beyond its
    threshold while the aircraft's is not, or points the other way. A correlation is that of all
    three axes as one vector, 0 of what does not move.
    """
    error, legs = cued.error, pose_to_legs(cued.stream.pose, cued.machine)
    forces = [motion.specific_force for motion in (error.aircraft, error.simulator)]
    asked, given = (force - force[0] for force in forces)
    common, power = float(np.sum(asked * given)), float(np.sum(asked**2))
    size = float(np.linalg.norm(asked) * np.linalg.norm(given))
    flown, felt = asked / error.threshold[:3], given / error.threshold[:3]
    false = (np.abs(felt) > 1.0) & ((np.abs(flown) < 1.0) | (felt * flown < 0.0))
    short = round(_SHORTEST * cued.aircraft.rate)
    found = [_stretches(false[:, axis]) for axis in range(3)]
    lasting = [_stretches(false[:, axis], short) for axis in range(3)]
    total = np.sqrt(np.mean(error.error**2, axis=0))
    missed = np.abs(cued.aircraft.specific_force - cued.simulator.specific_force).mean(axis=0)
    turning = np.abs(error.error[:, 3:5]) > error.threshold[3:5]
    return Judgement(
        force_error=float(np.linalg.norm(total[:3])),
        rate_error=float(np.linalg.norm(total[3:])),
        force_shape=common / size if size > 0.0 else 0.0,
        force_scale=common / power if power > 0.0 else 0.0,
        false_cues=sum(map(len, found)),
        lasting=sum(int((np.diff(pairs) >= short).sum()) for pairs in lasting),
        false_rms=float(np.sqrt(np.mean(np.sum((felt * false) ** 2, axis=1)))),
        mismatch=float(missed @ [0.34, 0.66, 0.0]),
        tilting=float(turning.any(axis=1).mean()),
        workspace=float(np.sqrt(np.mean(legs**2)) / cued.machine.working_stroke),
        travel=cued.excursion.travel,
        limited=int(cued.limited.sum()),
    )


_AXES = ("surge", "sway", "heave", "roll", "pitch", "yaw")
_TILTING, _EVERY = ("pitch_surge", "roll_sway"), ("pitch_surge", "roll_sway", "heave")
_SIZES = (
    *([(mode, key) for mode in _TILTING] for key in ("rate_error", "angle", "rate")),
    *([(mode, key) for mode in _EVERY] for key in ("position_integral", "velocity")),
    *([(mode, key)] for mode in _EVERY for key in ("position", "acceleration")),
)
FREE = {
    "classical": (
        *([(dof, key)] for dof in _AXES for key in ("gain", "natural_frequency")),
        *([(dof, "low_pass_frequency")] for dof in ("surge", "sway")),
        [("heave", "break_frequency")],
    ),
    "optimal": (
        *([(mode, "gain")] for mode in (*_EVERY, "yaw")),
        *([(mode, "rate_gain")] for mode in _TILTING),
        *_SIZES,
    ),
    "predictive": (
        *_SIZES,
        [(mode, "gain") for mode in _TILTING],
        *([("prediction", key)] for key in ("smoothing", "guess_time", "guess_fade")),
    ),
}
"""What is tuned of each family: entries with one factor each."""


def changed(base: WashoutSettings, factors: NDArray[np.float64], source: str) -> WashoutSettings:
    """A set with the entries of `FREE` times some factors, each of which says its source."""
    tables = base.model_dump()
    for entries, factor in zip(FREE[base.kind], factors, strict=True):
        for table, key in entries:
            entry = tables[table][key]
            entry |= {"value": float(f"{entry['value'] * factor:.4g}")}
            entry |= {"status": "derived", "source": source}
    return validated(type(base), tables, base.name)


def cost(cues: Sequence[Cue], workspace: float = 1.0) -> float:
    """J of this module for the cues of some manoeuvres and the workspace allowed."""
    total, used = [], []
    for cued in cues:
        error = cued.error.error / cued.error.threshold
        sensed = float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
        total.append(sensed * (1.0 + 5.0 * max(0.0, cued.excursion.largest - 1.0)))
        used.append(judge(cued).workspace)
    return float(np.mean(total)) * (1.0 + 5.0 * max(0.0, float(np.mean(used)) / workspace - 1.0))


class Search(NamedTuple):
    """What a search found."""

    settings: WashoutSettings
    cost: float
    start: float  #: Cost of the settings it began with.
    tried: int  #: Settings that were tried, the first included.


def search(
    base: WashoutSettings,
    names: Sequence[str] = TUNED,
    *,
    evaluations: int = 300,
    workspace: float = 1.0,
    rate: float = 40.0,
    seed: int = 5,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> Search:
    """Tune a set on manoeuvres by name; the best of about `evaluations`.

    `workspace` is the root mean square of the legs over their working travel that the mean over all
    manoeuvres may use, `rate` that of the frames [Hz]; `options` are those of `cue`.
    """
    if evaluations < 1:
        raise InputError(f"evaluations: {evaluations} must be at least 1")
    motions = [load_flight(name).motion for name in names]
    source = f"scripts/judgement.py: {evaluations} evaluations on {', '.join(names)}"

    def tried_at(logs: NDArray[np.float64]) -> tuple[float, WashoutSettings]:
        settings = changed(base, np.exp(np.clip(logs, -4.0, 4.0)), source)
        cues = [cue(one, settings, rate=rate, **options) for one in motions]
        return cost(cues, workspace), settings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import cma

        given = {"seed": seed, "verbose": -9, "popsize": 10}
        strategy = cma.CMAEvolutionStrategy(np.zeros(len(FREE[base.kind])), 0.3, given)
    first = tried_at(np.zeros(len(FREE[base.kind])))[0]
    least, best, tried = first, base, 1
    while tried < evaluations and not strategy.stop():
        points = strategy.ask()
        found = [tried_at(point) for point in points]
        strategy.tell(points, [one[0] for one in found])
        tried += len(points)
        least, best = min([(least, best), *found], key=lambda one: one[0])
        if progress is not None:
            progress(min(tried, evaluations), evaluations)
    return Search(best, least, first, tried)


def main() -> None:
    """Tune a washout and write what was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("washout", help="name or TOML file, of any family")
    parser.add_argument(
        "--workspace", type=float, default=1.0, help="rms of legs over their travel"
    )
    parser.add_argument("--evaluations", type=int, default=300, help="settings to try")
    parser.add_argument("--rate", type=float, default=80.0, help="frames a second")
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--out", type=Path, default=Path("out/cue/washout.toml"))
    how = vars(parser.parse_args())
    base, out = load_washout(how.pop("washout")), how.pop("out")
    found = search(base, **how)
    print(f"cost {found.cost:.4g} in place of {found.start:.4g} after {found.tried} settings")
    print(f"written: {save_washout(found.settings, out)}")


if __name__ == "__main__":
    main()
