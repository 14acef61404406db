"""The hexapod: real cab inertia, gimbal geometry and prismatic legs, integrated by MuJoCo.

Reflected mass (section 2.4.2) and static leg forces are those of `Plant`, leg masses included.
"""

import copy
from collections.abc import Mapping
from functools import cached_property, lru_cache
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg
from scipy.spatial.transform import Rotation

from cmf_mj.core.arrays import shaped
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.machine import kinematics
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.machine.geometry import FLIP
from cmf_mj.machine.machine import Machine
from cmf_mj.machine.models import RigidBody
from cmf_mj.plant import cylinder
from cmf_mj.plant.model_checks import ROUND_OFF, check_hexapod
from cmf_mj.plant.model_text import MACHINE_FILE, model_texts, with_floor
from cmf_mj.plant.native import headless
from cmf_mj.plant.parameters import HydraulicParameters, hydraulics_of
from cmf_mj.plant.plant import Plant, set_timestep
from cmf_mj.plant.single_legs import SingleLegs

_LEGS = range(1, 7)


class HydraulicModes(NamedTuple):
    """Undamped modes of the reflected mass on the oil springs at one pose, lowest first.

    M_leg(x) d2l/dt2 + K(x) l = 0 with the valves shut and no leakage. A mode of leg shape s,
    s' M_leg s = 1, moves the platform by p = J^-1 s; single legs have one mode of the mass of
    their payload.
    """

    cab: str
    pose: NDArray[np.float64]  #: (6,) [m, rad], z down.
    reflected_mass: NDArray[np.float64]  #: M_leg [kg], (6, 6).
    frequency: NDArray[np.float64]  #: Natural frequencies [rad/s], (6,).
    leg_shape: NDArray[np.float64]  #: Leg motion of the modes, a column each, of unit mass, (6, 6).
    pose_shape: NDArray[np.float64]
    """Platform motion of each mode, (6, 6), a column a mode: m and rad per unit of the mode."""
    share: NDArray[np.float64]
    """Part p_d (J' M_leg J p)_d of each degree of freedom d (rows) in the kinetic energy of each
    mode (columns)."""

    @property
    def frequency_hz(self) -> NDArray[np.float64]:
        """Natural frequencies [Hz], (6,)."""
        return self.frequency / (2.0 * np.pi)

    @property
    def leg_mass(self) -> NDArray[np.float64]:
        """Mass a leg feels in each mode, 1 / s's [kg], (6,)."""
        return 1.0 / np.sum(self.leg_shape**2, axis=0)


def oil_modes(
    mass: NDArray[np.float64], springs: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Modes of M d2l/dt2 + K l = 0, lowest first.

    Of the reflected mass (n, n) [kg] and the diagonal of K (n,) [N/m]: natural frequencies (n,)
    [rad/s], and shapes (n, n) of unit mass, a column a mode.
    """
    squares, shapes = linalg.eigh(np.diag(springs), mass)
    return np.sqrt(squares), shapes


class Hexapod(Plant):
    """Plant A: a motion base with one of its cabs, by default the Cockpit Motion Facility.

    >>> plant = cmf_mj.Hexapod("ifd", hydraulics="report")
    >>> plant.legs, plant.cab
    (6, 'ifd')
    """

    name = "hexapod"
    stops_end_strokes = True

    def __init__(
        self,
        cab: str | Path | Cab | None = None,
        hydraulics: str | Path | HydraulicParameters | None = None,
        *,
        machine: str | Path | Machine | None = None,
        spec: mujoco.MjSpec | None = None,
        timestep: float | None = None,
    ) -> None:
        """Load the machine, put a cab on it and attach the hydraulics.

        Args:
            cab: one of the machine's by name, a TOML file or a loaded cab; default its first, of
                the CMF `gfd`.
            hydraulics: `report`, `hardware`, `lossy`, a TOML file or a loaded set; default that of
                the machine, of the CMF `hardware`.
            machine: by name, TOML file or loaded; default that of a loaded cab, or the CMF.
            spec: an edited `hexapod_spec` of the cab, with its masses and the machine's geometry;
                default as shipped.
            timestep: mechanical step [s]; default that of the `spec`, else as `set_timestep`.
        """
        self.cab_parameters = loaded_cab = load_cab(cab, machine)  # for `check`, run by `super()`
        self.cab = loaded_cab.name
        try:
            self._model_with_geoms = None if spec is None else spec.compile()
            model = hexapod_model(loaded_cab, has_geoms=False) if spec is None else headless(spec)
        except ValueError as error:
            raise InputError(f"spec: does not compile: {error}") from None
        if spec is None or timestep is not None:
            set_timestep(model.opt, timestep, loaded_cab.machine.frame)
        parameters = hydraulics_of(loaded_cab.machine, hydraulics)
        super().__init__(model, parameters, payload=["platform"], machine=loaded_cab.machine)

    def check(self) -> None:
        """Refuse a model that is not the machine of kinematics, hydraulics and cab.

        Gimbals, leg axes and stops must be those of the kinematics, the gimbals pinned and closed
        at neutral, the masses those of the cab.
        """
        super().check()
        base_half, half = self.machine.half_stroke, self.hydraulics.cylinder.half_stroke
        for leg in np.flatnonzero(~(np.abs(half - base_half) <= ROUND_OFF)):
            raise InputError(
                f"half_stroke: set {self.parameters.name!r} gives leg_{leg + 1} "
                f"+-{half[leg]:.6g} m, the kinematics +-{base_half:.6g} m; allowed: both the same"
            )
        assert self.cab_parameters is not None
        check_hexapod(self.model, self.data, self.machine.geometry, self.cab_parameters)

    @property
    def drawn_model(self) -> mujoco.MjModel:
        """The model with its geoms; `model` has none, and the same state at every step."""
        assert self.cab_parameters is not None
        return self._model_with_geoms or hexapod_model(self.cab_parameters)

    @cached_property
    def sensors(self) -> dict[str, NDArray[np.int64]]:
        """Gyro, accelerometers of platform and crew, rod accelerometers (axial part), stops."""
        rods = [f"rod_acceleration_{i}" for i in _LEGS]
        return {
            "platform_gyro": self.sensor_indices(["platform_gyro"]),
            "platform_accelerometer": self.sensor_indices(["platform_accelerometer"]),
            "crew_accelerometer": self.sensor_indices(["cab/crew_accelerometer"]),
            "rod_accelerometer": self.sensor_indices(rods, component=2),
            "stop_force": self.sensor_indices([f"stop_force_{i}" for i in _LEGS]),
        }

    @property
    def gimbal_sites(self) -> NDArray[np.int64]:
        """Rod end and upper gimbal of each leg."""
        kinds = ("rod_end", "upper")
        return np.array([[self.model.site(f"{kind}_{i}").id for kind in kinds] for i in _LEGS])

    def derived_channels(
        self, channels: Mapping[str, NDArray[np.float64]]
    ) -> dict[str, tuple[NDArray[np.float64], str]]:
        """The platform's true pose, of the recorded `channels`."""
        return {"platform_pose": (self.pose_of(channels["generalised_position"]), "m, rad")}

    def place(self, pose: ArrayLike) -> None:
        """Set platform, gimbals and rods to a pose (6,) [m, rad], z down, all gimbals closed."""
        target, geometry = shaped("pose", pose, 6), self.machine.geometry
        extensions = kinematics.pose_to_legs(target, self.machine)
        half = self.hydraulics.cylinder.half_stroke
        for leg in np.flatnonzero(np.abs(extensions) >= half):
            raise InputError(
                f"pose: puts leg {leg + 1} at {extensions[leg]:.4f} m; allowed: +-{half[leg]:.4f} m"
            )
        rotation = kinematics.rotation(*target[3:])
        world_rotation = Rotation.from_matrix(FLIP[:, None] * rotation * FLIP)
        qpos = self.data.qpos
        position_slice, quaternion_slice = self._platform_slices()
        qpos[position_slice] = target[:3] * FLIP
        qpos[quaternion_slice] = world_rotation.as_quat(scalar_first=True)
        upper = target[:3] + geometry.upper @ rotation.T
        lines = (upper - geometry.lower) * FLIP
        for number, line, extension in zip(_LEGS, lines, extensions, strict=True):
            # Leg direction in the frame of its lower gimbal: Rx(a) Ry(b) z = (sin b, -sin a cos b,
            # cos a cos b).
            body = self.model.body(f"cylinder_{number}")
            frame = Rotation.from_quat(body.quat, scalar_first=True)
            x, y, z = frame.inv().apply(line / np.linalg.norm(line))
            qpos[self.model.joint(f"gimbal_{number}_x").qposadr[0]] = np.arctan2(-y, z)
            qpos[self.model.joint(f"gimbal_{number}_y").qposadr[0]] = np.arcsin(x)
            qpos[self.model.joint(f"leg_{number}").qposadr[0]] = extension
        mujoco.mj_forward(self.model, self.data)

    def _platform_slices(self) -> tuple[slice, slice]:
        """Position and quaternion of the platform, as parts of the generalised positions."""
        start = self.model.joint("platform").qposadr[0]
        return slice(start, start + 3), slice(start + 3, start + 7)

    def pose_of(self, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """Platform pose (..., 6), report axes, of generalised positions `qpos`, (..., nq)."""
        position_slice, quaternion_slice = self._platform_slices()
        position = qpos[..., position_slice] * FLIP
        quaternion = qpos[..., quaternion_slice] * np.array([1.0, 1.0, -1.0, -1.0])
        rotation = Rotation.from_quat(quaternion.reshape(-1, 4), scalar_first=True)
        yaw_pitch_roll = rotation.as_euler("ZYX").reshape((*qpos.shape[:-1], 3))
        return np.concatenate([position, yaw_pitch_roll[..., ::-1]], axis=-1)

    def hydraulic_modes(self, pose: ArrayLike | None = None) -> HydraulicModes:
        """Modes of M_leg d2l/dt2 + K(l) l = 0 at a pose, by default neutral."""
        target = np.zeros(6) if pose is None else shaped("pose", pose, 6)
        mass = self.reflected_mass(target)
        legs = kinematics.pose_to_legs(target, self.machine)
        bulk_modulus = self.hydraulics.oil.bulk_modulus
        springs = cylinder.stiffness(self.hydraulics.cylinder, bulk_modulus, legs)
        frequency, shapes = oil_modes(mass, springs)
        jacobian = kinematics.pose_jacobian(target, self.machine)
        pose_shapes = np.linalg.inv(jacobian) @ shapes
        share = pose_shapes * (jacobian.T @ mass @ shapes)
        return HydraulicModes(self.cab, target, mass, frequency, shapes, pose_shapes, share)


def hexapod_spec(
    cab: str | Path | Cab | None = None,
    machine: str | Path | Machine | None = None,
    *,
    sliding: bool = False,
) -> mujoco.MjSpec:
    """The editable MuJoCo model of a machine in its hall with a cab, for users who extend it.

    The legs stand on rigid ground or, `sliding`, on a body `floor` that slides in x, y and z and
    has no mass yet; `yielding` gives it one, and springs.
    """
    loaded_cab = load_cab(cab, machine)
    base = load_cab(loaded_cab.base, loaded_cab.machine)
    scene, files = model_texts(base)
    if sliding:
        files[MACHINE_FILE] = with_floor(files[MACHINE_FILE])
    spec = mujoco.MjSpec.from_string(scene, files)
    _change_masses(spec, loaded_cab, base)
    return spec


def hexapod_model(cab: str | Path | Cab | None = None, *, has_geoms: bool = True) -> mujoco.MjModel:
    """The compiled machine with a cab; one without geoms is the `headless` one."""
    return copy.copy(_compiled_model(load_cab(cab), has_geoms))


@lru_cache(maxsize=8)
def _compiled_model(cab: Cab, has_geoms: bool) -> mujoco.MjModel:
    """The model of a cab, to be copied and never changed."""
    spec = hexapod_spec(cab)
    return spec.compile() if has_geoms else headless(spec)


def principal_axes(inertia: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Principal moments (3,) [kg m^2] of a tensor (3, 3), and the quaternion of their axes."""
    if inertia[0, 1] == inertia[0, 2] == inertia[1, 2] == 0.0:  # keeps its axes
        return np.diag(inertia).copy(), np.array([1.0, 0.0, 0.0, 0.0])
    moments, axes = np.linalg.eigh(inertia)
    axes *= np.sign(np.linalg.det(axes))
    return moments, Rotation.from_matrix(axes).as_quat(scalar_first=True)


def _change_masses(spec: mujoco.MjSpec, cab: Cab, base: Cab) -> None:
    """Give the bodies of a base's model the masses of a cab, where they differ."""
    bodies = (("platform", cab.platform, base.platform), ("cab/cab", cab, base))
    for name, part, base_part in bodies:
        fields = RigidBody.model_fields
        if any(getattr(part, field) != getattr(base_part, field) for field in fields):
            body = spec.body(name)
            body.mass, body.ipos = part.mass.si, part.centre_of_mass.si
            body.inertia, body.iquat = principal_axes(part.tensor)
    for name in ("cylinder", "rod"):
        mass, base_mass = (getattr(legs, f"{name}_mass").si for legs in (cab.legs, base.legs))
        if mass != base_mass:
            for leg in _LEGS:
                body, factor = spec.body(f"{name}_{leg}"), mass / base_mass
                body.mass, body.inertia = factor * body.mass, factor * np.array(body.inertia)


PLANTS = ("hexapod", "single_legs")  #: The faithful plant and the report's original one.


def make_plant(
    plant: str = "hexapod",
    cab: str | Path | Cab | None = None,
    hydraulics: str | Path | HydraulicParameters | None = None,
    machine: str | Path | Machine | None = None,
) -> Plant:
    """Build a new plant: one of `PLANTS` with a cab, of which single legs have none."""
    check_name("plant", plant, PLANTS)
    if plant == "hexapod":
        return Hexapod(cab, hydraulics, machine=machine)
    return SingleLegs(hydraulics, machine=load_cab(cab, machine).machine)
