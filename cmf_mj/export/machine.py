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

_ALIGNMENT = 64  #: Of arrays in the block [octets].


class Image(NamedTuple):
    """Numbers and arrays as the loop's machine code reads them."""

    slots: NDArray[np.int64]  #: Table; of an array its place in the block, shape and strides.
    pointers: list[int]  #: Slots that hold places in the block.
    first_slots: dict[str, int]  #: Of each number and array by its dotted path.
    block: NDArray[np.uint8]  #: All arrays.


def make_image(value: Any, elsewhere: Collection[str] = ()) -> Image:
    """The image of nested tuples; arrays at the paths `elsewhere` are not in the block."""
    table: list[int] = []
    first_slots: dict[str, int] = {}
    arrays: dict[int, NDArray[Any]] = {}  # by slot
    for path, leaf in leaves(value):
        slot = first_slots[path] = len(table)
        if isinstance(leaf, np.ndarray):
            if path not in elsewhere:
                arrays[slot] = leaf
            table += [0, *leaf.shape, *leaf.strides]
        elif isinstance(leaf, float | np.floating):
            table.append(int(np.float64(leaf).view(np.int64)))
        else:
            table.append(int(leaf))
    block, places = _make_block(arrays)
    for slot, place in places.items():
        table[slot] = place
    return Image(np.array(table, dtype=np.int64), list(arrays), first_slots, block)


def _make_block(arrays: dict[int, NDArray[Any]]) -> tuple[NDArray[np.uint8], dict[int, int]]:
    """All arrays in one block, and their places in it, by slot."""
    block, places = bytearray(), dict[int, int]()
    begin = end = begin_place = 0  # of the memory that arrays share, and where it is in the block
    by_address = sorted(arrays.items(), key=lambda item: (_address(item[1]), -item[1].nbytes))
    for slot, array in by_address:
        if not array.flags.c_contiguous:
            raise InputError(f"image: the array of slot {slot} is not contiguous")
        address = _address(array)
        if address >= end:  # shares no memory with those before
            block += bytes(-len(block) % _ALIGNMENT)
            begin, end, begin_place = address, address, len(block)
        places[slot] = begin_place + address - begin
        new_bytes = array.tobytes()[end - address :]
        block += new_bytes
        end += len(new_bytes)
    block += bytes(-len(block) % _ALIGNMENT)
    return np.frombuffer(bytes(block), dtype=np.uint8), places


def _address(array: NDArray[Any]) -> int:
    address, _ = array.__array_interface__["data"]
    return int(address)


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


def run_frames(parts, first, last):  # type: ignore[no-untyped-def]
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


def write_legs(parts, first, last):  # type: ignore[no-untyped-def]
    """Write the leg demand of a motion; compiled where it is used."""
    demand.step(parts.geometry, parts.motion, parts.legs)


class Export(NamedTuple):
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
    def has_host(self) -> bool:
        """Whether frames of a host move it."""
        return isinstance(self.run.source, Arrivals)

    @property
    def digest(self) -> str:
        """Name of the machine among others, 14 hexadecimal digits."""
        blocks = self.image.slots.tobytes(), self.image.block.tobytes(), self.model.tobytes()
        return hashlib.sha256(b"".join(blocks)).hexdigest()[:14]

    def objects(self) -> dict[str, bytes]:
        """Object files of the loop by their names."""
        source = self.parts.controller.source
        objects = {"cmf_loop": machine_code("cmf_loop", run_frames, numba.typeof(self.parts))}
        if self.has_host:
            parts = PoseParts(source.blocks.geometry, source.motion, source.legs)
            objects["cmf_demand"] = machine_code("cmf_demand", write_legs, numba.typeof(parts))
        return objects


def make_export(
    plant: Plant, law: Law | None, electronics: ElectronicsSettings | None = None
) -> Export:
    """A plant with a law at rest at neutral, the law engaged.

    A plant of the facility stands behind the whole chain from the host. Any other follows a table
    of extensions, or without law one of valve commands.
    """
    run = _make_run(plant, law, electronics)
    session = run.session(kept_seconds=plant.machine.frame)
    sensors = session.dynamics.mechanics.sensordata.copy()
    session.run(1)
    first_row = session.record_rows.rows(0, 1)
    session = run.session(kept_seconds=plant.machine.frame)
    state = mujoco.mjtState.mjSTATE_INTEGRATION
    mechanics = np.empty(mujoco.mj_stateSize(plant.model, state))
    mujoco.mj_getState(plant.model, plant.data, mechanics, state)
    dynamics, controller, memory, recorder = session.parts
    recorder.out[:] = first_row
    parts = Parts(
        dynamics._replace(timeline=_empty_timeline()),
        _at_rest(controller) if controller.source.hosted else controller,
        memory,
        recorder,
        outcome=np.full(3, -1),
    )
    image = make_image(parts, IN_MUJOCO)
    model = np.frombuffer(saved_model(plant.model), dtype=np.uint8)
    return Export(run, session, parts, image, model, mechanics, sensors)


def _empty_timeline() -> Timeline:
    """Room for `EVENTS` failures, none of which happens."""
    kind, leg, valve = np.zeros((3, EVENTS), dtype=np.int64)
    return Timeline(np.full(EVENTS, NEVER), kind, leg, valve, np.zeros(EVENTS))


def _at_rest(controller: Controller) -> Controller:
    """A controller that follows one pose until a host sends frames."""
    poses = np.zeros((1, 6))
    poses.flags.writeable = False
    requests: Any = {"request_frame": np.full(1, -1), "request": np.zeros(1, dtype=np.int64)}
    source = controller.source._replace(hosted=False, poses=poses, **requests)
    return controller._replace(source=source)


def _make_run(plant: Plant, law: Law | None, electronics: ElectronicsSettings | None) -> Run:
    options: dict[str, Any] = {"protection": "default", "source": make_log(ARRIVALS)}
    if law is None:
        options = {"command_delay": 0, "source": from_table(np.zeros((1, plant.legs)))}
    elif plant.name in PLANTS:
        options["operation"] = HostChain(begin="engaged", requests=())
    else:
        plant.start()
        options["source"] = from_table(np.array([plant.extensions()]))
    frame = plant.machine.frame
    return Run(plant=plant, law=law, electronics=electronics, duration=frame, **options)
