"""`HostChain`, the way from host to valves as scenario files have it, and the source it makes."""

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from cmf_mj.control import limiter, states
from cmf_mj.control.dcu.play import Arrivals
from cmf_mj.control.dcu.state import DcuSettings, load_dcu, make_dcu
from cmf_mj.control.states import Request, State, StateSettings, load_state_settings
from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import Settings, name_or
from cmf_mj.core.units import INCH, RATE
from cmf_mj.facility.changes import RequestAt, Requests, name_of_state, plural
from cmf_mj.facility.front import Blocks, Source, from_host
from cmf_mj.facility.host.handover import Ring
from cmf_mj.machine.kinematics import legs_to_pose, pose_to_legs
from cmf_mj.machine.limits import MotionLimits
from cmf_mj.machine.machine import Machine
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.plant.parameters import fitting
from cmf_mj.plant.plant import Plant

_BeginName = Literal["off", "settled", "hold", "engaged"]

_REST_HEIGHT = 0.05  #: Height of a leg on the stops above its mechanical end [in].
_ENGAGE_AT_ONCE = RequestAt(at=0.0, request="engage")


class HostChain(Settings):
    """The whole chain from host to valves."""

    begin: Annotated[_BeginName, BeforeValidator(name_of_state)] = "settled"
    """Operating state to begin in. Off and settled begin on the stops, the others at the demand's
    pose. Settled has its valves open from the first frame, so that a law whose balance is elsewhere
    jumps; off fades them in."""
    requests: Requests = plural("request", "requests", (_ENGAGE_AT_ONCE,))
    """Operator's requests; of one instant the last counts, after any trip."""
    host_every: Annotated[int, Field(ge=1, le=RATE)] = 26
    """Control frames from one frame of the host to the next, where signals are what it sends; 26
    are 78.8 Hz."""
    dcu: Annotated[str | Path | DcuSettings, name_or(DcuSettings)] | None = None
    """Digital Control Unit, `default` or a file; default the machine's."""
    limits: Annotated[str | Path | MotionLimits, name_or(MotionLimits)] | None = None
    """Limits of platform and legs; default Table 2-1 with the assumed rates."""
    states: Annotated[str | Path | StateSettings, name_or(StateSettings)] | None = None
    """Times of the operating states."""

    def check(self, plant: str | Plant, machine: Machine) -> None:
        """Refuse what cannot be loaded, or another plant than the hexapod."""
        if plant != "hexapod":
            raise InputError(f"operation: is for the hexapod, plant is {plant}")
        dcu_of(machine, self.dcu)
        load_motion_limits(self.limits, machine)
        load_state_settings(self.states)

    def starting_pose(self, machine: Machine, arrivals: Arrivals) -> NDArray[np.float64]:
        """The first frame's pose, or neutral where the limits forbid it."""
        limits = load_motion_limits(self.limits, machine)
        pose, (low, high) = arrivals.values[0, 0], limits.operational.T
        is_allowed = bool(((pose >= low) & (pose <= high)).all())
        if is_allowed and np.abs(pose_to_legs(pose, machine)).max() <= limits.leg.position.si:
            return np.array(pose)
        return np.zeros(6)

    def source(
        self, machine: Machine, arrivals: Arrivals, start: Any, ring: Ring | None = None
    ) -> tuple[Source, NDArray[np.float64]]:
        """The chain before any frame, and the pose that the platform stands at.

        By default the demand begins at `starting_pose`. With a ring of live frames the arrivals are
        the log that they are collected in.
        """
        frame, begin = machine.frame, State[self.begin.upper()]
        limits = load_motion_limits(self.limits, machine)
        state_settings = load_state_settings(self.states, fitting(machine))
        pose = self.starting_pose(machine, arrivals) if start is None else np.array(start)
        legs, platform_pose = pose_to_legs(pose, machine), pose
        if begin in (State.OFF, State.SETTLED):
            legs = np.full(6, -round(machine.half_stroke / INCH - _REST_HEIGHT, 9) * INCH)
            platform_pose = legs_to_pose(legs, machine)
        blocks = Blocks(
            make_dcu(dcu_of(machine, self.dcu), frame),
            limiter.make_pose_limiter(limits, frame),
            machine.geometry,
            states.make_states(state_settings, machine),
            limiter.make_leg_limiter(limits, frame=frame),
        )
        in_order = sorted(self.requests, key=lambda x: round(x.at * machine.rate))
        requests = [(round(x.at * machine.rate), Request[x.request.upper()]) for x in in_order]
        source = from_host(blocks, arrivals, requests, begin, position=legs, pose=pose, ring=ring)
        return source, platform_pose


def dcu_of(machine: Machine, source: str | Path | DcuSettings | None = None) -> DcuSettings:
    """A DCU fitted to a machine, by default the machine's."""
    return load_dcu(machine.dcu if source is None else source, fitting(machine))
