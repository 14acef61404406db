"""A master read, and what has changed since.

What differs is found among numbers x, n of the master and m since:

    t = (mean_since - mean_master) / (s sqrt(1/n + 1/m)),    s of the master's own repetitions

against Student's t at the level alpha / (2 tests) over all numbers of a test, half for its measures
and half for its signature, see `signature`: a false alarm of the whole guide has at most the
probability alpha. Of a signature s is the mean of all legs, of real and imaginary parts, with the
degrees of freedom of one leg: what one leg does by chance, with friction above all, the others do.
"""

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats
from scipy.signal import correlate

from cmf_mj.core.errors import InputError, within
from cmf_mj.core.result import Field
from cmf_mj.core.settings import beside, read_toml, validated
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.record.columns import read_mapped
from cmf_mj.record.record import Record
from cmf_mj.studies.guide import FILE, Bench, MasterSettings, bench, named, write_head
from cmf_mj.studies.measurement import MEASURES, Lines, accelerations, signature

Array = NDArray[np.float64]

REPEATABLE = "repeatability [g]"
"""Measure of every test: largest linear acceleration off the master's mean history."""
SIGNATURE = "signature [deviations]"  #: The largest difference of a test's signature.
POWER = 0.9  #: Probability with which the smallest change that is stated is found.
ALIKE = 0.05  #: How far a recorded demand may be off the plan's, over its range.
_ROUND = 1e-9  # deviation over the mean that is round-off


class Master(NamedTuple):
    """A folder of recordings of a guide, read."""

    folder: Path
    head: MasterSettings
    bench: Bench
    records: Mapping[str, Sequence[Record]]  #: By test.

    def measured(self, name: str, mean: Array | None = None) -> list[dict[str, float]]:
        """All measures of each repetition of a test; `mean` (N, 3) is the master's acceleration."""
        found = []
        histories = [accelerations(record)[:, :3] for record in self.records[name]]
        for record, history in zip(self.records[name], histories, strict=True):
            measures: dict[str, float] = {}
            for measure in self.bench.of[name].measures:
                with within(f"{name}: {measure}"):
                    measures |= MEASURES[measure](record)
            if mean is not None:
                count = min(len(mean), len(history))
                off = np.abs(history[:count] - mean[:count]).max() / STANDARD_GRAVITY
                measures[REPEATABLE] = float(off)
            found.append(measures)
        return found

    def mean(self, name: str) -> Array:
        """Mean linear acceleration of the repetitions of a test [m/s^2], (N, 3)."""
        histories = [accelerations(record)[:, :3] for record in self.records[name]]
        count = min(map(len, histories))
        return np.asarray(np.mean([one[:count] for one in histories], axis=0))


def load_master(
    folder: str | Path,
    on: Bench | None = None,
) -> Master:
    """Read a master, or what was recorded since; `on` is that of a folder of the same head.

    Raises `InputError` that names the folder and the test that is missing, cut short or another's.
    """
    where = Path(folder)
    if not (where / FILE).is_file():
        raise InputError(f"{where}: holds no {FILE}; allowed: a folder of cmf guide run or plan")
    head = validated(MasterSettings, read_toml(where / FILE), str(where / FILE))
    if on is None or (on.guide, on.known) != (head.guide, head.known):
        with within(where / FILE):
            parts = (head.machine, head.cab, head.hydraulics, head.law)
            on = bench(head.guide, *(beside(where, one) for one in parts))
    missing = [name for name in on.commands if not _files(where, name, head)]
    lost = [name for name in missing if name not in head.aborted]
    if lost:
        allowed = "allowed: recordings of every test, or a reason under [aborted]"
        raise InputError(f"{where}: {', '.join(lost)}: no recordings; {allowed}")
    records = {}
    for name in on.commands:
        if name not in missing:
            records[name] = [_read(on, name, path, head) for path in _files(where, name, head)]
    return Master(where, head, on, records)


def seal(master: Master) -> Master:
    """Write the digests of recordings that have none; gives the master with them."""
    found = {
        path.name: read_mapped(path, beside(path.parent, master.head.columns), machine).digest
        for machine in [master.bench.plant.machine]
        for name in master.records
        for path in _files(master.folder, name, master.head)
    }
    head = master.head.model_copy(update={"digests": found})
    if found != dict(master.head.digests):
        write_head(head, master.folder)
    return master._replace(head=head)


def _files(folder: Path, name: str, head: MasterSettings) -> list[Path]:
    """Recordings of a test that count, in the order of their numbers."""
    found = []
    for path in folder.glob(f"{name}.*"):
        number = path.name.removeprefix(f"{name}.").split(".")[0]
        if number.isdigit() and f"{name}.{number}" not in head.set_aside:
            found.append((int(number), path))
    return [path for _, path in sorted(found)]


def _read(on: Bench, name: str, path: Path, head: MasterSettings) -> Record:
    """A recording from the beginning of its demand, by the largest correlation with the plan."""
    record = read_mapped(path, beside(path.parent, head.columns), on.plant.machine)
    known = head.digests.get(path.name)
    with within(path):
        if known is not None and record.digest != known:
            raise InputError(f"digest: {record.digest} is not the {known} of {FILE}")
        for channel in ("leg_reference", "leg_position"):
            if channel not in record.channels:
                raise InputError(f"{channel}: is missing; a test needs it")
        planned, given = on.legs(name, record.rate), record["leg_reference"]
        lag = 0
        if not head.simulated:
            moved = [
                (x - x[0]).sum(axis=1) if np.ptp((x - x[0]).sum(axis=1)) else x[:, 0]
                for x in (given, planned)
            ]
            lag = int(np.argmax(correlate(moved[0], moved[1], mode="full"))) - len(planned) + 1
        count = len(planned)
        if lag < 0 or lag + count > len(given) + 1:
            have = max(0, min(len(given) - lag, len(given))) / record.rate
            raise InputError(f"ends after {have:.1f} s; the test takes {count / record.rate:.1f} s")
        part = np.minimum(np.arange(lag, lag + count), len(given) - 1)
        off = np.abs(given[part] - planned).max() / np.ptp(planned, axis=0).max()
        if off > ALIKE:
            raise InputError(f"leg_reference: is {off:.0%} off what {name} demands")
        channels = {key: value[part] for key, value in record.channels.items()}
        cut = Record(np.arange(count) / record.rate, channels, record.units, record.metadata)
    return named(cut, on, name)


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
    """Difference that is found with the probability `POWER`."""
    limit: Annotated[float, Field(form=".3g")]  #: Largest size allowed; NaN for none.
    verdict: str


def smallest(n: int, m: int, level: float, degrees: float | None = None) -> float:
    """Change, in deviations of one repetition, that n of the master and m since find with `POWER`.

    `level` is the two-sided probability of a false alarm, `degrees` of freedom are by default
    n - 1. The noncentral t at its quantile: P(|t'| > t(level); c) = POWER, c sqrt(1/n + 1/m).

    >>> from cmf_mj.studies.guide_check import smallest
    >>> round(smallest(6, 2, 0.05), 2)
    2.97
    """
    degrees = n - 1.0 if degrees is None else degrees
    edge = float(stats.t.isf(level / 2.0, degrees))
    with warnings.catch_warnings():  # SciPy's series may run over far from the root
        warnings.simplefilter("ignore", RuntimeWarning)
        shift = optimize.brentq(
            lambda c: stats.nct.sf(edge, degrees, c) - POWER, 0.0, 20.0 * edge + 9.0
        )
    return float(shift * np.sqrt(1.0 / n + 1.0 / m))


class Signed(NamedTuple):
    """Signatures of a test's repetitions, of the master and since."""

    lines: Lines
    difference: Mapping[str, Array]  #: New less master's mean by channel, (rows, legs).
    deviation: Mapping[str, Array]  #: Of that difference, (rows, 1).
    degrees: Mapping[str, Array]  #: Of freedom of those, (rows, 1).

    @property
    def off(self) -> Array:
        """All differences over their deviations, (K,)."""
        return np.concatenate([(v / self.deviation[k]).ravel() for k, v in self.difference.items()])

    def worst(self) -> tuple[float, float]:
        """Student's t of the difference that is least by chance, and its degrees of freedom."""
        every = [
            np.broadcast_arrays(np.abs(v / self.deviation[k]), self.degrees[k])
            for k, v in self.difference.items()
        ]
        off, degrees = (np.concatenate([one[i].ravel() for one in every]) for i in (0, 1))
        least = int(np.argmin(stats.t.logsf(off, degrees)))
        return float(off[least]), float(degrees[least])


def signed(master: Master, new: Master, name: str) -> Signed:
    """Compare the signatures of a test; channels count that both have."""
    lines = master.bench.lines(name, master.records[name][0].rate)
    before, after = ([signature(r, lines) for r in one.records[name]] for one in (master, new))
    n, m, rows = len(before), len(after), lines.size
    difference, deviation, degrees = {}, {}, {}
    for channel in before[0].keys() & after[0].keys():
        old, now = (np.array([one[channel] for one in many]) for many in (before, after))
        variance = old.var(axis=0, ddof=1).mean(axis=1)
        parts = 0.5 * (variance[1 : 1 + rows] + variance[1 + rows :])
        pooled = np.concatenate([variance[:1], parts, parts])[:, None]
        floor = (_ROUND * np.abs(old).max()) ** 2
        difference[channel] = now.mean(axis=0) - old.mean(axis=0)
        deviation[channel] = np.sqrt(np.maximum(pooled, floor) * (1.0 / n + 1.0 / m))
        share = np.repeat([1.0, 2.0], [1, 2 * rows])[:, None]
        degrees[channel] = share * (n - 1.0)  # legs move together: they count as one
    return Signed(lines, difference, deviation, degrees)


def check_same(master: Master, new: Master) -> None:
    """Refuse what was not recorded by the same guide on the same machine."""
    for field, value in master.bench.known.items():
        other = new.bench.known[field]
        if other != value:
            raise InputError(f"{new.folder}: {field} is {other!r}; the master's is {value!r}")
    if dict(new.bench.of) != dict(master.bench.of):
        raise InputError(f"{new.folder}: its guide has other tests than the master's")
    few = [name for name, records in master.records.items() if len(records) < 2]
    if few:
        raise InputError(f"{master.folder}: {', '.join(few)}: one recording; allowed: at least 2")


def compare(master: Master, new: Master) -> list[Compared]:
    """Every measure and signature of every test; `verdict` says what has changed.

    Of a test that was aborted in either there is a row that says so.
    """
    check_same(master, new)
    names = [name for name in master.bench.commands if name in master.records]
    share = master.head.guide.false_alarm / (2.0 * len(names))
    found = []
    for name in master.bench.commands:
        if name not in master.records or name not in new.records:
            why = new.head.aborted.get(name) or master.head.aborted.get(name, "")
            none = float("nan")
            blank = (none, none, none, none, none, none, none)
            found.append(Compared(name, "", *blank, f"aborted: {why}"))
            continue
        mean = master.mean(name)
        old, now = master.measured(name, mean), new.measured(name, mean)
        limits = master.bench.of[name].limits
        count = max(1, len(old[0]) - 1)
        for measure in old[0]:
            before, after = (np.array([one[measure] for one in many]) for many in (old, now))
            if np.isnan(before).all() and np.isnan(after).all():
                continue
            limit = limits.get(measure, float("nan"))
            found.append(_measure(name, measure, before, after, share / count, limit))
        one = signed(master, new, name)
        (most, degrees), least = one.worst(), share / one.off.size
        edge = stats.t.isf(least / 2.0, degrees)
        seen = smallest(len(old), len(now), least, degrees)
        verdict = "changed" if most > edge else "as before"
        where = (0.0, 1.0, most, most, float(edge), seen, float("nan"))
        found.append(Compared(name, SIGNATURE, *where, verdict))
    return found


def _measure(
    test: str, measure: str, old: Array, now: Array, level: float, limit: float
) -> Compared:
    n, m = old.size, now.size
    before, after = old.mean(), now.mean()
    spread = max(float(old.std(ddof=1)), _ROUND * abs(before))
    edge = float(stats.t.isf(level / 2.0, n - 1))
    off = (after - before) / (spread * np.sqrt(1.0 / n + 1.0 / m))
    seen = spread * smallest(n, m, level)
    if measure == REPEATABLE:  # the master's own mean holds each of its repetitions
        off, edge, seen, after = float("nan"), float("nan"), float("nan"), now.max()
    gone = np.isnan(now).all() != np.isnan(old).all()
    verdict = "changed" if gone or abs(off) > edge else "as before"
    if abs(after) > limit:
        verdict = "beyond its limit"
    before, spread, after = float(before), float(spread), float(after)
    return Compared(test, measure, before, spread, after, float(off), edge, seen, limit, verdict)
