"""The hexapod in Exudyn, an independent multibody engine, with its hydraulics as one system.

Numbers come from the compiled MuJoCo model: masses, inertias, frames and gravity. The rest is
Exudyn's: the legs are a kinematic tree in their 18 joint coordinates (two hinges of the lower
gimbal, the slide), platform and cab one rigid body in Euler parameters, each upper gimbal a
spherical joint with Lagrange multipliers where MuJoCo has a spring of finite stiffness. The twelve
chamber pressures, with friction also six contacts, are first-order states of the same system. The
implicit trapezoidal rule advances all of it together, constraints on velocity level (index 2), and
so is of order 2:

    M(q) dv/dt = f(q, v, p) - G' lambda,    G v = 0,    dp/dt = g(p, q, v, u(t))

It can have what the other plant lacks: a floor that is a mass on springs, of which the legs stand,
and springs along the legs between each lower gimbal and its cylinder.
"""

import time as clock
from collections.abc import Callable
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


class Spring(NamedTuple):
    """What yields: a floor in x, y and z, or each leg along its axis. It is loaded at neutral."""

    stiffness: float  #: [N/m].
    damping: float = 0.0  #: [N s/m].
    mass: float = 0.0  #: Of a floor [kg].


class State(NamedTuple):
    """What a controller may read, (6,) each, of pressures (2, 6)."""

    extension: NDArray[np.float64]  #: [m].
    speed: NDArray[np.float64]  #: [m/s].
    acceleration: NDArray[np.float64]  #: [m/s^2].
    pressure: NDArray[np.float64]  #: Of cap and rod chambers [Pa].


Controller = Callable[[int, State], ArrayLike]
"""Gives the valve commands (6,) that are held over a frame from its number and the state there."""


class Trajectory(NamedTuple):
    """What an engine computed, at the ends of the control frames and at the start."""

    step: float  #: Mechanical step [s].
    time: NDArray[np.float64]  #: [s], (N,).
    extension: NDArray[np.float64]  #: Leg extensions from neutral [m], (N, 6).
    pressure: NDArray[np.float64]  #: Pressures of cap and rod chambers [Pa], (N, 6, 2).
    cpu_time: float  #: Of the run, without building the model [s].


class Machine:
    """The hexapod at rest in its neutral pose, ready to be driven once or several times."""

    def __init__(
        self,
        plant: Hexapod,
        *,
        floor: Spring | None = None,
        mounts: Spring | None = None,
        tolerance: float = 1e-8,
    ) -> None:
        """Build the machine of a plant.

        Args:
            plant: gives the mechanical numbers, the hydraulic set and the static leg forces.
            floor: that the legs stand on, by default a rigid one.
            mounts: of the cylinders on their lower gimbals, by default rigid ones.
            tolerance: of a step's residual, in proportion.

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
        self.floor, self.mounts, self.tolerance = floor, mounts, tolerance
        self._base = 3 if floor else 0  # joints of the floor
        self._joints = 4 if mounts else 3  # of a leg
        self.pushed = 0.0
        """Force down on the floor beside the weights [N]."""
        self._springs(plant.model)
        self._build(plant.model)

    def _springs(self, model: mujoco.MjModel) -> None:
        """Forces that the springs have at neutral, so that they are the same neutral ones."""
        gravity = float(-model.opt.gravity[2])
        self._weight = gravity * (float(model.body_mass.sum()) + (self.floor or Spring(0.0)).mass)
        barrels = [model.body(f"cylinder_{leg + 1}") for leg in range(_LEGS)]
        upright = np.array([_turn(barrel.quat)[2, 2] for barrel in barrels])
        weights = gravity * np.array([float(barrel.mass[0]) for barrel in barrels])
        self._held = self.load + weights * upright

    def _build(self, model: mujoco.MjModel) -> None:
        platform, centre = self._add_platform(model)
        tree = self._add_legs(model)
        items, system = self._exudyn.itemInterface, self.system
        for leg in range(1, _LEGS + 1):
            below = items.MarkerKinematicTreeRigid(
                objectNumber=tree,
                linkNumber=self._base + self._joints * leg - 1,
                localPosition=model.site(f"rod_end_{leg}").pos,
            )
            above = items.MarkerBodyPosition(
                bodyNumber=platform, localPosition=model.site(f"upper_{leg}").pos - centre
            )
            markers = [system.AddMarker(above), system.AddMarker(below)]
            system.AddObject(items.ObjectJointSpherical(markerNumbers=markers))
        states = (self.circuit.start_pressures(self.load) / _UNIT).ravel().tolist()
        states += [0.0] * (_LEGS if self.circuit.friction else 0)
        node = items.NodeGenericODE1(
            numberOfODE1Coordinates=len(states),
            referenceCoordinates=[0.0] * len(states),
            initialCoordinates=states,
        )
        system.AddObject(
            items.ObjectGenericODE1(nodeNumbers=[system.AddNode(node)], rhsUserFunction=self._rates)
        )
        system.Assemble()
        self._slides = np.array(system.systemData.GetObjectLTGODE2(tree))[self._of_legs()]

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

    def _of_legs(self, which: int = -1) -> slice:
        """A joint of each leg among all of the tree, by default its slide."""
        return slice(self._base + which % self._joints, None, self._joints)

    def _add_legs(self, model: mujoco.MjModel) -> int:
        """Floor and all legs as one kinematic tree; its number.

        Of a floor the slides x, y and z; of a leg hinge x without mass, hinge y, that of the mount
        where it yields, slide z. A massless link is a joint more of what it carries.
        """
        exudyn = self._exudyn
        kind = exudyn.JointType
        none = _Body(0.0, np.zeros(3), np.zeros((3, 3)))
        parents, kinds = [-1, 0, 1][: self._base], [kind.PrismaticX, kind.PrismaticY]
        kinds = [*kinds, kind.PrismaticZ][: self._base]
        frames: list[NDArray[np.float64]] = [np.eye(4)] * self._base
        links = [none] * self._base
        if self.floor:
            links[-1] = none._replace(mass=self.floor.mass)
        for leg in range(1, _LEGS + 1):
            first = len(parents)
            slides = self._joints - 2
            parents += [self._base - 1, *range(first, first + self._joints - 1)]
            kinds += [kind.RevoluteX, kind.RevoluteY, *([kind.PrismaticZ] * slides)]
            for name in (f"cylinder_{leg}", f"rod_{leg}"):
                frame = np.eye(4)
                frame[:3, 3], frame[:3, :3] = model.body(name).pos, _turn(model.body(name).quat)
                frames.append(frame)
                links.append(_own(model, name))
            frames[-1:-1] = [np.eye(4)] * (self._joints - 2)
            links[-2:-2] = [none] * (self._joints - 2)
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
            jointTypes=kinds,
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
        """Generalised forces of the tree: the cylinders on the slides, and the springs."""
        states = np.asarray(system.systemData.GetODE1Coordinates(copy=False))
        forces = np.zeros(self._base + self._joints * _LEGS)
        cylinder = self.circuit.forces(states[: 2 * _LEGS].reshape(2, _LEGS) * _UNIT)
        forces[self._of_legs()] = cylinder + self._extra
        if self.circuit.friction:
            forces[self._of_legs()] -= self.circuit.friction * states[2 * _LEGS :]
        if self.floor:
            way, rate = np.asarray(q)[:3], np.asarray(speed)[:3]
            forces[:3] = -self.floor.stiffness * way - self.floor.damping * rate
            forces[2] += self._weight - self.pushed
        if self.mounts:
            at = self._of_legs(2)
            way, rate = np.asarray(q)[at], np.asarray(speed)[at]
            forces[at] = self._held - self.mounts.stiffness * way - self.mounts.damping * rate
        return forces

    def _rates(self, system: Any, time: float, item: int, states: Any) -> NDArray[np.float64]:
        """Rates of the pressure states, and of the contacts' where there is friction."""
        data = system.systemData
        extension = np.asarray(data.GetODE2Coordinates(copy=False))[self._slides]
        speed = np.asarray(data.GetODE2Coordinates_t(copy=False))[self._slides]
        spool = self._spools[round(time * self._rate)]
        values = np.asarray(states)
        pressure, contact = values[: 2 * _LEGS].reshape(2, _LEGS) * _UNIT, values[2 * _LEGS :]
        rates = self.circuit.rates(pressure, extension, speed, spool).ravel() / _UNIT
        if not self.circuit.friction:
            return rates
        return np.append(rates, (speed - np.abs(speed) * contact) / self.circuit.presliding)

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
            InputError: a wrong step, or a state that the second equations leave out.
            RuntimeError: Exudyn could not solve a step.
        """
        commands = np.asarray(valves, dtype=float)
        return self.control(lambda frame, state: commands[frame], len(commands), step)

    def control(self, controller: Controller, frames: int, step: float) -> Trajectory:
        """Let a controller drive the machine from rest at neutral, otherwise as `run`."""
        parts = round(1.0 / (RATE * step)) if step > 0.0 else 0
        if parts < 1 or not np.isclose(parts * RATE * step, 1.0, rtol=1e-9):
            raise InputError(f"step: {step} s must be 1/{RATE} s over a whole number")
        self._rate = float(parts * RATE)
        self._spools = np.zeros((frames * parts + 1, _LEGS))
        extension = np.zeros((frames + 1, _LEGS))
        pressure = np.zeros((frames + 1, _LEGS, 2))
        data, drive = self.system.systemData, np.zeros(_LEGS)

        def begin(frame: int, state: State) -> None:
            """Keep the state at the start of a frame, and move the spools over it."""
            nonlocal drive
            extension[frame], pressure[frame] = state.extension, state.pressure.T
            if frame < frames:
                command = np.asarray(controller(frame, state))
                first = frame * parts
                drive, rows = self.circuit.spools(drive, self._spools[first], command, parts)
                self._spools[first + 1 : first + parts + 1] = rows

        def keep(system: Any, time: float) -> bool:
            done = round(time * self._rate)
            if done > 0 and done % parts == 0:  # it is called before the first step too
                motion = (
                    data.GetODE2Coordinates,
                    data.GetODE2Coordinates_t,
                    data.GetODE2Coordinates_tt,
                )
                way, speed, rate = (np.asarray(of(copy=False))[self._slides] for of in motion)
                states = np.asarray(data.GetODE1Coordinates(copy=False))[: 2 * _LEGS]
                begin(done // parts, State(way, speed, rate, states.reshape(2, _LEGS) * _UNIT))
            return True

        still = np.zeros(_LEGS)
        began = clock.process_time()
        begin(0, State(still, still, still, self.circuit.start_pressures(self.load)))
        self.system.SetPostStepUserFunction(keep)
        self._solve(frames * parts, frames / RATE)
        cpu_time = clock.process_time() - began
        self.circuit.check(pressure, extension)
        return Trajectory(step, np.arange(frames + 1) / RATE, extension, pressure, cpu_time)

    def _solve(self, steps: int, end: float) -> None:
        settings = self._exudyn.SimulationSettings()
        settings.timeIntegration.numberOfSteps = steps
        settings.timeIntegration.endTime = end
        settings.timeIntegration.adaptiveStep = False
        newton = settings.timeIntegration.newton
        newton.useModifiedNewton, newton.relativeTolerance = True, self.tolerance
        newton.absoluteTolerance = self.tolerance / 100.0
        settings.solution.file.write = False
        solver = self._exudyn.DynamicSolverType.TrapezoidalIndex2
        if not self.system.SolveDynamic(settings, solverType=solver):
            raise RunError(f"Exudyn could not solve {steps} steps to {end} s")
