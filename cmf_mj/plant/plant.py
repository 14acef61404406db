"""A plant: hydraulic actuators on motors of a MuJoCo model.

`Plant` owns one MjModel and one MjData. Each named motor (of a slide joint or a tendon) is driven
by one cylinder: the cylinder force is written to the motor's `ctrl`, the motor's length, counted
from its length at the neutral configuration, is the extension. Nothing here assumes six legs.

Let M be MuJoCo's full inertia matrix, c its bias force less passive forces, N a basis of the
motions that the closed loops (equality constraints) allow, and A the motors' moment arms. Where
there are as many motors as free motions, T = N (A N)^-1 is the exact motion of the whole machine
per unit actuator velocity, and

    M_leg = T' M T    reflected mass [kg],        F = T' c    static forces [N]
"""

import copy
import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Self

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from cmf_mj.core.arrays import copy_block, frozen_json, real, shaped
from cmf_mj.core.errors import InputError
from cmf_mj.core.threads import OneAtATime
from cmf_mj.core.units import FRAME
from cmf_mj.machine.cab import Cab
from cmf_mj.machine.machine import Machine, load_machine
from cmf_mj.plant import model_checks, native
from cmf_mj.plant.hydraulics import Hydraulics, HydraulicState, make_hydraulics, rest
from cmf_mj.plant.native import Stepper, saved_model, without_sensors
from cmf_mj.plant.parameters import HydraulicParameters, load_hydraulics


class _Start(NamedTuple):
    """A start, to be repeated under the same conditions."""

    conditions: tuple[object, ...]
    qpos: NDArray[np.float64]  #: Generalised positions, (nq,).
    hydraulic_state: HydraulicState


class Plant:
    """Hydraulic actuators driving a MuJoCo model.

    >>> isinstance(cmf_mj.SingleLegs(), cmf_mj.Plant)
    True
    """

    name = "plant"  #: How records and tables call the plant.
    cab = ""  #: The cab it carries, where it carries one.
    cab_parameters: Cab | None = None  #: Masses of cab, platform and legs, where it carries one.
    machine: Machine
    """Motion base whose kinematics, strokes and limits a control law counts with; of a model that
    is none, the CMF, whose working stroke then bounds the demand."""
    _model_with_geoms: mujoco.MjModel | None = None  #: Where `model` is headless.
    stops_end_strokes = False
    """Whether the model's stops are the ends of the cylinders; else they lie within the strokes."""

    def __init__(
        self,
        model: mujoco.MjModel,
        hydraulics: str | Path | HydraulicParameters = "hardware",
        *,
        motors: Sequence[str] | None = None,
        payload: Sequence[str] = (),
        neutral: ArrayLike | None = None,
        machine: Machine | None = None,
    ) -> None:
        """Attach one cylinder to each of some motors of a compiled model.

        `attach_hydraulics` does so for a model that has no motors yet.

        Args:
            model: the machine; MuJoCo's automatic reset is switched off in it.
            hydraulics: `report`, `hardware`, `lossy`, a TOML file or a loaded set.
            motors: names of the motors with a cylinder, each force = ctrl; default all actuators.
            payload: names of the bodies an overload rests on.
            neutral: lengths of the motors with the cylinders at half stroke [m], (n,); default
                those of the configuration the model starts in, `qpos0`.
            machine: the motion base that the model is, if it is one.
        """
        self.machine = load_machine() if machine is None else machine
        # A state out of bounds ends a run: it must not begin again at rest, as if nothing were.
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.model = model
        self.data = mujoco.MjData(model)
        self._model_without_sensors = without_sensors(model)  # for steps that nobody records
        self._last_start: _Start | None = None
        self.started = 0
        """How often the state has been reset: a run goes on only while nobody does."""
        self.alone = OneAtATime("plant: another thread runs it; allowed: a plant for each thread")
        """Who changes the state."""
        names = [model.actuator(i).name for i in range(model.nu)]
        self.actuators = tuple(names if motors is None else motors)
        """Names of the hydraulic motors, in the order of all arrays with a leg axis."""
        if not self.actuators:
            raise InputError("motors: the model has no actuators; each cylinder needs a motor")
        for name in self.actuators:
            if name not in names:
                raise InputError(f"motors: {name!r} is not one of {', '.join(names)}")
            model_checks.check_motor(model, name)
        self._motors = np.array([model.actuator(name).id for name in self.actuators])
        self._payload = np.array([model.body(name).id for name in payload], dtype=np.int64)
        self.parameters = load_hydraulics(hydraulics)
        self.hydraulics: Hydraulics = make_hydraulics(
            self.parameters, self.actuators, float(model.opt.timestep)
        )
        mujoco.mj_forward(model, self.data)
        if neutral is None:
            neutral = self.data.actuator_length[self._motors]
        self.neutral = shaped("neutral", neutral, self.legs)
        """Lengths of the motors with the cylinders at half stroke [m], (n,)."""
        self.check()

    def __repr__(self) -> str:
        """Name, cab, hydraulic set and number of legs."""
        name = f"{self.name} {self.cab}".strip()
        return (
            f"<{type(self).__name__}: {name}, {self.parameters.name} hydraulics, {self.legs} legs>"
        )

    @property
    def legs(self) -> int:
        """Number of actuators n."""
        return len(self.actuators)

    @property
    def law_key(self) -> str | Cab:
        """What a law is bound to: the cab it is known by, or the name of a plant without one."""
        return self.name if self.cab_parameters is None else self.cab_parameters.assumed

    @cached_property
    def sensors(self) -> dict[str, NDArray[np.int64]]:
        """Recorded sensor groups: channel name to indices into MjData.sensordata."""
        return {}

    @property
    def drawn_model(self) -> mujoco.MjModel:
        """The model to draw the machine with; its joints, bodies and sites are those of `model`."""
        return self.model if self._model_with_geoms is None else self._model_with_geoms

    @property
    def gimbal_sites(self) -> NDArray[np.int64]:
        """Sites of the two halves of each closed gimbal, (gimbals, 2)."""
        return np.empty((0, 2), dtype=np.int64)

    def derived_channels(
        self, channels: Mapping[str, NDArray[np.float64]]
    ) -> dict[str, tuple[NDArray[np.float64], str]]:
        """Channels computed from recorded `channels`: name to (values, unit)."""
        return {}

    def check(self) -> None:
        """Refuse a model that does not fit its hydraulics, with `data` in `qpos0`, before a run."""
        model_checks.check_stops(
            self.model,
            self.actuators,
            self.neutral,
            self.hydraulics.cylinder.half_stroke,
            self.parameters.name,
            equal=self.stops_end_strokes,
        )

    def sensor_indices(self, names: list[str], component: int | None = None) -> NDArray[np.int64]:
        """Indices into MjData.sensordata of sensors by `names`, or of one `component` of each."""
        indices: list[int] = []
        for name in names:
            sensor = self.model.sensor(name)
            start, size = int(sensor.adr[0]), int(sensor.dim[0])
            indices += range(start, start + size) if component is None else [start + component]
        return np.array(indices, dtype=np.int64)

    def place(self, pose: ArrayLike) -> None:
        """Put the mechanics at rest in generalised positions (nq,); a hexapod, in a pose (6,)."""
        self.data.qpos[:] = shaped("pose", pose, self.model.nq)
        mujoco.mj_forward(self.model, self.data)

    def extensions(self) -> NDArray[np.float64]:
        """Extensions from neutral in the present configuration [m], (n,)."""
        return self.data.actuator_length[self._motors] - self.neutral

    def _free_motions(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """N (nv, m), the motions closed loops allow, and A N (n, m), what the cylinders see."""
        loops, _, moment = self._jacobians()
        motions = linalg.null_space(loops, rcond=1e-9) if loops.size else np.eye(self.model.nv)
        return motions, moment @ motions

    def _jacobians(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Jacobian (rows, nv) and gaps (rows,) of the closed loops; moment arms (n, nv)."""
        model, data, count = self.model, self.data, self.data.nefc
        jacobian, moment = np.zeros((count, model.nv)), np.zeros((model.nu, model.nv))
        if mujoco.mj_isSparse(model):
            layout = (data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
            mujoco.mju_sparse2dense(jacobian, data.efc_J.ravel(), *layout)
        else:
            jacobian[:] = data.efc_J.reshape(count, model.nv)
        moment_layout = (data.moment_rownnz, data.moment_rowadr, data.moment_colind.ravel())
        mujoco.mju_sparse2dense(moment, data.actuator_moment.ravel(), *moment_layout)
        is_loop = data.efc_type[:count] == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        return jacobian[is_loop], data.efc_pos[:count][is_loop], moment[self._motors]

    def leg_motion(self) -> NDArray[np.float64]:
        """T, (nv, n): motion of all joints per unit actuator velocity, in the present state."""
        motions, arms = self._free_motions()
        if arms.shape[0] != arms.shape[1] or np.linalg.cond(arms) > 1e12:
            raise InputError(
                f"motors: {arms.shape[0]} cylinders do not determine the machine's "
                f"{arms.shape[1]} free motions; there must be as many, independent"
            )
        return motions @ np.linalg.inv(arms)

    def configuration(self, extensions: ArrayLike) -> NDArray[np.float64]:
        """Generalised positions (nq,) with extensions (n,) [m] and all loops closed, for `start`.

        Newton's method from `qpos0`, in steps of at most 0.1 m so as to stay on its branch; what
        the cylinders do not determine moves least. Leaves the mechanics there.
        """
        target = shaped("extensions", extensions, self.legs)
        half = self.hydraulics.cylinder.half_stroke
        for leg in np.flatnonzero(~(np.abs(target) <= half)):
            raise InputError(
                f"extensions: {self.actuators[leg]} at {target[leg]:.4f} m; "
                f"allowed: +-{half[leg]:.4f} m"
            )
        with self.alone:
            self._reset()
        for _ in range(200):
            mujoco.mj_forward(self.model, self.data)
            loops, gap, moment = self._jacobians()
            travel = target - self.extensions()
            error = float(np.abs(np.concatenate([gap, travel])).max())
            if error < 1e-12:
                return self.data.qpos.copy()
            travel *= min(1.0, 0.1 / max(float(np.abs(travel).max()), 1e-12))
            jacobian, changes = np.vstack([loops, moment]), np.concatenate([-gap, travel])
            motion, *_ = np.linalg.lstsq(jacobian, changes, rcond=1e-9)
            mujoco.mj_integratePos(self.model, self.data.qpos, motion, 1.0)
        raise InputError(f"extensions: the machine cannot be closed at {target.tolist()} m")

    def static_load(self) -> NDArray[np.float64]:
        """Axial forces (n,) [N] that hold the present configuration, positive extending.

        N' A' F = N' c, the T'c of the module where the cylinders determine all motions. A motion
        that no cylinder holds does not count; cylinders that share one share its load with the
        least sum of squares. Other actuators hold what they hold without control.
        """
        self.data.qvel[:] = 0.0
        self.data.ctrl[self._motors] = 0.0
        mujoco.mj_forward(self.model, self.data)
        motions, arms = self._free_motions()
        data = self.data
        load = motions.T @ (data.qfrc_bias - data.qfrc_passive - data.qfrc_actuator)
        forces, *_ = np.linalg.lstsq(arms.T, load, rcond=1e-9)
        return forces

    def reflected_mass(self, pose: ArrayLike | None = None) -> NDArray[np.float64]:
        """Reflected mass of the actuators, (n, n) [kg], in a pose as `place` takes it.

        Row i, column j is the force on leg i per acceleration of leg j at rest (section 2.4.2).
        """
        self.start(pose)
        inertia = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, inertia)
        motion = self.leg_motion()
        return motion.T @ inertia @ motion

    def start(self, pose: ArrayLike | None = None) -> HydraulicState:
        """Reset to rest in a pose as `place` takes it; the hydraulic state that holds it.

        Refused are what `check` refuses, a closed loop that is open there, what MuJoCo warns of
        there, and a machine that the supply cannot hold there.
        """
        with self.alone:
            self._reset()
            conditions = self._start_conditions(pose)
            if self._last_start is not None and conditions == self._last_start.conditions:
                self.data.qpos[:] = self._last_start.qpos
                mujoco.mj_forward(self.model, self.data)
                return copy_block(self._last_start.hydraulic_state)
            self._model_without_sensors = without_sensors(self.model)
            mujoco.mj_kinematics(self.model, self.data)
            self.check()
            if pose is not None:
                self.place(pose)
            mujoco.mj_forward(self.model, self.data)
            model_checks.check_closed(self.model, self.data)
            load = self.static_load()
            if warnings := self.warning_text():
                raise InputError(f"start: {warnings}; allowed: a state without warnings")
            state = rest(self.hydraulics, load, self.extensions())
            self._last_start = _Start(conditions, self.data.qpos.copy(), copy_block(state))
            return state

    def _start_conditions(self, pose: ArrayLike | None) -> tuple[object, ...]:
        """What the state of a start follows from: model, pose and hydraulics, to compare."""
        pose_bytes = None if pose is None else real("pose", pose).tobytes()
        valve, cylinder, friction, *scalars = self.hydraulics
        array_bytes = [array.tobytes() for array in (valve, cylinder, friction, self.neutral)]
        return saved_model(self.model), pose_bytes, array_bytes, scalars

    def warning_text(self) -> str:
        """MuJoCo's warnings since the state was reset, by name; empty for none."""
        kinds = [mujoco.mjtWarning(i) for i in np.flatnonzero(self.data.warning.number)]
        return ", ".join(
            f"MuJoCo warns of {kind.name.removeprefix('mjWARN_')} "
            f"({mujoco.mju_warningText(kind, self.data.warning[kind].lastinfo).strip(' .')})"
            for kind in kinds
        )

    def _reset(self) -> None:
        mujoco.mj_resetData(self.model, self.data)
        self.started += 1

    def changed(
        self, hydraulics: HydraulicParameters, edit: Callable[[mujoco.MjModel], None]
    ) -> Self:
        """The same plant with another set of `hydraulics`, its MuJoCo model changed by `edit`."""
        plant = copy.deepcopy(self)
        for cached_name in ("digest", "_description"):
            plant.__dict__.pop(cached_name, None)
        plant.parameters = hydraulics
        step = float(plant.model.opt.timestep)
        plant.hydraulics = make_hydraulics(hydraulics, plant.actuators, step)
        edit(plant.model)
        mujoco.mj_setConst(plant.model, plant.data)
        return plant

    def mechanics(self) -> Stepper:
        """Views and addresses for the compiled loop; valid from a `start` to the next."""
        return Stepper(
            model=self.model._address,
            quiet=self._model_without_sensors._address,
            data=self.data._address,
            position_stage=native.address("mj_step1"),
            force_stage=native.address("mj_step2"),
            motors=self._motors,
            length=self.data.actuator_length,
            ctrl=self.data.ctrl,
            payload=self.data.xfrc_applied,
            payload_bodies=self._payload,
            sensordata=self.data.sensordata,
            site=self.data.site_xpos,
            qpos=self.data.qpos,
            neutral=self.neutral,
            warnings=self.data.warning.number,
        )

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the compiled MuJoCo model, taken once: the model is not to be edited."""
        return hashlib.sha256(saved_model(self.model)).hexdigest()

    @cached_property
    def _description(self) -> Mapping[str, object]:
        cab = self.cab_parameters
        return frozen_json(
            {
                "plant": self.name,
                "machine": self.machine.name,
                "machine_parameters": self.machine.recorded(),
                "cab": self.cab,
                "cab_parameters": cab.model_dump(mode="json", exclude_none=True) if cab else {},
                "hydraulics": self.parameters.name,
                "hydraulic_parameters": self.parameters.model_dump(exclude_none=True),
                "model_digest": self.digest,
            }
        )

    def describe(self) -> Mapping[str, object]:
        """What a record keeps of the plant, taken once but for the step."""
        return {**self._description, "mechanical_step": self.model.opt.timestep}


def set_timestep(option: Any, timestep: float | None, frame: float = FRAME) -> None:
    """Set the mechanical step [s] in the options of a model, made for steps to 1/2048 s.

    None is the longest share of a control frame that is no longer.
    """
    if timestep is None:
        timestep = frame / math.ceil(frame / FRAME)
    if not 0.0 < timestep < math.inf:
        raise InputError(f"timestep: {timestep} s must be greater than 0 and finite")
    option.timestep = timestep
