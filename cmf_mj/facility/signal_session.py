"""A session on signals: its demand changes as it goes, and what was done runs again as a run.

Blocks of the demand begin at multiples of their length, whatever the parts that a session is run
in, so that a live session and the run of what was done compute the same bits.
"""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from cmf_mj.analysis.modes import bound
from cmf_mj.control.law import Law, load_law
from cmf_mj.control.states import Request
from cmf_mj.core.errors import InputError
from cmf_mj.core.units import MOST_FRAMES
from cmf_mj.facility.changes import Change, ComingChange, overlaid_law
from cmf_mj.facility.front import from_table
from cmf_mj.facility.host.handover import make_log
from cmf_mj.facility.session import Session
from cmf_mj.facility.signal import LayeredDemand, added
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.machine.machine import Machine
from cmf_mj.plant.events import Event

if TYPE_CHECKING:
    from cmf_mj.facility.run import Run

BLOCK = 1024  #: Control frames of a block of the demand.


class TableFeed:
    """A table of one block, for a source that reads it again from the start."""

    def __init__(self, demand: LayeredDemand, machine: Machine) -> None:
        """Make the first block."""
        self._demand, self._machine = demand, machine
        self.poses, self.legs = np.zeros((BLOCK, 6)), np.zeros((BLOCK, 6))
        self.fill(0)

    def fill(self, first: int) -> None:
        """Make the block of frames from `first` on."""
        self.poses[:] = self._demand.poses(first, BLOCK)
        self.legs[:] = pose_to_legs(self.poses, self._machine)


class HostFeed:
    """Frames of a host that sends the demand, with central differences, exact to second order."""

    def __init__(self, demand: LayeredDemand, rate: int, every: int, frames: int | None) -> None:
        """Make the host frames of the first block; the log of an open run grows."""
        self._demand, self._rate, self._every = demand, rate, every
        self.log = make_log((frames or BLOCK) // every + BLOCK)
        self.fill(0)

    def fill(self, first: int) -> None:
        """Make the host frames that arrive in the block of frames from `first` on.

        Where they do not fit, a larger `log` replaces the present one. The caller passes `log` on
        to the loop after each call.
        """
        poses, every = self._demand.poses(first - 1, BLOCK + 2), self._every
        numbers = np.arange(math.ceil(first / every), math.ceil((first + BLOCK) / every))
        if numbers.size and numbers[-1] >= self.log.frame.size:
            larger = make_log(2 * (int(numbers[-1]) + 1))
            for larger_column, column in zip(larger, self.log, strict=True):
                larger_column[: column.shape[0]] = column
            self.log = larger
        log, frames = self.log, numbers * every
        row = frames - first + 1
        pose_before, pose, pose_after = poses[row - 1], poses[row], poses[row + 1]
        log.frame[numbers], log.sequence[numbers] = frames, numbers
        log.time[numbers] = frames / self._rate
        log.values[numbers, 0] = pose
        log.values[numbers, 1] = (pose_after - pose_before) * (self._rate / 2.0)
        second_difference = pose_after - 2.0 * pose + pose_before
        log.values[numbers, 2] = second_difference * float(self._rate) ** 2


class SignalSession(Session):
    """A session on signals: change it as it goes, and get a run of what was done."""

    def __init__(self, run: "Run", kept_seconds: float | None = None) -> None:
        """Put the plant at rest at the first pose of the demand and engage the law.

        The latest `kept_seconds` are kept, by default all, of an `open` run 600 s.
        """
        if run.source is not None:
            raise InputError("source: is a table or a host's; allowed: a run of signals")
        plant = run.built_plant()
        rate, frames = plant.machine.rate, run.frames
        self._first_run = run
        self._demand = LayeredDemand(added(run.signal, run.seed, rate))
        self._feed: TableFeed | HostFeed
        if run.operation is None:
            self._feed = table = TableFeed(self._demand, plant.machine)
            source = from_table(table.legs, table.poses)
            start = table.poses[0] if run.start is None else run.start
        else:
            self._feed = host = HostFeed(self._demand, rate, run.operation.host_every, frames)
            source, start = run.operation.source(plant.machine, host.log, run.start)
        if frames is None and kept_seconds is None:
            kept_seconds = 600.0
        law, settings = run.first_law(), run.session_settings(plant.machine)
        lengths: Any = {"frames": frames or MOST_FRAMES, "kept_seconds": kept_seconds}
        super().__init__(plant, law, source, start, settings, **lengths)
        self._block_start = 0  # first frame of the block of the demand that was made last
        load = cache(partial(load_law, machine=plant.machine))
        self._coming = [self._prepared(x.at_frame(rate), x, load) for x in run.change]
        self._laws_after(self._coming)
        self._carried_out: list[Change] = []
        self._pushes: dict[int, tuple[float, ...]] = {}  # wrenches by number of the body
        self._frames_after_failures = [round(event.at * rate) + 1 for event in run.events]

    def run(self, frames: int | None = None) -> None:
        """Run a number of control frames, at most to the end; refusals as of any session.

        Each part ends where something is due: a change, a new block of the demand, or the frame
        after a failure, in which an overload joins the pushes.
        """
        end = self.frames if frames is None else min(self.frame + frames, self.frames)
        while self.frame < end:
            while self._coming and self._coming[0].frame <= self.frame:
                self._carry_out(self._coming.pop(0))
            if self.frame % BLOCK == 0:
                self._fill_block(self.frame)
            self.push(self._pushes)
            frames_due = [end, (self.frame // BLOCK + 1) * BLOCK]
            frames_due += [change.frame for change in self._coming]
            frames_due += [frame for frame in self._frames_after_failures if frame > self.frame]
            super().run(min(frames_due) - self.frame)

    def apply(self, change: Change) -> None:
        """Change something from the next frame on; a change with a time is refused."""
        if (change.at, change.frame) != (None, None):
            raise InputError("at, frame: a change applied live happens in the next frame")
        load = partial(load_law, machine=self.plant.machine)
        present = self._prepared(self.frame, change, load)
        past = [x for x in self._coming if x.frame <= self.frame]
        coming = [*past, present, *self._coming[len(past) :]]
        self._laws_after(coming)
        self._coming = coming

    def done_run(self) -> "Run":
        """What has been done so far, as a run that does it again bit for bit."""
        frames, first_run, rate = max(self.frame, 1), self._first_run, self.rate
        changes = tuple(x for x in self._carried_out if x.at_frame(rate) < frames)
        events = tuple(event for event in first_run.events if round(event.at * rate) < frames)
        fields: dict[str, Any] = {"change": changes, "events": events, "duration": frames / rate}
        if first_run.operation is not None:
            requests = [x for x in first_run.operation.requests if round(x.at * rate) < frames]
            update = {"requests": tuple(requests)}
            fields["operation"] = first_run.operation.model_copy(update=update)
        return first_run.model_copy(update=fields)

    def describe(self) -> dict[str, Any]:
        """What a record keeps of the run, the scenario among it."""
        run = self.done_run()
        command = {"kind": "scenario"}
        if len(run.signal) == 1 and all(change.signal is None for change in run.change):
            command = run.signal[0].described()
        description: dict[str, Any] = {"command": command, "seed": run.seed}
        with suppress(InputError):  # of a plant or law that was made
            description["scenario"] = run.table()
        return description | super().describe()

    def _prepared(self, frame: int, change: Change, load: Callable[[str], Law]) -> ComingChange:
        """The change with its motion and law, after a check that all of it is possible."""
        run, signal = self._first_run, change.signal
        change.check(run.plant, run.operation is not None)
        motion = None if signal is None else added(signal, run.seed, self.rate)
        return ComingChange(frame, change, motion, None if change.law is None else load(change.law))

    def _laws_after(self, coming: Sequence[ComingChange]) -> list[Law]:
        """The law after each of the coming changes; one may make the next impossible."""
        assert self.law_in_force is not None
        law, laws = self.law_in_force, []
        for change in coming:
            law = bound(overlaid_law(change.law or law, change.change.gains), self.plant)
            laws.append(law)
        return laws

    def _carry_out(self, coming: ComingChange) -> None:
        """Make a change, and keep it with its frame for `done_run`."""
        change = coming.change
        self._carried_out.append(change.model_copy(update={"at": None, "frame": self.frame}))
        if change.law is not None or change.gains:
            (law,) = self._laws_after([coming])
            self.engage(law)
        if coming.motion is not None:
            self._demand.change(self.frame, coming.motion, round(change.fade * self.rate))
            if self.frame % BLOCK:
                self._fill_block(self._block_start)
        for failure in change.failure:
            self.inject(Event(at=self.frame / self.rate, **dict(failure)))
            self._frames_after_failures.append(self.frame + 1)
        if change.push is not None:
            push = change.push
            self._pushes[self.body_number(push.body)] = (*push.force, *push.torque)
        if change.request is not None:
            self.request(Request[change.request.upper()])

    def _fill_block(self, first: int) -> None:
        """Make the block of the demand from a frame on."""
        self._feed.fill(first)
        if isinstance(self._feed, HostFeed):
            self.replace_source(arrivals=self._feed.log)
        self._block_start = first
