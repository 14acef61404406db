"""A master read, and what has changed since.

What differs is found among numbers x, n of the master and m since:

    t = (mean_since - mean_master) / (s sqrt(1/n + 1/m)),    s of the master's own repetitions

against Student's t at the level alpha / (2 tests) over all numbers of a test, half for its measures
and half for its signature, see `signature`: a false alarm of the whole guide has at most the
probability alpha. A measure that all of one have and none of the other has changed where chance,
one in (n + m)! / n! m!, is below the level. Of a signature s is the mean of all legs, of real and
imaginary parts, with the degrees of freedom of one leg: what one leg does by chance, with friction
above all, the others do.
"""

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from functools import lru_cache
from math import comb
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special, stats
from scipy.signal import correlate

from cmf_mj.core.errors import InputError, within
from cmf_mj.core.result import Field
from cmf_mj.core.settings import beside, read_toml, validated
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.record.columns import read_mapped
from cmf_mj.record.record import Record
from cmf_mj.studies.guide import FILE, Bench, MasterSettings, bench
from cmf_mj.studies.measurement import MEASURES, SIGNED, accelerations, signature

Array = NDArray[np.float64]

REPEATABLE = "repeatability [g]"
"""Measure of every test: largest linear acceleration off the master's mean history."""
SIGNATURE = "signature [deviations]"  #: The largest difference of a test's signature.
SOUGHT = 0.05  #: Change that repetitions shall find where no other is `sought`, of a measure.
SOUGHT_IN = {"[dB]": 0.5, "[deg]": 1.0, "[%]": 1.0, "[g]": 0.01}
"""Likewise of measures in these units, which may be next to nothing."""
SIGNATURE_SOUGHT = 10.0  #: Likewise of a signature [deviations].
MOST = 1000  #: Repetitions that are stated; beyond they are infinitely many.
ALIKE = 0.05  #: How far a recorded demand may be off the plan's, over its range.
_ROUND = 1e-9  # deviation over the mean that is round-off


class Master(NamedTuple):
    """A folder of recordings of a guide, read."""

    folder: Path
    head: MasterSettings  #: With the digests of all recordings.
    bench: Bench
    records: Mapping[str, Sequence[Record]]  #: By test.

    def accelerations(self, name: str) -> Array:
        """Linear accelerations in the repetitions of a test [m/s^2], (n, N, 3)."""
        histories = [accelerations(record)[:, :3] for record in self.records[name]]
        count = min(map(len, histories))
        return np.array([one[:count] for one in histories])

    def measured(self, name: str, mean: Array) -> dict[str, Array]:
        """Measures of a test, each of all repetitions (n,); `mean` (N, 3) is of accelerations."""
        found: dict[str, list[float]] = {}
        for record in self.records[name]:
            for measure in self.bench.of[name].measures:
                with within(f"{name}: {measure}"):
                    for what, value in MEASURES[measure](record).items():
                        found.setdefault(what, []).append(value)
        felt = self.accelerations(name)
        count = min(felt.shape[1], len(mean))
        off = np.abs(felt[:, :count] - mean[:count]).max(axis=(1, 2)) / STANDARD_GRAVITY
        return {what: np.array(values) for what, values in found.items()} | {REPEATABLE: off}


def load_master(folder: str | Path, on: Bench | None = None) -> Master:
    """Read a master, or what was recorded since; `on` is its guide on its machine, if at hand.

    Raises `InputError` that names the folder and the test that is missing, cut short or another's.
    """
    where = Path(folder)
    if not (where / FILE).is_file():
        raise InputError(f"{where}: holds no {FILE}; allowed: a folder of cmf guide run or plan")
    head = validated(MasterSettings, read_toml(where / FILE), str(where / FILE))
    if on is None:
        with within(where / FILE):
            parts = (head.machine, head.cab, head.hydraulics, head.law)
            on = bench(head.guide, *(beside(where, one) for one in parts))
    records, digests, lost = {}, dict[str, str](), []
    for name in on.commands:
        read = [_read(on, name, path, head) for path in _files(where, name, head)]
        if read:
            records[name] = [record for record, _ in read]
            digests |= dict(known for _, known in read)
        elif name not in head.left_out:
            lost.append(name)
    if lost:
        allowed = "allowed: recordings of every test, or a reason under [left_out]"
        raise InputError(f"{where}: {', '.join(lost)}: no recordings; {allowed}")
    return Master(where, head.model_copy(update={"digests": digests}), on, records)


def _files(folder: Path, name: str, head: MasterSettings) -> list[Path]:
    """Recordings of a test that count, in the order of their numbers."""
    found = []
    for path in folder.glob(f"{name}.*"):
        number = path.name.removeprefix(f"{name}.").split(".")[0]
        if number.isdigit() and f"{name}.{number}" not in head.left_out:
            found.append((int(number), path))
    return [path for _, path in sorted(found)]


def _read(on: Bench, name: str, path: Path, head: MasterSettings) -> tuple[Record, tuple[str, str]]:
    """A recording from the beginning of its demand, where it looks most like the plan's; digest."""
    record = read_mapped(path, beside(path.parent, head.columns), on.plant.machine)
    known = head.digests.get(path.name, record.digest)
    with within(path):
        if record.digest != known:
            raise InputError(f"digest: {record.digest} is not the {known} of {FILE}")
        for channel in ("leg_reference", "leg_position"):
            if channel not in record.channels:
                raise InputError(f"{channel}: is missing; a test needs it")
        planned, given = on.legs(name, record.rate), record["leg_reference"]
        count, lag = len(planned), 0
        if not head.simulated:
            moved = [
                (x - x[0]).sum(axis=1) if np.ptp((x - x[0]).sum(axis=1)) else x[:, 0]
                for x in (given, planned)
            ]
            lag = int(np.argmax(correlate(*moved, mode="full"))) - count + 1
        if lag < 0 or lag + count > len(given) + 1:
            have = max(0, min(len(given) - lag, len(given))) / record.rate
            raise InputError(f"ends after {have:.1f} s; the test takes {count / record.rate:.1f} s")
        part = np.minimum(np.arange(lag, lag + count), len(given) - 1)
        off = np.abs(given[part] - planned).max() / np.ptp(planned, axis=0).max()
        if off > ALIKE:
            raise InputError(f"leg_reference: is {off:.0%} off what {name} demands")
        channels = {key: value[part] for key, value in record.channels.items()}
        about = {**record.metadata, **on.about(name)}
        cut = Record(np.arange(count) / record.rate, channels, record.units, about)
    return cut, (path.name, record.digest)


class Compared(NamedTuple):
    """One measure of a test, of the master and since."""

    test: str
    measure: str
    master: Annotated[float, Field(form=".4g")]
    spread: Annotated[float, Field("", "deviation", ".2g", about="of the master's repetitions")]
    new: Annotated[float, Field("", "now", ".4g")]
    off: Annotated[float, Field("", "t", ".1f")]  #: Student's t of the difference.
    level: Annotated[float, Field("", "alarm from", ".1f")]  #: Largest t without an alarm.
    found: Annotated[float, Field("", "found from", ".2g")]
    """Difference that is found with the guide's `power`."""
    sought: Annotated[float, Field("", "sought", ".2g", about="a difference to be found")]
    repetitions: Annotated[float, Field("", "takes", ".0f", about="of master and now to find it")]
    limit: Annotated[float, Field(form=".3g")]  #: Largest size allowed; NaN for none.
    verdict: str


@lru_cache
def smallest(n: int, m: int, level: float, degrees: float, power: float = 0.9) -> float:
    """Change, in deviations of one repetition, that n of the master and m since find with `power`.

    `level` is the two-sided probability of a false alarm. The noncentral t of d degrees of freedom
    at its quantile e: c sqrt(1/n + 1/m), where the mean over a normal z of P(chi^2_d < d (c + z)^2
    / e^2) is `power`. SciPy's own inverse searches for ever where e is large. NaN without a degree.

    >>> from cmf_mj.studies.guide_check import smallest
    >>> round(smallest(6, 2, 0.05, degrees=5), 2)
    3.34
    """
    if not degrees > 0.0:
        return float("nan")
    edge, half = float(stats.t.isf(level / 2.0, degrees)), degrees / 2.0
    z = np.linspace(-8.0, 8.0, 1601)
    weight = np.exp(-0.5 * z * z) / np.exp(-0.5 * z * z).sum()

    def missed(c: float) -> float:
        found = special.gammainc(half, half * (np.maximum(c + z, 0.0) / edge) ** 2)
        return power - float(weight @ found)

    most = 10.0 + edge * np.sqrt(special.gammainccinv(half, 0.01 * (1.0 - power)) / half)
    return float(optimize.brentq(missed, 0.0, most) * np.sqrt(1.0 / n + 1.0 / m))


def enough(change: float, level: float, degrees: float, power: float = 0.9) -> float:
    """Repetitions, as many of the master as since, that find a change in deviations of one.

    `degrees` are those of freedom that each but the first adds; the rest as `smallest` has it.

    >>> from cmf_mj.studies.guide_check import enough
    >>> enough(3.0, 0.05, degrees=1)
    5.0
    """
    if not change > 0.0:
        return float("nan")

    def found(n: int) -> bool:
        return smallest(n, n, level, degrees * (n - 1.0), power) <= change

    least = 2 + bisect_left(range(2, MOST + 1), True, key=found)
    return float(least if least <= MOST else "inf")


class Signed(NamedTuple):
    """Signatures of a test's repetitions, of the master and since."""

    difference: Array  #: New less master's mean, (channels, rows, legs).
    deviation: Array  #: Of that difference, (channels, rows, 1).
    degrees: Array  #: Of freedom of those, (rows, 1).

    def worst(self) -> tuple[float, float]:
        """Student's t of the difference that is least by chance, and its degrees of freedom."""
        # What differs by nothing is by chance, also where nothing is all there ever was.
        off, there = np.abs(self.difference), self.difference != 0.0
        np.divide(off, self.deviation, out=off, where=there)
        degrees = np.broadcast_to(self.degrees, off.shape)
        least = np.unravel_index(int(np.argmin(stats.t.logsf(off, degrees))), off.shape)
        return float(off[least]), float(degrees[least])


def signed(master: Master, new: Master, name: str, channels: Sequence[str] = ()) -> Signed:
    """Compare the signatures of a test, of some channels or all that both have."""
    first = [one.records[name][0] for one in (master, new)]
    chosen = channels or [c for c in SIGNED if all(c in record.channels for record in first)]
    lines = master.bench.lines(name, first[0].rate)
    old, now = (
        np.array([signature(r, lines, chosen) for r in one.records[name]]) for one in (master, new)
    )
    n, m, rows = len(old), len(now), lines.size
    variance = (_deviation(old) ** 2).mean(axis=2)
    parts = 0.5 * (variance[:, 1 : 1 + rows] + variance[:, 1 + rows :])
    pooled = np.concatenate([variance[:, :1], parts, parts], axis=1)[:, :, None]
    floor = (_ROUND * np.abs(old).max(axis=(0, 2, 3))[:, None, None]) ** 2
    deviation = np.sqrt(np.maximum(pooled, floor) * (1.0 / n + 1.0 / m))
    share = np.repeat([1.0, 2.0], [1, 2 * rows])[:, None]
    degrees = share * (n - 1.0)  # legs move together: they count as one
    return Signed(now.mean(axis=0) - old.mean(axis=0), deviation, degrees)


def _deviation(values: Array) -> Array:
    """Of repetitions (n, ...); NaN of one alone."""
    alone = np.full(values.shape[1:], np.nan)
    return np.asarray(values.std(axis=0, ddof=1)) if len(values) > 1 else alone


def check_same(master: Master, new: Master) -> None:
    """Refuse what was not recorded by the same guide on the same machine."""
    for field, value in master.bench.known.items():
        other = new.bench.known[field]
        if other != value:
            raise InputError(f"{new.folder}: {field} is {other!r}; the master's is {value!r}")
    if dict(new.bench.of) != dict(master.bench.of):
        raise InputError(f"{new.folder}: its guide has other tests than the master's")
    for name in master.records.keys() & new.records.keys():
        rate, other = (one.records[name][0].rate for one in (master, new))
        if not np.isclose(rate, other, rtol=1e-3):
            where = f"{new.folder}: {name}"
            raise InputError(f"{where}: has {other:g} samples a second; the master's {rate:g}")
    few = [name for name, records in master.records.items() if len(records) < 2]
    if few:
        raise InputError(f"{master.folder}: {', '.join(few)}: one recording; allowed: at least 2")


def compare(master: Master, new: Master) -> list[Compared]:
    """Every measure and signature of every test; `verdict` says what has changed.

    Of a test that was left out in either there is a row that says so. A master beside itself has
    its own measures, spreads, and what as many repetitions again would find.
    """
    if new is not master:
        check_same(master, new)
    guide, none = master.head.guide, float("nan")
    share, power = guide.false_alarm / (2.0 * max(1, len(master.records))), guide.power
    found = []
    for name in master.bench.commands:
        if name not in master.records or name not in new.records:
            why = new.head.left_out.get(name) or master.head.left_out.get(name, "")
            found.append(Compared._make([name, "", *[none] * 9, f"left out: {why}"]))
            continue
        mean, test = master.accelerations(name).mean(axis=0), master.bench.of[name]
        old, now = master.measured(name, mean), new.measured(name, mean)
        level = share / max(1, len(old) - 1)
        for measure, values in old.items():
            if not (np.isnan(values).all() and np.isnan(now[measure]).all()):
                limit = test.limits.get(measure, none)
                sought = {**test.limits, **test.sought}.get(measure, none)
                pair = values, now[measure]
                found.append(_measure(name, measure, *pair, level, limit, sought, power))
        one = signed(master, new, name)
        (most, degrees), least = one.worst(), share / one.difference.size
        edge = float(stats.t.isf(least / 2.0, degrees))
        n, m = (len(each.records[name]) for each in (master, new))
        seen = smallest(n, m, least, degrees, power)
        sought = test.sought.get(SIGNATURE, SIGNATURE_SOUGHT)
        takes = enough(sought, least, degrees / max(n - 1, 1), power)
        verdict = "changed" if most > edge else "as before"
        row = (0.0, 1.0, most, most, edge, seen, sought, takes, none, verdict)
        found.append(Compared(name, SIGNATURE, *row))
    return found


def _measure(
    test: str,
    measure: str,
    old: Array,
    now: Array,
    level: float,
    limit: float,
    sought: float = float("nan"),
    power: float = 0.9,
) -> Compared:
    """A measure in repetitions of the master (n,) and since (m,), NaN where one has none.

    `level` is that of its alarm; without a `limit` or a change that is `sought` these are NaN.
    """
    n, m, none = old.size, now.size, float("nan")
    all_or_none = {float(np.isnan(one).mean()) for one in (old, now)} == {0.0, 1.0}
    gone = all_or_none and 1.0 / comb(n + m, m) < level  # of all orders that chance may give them
    old_known, now_known = old[~np.isnan(old)], now[~np.isnan(now)]
    if old_known.size > 1 and now_known.size:  # judged by the repetitions that have the measure
        old, now, n, m = old_known, now_known, old_known.size, now_known.size
    before, after = float(old.mean()), float(now.mean())
    spread = float(np.maximum(_deviation(old), _ROUND * abs(before)))
    edge = float(stats.t.isf(level / 2.0, n - 1))
    off = (after - before) / (spread * np.sqrt(1.0 / n + 1.0 / m))
    found = spread * smallest(n, m, level, n - 1.0, power)
    if np.isnan(sought):
        sought = SOUGHT_IN.get(measure.rpartition(" ")[2], SOUGHT * abs(before))
    takes = enough(sought / spread, level, 1.0, power) if spread else none
    if measure == REPEATABLE:  # the master's own mean holds each of its repetitions
        off = edge = found = sought = takes = none
        after = float(now.max())
    verdict = "changed" if gone or abs(off) > edge else "as before"
    if abs(after) > limit:
        verdict = "beyond its limit"
    row = (before, spread, after, float(off), edge, found, sought, takes, limit, verdict)
    return Compared(test, measure, *row)
