"""The hexapod in Exudyn, an independent multibody engine, with its hydraulics as one system.

Numbers come from the compiled MuJoCo model: masses, inertias, frames and gravity. The rest is
Exudyn's: the legs are a kinematic tree in their 18 joint coordinates (two hinges of the lower
gimbal, the slide), platform and cab one rigid body in Euler parameters, each upper gimbal a
spherical joint with Lagrange multipliers where MuJoCo has a spring of finite stiffness. The twelve
chamber pressures are first-order states of the same system. The implicit trapezoidal rule advances
all of it together, constraints on velocity level (index 2), and so is of order 2:

    M(q) dv/dt = f(q, v, p) - G' lambda,    G v = 0,    dp/dt = g(p, q, v, u(t))
"""

import time as clock
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from cmf_mj.plant import Hexapod
from cmf_mj.signals import RATE
from cmf_mj.verification.hydraulics import Circuit, make_circuit

_LEGS = 6
_UNIT = 1e5
"""Pressure states are counted in this [Pa], so that all residuals have a similar size."""


class Trajectory(NamedTuple):
    """What an engine computed, at the ends of the control frames and at the start."""

    step: float
    """Mechanical step [s]."""
    time: NDArray[np.float64]
    """[s], (N,)."""
    extension: NDArray[np.float64]
    """Leg extensions from neutral [m], (N, 6)."""
    pressure: NDArray[np.float64]
    """Pressures of cap and rod chambers [Pa], (N, 6, 2)."""
    wall: float
    """Time the run took, without building the model [s]."""


class _Body(NamedTuple):
    mass: float
    centre: NDArray[np.float64]
    inertia: NDArray[np.float64]
    """About the centre of mass, in the axes of the frame."""


def _engine() -> Any:
    try:
        import exudyn
        import exudyn.itemInterface
        import exudyn.rigidBodyUtilities
    except ImportError as error:
        raise ImportError(
            "the cross-verification needs exudyn; install cmf-mj[verification]"
        ) from error
    return exudyn


def _own(model: mujoco.MjModel, name: str) -> _Body:
    body = model.body(name)
    turn = Rotation.from_quat(body.iquat, scalar_first=True).as_matrix()
    return _Body(float(body.mass[0]), body.ipos.copy(), turn * body.inertia @ turn.T)


def _joined(first: _Body, second: _Body) -> _Body:
    """Two rigidly joined bodies given in one frame."""
    mass = first.mass + second.mass
    centre = (first.mass * first.centre + second.mass * second.centre) / mass
    inertia = np.zeros((3, 3))
    for part in (first, second):
        arm = part.centre - centre
        inertia += part.inertia + part.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return _Body(mass, centre, inertia)


def _turn(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()


class Machine:
    """The hexapod at rest in its neutral pose, ready to be driven once or several times."""

    def __init__(self, plant: Hexapod) -> None:
        """Build the machine of a plant.

        Args:
            plant: gives the mechanical numbers, the hydraulic set and the static leg forces.

        Raises:
            ImportError: exudyn is not installed; says what to install.
            ValueError: the hydraulics have what the second equations leave out.
        """
        self.circuit: Circuit = make_circuit(plant.parameters)
        self._exudyn = _engine()
        self.system = self._exudyn.SystemContainer().AddSystem()
        plant.start()
        self.load = plant.static_load()
        """Axial forces that hold the machine at neutral [N], (6,)."""
        self._spools = np.zeros((1, _LEGS))
        self._rate = float(RATE)
        self._build(plant.model)

    def _build(self, model: mujoco.MjModel) -> None:
        exudyn, system = self._exudyn, self.system
        items = exudyn.itemInterface
        gravity = model.opt.gravity.tolist()

        cab = model.body("cab/cab")
        inner = _own(model, "cab/cab")
        turn = _turn(cab.quat)
        moved = _Body(
            inner.mass, cab.pos + turn @ inner.centre, turn @ inner.inertia @ turn.T
        )
        platform = _joined(_own(model, "platform"), moved)
        body = system.CreateRigidBody(
            referencePosition=model.body("platform").pos + platform.centre,
            inertia=exudyn.rigidBodyUtilities.RigidBodyInertia(platform.mass, platform.inertia),
            nodeType=exudyn.NodeType.RotationEulerParameters,
            gravity=gravity,
        )

        kinds, parents, frames, inertias, centres, masses = [], [], [], [], [], []
        for leg in range(1, _LEGS + 1):
            cylinder, rod = model.body(f"cylinder_{leg}"), model.body(f"rod_{leg}")
            first = len(parents)
            kinds += [
                exudyn.JointType.RevoluteX,
                exudyn.JointType.RevoluteY,
                exudyn.JointType.PrismaticZ,
            ]
            parents += [-1, first, first + 1]
            frames += [(cylinder.pos, cylinder.quat), None, (rod.pos, rod.quat)]
            links = [
                _Body(0.0, np.zeros(3), np.zeros((3, 3))),
                _own(model, f"cylinder_{leg}"),
                _own(model, f"rod_{leg}"),
            ]
            masses += [link.mass for link in links]
            centres += [link.centre for link in links]
            inertias += [link.inertia for link in links]
        transforms = []
        for frame in frames:
            transform = np.eye(4)
            if frame is not None:
                transform[:3, 3], transform[:3, :3] = frame[0], _turn(frame[1])
            transforms.append(transform)
        joints = len(parents)
        node = system.AddNode(
            items.NodeGenericODE2(
                numberOfODE2Coordinates=joints,
                referenceCoordinates=[0.0] * joints,
                initialCoordinates=[0.0] * joints,
                initialCoordinates_t=[0.0] * joints,
            )
        )
        tree = system.AddObject(
            items.ObjectKinematicTree(
                nodeNumber=node,
                gravity=gravity,
                jointTypes=kinds,
                linkParents=parents,
                jointHTs=transforms,
                linkInertiasCOM=exudyn.Matrix3DList(inertias),
                linkCOMs=exudyn.Vector3DList(centres),
                linkMasses=masses,
                forceUserFunction=self._forces,
            )
        )
        for leg in range(1, _LEGS + 1):
            rod_end, upper = model.site(f"rod_end_{leg}").pos, model.site(f"upper_{leg}").pos
            below = system.AddMarker(
                items.MarkerKinematicTreeRigid(
                    objectNumber=tree, linkNumber=3 * leg - 1, localPosition=rod_end
                )
            )
            above = system.AddMarker(
                items.MarkerBodyPosition(
                    bodyNumber=body, localPosition=upper - platform.centre
                )
            )
            system.AddObject(items.ObjectJointSpherical(markerNumbers=[above, below]))
        pressure = self.circuit.start_pressures(self.load) / _UNIT
        states = system.AddNode(
            items.NodeGenericODE1(
                numberOfODE1Coordinates=2 * _LEGS,
                referenceCoordinates=[0.0] * (2 * _LEGS),
                initialCoordinates=pressure.ravel().tolist(),
            )
        )
        system.AddObject(
            items.ObjectGenericODE1(nodeNumbers=[states], rhsUserFunction=self._rates)
        )
        system.Assemble()
        self._joints = np.array(system.systemData.GetObjectLTGODE2(tree))
        self._slides = self._joints[2::3]

    def _forces(
        self, system: Any, time: float, item: int, q: Any, speed: Any
    ) -> NDArray[np.float64]:
        """Generalised forces of the tree: the cylinders on the slides."""
        pressure = np.asarray(system.systemData.GetODE1Coordinates(copy=False))
        forces = np.zeros(3 * _LEGS)
        forces[2::3] = self.circuit.forces(pressure.reshape(2, _LEGS) * _UNIT)
        return forces

    def _rates(self, system: Any, time: float, item: int, states: Any) -> NDArray[np.float64]:
        """Rates of the pressure states."""
        data = system.systemData
        extension = np.asarray(data.GetODE2Coordinates(copy=False))[self._slides]
        speed = np.asarray(data.GetODE2Coordinates_t(copy=False))[self._slides]
        spool = self._spools[round(time * self._rate)]
        pressure = np.asarray(states).reshape(2, _LEGS) * _UNIT
        return self.circuit.rates(pressure, extension, speed, spool).ravel() / _UNIT

    def run(self, valves: ArrayLike, step: float) -> Trajectory:
        """Drive the machine from rest at neutral with valve commands.

        Args:
            valves: command fractions (N, 6) at 2048 Hz, each held over its frame.
            step: [s], a whole part of a frame.

        Returns:
            N + 1 rows, the first at the start.

        Raises:
            ValueError: wrong commands or step, or a state that the second equations leave out.
            RuntimeError: Exudyn could not solve a step.
        """
        commands = np.asarray(valves, dtype=float)
        if commands.ndim != 2 or commands.shape[1] != _LEGS or not (np.abs(commands) <= 1.0).all():
            raise ValueError(
                f"valves: shape {commands.shape}, largest {np.abs(commands).max()}; "
                f"allowed: (N, {_LEGS}), -1 to 1"
            )
        parts = round(1.0 / (RATE * step)) if step > 0.0 else 0
        if parts < 1 or not np.isclose(parts * RATE * step, 1.0, rtol=1e-9):
            raise ValueError(f"step: {step} s must be 1/{RATE} s over a whole number")
        frames = len(commands)
        self._rate = float(parts * RATE)
        self._spools = self.circuit.spools(commands, parts)
        extension = np.zeros((frames + 1, _LEGS))
        pressure = np.zeros((frames + 1, _LEGS, 2))
        data = self.system.systemData

        def keep(system: Any, time: float) -> bool:
            done = round(time * self._rate)
            if done % parts == 0:
                row = done // parts
                extension[row] = np.asarray(data.GetODE2Coordinates(copy=False))[self._slides]
                states = np.asarray(data.GetODE1Coordinates(copy=False)).reshape(2, _LEGS)
                pressure[row] = states.T * _UNIT
            return True

        pressure[0] = self.circuit.start_pressures(self.load).T
        self.system.SetPostStepUserFunction(keep)
        begin = clock.perf_counter()
        solved = self.system.SolveDynamic(
            self._settings(frames * parts, frames / RATE),
            solverType=self._exudyn.DynamicSolverType.TrapezoidalIndex2,
        )
        wall = clock.perf_counter() - begin
        if not solved:
            raise RuntimeError(f"Exudyn could not solve all {frames * parts} steps of {step} s")
        self.circuit.check(pressure, extension)
        return Trajectory(step, np.arange(frames + 1) / RATE, extension, pressure, wall)

    def _settings(self, steps: int, end: float) -> Any:
        settings = self._exudyn.SimulationSettings()
        settings.timeIntegration.numberOfSteps = steps
        settings.timeIntegration.endTime = end
        settings.timeIntegration.adaptiveStep = False
        settings.timeIntegration.newton.useModifiedNewton = True
        settings.solution.file.write = False
        return settings
