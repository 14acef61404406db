"""Where a scenario's run takes its demand from, block by block.

It is a table of leg references, or the frames of a host that means the demand.

The host of the chain sends the demand every so many control frames, with the derivatives of central
differences at 2048 Hz, exact to T^2/6 of the third and T^2/12 of the fourth derivative.
"""

from typing import Any

import numpy as np

from cmf_mj.control.law import Law
from cmf_mj.control.protection import load_protection
from cmf_mj.control.states import Request, State
from cmf_mj.core.errors import InputError
from cmf_mj.core.rates import MOST_FRAMES
from cmf_mj.facility.host.handover import make_log
from cmf_mj.facility.operation import (
    FacilitySettings,
    Start,
    dcu_of,
    facility_session,
    starting_pose,
)
from cmf_mj.facility.options import Options
from cmf_mj.facility.scenario.demand import Demand
from cmf_mj.facility.scenario.settings import Scenario
from cmf_mj.facility.session import Session, Table
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters.loading import fitting
from cmf_mj.plant.plant import Plant

BLOCK = 1024
"""Control frames of a block."""


class TableSource:
    """Leg references of the demand, rigid platform."""

    def __init__(self, demand: Demand, plant: Plant, law: Law, scenario: Scenario) -> None:
        """Make the session of a scenario without chain."""
        self._demand = demand
        self._machine = plant.machine
        self._poses = np.zeros((BLOCK, 6))
        self._table = np.zeros((BLOCK, plant.legs))
        self.fill(0)
        protection = scenario.protection
        self.session = Session(
            plant,
            law,
            Table(self._table, self._poses),
            _options(scenario)._replace(
                start=self._poses[0],
                protection=None
                if protection is None
                else load_protection(protection, fitting(plant.machine)),
                electronics=scenario.chosen_electronics(),
            ),
        )

    def fill(self, first: int) -> None:
        """Make the block of frames from `first` on."""
        self._poses[:] = self._demand.poses(first, BLOCK)
        self._table[:] = pose_to_legs(self._poses, self._machine)

    def described(self) -> dict[str, Any]:
        """What a record keeps of it."""
        return {}


class ChainSource:
    """Host frames of the demand, sent to the DCU of the whole chain."""

    def __init__(self, demand: Demand, plant: Plant, law: Law, scenario: Scenario) -> None:
        """Make the session of a scenario with the chain from host to valves."""
        operation = scenario.operation
        if operation is None or not isinstance(plant, Hexapod):
            raise InputError("operation: needs the hexapod")
        self._demand = demand
        self._every, self._rate = operation.host_every, plant.machine.rate
        self._arrivals = make_log((scenario.frames or BLOCK) // self._every + BLOCK)
        self.fill(0)
        limits = load_motion_limits(operation.limits, plant.machine)
        self._settings = FacilitySettings(
            dcu=operation.dcu,
            limits=operation.limits,
            states=operation.states,
            electronics=scenario.chosen_electronics(),
            protection=scenario.protection,
        )
        self.session = facility_session(
            plant,
            law,
            self._arrivals,
            self._settings,
            Start(
                State[operation.begin.upper()],
                starting_pose(self._arrivals.values[0, 0], limits, plant.machine),
                [(one.at, Request[one.request.upper()]) for one in operation.request],
            ),
            _options(scenario),
        )

    def fill(self, first: int) -> None:
        """Make the host frames that arrive in the block of frames from `first` on."""
        poses = self._demand.poses(first - 1, BLOCK + 2)
        numbers = np.arange(-(-first // self._every), -(-(first + BLOCK) // self._every))
        self._extend(int(numbers[-1]) + 1 if numbers.size else 0)
        frames = numbers * self._every
        at = frames - first + 1
        before, here, after = poses[at - 1], poses[at], poses[at + 1]
        log, rate = self._arrivals, self._rate
        log.frame[numbers], log.sequence[numbers] = frames, numbers
        log.time[numbers] = frames / rate
        log.values[numbers, 0] = here
        log.values[numbers, 1] = (after - before) * (rate / 2.0)
        log.values[numbers, 2] = (after - 2.0 * here + before) * float(rate) ** 2

    def _extend(self, count: int) -> None:
        if count <= self._arrivals.frame.size:
            return
        larger = make_log(2 * count)
        for new, old in zip(larger, self._arrivals, strict=True):
            new[: old.shape[0]] = old
        self._arrivals = larger
        self.session.exchange(arrivals=larger)

    def request(self, frame: int, code: int) -> None:
        """Let the operator request something in a frame."""
        chain = self.session.chain
        self.session.exchange(
            request_frame=np.append(chain.request_frame, frame),
            request=np.append(chain.request, code),
        )

    def described(self) -> dict[str, Any]:
        """What a record keeps of it."""
        state = self.session.chain.dcu_state
        return {
            "dcu": dcu_of(self.session.plant.machine, self._settings.dcu).model_dump(mode="json"),
            "host_counts": state.counts,
            "host_rejections": state.rejections,
        }


def _options(scenario: Scenario) -> Options:
    return Options(
        events=scenario.event,
        record_every=scenario.record_every,
        frames=scenario.frames or MOST_FRAMES,
        window=None if scenario.frames else BLOCK,
    )
