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
from cmf_mj.studies.guide import FILE, Bench, MasterSettings, make_bench
from cmf_mj.studies.measurement import MEASURES, SIGNATURE_CHANNELS, accelerations, signature

Array = NDArray[np.float64]

REPEATABLE = "repeatability [g]"
"""Measure of every test: largest linear acceleration off the master's mean history."""
SIGNATURE = "signature [deviations]"  #: The largest difference of a test's signature.
SOUGHT = 0.05  #: Change that repetitions shall find where no other is `sought`, of a measure.
SOUGHT_IN = {"[dB]": 0.5, "[deg]": 1.0, "[%]": 1.0, "[g]": 0.01}
"""Likewise of measures in these units, which may be next to nothing."""
SIGNATURE_SOUGHT = 10.0  #: Likewise of a signature [deviations].
MOST_REPETITIONS = 1000  #: That are stated; beyond they are infinitely many.
ALIKE = 0.05  #: How far a recorded demand may be off the plan's, over its range.
_ROUND_OFF = 1e-9  #: Deviation over the mean that is round-off.


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
        return np.array([history[:count] for history in histories])

    def measure_test(self, name: str, mean: Array) -> dict[str, Array]:
        """Measures of a test, each of all repetitions (n,); `mean` (N, 3) is of accelerations."""
        values: dict[str, list[float]] = {}
        for record in self.records[name]:
            for measure in self.bench.tests[name].measures:
                with within(f"{name}: {measure}"):
                    for measured_name, value in MEASURES[measure](record).items():
                        values.setdefault(measured_name, []).append(value)
        accelerations = self.accelerations(name)
        count = min(accelerations.shape[1], len(mean))
        errors = np.abs(accelerations[:, :count] - mean[:count]).max(axis=(1, 2))
        measures = {measure: np.array(each) for measure, each in values.items()}
        return measures | {REPEATABLE: errors / STANDARD_GRAVITY}


def load_master(folder: str | Path, bench: Bench | None = None) -> Master:
    """Read a master, or what was recorded since; `bench` is its guide on its machine, if at hand.

    Raises `InputError` that names the folder and the test that is missing, cut short or another's.
    """
    folder = Path(folder)
    file = folder / FILE
    if not file.is_file():
        raise InputError(f"{folder}: holds no {FILE}; allowed: a folder of cmf guide run or plan")
    head = validated(MasterSettings, read_toml(file), str(file))
    if bench is None:
        with within(file):
            parts = (head.machine, head.cab, head.hydraulics, head.law)
            bench = make_bench(head.guide, *(beside(folder, part) for part in parts))
    records, digests, missing = dict[str, list[Record]](), dict[str, str](), []
    for name in bench.commands:
        for path in _recording_files(folder, name, head):
            record, digests[path.name] = _read_test(bench, name, path, head)
            records.setdefault(name, []).append(record)
        if name not in records and name not in head.left_out:
            missing.append(name)
    if missing:
        allowed = "allowed: recordings of every test, or a reason under [left_out]"
        raise InputError(f"{folder}: {', '.join(missing)}: no recordings; {allowed}")
    return Master(folder, head.model_copy(update={"digests": digests}), bench, records)


def _recording_files(folder: Path, name: str, head: MasterSettings) -> list[Path]:
    """Recordings of a test that count, in the order of their numbers."""
    numbered = []
    for path in folder.glob(f"{name}.*"):
        number = path.name.removeprefix(f"{name}.").split(".")[0]
        if number.isdigit() and f"{name}.{number}" not in head.left_out:
            numbered.append((int(number), path))
    return [path for _, path in sorted(numbered)]


def _read_test(bench: Bench, name: str, path: Path, head: MasterSettings) -> tuple[Record, str]:
    """A recording of a test from the beginning of the test's demand, and the file's digest."""
    record = read_mapped(path, beside(path.parent, head.columns), bench.plant.machine)
    digest = head.digests.get(path.name, record.digest)
    with within(path):
        if record.digest != digest:
            raise InputError(f"digest: {record.digest} is not the {digest} of {FILE}")
        for channel in ("leg_reference", "leg_position"):
            if channel not in record.channels:
                raise InputError(f"{channel}: is missing; a test needs it")
        planned, demand = bench.legs(name, record.rate), record["leg_reference"]
        count, size = len(planned), len(demand)
        first = 0 if head.simulated else _first_row(demand, planned)
        if first < 0 or first + count > size + 1:
            seconds = max(0, min(size - first, size)) / record.rate
            needed = count / record.rate
            raise InputError(f"ends after {seconds:.1f} s; the test takes {needed:.1f} s")
        rows = np.minimum(np.arange(first, first + count), size - 1)
        error = np.abs(demand[rows] - planned).max() / np.ptp(planned, axis=0).max()
        if error > ALIKE:
            raise InputError(f"leg_reference: is {error:.0%} off what {name} demands")
        channels = {key: value[rows] for key, value in record.channels.items()}
        metadata = {**record.metadata, **bench.metadata(name)}
        time = np.arange(count) / record.rate
        return Record(time, channels, record.units, metadata), record.digest


def _first_row(demand: Array, planned: Array) -> int:
    """Where a demand looks most like the plan's, by the sum of its legs, or leg 1."""
    sums = [(legs - legs[0]).sum(axis=1) for legs in (demand, planned)]
    demand, planned = (
        total if np.ptp(total) else legs[:, 0]
        for total, legs in zip(sums, (demand, planned), strict=True)
    )
    return int(np.argmax(correlate(demand, planned, mode="full"))) - len(planned) + 1


class Compared(NamedTuple):
    """One measure of a test, of the master and since."""

    test: str
    measure: str
    master: Annotated[float, Field(form=".4g")] = np.nan
    spread: Annotated[float, Field("", "deviation", ".2g", about="of the master's repetitions")] = (
        np.nan
    )
    new: Annotated[float, Field("", "now", ".4g")] = np.nan
    off: Annotated[float, Field("", "t", ".1f")] = np.nan  #: Student's t of the difference.
    level: Annotated[float, Field("", "alarm from", ".1f")] = np.nan
    """Largest t without an alarm."""
    found: Annotated[float, Field("", "found from", ".2g")] = np.nan
    """Difference that is found with the guide's `power`."""
    sought: Annotated[float, Field("", "sought", ".2g", about="a difference to be found")] = np.nan
    repetitions: Annotated[
        float, Field("", "takes", ".0f", about="of master and now to find it")
    ] = np.nan
    limit: Annotated[float, Field(form=".3g")] = np.nan  #: Largest size allowed.
    verdict: str = ""


@lru_cache
def smallest_change(n: int, m: int, level: float, degrees: float, power: float = 0.9) -> float:
    """Change, in deviations of one repetition, that n of the master and m since find with `power`.

    `level` is the two-sided probability of a false alarm. The noncentral t of d degrees of freedom
    at its quantile e: c sqrt(1/n + 1/m), where the mean over a normal z of P(chi^2_d < d (c + z)^2
    / e^2) is `power`. SciPy's own inverse searches for ever where e is large. NaN without a degree.

    >>> from cmf_mj.studies.guide_check import smallest_change
    >>> round(smallest_change(6, 2, 0.05, degrees=5), 2)
    3.34
    """
    if not degrees > 0.0:
        return float("nan")
    edge, half = float(stats.t.isf(level / 2.0, degrees)), degrees / 2.0
    z = np.linspace(-8.0, 8.0, 1601)
    weight = np.exp(-0.5 * z * z) / np.exp(-0.5 * z * z).sum()

    def missing_power(c: float) -> float:
        found = special.gammainc(half, half * (np.maximum(c + z, 0.0) / edge) ** 2)
        return power - float(weight @ found)

    largest = 10.0 + edge * np.sqrt(special.gammainccinv(half, 0.01 * (1.0 - power)) / half)
    return float(optimize.brentq(missing_power, 0.0, largest) * np.sqrt(1.0 / n + 1.0 / m))


def enough_repetitions(change: float, level: float, degrees: float, power: float = 0.9) -> float:
    """Repetitions, as many of the master as since, that find a change in deviations of one.

    `degrees` are those of freedom that each but the first adds; all else as in `smallest_change`.

    >>> from cmf_mj.studies.guide_check import enough_repetitions
    >>> enough_repetitions(3.0, 0.05, degrees=1)
    5.0
    """
    if not change > 0.0:
        return float("nan")

    def suffice(n: int) -> bool:
        return smallest_change(n, n, level, degrees * (n - 1.0), power) <= change

    least = 2 + bisect_left(range(2, MOST_REPETITIONS + 1), True, key=suffice)
    return float(least if least <= MOST_REPETITIONS else "inf")


class SignatureChange(NamedTuple):
    """What has changed in the signature of a test."""

    difference: Array  #: New less master's mean, (channels, rows, legs).
    deviation: Array  #: Of that difference, (channels, rows, 1).
    degrees: Array  #: Of freedom of those, (rows, 1).

    def least_likely(self) -> tuple[float, float]:
        """Student's t of the difference that is least by chance, and its degrees of freedom."""
        # What differs by nothing is by chance, also where nothing is all there ever was.
        t = np.abs(self.difference)
        np.divide(t, self.deviation, out=t, where=self.difference != 0.0)
        degrees = np.broadcast_to(self.degrees, t.shape)
        worst = np.unravel_index(int(np.argmin(stats.t.logsf(t, degrees))), t.shape)
        return float(t[worst]), float(degrees[worst])


def compare_signatures(
    master: Master, new: Master, name: str, channels: Sequence[str] = ()
) -> SignatureChange:
    """Compare the signatures of a test, of some channels or all that both have."""
    old_records, new_records = master.records[name], new.records[name]
    both = old_records[0].channels.keys() & new_records[0].channels.keys()
    channels = channels or [channel for channel in SIGNATURE_CHANNELS if channel in both]
    lines = master.bench.lines(name, old_records[0].rate)
    old = np.array([signature(record, lines, channels) for record in old_records])
    now = np.array([signature(record, lines, channels) for record in new_records])
    n, m, line_count = len(old), len(now), lines.size
    variance = (_deviation(old) ** 2).mean(axis=2)
    mean, real, imaginary = np.split(variance, [1, 1 + line_count], axis=1)
    of_lines = 0.5 * (real + imaginary)
    pooled = np.concatenate([mean, of_lines, of_lines], axis=1)[:, :, None]
    floor = (_ROUND_OFF * np.abs(old).max(axis=(0, 2, 3))[:, None, None]) ** 2
    deviation = np.sqrt(np.maximum(pooled, floor) * (1.0 / n + 1.0 / m))
    share = np.repeat([1.0, 2.0], [1, 2 * line_count])[:, None]
    degrees = share * (n - 1.0)  # legs move together: they count as one
    return SignatureChange(now.mean(axis=0) - old.mean(axis=0), deviation, degrees)


def _deviation(values: Array) -> Array:
    """Of repetitions (n, ...); NaN of one alone."""
    alone = np.full(values.shape[1:], np.nan)
    return np.asarray(values.std(axis=0, ddof=1)) if len(values) > 1 else alone


def check_same(master: Master, new: Master) -> None:
    """Refuse what was not recorded by the same guide on the same machine."""
    for field, value in master.bench.identity.items():
        other = new.bench.identity[field]
        if other != value:
            raise InputError(f"{new.folder}: {field} is {other!r}; the master's is {value!r}")
    if dict(new.bench.tests) != dict(master.bench.tests):
        raise InputError(f"{new.folder}: its guide has other tests than the master's")
    for name in master.records.keys() & new.records.keys():
        rate, other_rate = master.records[name][0].rate, new.records[name][0].rate
        if not np.isclose(rate, other_rate, rtol=1e-3):
            text = f"has {other_rate:g} samples a second; the master's {rate:g}"
            raise InputError(f"{new.folder}: {name}: {text}")
    names = [name for name, records in master.records.items() if len(records) < 2]
    if names:
        raise InputError(f"{master.folder}: {', '.join(names)}: one recording; allowed: at least 2")


def compare(master: Master, new: Master) -> list[Compared]:
    """Every measure and signature of every test; `verdict` says what has changed.

    Of a test that was left out in either there is a row that says so. A master beside itself has
    its own measures, spreads, and what as many repetitions again would find.
    """
    if new is not master:
        check_same(master, new)
    guide, rows = master.head.guide, []
    level = guide.false_alarm / (2.0 * max(1, len(master.records)))
    for name in master.bench.commands:
        if name not in master.records or name not in new.records:
            reason = new.head.left_out.get(name) or master.head.left_out.get(name, "")
            rows.append(Compared(name, "", verdict=f"left out: {reason}"))
            continue
        mean, test = master.accelerations(name).mean(axis=0), master.bench.tests[name]
        old, now = master.measure_test(name, mean), new.measure_test(name, mean)
        level_of_measure = level / max(1, len(old) - 1)
        for measure, values in old.items():
            if np.isnan(values).all() and np.isnan(now[measure]).all():
                continue
            limit = test.limits.get(measure, np.nan)
            sought = test.sought.get(measure, limit)
            row = _compare_measure(
                name, measure, values, now[measure], level_of_measure, limit, sought, guide.power
            )
            rows.append(row)
        rows.append(_compare_signature(master, new, name, level))
    return rows


def _compare_signature(master: Master, new: Master, name: str, level: float) -> Compared:
    """The signature of a test; `level` is of all its alarms."""
    change, power = compare_signatures(master, new, name), master.head.guide.power
    (t, degrees), level = change.least_likely(), level / change.difference.size
    edge = float(stats.t.isf(level / 2.0, degrees))
    n, m = len(master.records[name]), len(new.records[name])
    sought = master.bench.tests[name].sought.get(SIGNATURE, SIGNATURE_SOUGHT)
    found = smallest_change(n, m, level, degrees, power)
    repetitions = enough_repetitions(sought, level, degrees / max(n - 1, 1), power)
    row = Compared(name, SIGNATURE, master=0.0, spread=1.0, new=t, off=t, level=edge, found=found)
    verdict = "changed" if t > edge else "as before"
    return row._replace(sought=sought, repetitions=repetitions, verdict=verdict)


def _compare_measure(
    test: str,
    measure: str,
    old: Array,
    now: Array,
    level: float,
    limit: float = np.nan,
    sought: float = np.nan,
    power: float = 0.9,
) -> Compared:
    """A measure in repetitions of the master (n,) and since (m,), NaN where one has none.

    `level` is that of its alarm; without a `limit` or a change that is `sought` these are NaN.
    """
    all_or_none = {float(np.isnan(values).mean()) for values in (old, now)} == {0.0, 1.0}
    order_count = comb(old.size + now.size, now.size)  # that chance may give them
    has_changed = all_or_none and 1.0 / order_count < level
    old_known, now_known = old[~np.isnan(old)], now[~np.isnan(now)]
    if old_known.size > 1 and now_known.size:  # judged by the repetitions that have the measure
        old, now = old_known, now_known
    n, m = old.size, now.size
    before, after = float(old.mean()), float(now.mean())
    spread = float(np.maximum(_deviation(old), _ROUND_OFF * abs(before)))
    row = Compared(test, measure, before, spread, new=after, limit=limit)
    if measure == REPEATABLE:  # the master's own mean holds each of its repetitions
        row = row._replace(new=float(now.max()))
    else:
        if np.isnan(sought):
            sought = SOUGHT_IN.get(measure.rpartition(" ")[2], SOUGHT * abs(before))
        t = float((after - before) / (spread * np.sqrt(1.0 / n + 1.0 / m)))
        edge = float(stats.t.isf(level / 2.0, n - 1))
        found = spread * smallest_change(n, m, level, n - 1.0, power)
        needed = enough_repetitions(sought / spread, level, 1.0, power) if spread else np.nan
        row = row._replace(off=t, level=edge, found=found, sought=sought, repetitions=needed)
        has_changed = has_changed or abs(t) > edge
    if abs(row.new) > limit:
        return row._replace(verdict="beyond its limit")
    return row._replace(verdict="changed" if has_changed else "as before")
