"""A plant: hydraulic actuators on the motors of a MuJoCo model.

`Plant` owns one MjModel and one MjData. Each named motor (of a slide joint or a tendon) is driven
by one cylinder: the cylinder force is written to the motor's `ctrl`, the motor's length, counted
from its length at the neutral pose, is the leg extension. Nothing here assumes six legs.
"""

import hashlib
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.parameters import HydraulicParameters, load_hydraulics
from cmf_mj.plant import native
from cmf_mj.plant.hydraulics import Hydraulics, make_hydraulics, rest


class Mechanics(NamedTuple):
    """What the compiled loop needs of MuJoCo: three addresses and views of MjData."""

    model: int
    """Address of the mjModel."""
    data: int
    """Address of the mjData."""
    position_stage: int
    """Address of mj_step1: kinematics and position sensors at the present state."""
    force_stage: int
    """Address of mj_step2: forces, acceleration and integration."""
    length: NDArray[np.float64]
    """Motor lengths, fresh after the position stage, (n,)."""
    ctrl: NDArray[np.float64]
    """Motor forces [N], (n,)."""
    sensordata: NDArray[np.float64]
    """All sensors."""
    qpos: NDArray[np.float64]
    """Generalised positions."""
    neutral: NDArray[np.float64]
    """Motor lengths at neutral, (n,)."""


class Plant:
    """Hydraulic actuators driving a MuJoCo model."""

    name = "plant"
    """How records and tables call the plant."""
    cab = ""
    """The cab it carries, where it carries one."""

    def __init__(
        self,
        model: mujoco.MjModel,
        hydraulics: str | Path | HydraulicParameters = "hardware",
    ) -> None:
        """Attach one cylinder to each motor of a compiled model.

        Args:
            model: its actuators are the legs; each must be a motor (force = ctrl).
            hydraulics: `report`, `hardware`, a TOML file or a loaded set.

        Raises:
            ValueError: the model has no motors, or the hydraulics are refused.
        """
        if model.nu == 0:
            raise ValueError("model: has no actuators; each leg needs a motor")
        self.model = model
        self.data = mujoco.MjData(model)
        self.parameters = load_hydraulics(hydraulics)
        self.hydraulics: Hydraulics = make_hydraulics(self.parameters)
        mujoco.mj_forward(model, self.data)
        self.neutral = self.data.actuator_length.copy()

    @property
    def legs(self) -> int:
        """Number of actuators n."""
        return int(self.model.nu)

    @property
    def sensors(self) -> dict[str, NDArray[np.int64]]:
        """Recorded sensor groups: channel name to indices into MjData.sensordata."""
        return {}

    @property
    def gimbal_sensors(self) -> NDArray[np.int64]:
        """First indices of the three-vectors between the halves of each closed gimbal."""
        return np.empty(0, dtype=np.int64)

    def derived_channels(
        self, channels: Mapping[str, NDArray[np.float64]]
    ) -> dict[str, tuple[NDArray[np.float64], str]]:
        """Channels computed from recorded ones: name to (values, unit)."""
        return {}

    def sensor_indices(self, names: list[str], component: int | None = None) -> NDArray[np.int64]:
        """Indices into MjData.sensordata of named sensors, or of one component of each."""
        indices: list[int] = []
        for name in names:
            sensor = self.model.sensor(name)
            start, size = int(sensor.adr[0]), int(sensor.dim[0])
            indices += range(start, start + size) if component is None else [start + component]
        return np.array(indices, dtype=np.int64)

    def place(self, pose: ArrayLike) -> None:
        """Put the mechanics at rest at a pose (6,) [m, rad]; to be given by the subclass."""
        raise TypeError(f"{type(self).__name__} does not know platform poses")

    def static_load(self) -> NDArray[np.float64]:
        """Axial forces (n,) [N] that hold the present configuration, positive extending."""
        raise TypeError(f"{type(self).__name__} does not know its static load")

    def start(self, pose: ArrayLike | None = None) -> NDArray[np.float64]:
        """Reset to rest at a pose and return the hydraulic state (n, 4) that holds it."""
        mujoco.mj_resetData(self.model, self.data)
        self.place(np.zeros(6) if pose is None else pose)
        return rest(self.hydraulics, self.static_load())

    def mechanics(self) -> Mechanics:
        """Views and addresses for the compiled loop; valid while this plant lives."""
        return Mechanics(
            model=self.model._address,
            data=self.data._address,
            position_stage=native.address("mj_step1"),
            force_stage=native.address("mj_step2"),
            length=self.data.actuator_length,
            ctrl=self.data.ctrl,
            sensordata=self.data.sensordata,
            qpos=self.data.qpos,
            neutral=self.neutral,
        )

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the compiled MuJoCo model, taken once: the model is not to be edited."""
        buffer = np.empty(mujoco.mj_sizeModel(self.model), dtype=np.uint8)
        mujoco.mj_saveModel(self.model, None, buffer)
        return hashlib.sha256(buffer.tobytes()).hexdigest()

    def describe(self) -> Mapping[str, object]:
        """What a record keeps of the plant."""
        return {
            "plant": self.name,
            "cab": self.cab,
            "hydraulics": self.parameters.name,
            "hydraulic_parameters": self.parameters.model_dump(),
            "model_digest": self.digest,
            "mechanical_step": self.model.opt.timestep,
        }
