"""A machine as an image: plant, control law and electronics at rest, and what a host must know.

Nested tuples of numbers and arrays as data: a table of slots and one block of all arrays.

A host has the table and the block once for each instance and adds the block's address to the slots
that are `pointers`. Arrays that share memory share it in the block.
"""

import hashlib
from collections.abc import Collection
from typing import Any, NamedTuple

import mujoco
import numba
import numpy as np
from numpy.typing import NDArray

from cmf_mj.control import demand
from cmf_mj.control.dcu.play import Arrivals
from cmf_mj.control.law import Law
from cmf_mj.core.errors import InputError
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.export.machine_code import leaves, machine_code
from cmf_mj.facility.front import from_table
from cmf_mj.facility.host.handover import NEVER, make_log
from cmf_mj.facility.host_chain import HostChain
from cmf_mj.facility.loop import Controller, Dynamics, Memory, Recorder, run
from cmf_mj.facility.run import Run
from cmf_mj.facility.session import Session
from cmf_mj.machine.geometry import Geometry
from cmf_mj.plant.events import Timeline
from cmf_mj.plant.hexapod import PLANTS
from cmf_mj.plant.native import saved_model
from cmf_mj.plant.plant import Plant

_ALIGNED = 64


class Image(NamedTuple):
    """Numbers and arrays as the loop's machine code reads them."""

    slots: NDArray[np.int64]  #: Table; of an array its place in the block, shape and strides.
    pointers: list[int]  #: Slots that hold places in the block.
    at: dict[str, int]  #: First slot of each number and array by its dotted path.
    block: NDArray[np.uint8]  #: All arrays.


def make_image(value: Any, elsewhere: Collection[str] = ()) -> Image:
    """The image of nested tuples; arrays at the paths `elsewhere` are not in the block."""
    table: list[int] = []
    pointers: list[int] = []
    at: dict[str, int] = {}
    arrays: list[tuple[int, NDArray[Any]]] = []
    for path, leaf in leaves(value):
        at[path] = len(table)
        if isinstance(leaf, np.ndarray):
            if path not in elsewhere:
                pointers.append(len(table))
                arrays.append((len(table), leaf))
            table += [0, *leaf.shape, *leaf.strides]
        elif isinstance(leaf, float | np.floating):
            table.append(int(np.float64(leaf).view(np.int64)))
        else:
            table.append(int(leaf))
    block = _block(arrays, table)
    return Image(np.array(table, dtype=np.int64), pointers, at, block)


def _block(arrays: list[tuple[int, NDArray[Any]]], table: list[int]) -> NDArray[np.uint8]:
    """All arrays in one block; writes their places into their slots."""
    block = bytearray()
    begin = end = place = 0
    for slot, array in sorted(arrays, key=lambda pair: (_start(pair[1]), -pair[1].nbytes)):
        if not array.flags.c_contiguous:
            raise InputError(f"image: the array of slot {slot} is not contiguous")
        start = _start(array)
        if start >= end:  # shares no memory with those before
            block += bytes(-len(block) % _ALIGNED)
            begin, end, place = start, start, len(block)
        table[slot] = place + start - begin
        new = array.tobytes()[end - start :]
        block += new
        end += len(new)
    block += bytes(-len(block) % _ALIGNED)
    return np.frombuffer(bytes(block), dtype=np.uint8)


def _start(array: NDArray[Any]) -> int:
    return int(array.__array_interface__["data"][0])


ARRIVALS = 64  #: Host frames that may wait for the next step.

EVENTS = 64  #: Failures of a run.

IN_MUJOCO = {
    f"dynamics.mechanics.{name}"
    for name in ("length", "ctrl", "payload", "sensordata", "site", "qpos", "warnings")
}
"""Arrays that MuJoCo owns."""


class Parts(NamedTuple):
    """All that the frame loop works on."""

    dynamics: Dynamics
    controller: Controller
    memory: Memory
    recorder: Recorder
    outcome: NDArray[np.int64]  #: Frame, bound and leg where the state left its bounds, else -1.


def frames(parts, first, last):  # type: ignore[no-untyped-def]
    """Run frames of the loop; compiled where it is used."""
    frame, bound, leg = run(
        parts.dynamics, parts.controller, parts.memory, parts.recorder, first, last
    )
    parts.outcome[0], parts.outcome[1], parts.outcome[2] = frame, bound, leg


class PoseParts(NamedTuple):
    """What the leg demand of a pose is computed with, as it follows in the table."""

    geometry: Geometry
    motion: NDArray[np.float64]
    legs: NDArray[np.float64]


def legs_of_pose(parts, first, last):  # type: ignore[no-untyped-def]
    """Write the leg demand of a motion; compiled where it is used."""
    demand.step(parts.geometry, parts.motion, parts.legs)


class Frozen(NamedTuple):
    """A machine at rest as data."""

    run: Run
    session: Session
    parts: Parts
    image: Image
    model: NDArray[np.uint8]  #: As MuJoCo saves it.
    mechanics: NDArray[np.float64]  #: MuJoCo's state.
    sensors: NDArray[np.float64]  #: MuJoCo's sensors.

    @property
    def plant(self) -> Plant:
        """The plant of the run."""
        return self.session.plant

    @property
    def chain(self) -> bool:
        """Whether a host's frames can move it."""
        return isinstance(self.run.source, Arrivals)

    @property
    def digest(self) -> str:
        """Name of the machine among others, 14 hexadecimal digits."""
        blocks = self.image.slots.tobytes(), self.image.block.tobytes(), self.model.tobytes()
        return hashlib.sha256(b"".join(blocks)).hexdigest()[:14]

    def objects(self) -> dict[str, bytes]:
        """Object files of the loop by their names."""
        source = self.parts.controller.source
        made = {"cmf_loop": machine_code("cmf_loop", frames, numba.typeof(self.parts))}
        if self.chain:
            posed = PoseParts(source.blocks.geometry, source.motion, source.legs)
            made["cmf_demand"] = machine_code("cmf_demand", legs_of_pose, numba.typeof(posed))
        return made


def freeze(plant: Plant, law: Law | None, electronics: ElectronicsSettings | None = None) -> Frozen:
    """A plant with a law at rest at neutral, the law engaged.

    A plant of the facility stands behind the whole chain from the host. Any other follows a table
    of extensions, or without law one of valve commands.
    """
    run = _run(plant, law, electronics)
    session = run.session(kept_seconds=plant.machine.frame)
    first = session.dynamics.mechanics.sensordata.copy()
    session.run(1)
    row = session.record_rows.rows(0, 1)
    session = run.session(kept_seconds=plant.machine.frame)
    size = mujoco.mj_stateSize(plant.model, mujoco.mjtState.mjSTATE_INTEGRATION)
    mechanics = np.empty(size)
    mujoco.mj_getState(plant.model, plant.data, mechanics, mujoco.mjtState.mjSTATE_INTEGRATION)
    dynamics, controller, memory, recorder = session.parts
    recorder.out[:] = row
    never = np.full(EVENTS, NEVER)
    kind, leg, valve = np.zeros((3, EVENTS), dtype=np.int64)
    dynamics = dynamics._replace(timeline=Timeline(never, kind, leg, valve, np.zeros(EVENTS)))
    if controller.source.hosted:
        poses = np.zeros((1, 6))
        poses.flags.writeable = False
        asked: Any = {"request_frame": np.full(1, -1), "request": np.zeros(1, dtype=np.int64)}
        resting = controller.source._replace(hosted=False, poses=poses, **asked)
        controller = controller._replace(source=resting)
    parts = Parts(dynamics, controller, memory, recorder, np.full(3, -1))
    image = make_image(parts, IN_MUJOCO)
    model = np.frombuffer(saved_model(plant.model), dtype=np.uint8)
    return Frozen(run, session, parts, image, model, mechanics, first)


def _run(plant: Plant, law: Law | None, electronics: ElectronicsSettings | None) -> Run:
    given: dict[str, Any] = {"protection": "default", "source": make_log(ARRIVALS)}
    if law is None:
        given = {"command_delay": 0, "source": from_table(np.zeros((1, plant.legs)))}
    elif plant.name in PLANTS:
        given["operation"] = HostChain(begin="engaged", requests=())
    else:
        plant.start()
        given["source"] = from_table(np.array([plant.extensions()]))
    frame = plant.machine.frame
    return Run(plant=plant, law=law, electronics=electronics, duration=frame, **given)
