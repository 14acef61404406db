"""Search for a host that the demand does not stay near: `python scripts/search_amplification.py`.

Evolution over all that a host may do wrong with a small sine below 1 Hz: rate, speed of its clock
in pieces, a repeated pattern of delays, jitter, losses, derivatives that are wrong, and the
operator's requests between hold and engage. Prints the largest gain of the demand in position, of
the acceleration of a host with ordinary jitter, and of the leg reference under requests, over the
host's range and the way of a stop, each with the host that had it. `--minutes 60` before a
release; same seed and count of trials, same result.
"""

import argparse
import csv
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.dcu.play import Arrivals, upsample
from cmf_mj.control.dcu.state import make_dcu, resting
from cmf_mj.control.limiter import make_leg_limiter, make_pose_limiter
from cmf_mj.control.states import Request, State, make_states
from cmf_mj.core.compiled import allocating
from cmf_mj.facility.front import Blocks, follow, from_host
from cmf_mj.facility.host.stream import differentiate
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.machine.machine import load_machine

Array = NDArray[np.float64]

RATE, SECONDS, FADE = 2048, 9.0, 1.5
AMPLITUDE = 0.005
"""Of the sine in heave [m]."""

DELAYS, SPEEDS, REQUESTS = 24, 6, 16
GENES = 9 + DELAYS + SPEEDS + REQUESTS
DERIVATIVES = ("exact", "spline", "zero", "delayed", "noisy")
DCU, STATES = make_dcu(), make_states()
BLOCKS = Blocks(DCU, make_pose_limiter(), load_machine().geometry, STATES, make_leg_limiter())


class Host(NamedTuple):
    """A host and how it keeps to its stamps."""

    rate: float  #: Frames in a second of its own [Hz].
    frequency: float  #: Largest of its sine in real time [Hz].
    phase: float  #: [rad].
    jitter: float  #: [s].
    loss: float  #: Share.
    derivatives: str
    error: float  #: Of noisy derivatives, share.
    pattern: tuple[float, ...]  #: Delays of frame after frame, repeated [s]; inf is lost.
    speeds: tuple[float, ...]  #: Of its clock, one after the other, repeated.
    lasting: float  #: How long each [s].
    requests: tuple[float, ...] = ()  #: Times of hold, engage, hold ... [s].


def host_of(genes: Array) -> Host:
    """The host of numbers from 0 to 1."""
    delays, speeds, _ = np.split(genes[9:], [DELAYS, DELAYS + SPEEDS])
    length = 1 + int(genes[6] * (DELAYS - 1e-9))
    return Host(
        rate=float(20.0 * 6.0 ** genes[0]),
        frequency=float(0.1 * 10.0 ** genes[1]),
        phase=float(2.0 * np.pi * genes[2]),
        jitter=float(0.03 * genes[3] ** 2),
        loss=float(0.5 * genes[4] ** 2),
        derivatives=DERIVATIVES[int(genes[5] * (len(DERIVATIVES) - 1e-9))],
        error=float(genes[7]),
        pattern=tuple((0.24 * delays[:length] ** 3).tolist()),
        speeds=tuple((0.5 * 4.0**speeds).tolist()),
        lasting=float(0.25 * 12.0 ** genes[8]),
    )


def ordinary_of(genes: Array) -> Host:
    """A host of 40 to 120 Hz without clock, whose frames come up to 2 ms early or late."""
    host = host_of(genes)
    rate, frequency = float(40.0 * 3.0 ** genes[0]), float(0.2 * 5.0 ** genes[1])
    host = host._replace(rate=rate, frequency=frequency, jitter=float(0.004 * genes[3]))
    return host._replace(loss=0.0, pattern=(0.0,), speeds=(1.0,))


def requested_of(genes: Array) -> Host:
    """Any host, and an operator who goes to and fro between hold and engaged."""
    times = np.sort(genes[-REQUESTS:] * SECONDS)
    return host_of(genes)._replace(requests=tuple(times.tolist()))


def arrivals_of(host: Host, seed: int) -> tuple[Arrivals, float]:
    """Its frames as they arrive, and the frequency of its sine in its own time [Hz]."""
    random = np.random.default_rng(seed)
    count = round(SECONDS * host.rate * max(host.speeds))
    time = np.arange(count) / host.rate
    piece = (time / host.lasting).astype(int) % len(host.speeds)
    when = np.cumsum(1.0 / (host.rate * np.array(host.speeds)[piece]))
    delay = np.resize(np.array(host.pattern), count)
    when += np.where(delay < np.inf, delay, 0.0) + host.jitter * random.uniform(size=count)
    when = np.maximum.accumulate(when)
    frequency = host.frequency / max(host.speeds)
    values = np.zeros((count, 3, 6))
    values[:, :, 2] = motion(time, frequency, host.phase)
    if host.derivatives == "zero":
        values[:, 1:] = 0.0
    elif host.derivatives == "spline":
        values[:, 1], values[:, 2] = differentiate(time, values[:, 0])
    elif host.derivatives == "delayed":
        values[1:, 1:] = values[:-1, 1:]
    elif host.derivatives == "noisy":
        size = host.error * np.abs(values[:, 1:, 2]).max(axis=0)
        values[:, 1:, 2] += size * random.normal(size=(count, 2))
    sent = random.uniform(size=count) >= host.loss
    sent[:2] = True
    sent &= (when < SECONDS) & (delay < np.inf)
    frame = np.ceil(when * RATE).astype(np.int64)
    return Arrivals(frame[sent], np.arange(count)[sent], time[sent], values[sent]), frequency


def motion(time: Array, frequency: float, phase: float) -> Array:
    """A sine that fades in over `FADE`, with its derivatives, (N, 3)."""
    turn, x = 2.0 * np.pi * frequency, np.clip(time / FADE, 0.0, 1.0)
    fade = x**3 * (10.0 - 15.0 * x + 6.0 * x * x)
    rise = 30.0 * (x * (1.0 - x)) ** 2 / FADE
    bend = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / FADE**2
    sine, cosine = np.sin(turn * time + phase), np.cos(turn * time + phase)
    first = rise * sine + fade * turn * cosine
    second = bend * sine + 2.0 * rise * turn * cosine - fade * turn * turn * sine
    return AMPLITUDE * np.column_stack([fade * sine, first, second])


def demand_of(host: Host, seed: int) -> Array:
    """Demand in heave and its derivatives, (N, 3)."""
    arrivals, _ = arrivals_of(host, seed)
    return upsample(DCU, resting(DCU), arrivals, round(SECONDS * RATE))[:, :, 2]


def position_gain(host: Host, seed: int) -> float:
    """Largest demand over the sine's amplitude."""
    return float(np.abs(demand_of(host, seed)[:, 0]).max() / AMPLITUDE)


def acceleration_gain(host: Host, seed: int) -> float:
    """Largest acceleration over the sine's, after the start."""
    turn = 2.0 * np.pi * host.frequency
    late = demand_of(host, seed)[round(2.0 * FADE * RATE) :, 2]
    return float(np.abs(late).max() / (AMPLITUDE * turn * turn))


def jitter_gain(host: Host, seed: int) -> float:
    """Largest acceleration over that of the same frames, errors and all, on time."""
    return acceleration_gain(host, seed) / max(
        acceleration_gain(host._replace(jitter=0.0), seed), 1.0
    )


@allocating
def _advance(source, out):  # type: ignore[no-untyped-def]
    """Legs that follow at once."""
    position = np.zeros(6)
    for frame in range(out.shape[0]):
        follow(source, frame, position, 0, False, out[frame])
        position[:] = out[frame]


def leg_gain(host: Host, seed: int) -> float:
    """Largest leg reference over the host's range and the stop from its motion."""
    names = (Request.HOLD, Request.ENGAGE)
    requests = [(round(t * RATE), names[k % 2]) for k, t in enumerate(host.requests)]
    rest, out = np.zeros(6), np.empty((round(SECONDS * RATE), 6))
    arrivals, _ = arrivals_of(host, seed)
    source = from_host(BLOCKS, arrivals, requests, State.ENGAGED, position=rest, pose=rest)
    _advance(source, out)
    turn, stop = 2.0 * np.pi * host.frequency, STATES.stop_time
    reach = AMPLITUDE * (1.0 + turn * stop / 2.0 + turn * turn * stop * stop / 16.0)
    legs = pose_to_legs(np.array([[0.0, 0.0, sign * reach, 0.0, 0.0, 0.0] for sign in (-1, 1)]))
    return float(np.abs(out).max() / np.abs(legs).max())


class Search(NamedTuple):
    """What is searched for the largest."""

    name: str
    host: Callable[[Array], Host]
    gain: Callable[[Host, int], float]


SEARCHES = (
    Search("position", host_of, position_gain),
    Search("acceleration, ordinary jitter", ordinary_of, jitter_gain),
    Search("leg reference, hold and engage", requested_of, leg_gain),
)

PARENTS = 12


def evolve(
    search: Search, seed: int, trials: int, until: float = np.inf
) -> tuple[float, Host, int]:
    """Largest gain, its host, and trials made, of at most some, until a time of the clock [s]."""
    random = np.random.default_rng(seed)
    pool: list[tuple[float, Array]] = []
    made = 0
    while made < trials and time.monotonic() < until:
        genes = random.uniform(size=GENES)
        if made % 4 and len(pool) == PARENTS:  # three of four from the best, one from anywhere
            genes = pool[random.integers(PARENTS)][1].copy()
            other = pool[random.integers(PARENTS)][1]
            swapped = random.uniform(size=GENES) < 0.2
            genes[swapped] = other[swapped]
            moved = random.uniform(size=GENES) < 0.25
            genes[moved] += 0.2 * random.normal(size=int(moved.sum()))
            genes = np.clip(genes, 0.0, 1.0)
        pool.append((search.gain(search.host(genes), seed), genes))
        pool.sort(key=lambda one: -one[0])
        del pool[PARENTS:]
        made += 1
    return pool[0][0], search.host(pool[0][1]), made


def main() -> None:
    """Search for some minutes or trials and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=1.0, help="for all searches together")
    parser.add_argument("--trials", type=int, default=10**9, help="most trials of a search")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="CSV file for what was found")
    options = parser.parse_args()
    rows = []
    for search in SEARCHES:
        evolve(search, options.seed, 1)  # compiles
        until = time.monotonic() + 60.0 * options.minutes / len(SEARCHES)
        gain, host, made = evolve(search, options.seed, options.trials, until)
        print(f"{search.name}: largest gain {gain:.3f} of {made} hosts\n  {host}", flush=True)
        rows.append((search.name, f"{gain:.4f}", made, options.seed, host))
    if options.out:
        with options.out.open("w", newline="") as file:
            csv.writer(file).writerows([("gain of", "largest", "hosts", "seed", "host"), *rows])


if __name__ == "__main__":
    main()
