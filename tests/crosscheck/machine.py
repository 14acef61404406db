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

from cmf_mj.core.errors import InputError, RunError, require
from cmf_mj.core.units import RATE
from cmf_mj.plant.hexapod import Hexapod
from crosscheck.hydraulics import Circuit, make_circuit

_LEGS = 6
_UNIT = 1e5  #: Pressure states are counted in this [Pa], so that all residuals have a similar size.


class _Body(NamedTuple):
    mass: float
    centre: NDArray[np.float64]
    inertia: NDArray[np.float64]  #: About the centre of mass, in the axes of the frame.


def _engine() -> Any:
    exudyn = require("exudyn", "verification")
    for part in ("itemInterface", "rigidBodyUtilities"):
        require(f"exudyn.{part}", "verification")
    exudyn.config.printToConsole = False  # its hints on user functions; failures raise all the same
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


class Trajectory(NamedTuple):
    """What an engine computed, at the ends of the control frames and at the start."""

    step: float  #: Mechanical step [s].
    time: NDArray[np.float64]  #: [s], (N,).
    extension: NDArray[np.float64]  #: Leg extensions from neutral [m], (N, 6).
    pressure: NDArray[np.float64]  #: Pressures of cap and rod chambers [Pa], (N, 6, 2).
    cpu_time: float  #: Of the run, without building the model [s].


class Machine:
    """The hexapod at rest in its neutral pose, ready to be driven once or several times."""

    def __init__(self, plant: Hexapod) -> None:
        """Build the machine of a plant.

        Args:
            plant: gives the mechanical numbers, the hydraulic set and the static leg forces.

        Raises:
            MissingExtraError: exudyn is not installed.
            InputError: the hydraulics have what the second equations leave out.
        """
        self.circuit: Circuit = make_circuit(plant.parameters)
        self._exudyn = _engine()
        self.system = self._exudyn.SystemContainer().AddSystem()
        plant.start()
        self.load = plant.static_load()
        """Axial forces that hold the machine at neutral [N], (6,)."""
        self._spools = np.zeros((1, _LEGS))
        self._rate = float(RATE)
        self._extra = np.zeros(_LEGS)
        self._build(plant.model)

    def _build(self, model: mujoco.MjModel) -> None:
        platform, centre = self._add_platform(model)
        tree = self._add_legs(model)
        items, system = self._exudyn.itemInterface, self.system
        for leg in range(1, _LEGS + 1):
            below = items.MarkerKinematicTreeRigid(
                objectNumber=tree,
                linkNumber=3 * leg - 1,
                localPosition=model.site(f"rod_end_{leg}").pos,
            )
            above = items.MarkerBodyPosition(
                bodyNumber=platform, localPosition=model.site(f"upper_{leg}").pos - centre
            )
            markers = [system.AddMarker(above), system.AddMarker(below)]
            system.AddObject(items.ObjectJointSpherical(markerNumbers=markers))
        states = 2 * _LEGS
        node = items.NodeGenericODE1(
            numberOfODE1Coordinates=states,
            referenceCoordinates=[0.0] * states,
            initialCoordinates=(self.circuit.start_pressures(self.load) / _UNIT).ravel().tolist(),
        )
        system.AddObject(
            items.ObjectGenericODE1(nodeNumbers=[system.AddNode(node)], rhsUserFunction=self._rates)
        )
        system.Assemble()
        self._slides = np.array(system.systemData.GetObjectLTGODE2(tree))[2::3]

    def _add_platform(self, model: mujoco.MjModel) -> tuple[int, NDArray[np.float64]]:
        """Platform and cab as one body; its number, and its centre of mass in platform axes."""
        exudyn = self._exudyn
        cab, inner = model.body("cab/cab"), _own(model, "cab/cab")
        turn = _turn(cab.quat)
        moved = _Body(inner.mass, cab.pos + turn @ inner.centre, turn @ inner.inertia @ turn.T)
        whole = _joined(_own(model, "platform"), moved)
        number = self.system.CreateRigidBody(
            referencePosition=model.body("platform").pos + whole.centre,
            inertia=exudyn.rigidBodyUtilities.RigidBodyInertia(whole.mass, whole.inertia),
            nodeType=exudyn.NodeType.RotationEulerParameters,
            gravity=model.opt.gravity.tolist(),
        )
        return number, whole.centre

    def _add_legs(self, model: mujoco.MjModel) -> int:
        """All legs as one kinematic tree: hinge x without mass, hinge y, slide z; its number."""
        exudyn = self._exudyn
        kind = exudyn.JointType
        parents: list[int] = []
        frames, links = [], []
        for leg in range(1, _LEGS + 1):
            first = len(parents)
            parents += [-1, first, first + 1]
            for name in (f"cylinder_{leg}", f"rod_{leg}"):
                frame = np.eye(4)
                frame[:3, 3], frame[:3, :3] = model.body(name).pos, _turn(model.body(name).quat)
                frames.append(frame)
                links.append(_own(model, name))
            frames.insert(-1, np.eye(4))
            links.insert(-2, _Body(0.0, np.zeros(3), np.zeros((3, 3))))
        joints = len(parents)
        node = exudyn.itemInterface.NodeGenericODE2(
            numberOfODE2Coordinates=joints,
            referenceCoordinates=[0.0] * joints,
            initialCoordinates=[0.0] * joints,
            initialCoordinates_t=[0.0] * joints,
        )
        tree = exudyn.itemInterface.ObjectKinematicTree(
            nodeNumber=self.system.AddNode(node),
            gravity=model.opt.gravity.tolist(),
            jointTypes=[kind.RevoluteX, kind.RevoluteY, kind.PrismaticZ] * _LEGS,
            linkParents=parents,
            jointHTs=frames,
            linkInertiasCOM=exudyn.Matrix3DList([link.inertia for link in links]),
            linkCOMs=exudyn.Vector3DList([link.centre for link in links]),
            linkMasses=[link.mass for link in links],
            forceUserFunction=self._forces,
        )
        return self.system.AddObject(tree)

    def _forces(
        self, system: Any, time: float, item: int, q: Any, speed: Any
    ) -> NDArray[np.float64]:
        """Generalised forces of the tree: the cylinders on the slides."""
        pressure = np.asarray(system.systemData.GetODE1Coordinates(copy=False))
        forces = np.zeros(3 * _LEGS)
        cylinder = self.circuit.forces(pressure.reshape(2, _LEGS) * _UNIT)
        forces[2::3] = cylinder + self._extra
        return forces

    def _rates(self, system: Any, time: float, item: int, states: Any) -> NDArray[np.float64]:
        """Rates of the pressure states."""
        data = system.systemData
        extension = np.asarray(data.GetODE2Coordinates(copy=False))[self._slides]
        speed = np.asarray(data.GetODE2Coordinates_t(copy=False))[self._slides]
        spool = self._spools[round(time * self._rate)]
        pressure = np.asarray(states).reshape(2, _LEGS) * _UNIT
        return self.circuit.rates(pressure, extension, speed, spool).ravel() / _UNIT

    def reflected_mass(self) -> NDArray[np.float64]:
        """Reflected mass at neutral [kg], (6, 6), from Exudyn's own accelerations.

        A force on one leg beyond what holds the machine accelerates all legs from rest; the
        accelerations of six such trials are the inverse of the mass, column by column.
        """
        force, short = 1000.0, 1e-7
        self._rate, self._spools = 0.0, np.zeros((1, _LEGS))
        self.system.SetPostStepUserFunction(0)
        columns = []
        for leg in range(_LEGS):
            self._extra = force * np.eye(_LEGS)[leg]
            self._solve(1, short)
            found = self.system.systemData.GetODE2Coordinates_tt()
            columns.append(np.asarray(found)[self._slides] / force)
        self._extra = np.zeros(_LEGS)
        return np.linalg.inv(np.column_stack(columns))

    def run(self, valves: ArrayLike, step: float) -> Trajectory:
        """Drive the machine from rest at neutral with valve commands.

        Args:
            valves: command fractions (N, 6) at 2048 Hz, each held over its frame.
            step: [s], a whole part of a frame.

        Returns:
            N + 1 rows, the first at the start.

        Raises:
            InputError: wrong commands or step, or a state that the second equations leave out.
            RuntimeError: Exudyn could not solve a step.
        """
        commands = np.asarray(valves, dtype=float)
        if commands.ndim != 2 or commands.shape[1] != _LEGS or not (np.abs(commands) <= 1.0).all():
            raise InputError(
                f"valves: shape {commands.shape}, largest {np.abs(commands).max()}; "
                f"allowed: (N, {_LEGS}), -1 to 1"
            )
        parts = round(1.0 / (RATE * step)) if step > 0.0 else 0
        if parts < 1 or not np.isclose(parts * RATE * step, 1.0, rtol=1e-9):
            raise InputError(f"step: {step} s must be 1/{RATE} s over a whole number")
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
        begin = clock.process_time()
        self._solve(frames * parts, frames / RATE)
        cpu_time = clock.process_time() - begin
        self.circuit.check(pressure, extension)
        return Trajectory(step, np.arange(frames + 1) / RATE, extension, pressure, cpu_time)

    def _solve(self, steps: int, end: float) -> None:
        settings = self._exudyn.SimulationSettings()
        settings.timeIntegration.numberOfSteps = steps
        settings.timeIntegration.endTime = end
        settings.timeIntegration.adaptiveStep = False
        settings.timeIntegration.newton.useModifiedNewton = True
        settings.solution.file.write = False
        solver = self._exudyn.DynamicSolverType.TrapezoidalIndex2
        if not self.system.SolveDynamic(settings, solverType=solver):
            raise RunError(f"Exudyn could not solve {steps} steps to {end} s")
