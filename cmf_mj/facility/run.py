"""A run: everything that determines a record, and the one place where a session is made of it.

`simulate` closes the loop of command, DCL, valves, cylinders, mechanics and sensors; `drive` opens
it at the valves. Both are the one loop of `loop.run`, whose docstring gives the order.
"""

from collections.abc import Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.control import limiter, states
from cmf_mj.control.dcu.play import Arrivals
from cmf_mj.control.dcu.settings import DcuSettings, load_dcu, make_dcu
from cmf_mj.control.demand import Demand, make_demand
from cmf_mj.control.law import Law, load_law
from cmf_mj.control.protection import ProtectionSettings, load_protection
from cmf_mj.control.states import Request, State, StateSettings, load_state_settings
from cmf_mj.core.arrays import real, whole
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.units import INCH, LONGEST, MOST_FRAMES, RATE
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.front import Blocks, Source, from_host, from_table
from cmf_mj.facility.host.handover import Ring
from cmf_mj.facility.pace import Pace
from cmf_mj.facility.session import Session
from cmf_mj.machine.kinematics import legs_to_pose, pose_to_legs
from cmf_mj.machine.limits import MotionLimits
from cmf_mj.machine.machine import Machine
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.plant.events import Event
from cmf_mj.plant.parameters import fitting
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record
from cmf_mj.signals.signal import Command, commanded

OPTIONS = ("start", "events", "record_every", "command_delay")
"""Fields of `Run` that `simulate` and `drive` take as options."""

OPERATION = (
    *("begin", "requests", "events", "dcu", "limits", "states", "demand"),
    *("electronics", "protection", "record_every", "command_delay"),
)
"""Those that `operate` and `serve` take."""

_NUMBERS = (
    *(("record_every", 1, MOST_FRAMES), ("window", 1, MOST_FRAMES), ("frames", 1, MOST_FRAMES)),
    ("command_delay", 0, RATE),
)
"""Numbers of frames, each with the least and most allowed."""

_RESTING = 0.05
"""What a leg on the stops is above its mechanical end [in]."""


class LegDemand(NamedTuple):
    """A demand of leg extensions."""

    rows: ArrayLike  #: At the control rate, (N, n) [m].


class ValveCommands(NamedTuple):
    """Valve commands of an open loop."""

    rows: ArrayLike  #: Fractions, -1 to 1, positive extending, each held over its frame, (N, n).


class _Given(NamedTuple):
    law: Law | None
    source: Source | Arrivals
    start: ArrayLike | None
    context: dict[str, Any]  #: What a record says of the source.


class Run(NamedTuple):
    """Everything that determines a record; settings by name, TOML file or loaded.

    >>> command = cmf_mj.signals.sine("heave", 0.01, frequency=2.0, cycles=1)
    >>> run = cmf_mj.Run(cmf_mj.Hexapod(), "velocity", command, record_every=16)
    >>> record = run.record()  # what `simulate` gives
    >>> session = run._replace(law="position").session()
    >>> session.run(100)  # and then look at it, push it, exchange its law
    >>> session.look().law
    'position'
    """

    plant: Plant
    law: str | Path | Law | None  #: None opens the loop: the source holds valve commands.
    source: Command | ArrayLike | LegDemand | ValveCommands | Source | Arrivals
    """A command or poses (N, 6) [m, rad], z down, leg extensions, valve commands, a table of any of
    them; or the host's frames, which take the whole chain."""
    start: ArrayLike | None = None
    """Configuration to start from, as `plant.place` takes it, by default the first pose of the
    command, else the model's own; with a host the pose of the demand at the start."""
    events: Sequence[Event] = ()  #: Failures on the time line.
    record_every: int = 1  #: Keep one frame in this many.
    command_delay: int = 1  #: Frames from a DCL frame to its command at the valves.
    protection: str | Path | ProtectionSettings | None = None
    """Conditions that make an emergency stop; None for none."""
    electronics: ElectronicsSettings | None = None
    """Sensors, converters, servo electronics; None for ideal ones."""
    begin: State = State.ENGAGED
    """Operating state to begin in, with a host: off, settled, hold or engaged. Off and settled
    begin on the stops, the others at the demand's pose. Settled has its valves open from the first
    frame, so that a law whose balance is elsewhere jumps; off fades them in."""
    requests: Sequence[tuple[float, Request]] = ()
    """Operator's requests and their times [s]; of one instant the last counts, after any trip."""
    dcu: str | Path | DcuSettings | None = None  #: Digital Control Unit; default the machine's.
    limits: str | Path | MotionLimits | None = None
    """Limits of platform and legs; default Table 2-1 with the assumed rates."""
    states: str | Path | StateSettings | None = None  #: Operating states.
    demand: Demand | None = None  #: Leg demand, with body flexibility or without; default rigid.
    frames: int | None = None  #: Control frames of the run; default the rows of the table.
    window: int | None = None
    """Control frames whose `rows` are kept, the latest; default all, as `history`."""

    def session(self, *, ring: Ring | None = None, pace: Pace | None = None) -> Session:
        """The run before its first frame, to be run in parts.

        With a ring of live frames the source is the log that they are collected in; without pace
        the run goes as fast as possible.
        """
        return self._session(self._given(), ring, pace)

    def record(self) -> Record:
        """All signals from beginning to end.

        Raises `InputError`, an argument out of range, named, and `OutOfBounds`: the state left its
        physical bounds; leg, time and value are named.
        """
        given = self._given()
        session = self._session(given)
        session.run()
        time, channels, units = session.history()
        return Record(time, channels, units, session.describe() | given.context)

    def unit(self) -> DcuSettings:
        """The DCU, fitted to the machine."""
        return dcu_of(self.plant.machine, self.dcu)

    def _given(self) -> _Given:
        """Law and source as the loop takes them."""
        law = None if self.law is None else load_law(self.law)
        said = "table"
        match self.source:
            case Source() | Arrivals() as source:
                pass
            case LegDemand(rows):
                source, said = self._legs(rows), "leg extensions"
            case ValveCommands(rows):
                source, said = self._valves(rows), "valve commands"
            case command:
                demanded = commanded(command, self.plant.machine.rate)
                legs = pose_to_legs(demanded.pose, self.plant.machine)
                start = demanded.pose[0] if self.start is None else self.start
                context = {"command": demanded.description, "seed": demanded.seed}
                return _Given(law, from_table(legs, demanded.pose), start, context)
        return _Given(law, source, self.start, {"command": {"signal": said}, "seed": None})

    def _session(
        self, given: _Given, ring: Ring | None = None, pace: Pace | None = None
    ) -> Session:
        machine, source, start = self.plant.machine, given.source, given.start
        numbers: dict[str, Any] = {}  # of Python, which alone share a compiled loop
        for field, least, most in _NUMBERS:
            value = getattr(self, field)
            numbers[field] = None if value is None else whole(field, value, least, most)
        guard = self.protection
        loaded = None if guard is None else load_protection(guard, fitting(machine))
        on_stops = isinstance(source, Arrivals) and self.begin in (State.OFF, State.SETTLED)
        if isinstance(source, Arrivals):
            pose = np.zeros(6) if start is None else np.array(start)
            start = pose
            legs = pose_to_legs(pose, machine)
            if on_stops:
                legs = np.full(6, -round(machine.half_stroke / INCH - _RESTING, 9) * INCH)
                start = legs_to_pose(legs, machine)
            source = self._chain(source, pose, legs, ring)
        session = Session(
            self.plant,
            given.law,
            source,
            start,
            events=self.events,
            protection=loaded,
            electronics=self.electronics,
            pace=pace,
            **numbers,
        )
        if on_stops:
            session.controller.state.error.integral[:] = 0.0
        return session

    def _legs(self, rows: ArrayLike) -> Source:
        reference = np.atleast_2d(real("command", rows))
        if reference.shape[1] != self.plant.legs:
            raise InputError(
                f"command: has {reference.shape[1]} columns; allowed: {self.plant.legs}, one a leg"
            )
        return from_table(reference)

    def _valves(self, rows: ArrayLike) -> Source:
        table = np.atleast_2d(real("valves", rows))
        if table.ndim != 2 or table.shape[1] != self.plant.legs:
            raise InputError(f"valves: has shape {table.shape}; allowed: (N, {self.plant.legs})")
        if not (np.abs(table) <= 1.0).all():
            row, leg = np.argwhere(~(np.abs(table) <= 1.0))[0]
            raise InputError(
                f"valves: {table[row, leg]} of leg {leg + 1} in row {row} is not between -1 and 1"
            )
        return from_table(table)

    def _chain(
        self,
        arrivals: Arrivals,
        pose: NDArray[np.float64],
        legs: NDArray[np.float64],
        ring: Ring | None,
    ) -> Source:
        """The chain from host to leg reference, before any frame."""
        for one in self.requests:
            match one:
                case (int() | float() | np.integer() as at, Request()) if 0.0 <= at <= LONGEST:
                    continue
            allowed = f"a time of 0 to {LONGEST:g} s and a Request"
            raise InputError(f"requests: {one!r} is refused; allowed: {allowed}")
        machine = self.plant.machine
        frame, limits = machine.frame, load_motion_limits(self.limits, machine)
        operating = load_state_settings(self.states, fitting(machine))
        blocks = Blocks(
            make_dcu(self.unit(), frame),
            limiter.make_pose_limiter(limits, frame),
            self.demand or make_demand(machine),
            states.make_states(operating, machine),
            limiter.make_leg_limiter(limits, frame=frame),
        )
        timed = ((round(at * machine.rate), code) for at, code in self.requests)
        requests = sorted(timed, key=itemgetter(0))
        return from_host(
            blocks, arrivals, requests, self.begin, position=legs, pose=pose, ring=ring
        )


def simulate(
    plant: Plant,
    law: str | Law,
    command: Command | ArrayLike,
    *,
    legs: bool = False,
    protection: str | Path | ProtectionSettings | None = None,
    electronics: ElectronicsSettings | None = None,
    **options: Any,
) -> Record:
    """Run a control law on a plant and record all signals.

    The run starts at rest at the first pose of the command, in static equilibrium, with the DCL
    engaged there. The same arguments give the same bits on one kind of processor.

    Args:
        plant: `Hexapod`, `SingleLegs`, or any `Plant`; its mechanical step must divide the
            control frame.
        law: name, TOML file or loaded `Law`.
        command: a `Command`, platform poses (N, 6) at the control rate [m, rad], z down, or with
            `legs` extensions of the actuators (N, n) [m].
        legs: whether `command` are extensions.
        protection: conditions that make an emergency stop, `default` or a TOML file; the metadata
            tell the `fault` and its time. Default none.
        electronics: sensors, converters and servo electronics; default ideal, to the bit.
        **options: `start`, by default the command's first pose, with `legs` the model's `qpos0`
            (`plant.configuration` gives that of extensions); `events` on the time line;
            `record_every`, keep one frame in this many; `command_delay`, frames from a DCL frame
            to its command at the valves, by default 1.

    Returns:
        Channels of the demand, the legs, the hydraulics, the supply, `energy` passed since the
        start (columns `plant.hydraulics.ENERGIES`), the sensors, `generalised_position` (MuJoCo's
        qpos, to replay), the platform's true pose and `gimbal_error`, the largest distance between
        the halves of a closed gimbal since the row before. `leg_position` is what the sensors
        read, `leg_extension` what is true.

    Raises:
        InputError: an argument out of range, named.
        OutOfBounds: the state left its physical bounds; leg, time and value are named.

    >>> command = cmf_mj.signals.sine("surge", 0.01, frequency=2.0, cycles=1)
    >>> record = cmf_mj.simulate(cmf_mj.Hexapod(), "velocity", command)
    >>> bool(record["gimbal_error"].max() < 1e-5)
    True
    """
    check_options(plant, options, OPTIONS)
    guarded: Any = {"protection": protection, "electronics": electronics}
    source = LegDemand(cast("ArrayLike", command)) if legs else command
    return Run(plant, law, source, **options, **guarded).record()


def drive(plant: Plant, valves: ArrayLike, **options: Any) -> Record:
    """Run a plant open loop on given valve commands and record all signals.

    Args:
        plant: any `Plant`.
        valves: valve commands as fractions, -1 to 1, positive extending, (N, n), each held
            over its control frame.
        **options: as for `simulate`; `command_delay` is that from a row to the valves, by
            default 0.

    Returns:
        The channels of `simulate` without those of demand and DCL.

    Raises:
        InputError: an argument out of range, named.
        OutOfBounds: the state left its physical bounds; leg, time and value are named.

    >>> record = cmf_mj.drive(cmf_mj.SingleLegs(), np.full((200, 6), 0.1))
    >>> bool((record["leg_extension"][-1] > 0.0).all())
    True
    """
    check_options(plant, options, OPTIONS)
    return Run(plant, None, ValveCommands(valves), **{"command_delay": 0, **options}).record()


def check_options(plant: object, options: Mapping[str, Any], allowed: Sequence[str]) -> None:
    """Refuse what is no plant, and what is no option, by its name."""
    if not isinstance(plant, Plant):
        raise InputError(f"plant: {plant!r} is refused; allowed: a Plant, such as Hexapod('gfd')")
    for name in options:
        check_name("option", name, allowed)


def dcu_of(machine: Machine, source: str | Path | DcuSettings | None = None) -> DcuSettings:
    """A DCU fitted to a machine, by default the machine's."""
    return load_dcu(machine.dcu if source is None else source, fitting(machine))
