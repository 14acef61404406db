"""The demand of a scenario, made block by block where the run's source reads it.

The source is a table of leg references, or the frames of a host that means the demand.

The host sends it every so many control frames, with the derivatives of central differences at
2048 Hz, exact to T^2/6 of the third and T^2/12 of the fourth derivative.
"""

from typing import Any

import numpy as np

from cmf_mj.control.dcu.play import Arrivals
from cmf_mj.control.law import Law
from cmf_mj.control.states import Request, State
from cmf_mj.core.units import MOST_FRAMES
from cmf_mj.facility.front import from_table
from cmf_mj.facility.host.handover import make_log
from cmf_mj.facility.operation import starting_pose
from cmf_mj.facility.run import Run
from cmf_mj.facility.scenario.settings import OperationChoice, Scenario
from cmf_mj.facility.scenario.signal import Demand
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.plant.plant import Plant

BLOCK = 1024
"""Control frames of a block."""


class Feed:
    """A scenario's session, and the part of its source that is filled as it goes."""

    def __init__(self, demand: Demand, plant: Plant, law: Law, scenario: Scenario) -> None:
        """Fill the first block, and make the session."""
        self._demand, self._machine = demand, plant.machine
        self._poses, self._table = np.zeros((BLOCK, 6)), np.zeros((BLOCK, plant.legs))
        self._run = Run(
            plant,
            law,
            from_table(self._table, self._poses),
            events=scenario.event,
            record_every=scenario.record_every,
            frames=scenario.frames or MOST_FRAMES,
            window=None if scenario.frames else BLOCK,
            protection=scenario.protection,
            electronics=scenario.chosen_electronics(),
        )
        self._arrivals: Arrivals | None = None
        if scenario.operation is not None:
            self._every = scenario.operation.host_every
            self._arrivals = make_log((scenario.frames or BLOCK) // self._every + BLOCK)
        self.fill(0)
        if scenario.operation is None:
            self._run = self._run._replace(start=self._poses[0])
        else:
            self._run = self._hosted(scenario.operation)
        self.session = self._run.session()

    def fill(self, first: int) -> None:
        """Make the block of frames from `first` on."""
        if self._arrivals is not None:
            self._fill_frames(first)
            return
        self._poses[:] = self._demand.poses(first, BLOCK)
        self._table[:] = pose_to_legs(self._poses, self._machine)

    def request(self, frame: int, code: int) -> None:
        """Let the operator request something in a frame, of a run with a host."""
        source = self.session.source
        self.session.exchange(
            request_frame=np.append(source.request_frame, frame),
            request=np.append(source.request, code),
        )

    def described(self) -> dict[str, Any]:
        """What a record keeps of the host."""
        if self._arrivals is None:
            return {}
        state = self.session.source.dcu_state
        return {
            "dcu": self._run.unit().model_dump(mode="json"),
            "host_counts": state.counts,
            "host_rejections": state.rejections,
        }

    def _hosted(self, operation: OperationChoice) -> Run:
        assert self._arrivals is not None
        limits = load_motion_limits(operation.limits, self._machine)
        return self._run._replace(
            source=self._arrivals,
            start=starting_pose(self._arrivals.values[0, 0], limits, self._machine),
            begin=State[operation.begin.upper()],
            requests=[(one.at, Request[one.request.upper()]) for one in operation.request],
            dcu=operation.dcu,
            limits=operation.limits,
            states=operation.states,
        )

    def _fill_frames(self, first: int) -> None:
        """Make the host frames that arrive in the block of frames from `first` on."""
        poses = self._demand.poses(first - 1, BLOCK + 2)
        numbers = np.arange(-(-first // self._every), -(-(first + BLOCK) // self._every))
        log, rate = self._room(int(numbers[-1]) + 1 if numbers.size else 0), self._machine.rate
        frames = numbers * self._every
        at = frames - first + 1
        before, here, after = poses[at - 1], poses[at], poses[at + 1]
        log.frame[numbers], log.sequence[numbers] = frames, numbers
        log.time[numbers] = frames / rate
        log.values[numbers, 0] = here
        log.values[numbers, 1] = (after - before) * (rate / 2.0)
        log.values[numbers, 2] = (after - 2.0 * here + before) * float(rate) ** 2

    def _room(self, count: int) -> Arrivals:
        """The log of host frames, with room for so many."""
        assert self._arrivals is not None
        if count > self._arrivals.frame.size:
            larger = make_log(2 * count)
            for new, old in zip(larger, self._arrivals, strict=True):
                new[: old.shape[0]] = old
            self._arrivals = larger
            self.session.exchange(arrivals=larger)
        return self._arrivals
