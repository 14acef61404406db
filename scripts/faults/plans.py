"""What a seed decides: one run of the whole system as data, and the simpler runs next to it."""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, NamedTuple

import numpy as np

from cmf_mj.control.law import law_names
from cmf_mj.machine.geometry import DOFS
from cmf_mj.plant.events import KINDS

MACHINES = ("cmf/gfd", "cmf/rfd", "cmf/ifd", "simona", "lab", "new")
"""Machine and cab; `new` is a file that `cmf machine new` writes."""

FOREIGN = ("original", "velocity")
"""Laws of the CMF that run on other machines: the rest are tuned to its mass and oil, and some
of them burst a lighter machine's chamber before a fault can be detected."""

DOORS = ("native", "moog", "telemetry")
"""How the host reaches the machine."""

DERIVATIVES = ("exact", "zero", "delayed", "noisy")
"""What a native host says of velocity and acceleration."""

JUMPS = ("second", "wild", "restart", "silent")
"""Oddities with which a host jumps, or stops, by itself."""

_SIZES = {
    "jitter": (1e-3, 0.03),
    "loss": (0.02, 0.5),
    "double": (0.05, 0.5),
    "late": (0.05, 0.3),
    "not_finite": (0.02, 0.2),
    "wild": (0.02, 0.2),
    "garbage": (0.05, 1.0),
    "burst": (0.02, 0.2),
    "skip": (0.02, 0.2),
    "freeze": (0.02, 0.2),
    "second": (0.1, 1.0),
    "silent": (0.0, 0.0),
    "restart": (0.0, 0.0),
    "rate": (0.6, 1.6),
}

ODDITIES = tuple(_SIZES)
"""What may befall the datagrams of a host, while it lasts, and its size:

jitter      each arrives late by up to the size [s], in order
loss        a share is lost
double      a share arrives twice, the second up to 20 ms later
late        a share arrives 10 to 60 ms late, behind its successors
not_finite  a share holds a number that is not finite, a fifth of it the stamp too
wild        a share holds a pose of metres
garbage     octets of a stranger between, so many to a frame
burst       the host stalls twice a second for the size [s] and then sends what was due
skip        it stalls alike and never sends it
freeze      it stalls alike and its clock stands still meanwhile
second      another host sends to the same port, its amplitude the size times the first's
silent      nothing is sent
restart     sequence and stamps begin anew at the beginning
rate        frames a second are the size times the plan's; stamps tell it
"""


class Oddity(NamedTuple):
    """What befalls the datagrams of a host."""

    kind: str  #: One of `ODDITIES`.
    at: float  #: From then on [s].
    length: float  #: So long [s].
    size: float  #: How much.


class Action(NamedTuple):
    """What the operator does, or what breaks."""

    at: float  #: When [s].
    kind: str  #: `request`, `law`, `event` or `kill`.
    what: str = ""  #: Name of the request, the law or the event.
    where: int = 1  #: Leg of an event that has one.


@dataclass(frozen=True)
class Plan:
    """One run; the defaults are the plain one."""

    seconds: float = 4.0  #: Length [s].
    machine: str = "cmf/gfd"  #: One of `MACHINES`.
    control_rate: int = 2048  #: Of a `new` machine [Hz].
    law: str = ""  #: At the start; empty for the machine's.
    hydraulics: str = ""  #: A set of the CMF; empty for the machine's.
    electronics: str = ""  #: `ideal`, `noisy`, or empty for none.
    door: str = "native"  #: One of `DOORS`.
    begin: str = "engaged"  #: Operating state to begin in.
    dof: str = "heave"  #: Degree of freedom that the host moves.
    amplitude: float = 0.01  #: Of its sine [m or rad].
    frequency: float = 0.5  #: In the host's own time [Hz].
    rate: float = 80.0
    """Frames a second in the host's own time [Hz]; 20 to 120 in the machine's."""
    speed: float = 1.0  #: Seconds of the host in one of the machine's.
    derivatives: str = "exact"  #: One of `DERIVATIVES`.
    piece: int = 200  #: Most control frames run in one part.
    disk: str = ""  #: `full` or `kill`: how the first saving ends.
    way_out: float = 0.0  #: Time the operator has afterwards to engage again [s]; 0 for none.
    oddities: tuple[Oddity, ...] = ()
    actions: tuple[Action, ...] = ()
    seed: int = field(default=0)  #: Of noise and shares.

    def text(self) -> str:
        """What differs from the plain plan, as JSON."""
        plain, own = asdict(Plan()), asdict(self)
        return json.dumps({name: own[name] for name in own if own[name] != plain[name]})

    @staticmethod
    def read(text: str) -> "Plan":
        """The plan of a text."""
        table: dict[str, Any] = json.loads(text)
        table["oddities"] = tuple(Oddity(*each) for each in table.get("oddities", ()))
        table["actions"] = tuple(Action(*each) for each in table.get("actions", ()))
        return Plan(**table)


def _chosen(rng: np.random.Generator, names: tuple[str, ...]) -> str:
    return names[int(rng.integers(len(names)))]


def draw(seed: int, seconds: float) -> Plan:
    """The run of a seed, of so many seconds."""
    rng = np.random.default_rng([37, seed])
    machine, door = _chosen(rng, MACHINES), _chosen(rng, DOORS)
    speed = float(np.round(2.0 ** rng.uniform(-1.0, 1.0), 3)) if rng.random() < 0.5 else 1.0
    rate = float(rng.uniform(20.0, 120.0)) if rng.random() < 0.7 else 80.0
    laws = law_names("all") if machine[:3] == "cmf" else FOREIGN
    dof = _chosen(rng, DOFS)
    amplitude = float(np.round(10.0 ** rng.uniform(-3.0, -1.6), 5))
    oddities = tuple(
        _oddity(rng, seconds) for _ in range(int(rng.choice(4, p=(0.4, 0.3, 0.2, 0.1))))
    )
    hydraulics = _chosen(rng, ("report", "hardware", "lossy")) if machine[:3] == "cmf" else ""
    return Plan(
        seconds=seconds,
        machine=machine,
        control_rate=int(rng.choice((1000, 2048))) if machine == "new" else 2048,
        law=_chosen(rng, laws) if rng.random() < 0.4 else "",
        hydraulics=hydraulics,
        electronics=_chosen(rng, ("", "ideal", "noisy")),
        door=door,
        begin=_chosen(rng, ("engaged", "engaged", "engaged", "hold", "settled", "off")),
        dof=dof,
        amplitude=amplitude if dof in DOFS[:3] else float(np.round(0.5 * amplitude, 5)),
        frequency=float(np.round(rng.uniform(0.2, 0.9) / max(speed, 1.0), 3)),
        rate=float(np.round(rate / speed, 1)),
        speed=speed,
        derivatives=_chosen(rng, DERIVATIVES) if rng.random() < 0.4 else "exact",
        piece=int(rng.integers(5, 400)),
        disk=_chosen(rng, ("", "", "", "full", "kill")),
        way_out=25.0 if rng.random() < 0.1 else 0.0,
        oddities=oddities,
        actions=tuple(sorted(_actions(rng, seconds, laws))),
        seed=seed,
    )


def _oddity(rng: np.random.Generator, seconds: float) -> Oddity:
    kind = _chosen(rng, ODDITIES)
    at = float(np.round(rng.uniform(0.0, 0.7 * seconds), 3))
    length = float(np.round(rng.uniform(0.05, 1.0) * seconds, 3))
    if kind == "silent":
        length = float(np.round(rng.uniform(0.02, 0.5), 3))
    return Oddity(kind, at, length, float(np.round(rng.uniform(*_SIZES[kind]), 4)))


def _actions(rng: np.random.Generator, seconds: float, laws: tuple[str, ...]) -> Iterator[Action]:
    """One run in three has nothing but its host, so that oddities show what they do."""
    if rng.random() < 0.35:
        return

    def when() -> float:
        return float(np.round(rng.uniform(0.0, seconds), 3))

    requests = ("off", "settle", "raise", "hold", "engage", "trip", "reset")
    for _ in range(int(rng.choice(4, p=(0.4, 0.3, 0.2, 0.1)))):
        yield Action(when(), "request", _chosen(rng, requests))
    if rng.random() < 0.2:
        half = float(np.round(0.5 / rng.uniform(0.2, 5.0), 3))
        times = np.arange(half, seconds, half)[:40]
        for number, at in enumerate(times.tolist()):
            yield Action(round(at, 3), "request", ("hold", "engage")[number % 2])
    for _ in range(int(rng.choice(3, p=(0.6, 0.25, 0.15)))):
        yield Action(when(), "law", _chosen(rng, laws))
    if rng.random() < 0.25:
        yield Action(when(), "event", _chosen(rng, KINDS), int(rng.integers(1, 7)))
    if rng.random() < 0.15:
        yield Action(when(), "kill")


def simpler(plan: Plan) -> Iterator[Plan]:
    """Runs next to a plan that are simpler, the simplest steps first."""
    for name in ("oddities", "actions"):
        kept: tuple[Any, ...] = getattr(plan, name)
        fewer = [kept[:index] + kept[index + 1 :] for index in range(len(kept))]
        if len(kept) > 1:
            fewer = [(), kept[: len(kept) // 2], kept[len(kept) // 2 :], *fewer]
        for rest in fewer:
            yield (
                replace(plan, oddities=rest) if name == "oddities" else replace(plan, actions=rest)
            )
    plain = Plan()
    for each in fields(Plan):
        value, least = getattr(plan, each.name), getattr(plain, each.name)
        if each.name not in ("seconds", "oddities", "actions") and value != least:
            change: dict[str, Any] = {each.name: least}
            yield replace(plan, **change)
    for share in (0.5, 0.75, 0.9):
        if plan.seconds > 0.5:
            yield replace(plan, seconds=float(np.round(share * plan.seconds, 2)))
    if 0.5 < plan.speed < 2.0 and plan.speed not in (0.9, 1.0, 1.1):
        yield replace(plan, speed=0.9 if plan.speed < 1.0 else 1.1)
