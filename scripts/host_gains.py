"""How much of a host's small motion the demand and the platform make, whatever its timing.

Each row is a kind of host, run at several rates, with several derivatives and frequencies; it holds
the largest gains found: of the demand in position and acceleration over the host's motion as it is
in real time, and of the platform over what the same law makes of the clean stream of that motion.
Native hosts differ in `search_amplification.py`'s ways; Moog clients and telemetry go through their
doors. `python scripts/host_gains.py` takes some minutes.
"""

import argparse
import itertools
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from faults.plans import Oddity, Plan
from faults.runs import run
from numpy.typing import NDArray
from search_amplification import (
    AMPLITUDE,
    DERIVATIVES,
    FADE,
    SECONDS,
    Host,
    acceleration_gain,
    arrivals_of,
    position_gain,
)

from cmf_mj import Hexapod
from cmf_mj.core.result import Table
from cmf_mj.facility.operation import operate
from cmf_mj.machine.geometry import DOFS

RATES = (20.0, 25.0, 40.0, 58.0, 72.0, 80.0, 100.0, 120.0)
FREQUENCIES = (0.2, 0.9)
LAW = "velocity"


class Row(NamedTuple):
    """The largest of a kind of host."""

    host: str
    hosts: int
    position: float  #: Demand over host.
    position_case: str
    acceleration: float  #: Demand over host.
    acceleration_case: str
    platform: float  #: Position, over that of the clean stream, in the larger of the two cases.


def stalls(rate: float, length: float, lost: bool) -> tuple[float, ...]:
    """Delays of a host that stalls for a time in every half second, then sends or drops frames."""
    left = length - np.arange(round(rate / 2)) / rate
    return tuple(np.where(left > 0.0, np.inf if lost else left, 0.0).tolist())


def natives() -> Iterator[tuple[str, list[Host]]]:
    """Kinds of native hosts."""

    def hosts(**changes: Any) -> list[Host]:
        made = []
        for rate, name, frequency in itertools.product(RATES, DERIVATIVES, FREQUENCIES):
            host = Host(rate, frequency, 0.0, 0.0, 0.0, name, 0.2, (0.0,), (1.0,), 1.0)
            own = {key: value(rate) if callable(value) else value for key, value in changes.items()}
            made.append(host._replace(**own))
        return made

    yield "on time", hosts()
    for kind, speeds in (
        ("slow, 0.5 to 0.97 of real time", (0.5, 0.6, 0.7, 0.8, 0.9, 0.965, 0.97)),
        ("fast, 1.03 to 2", (1.03, 1.1, 1.25, 1.5, 1.75, 2.0)),
    ):
        yield kind, [host for speed in speeds for host in hosts(speeds=(speed,))]
    changing = ((1.0, 0.75), (1.0, 0.9), (1.0, 1.4), (0.5, 2.0))
    yield (
        "changing speed every 0.3 to 2 s",
        [
            h
            for s, t in itertools.product(changing, (0.3, 1.0, 2.0))
            for h in hosts(speeds=s, lasting=t)
        ],
    )
    yield "10 to 50 % lost", [h for share in (0.1, 0.3, 0.5) for h in hosts(loss=share)]
    yield "jitter to 10, 20, 30 ms", [h for j in (0.01, 0.02, 0.03) for h in hosts(jitter=j)]
    for kind, lost in (("stalls, then sends all", False), ("falls silent", True)):
        yield (
            f"{kind}: 0.05, 0.14, 0.2 s in 0.5 s",
            [
                h
                for length in (0.05, 0.14, 0.2)
                for h in hosts(pattern=lambda rate, s=length: stalls(rate, s, lost))  # noqa: B023
            ],
        )


def native_row(kind: str, hosts: list[Host]) -> Row:
    """Gains of native hosts; the platform's is the larger of the two cases."""
    position = [position_gain(host, 0) for host in hosts]
    acceleration = [acceleration_gain(host, 0) for host in hosts]
    worst, harsh = hosts[int(np.argmax(position))], hosts[int(np.argmax(acceleration))]
    return Row(
        kind, len(hosts), max(position), words(worst), max(acceleration), words(harsh),
        max(platform(host) / platform(clean(host)) for host in {worst, harsh}),
    )  # fmt: skip


def clean(host: Host) -> Host:
    """The same motion, exact and on time."""
    return Host(80.0, host.frequency, 0.0, 0.0, 0.0, "exact", 0.0, (0.0,), (1.0,), 1.0)


def words(host: Host) -> str:
    """A host in a few words."""
    speeds = " and ".join(f"{speed:g}" for speed in host.speeds)
    told = f"{host.rate:g} Hz, sine {host.frequency:g} Hz, {host.derivatives}"
    told += "" if host.speeds == (1.0,) else f", speed {speeds}"
    told += f", each {host.lasting:g} s" if len(host.speeds) > 1 else ""
    told += f", {host.loss:.0%} lost" if host.loss else ""
    told += f", jitter {1e3 * host.jitter:g} ms" if host.jitter else ""
    stalled = sum(delay > 0.0 for delay in host.pattern) / host.rate
    return told + (f", stalls {stalled:.2f} s" if stalled else "")


@lru_cache
def platform(host: Host) -> float:
    """Largest heave of the platform [m]; the host watchdog would stop it in 0.1 s of silence."""
    arrivals, _ = arrivals_of(host, 0)
    record = operate(
        Hexapod(), LAW, arrivals, seconds=SECONDS, record_every=8, protection=None
    ).record
    return float(np.abs(record["platform_pose"][:, 2]).max())


def doors() -> Iterator[tuple[str, list[Plan]]]:
    """Kinds of hosts at the other doors."""
    plain = Plan(seconds=SECONDS, law=LAW, amplitude=AMPLITUDE, piece=400)

    def plans(door: str, rate: float, *oddities: Oddity, speed: float = 1.0) -> list[Plan]:
        own = replace(plain, door=door, rate=rate, oddities=oddities, speed=speed)
        if door == "telemetry":
            own = replace(own, dof="surge")  # the washout tilts for it
        return [replace(own, frequency=frequency / speed) for frequency in FREQUENCIES]

    def odd(kind: str, size: float, length: float = SECONDS) -> Oddity:
        return Oddity(kind, 1.0, length, size)

    def stalled(door: str, rate: float, length: float) -> list[Plan]:
        kinds = ("skip", "burst")
        return [plan for kind in kinds for plan in plans(door, rate, odd(kind, length))]

    rates = (40.0, 50.0, 55.0, 60.0, 61.0, 72.0, 90.0, 120.0)
    yield "Moog, 40 to 120 commands a second", [p for r in rates for p in plans("moog", r)]
    yield (
        "Moog, falls from 60 to 55 Hz",
        [p for t in (2.0, SECONDS) for p in plans("moog", 60.0, odd("rate", 55.0 / 60.0, t))],
    )
    yield "Moog, jitter to 4 ms", plans("moog", 60.0, odd("jitter", 0.004))
    yield "Moog, stalls for 0.08 s in 0.5 s", stalled("moog", 60.0, 0.08)
    yield "Moog, a fifth of all lost", plans("moog", 60.0, odd("loss", 0.2))
    yield "telemetry, stalls for 0.14 s in 0.5 s", stalled("telemetry", 80.0, 0.14)
    yield (
        "telemetry, slow and fast",
        [p for s in (0.5, 0.75, 1.5) for p in plans("telemetry", 80.0, speed=s)],
    )


def door_row(kind: str, plans: list[Plan]) -> Row:
    """Gains at a door: over the host, of telemetry over the same through a clean run."""
    found, told = [], []
    for plan in plans:
        hertz = plan.frequency * plan.speed
        plain = replace(plan, oddities=(), rate=80.0, speed=1.0, frequency=hertz)
        if plan.door == "moog":
            plain = replace(plain, door="native")
        found.append(peaks(plan) / peaks(plain))
        odd = [f"speed {plan.speed:g}"] if plan.speed != 1.0 else []
        odd += [f"{o.kind} {o.size:.3g}" for o in plan.oddities]
        told.append(", ".join([f"{plan.rate:g} Hz, sine {hertz:g} Hz", *odd]))
    gains = np.array(found)
    (worst, harsh, _), most = gains.argmax(axis=0).tolist(), gains.max(axis=0).tolist()
    return Row(kind, len(plans), most[0], told[worst], most[1], told[harsh], most[2])


@lru_cache
def peaks(plan: Plan) -> NDArray[np.float64]:
    """Largest demand, its acceleration after the start, and largest pose of the platform."""
    record = run(plan).parts[0].operation.record
    assert record.metadata["fault"] is None, plan.text()
    late = record.time > 2.0 * FADE
    column = DOFS.index(plan.dof)
    demand, platform = record["demand_pose"], record["platform_pose"]
    peak = [demand, record["demand_acceleration"][late], platform]
    return np.array([np.abs(values[:, column]).max() for values in peak])


def table(rows: list[Row]) -> Table:
    """All rows, the cases in words."""
    columns = (
        "host", ("hosts", "d"), ("position", ".3f"), "largest with", ("acceleration", ".1f"),
        "largest with ", ("platform", ".3f"),
    )  # fmt: skip
    return Table("Largest gains", columns, rows)


def main() -> None:
    """Print the rows and write them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/host_gains"), help="folder")
    out = parser.parse_args().out
    rows: list[Row] = []
    found = itertools.chain(
        itertools.starmap(native_row, natives()), itertools.starmap(door_row, doors())
    )
    for row in found:
        print(row, flush=True)
        rows.append(row)
    out.mkdir(parents=True, exist_ok=True)
    made = table(rows)
    made.save(out / "host_gains.csv")
    made.save(out / "host_gains.md")


if __name__ == "__main__":
    main()
