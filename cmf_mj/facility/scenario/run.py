"""Runs of a scenario, live or in one go.

The demand is made in blocks of frames, and an open run keeps its last ones. A block begins at a
multiple of its length whatever the parts a run is advanced in, so that a live run and the scenario
it leaves behind compute the same numbers in the same arrays: the same bits.
"""

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.modes import bound
from cmf_mj.control.law import Law
from cmf_mj.control.states import Request
from cmf_mj.core.errors import InputError
from cmf_mj.facility.scenario.settings import Change, Laws, Scenario, changed_law
from cmf_mj.facility.scenario.signal import Demand, added
from cmf_mj.facility.scenario.source import BLOCK, Feed
from cmf_mj.facility.session import Live
from cmf_mj.plant.events import Event
from cmf_mj.plant.hexapod import make_plant
from cmf_mj.record.record import Record
from cmf_mj.signals.signal import Motion


class _Due(NamedTuple):
    frame: int
    change: Change
    motion: Motion | None
    laws: Laws  #: With the one that the change names, read when it was applied.


class ScenarioRun:
    """A scenario as it goes: advance it, look at it, change it, and take away what was done."""

    def __init__(self, scenario: Scenario, *, keep: float = 600.0) -> None:
        """Build the plant, put it at rest at the first pose of the demand and engage the law.

        Of an `open` run, the record keeps the last `keep` seconds.
        """
        self._begun = scenario
        self.plant = make_plant(scenario.plant, scenario.carried, scenario.hydraulics)
        """The machine; its MuJoCo data is that of the run."""
        self._law, self._rate = scenario.begun_law(), self.plant.machine.rate
        self._demand = Demand(added(scenario.signal, scenario.seed, self._rate))
        self._feed = Feed(self._demand, self.plant, self._law, scenario)
        self._session = self._feed.session
        self._filled = 0
        laws = Laws()
        self._due = deque(self._checked(one.when(self._rate), one, laws) for one in scenario.change)
        self._laws(self._due)
        self._done: list[Change] = []
        self._pushes: dict[int, tuple[float, ...]] = {}
        self._strikes = sorted(round(event.at * self._rate) + 1 for event in scenario.event)
        self._parts: deque[NDArray[np.float64]] = deque()
        self._first = self._next = 0
        self._most = 0 if scenario.frames else max(round(keep * self._rate / BLOCK), 1)

    @property
    def frame(self) -> int:
        """Control frames run so far."""
        return self._session.frame

    @property
    def finished(self) -> bool:
        """Whether the scenario's duration is over."""
        return self.frame >= self._session.frames

    def advance(self, frames: int) -> None:
        """Run a number of control frames, at most to the end of the duration."""
        session = self._session
        target = min(self.frame + frames, session.frames)
        while self.frame < target:
            while self._due and self._due[0].frame <= self.frame:
                self._happen(self._due.popleft())
            if self.frame % BLOCK == 0:
                self._fill(self.frame)
            session.push(self._pushes)
            ends = [target, (self.frame // BLOCK + 1) * BLOCK]
            ends += [due.frame for due in self._due]
            ends += [strike for strike in self._strikes if strike > self.frame]
            session.run(min(ends) - self.frame)
            if self._most and self.frame % BLOCK == 0:
                self._take()

    def apply(self, change: Change) -> None:
        """Change something from the next frame on.

        A law takes over as `control.engage` says, signals as `demand` says. A change with a time
        is refused.
        """
        for field in ("at", "frame"):
            if getattr(change, field) is not None:
                raise InputError(
                    f"{field}: {getattr(change, field)} is refused; a change applied live happens "
                    "in the next frame"
                )
        at = sum(due.frame <= self.frame for due in self._due)
        coming = list(self._due)
        coming.insert(at, self._checked(self.frame, change, Laws()))
        self._laws(coming)
        self._due = deque(coming)

    def latest(self) -> Live:
        """The present state."""
        return self._session.look()

    def scenario(self) -> Scenario:
        """What has been done so far, as a scenario that does it again bit for bit."""
        frames, begun, rate = max(self.frame, 1), self._begun, self._rate
        past: dict[str, Any] = {
            "change": tuple(change for change in self._done if change.when(rate) < frames),
            "event": tuple(event for event in begun.event if round(event.at * rate) < frames),
            "duration": frames / rate,
        }
        if begun.operation is not None:
            done = tuple(r for r in begun.operation.request if round(r.at * rate) < frames)
            past["operation"] = begun.operation.model_copy(update={"request": done})
        return begun.model_copy(update=past)

    def record(self) -> Record:
        """All signals so far; of an `open` run those of the last `keep` seconds."""
        session, scenario, rows = self._session, self.scenario(), None
        if self._most:
            last = -(-self.frame // session.every)
            rows = np.concatenate([*self._parts, session.rows(self._next, last)])
        time, channels, units = session.history(rows, self._first)
        context: dict[str, Any] = {
            "command": _command(scenario),
            "seed": scenario.seed,
            "scenario": scenario.model_dump(mode="json", exclude_defaults=True, exclude_none=True),
        }
        context |= session.describe() | self._feed.described()
        return Record(time, channels, units, context)

    def _checked(self, frame: int, change: Change, laws: Laws) -> _Due:
        """The change with its motion, after a check that all of it is possible."""
        self._begun.check_change(change)
        signal = change.signal
        motion = None if signal is None else added(signal, self._begun.seed, self._rate)
        named = Laws() if change.law is None else Laws({change.law: laws[change.law]})
        return _Due(frame, change, motion, named)

    def _laws(self, coming: Sequence[_Due]) -> list[Law]:
        """The law after each of the coming changes, bound to the plant.

        One of them may be refused because the change before made it impossible.
        """
        laws = [self._law]
        for due in coming:
            law = changed_law(laws[-1], due.change, due.laws)
            laws.append(bound(law, self.plant))
        return laws[1:]

    def _happen(self, due: _Due) -> None:
        change, session = due.change, self._session
        self._done.append(change.model_copy(update={"at": None, "frame": self.frame}))
        if change.law is not None or change.gains:
            (self._law,) = self._laws([due])
            session.engage(self._law)
        if due.motion is not None:
            self._demand.change(self.frame, due.motion, round(change.fade * self._rate))
            if self.frame % BLOCK:
                self._fill(self._filled)
        for failure in change.failure:
            session.inject(Event(at=self.frame / self._rate, **dict(failure)))
            self._strikes.append(self.frame + 1)
        if change.push is not None:
            push = change.push
            self._pushes[session.body(push.body)] = (*push.force, *push.torque)
        if change.request is not None:
            self._feed.request(self.frame, Request[change.request.upper()])

    def _fill(self, first: int) -> None:
        self._feed.fill(first)
        self._filled = first

    def _take(self) -> None:
        """Take the block just run out of the loop."""
        last = -(-self.frame // self._session.every)
        self._parts.append(self._session.rows(self._next, last))
        self._next = last
        while len(self._parts) > self._most:
            self._first += self._parts.popleft().shape[0]


def run_scenario(
    scenario: Scenario, *, progress: Callable[[int, int], None] | None = None
) -> Record:
    """Run a scenario from beginning to end.

    Args:
        scenario: with a duration.
        progress: called with the control frames run and those in all, about twice a second of the
            run.

    Raises:
        InputError: an argument out of range, named; an `open` duration.
        OutOfBounds: the state left its physical bounds; leg, time and value are named.

    >>> scenario = cmf_mj.load_scenario("heave_sine").model_copy(update={"duration": 0.1})
    >>> cmf_mj.run_scenario(scenario).time.size
    205
    """
    frames = scenario.frames
    if frames is None:
        raise InputError("duration: is open; a run to the end needs one in s")
    run = ScenarioRun(scenario)
    while not run.finished:
        run.advance(BLOCK)
        if progress is not None:
            progress(run.frame, frames)
    return run.record()


def _command(scenario: Scenario) -> dict[str, Any]:
    """Description of the demand: of its signal, where it is one to the end."""
    changed = any(change.signal is not None for change in scenario.change)
    if changed or len(scenario.signal) != 1:
        return {"kind": "scenario"}
    return scenario.signal[0].described()
