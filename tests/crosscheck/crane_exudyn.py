"""The hydraulic crane in Exudyn, with its own hydraulic element: see `crane`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.errors import RunError, require
from cmf_mj.core.units import FRAME
from crosscheck import crane
from crosscheck.crane import History, Terms, history, stop


def _spools(times: NDArray[Any]) -> NDArray[np.float64]:
    """Spool positions at times [s]: the lag's answer to straight lines, in closed form."""
    found, spool = np.empty(len(times)), 0.0
    for turn in range(int(times[-1] / crane.TIMES[-1]) + 1):
        for i, first in enumerate(crane.COMMANDS[:-1]):
            start, end = turn * crane.TIMES[-1] + crane.TIMES[i : i + 2]
            slope = (crane.COMMANDS[i + 1] - first) / (end - start)
            inside = (times >= start) & (times < end)
            passed = np.append(times[inside], end) - start
            behind = (spool - first + slope * crane.LAG) * np.exp(-passed / crane.LAG)
            answer = first + slope * (passed - crane.LAG) + behind
            found[inside], spool = answer[:-1], answer[-1]
    return found


def _crane(exudyn: Any, items: Any, system: Any) -> int:
    """Put crane, ball and cylinder into a system; the number of the cylinder."""
    still = {"referenceCoordinates": [0.0, 0.0]}
    swing = items.NodeGenericODE2(
        numberOfODE2Coordinates=2,
        initialCoordinates=[crane.ANGLE, -crane.ANGLE],
        initialCoordinates_t=[0.0, 0.0],
        **still,
    )
    place = np.eye(4)
    place[0, 3] = crane.LENGTH
    tree = system.AddObject(
        items.ObjectKinematicTree(
            nodeNumber=system.AddNode(swing),
            gravity=[0.0, -crane.GRAVITY, 0.0],
            jointTypes=[exudyn.JointType.RevoluteZ] * 2,
            linkParents=[-1, 0],
            jointHTs=[np.eye(4), place],
            linkMasses=[crane.CRANE, crane.BALL],
            linkInertiasCOM=exudyn.Matrix3DList([crane.INERTIA * np.eye(3)] * 2),
            linkCOMs=exudyn.Vector3DList([[0.5 * crane.LENGTH, 0.0, 0.0], [0.0, -crane.ROPE, 0.0]]),
        )
    )
    foot = items.MarkerBodyPosition(
        bodyNumber=system.AddObject(items.ObjectGround()), localPosition=[crane.FOOT, 0.0, 0.0]
    )
    eye = items.MarkerKinematicTreeRigid(
        objectNumber=tree, linkNumber=0, localPosition=[0.5 * crane.LENGTH, 0.0, 0.0]
    )
    ends = {"markerNumbers": [system.AddMarker(foot), system.AddMarker(eye)]}

    def spring(_system: Any, _time: float, _item: int, longer: float, *_rest: float) -> float:
        return -stop(longer + 0.5, 0.0, Terms())

    system.AddObject(
        items.SpringDamper(referenceLength=0.5, springForceUserFunction=spring, **ends)
    )
    oil = items.NodeGenericODE1(
        numberOfODE1Coordinates=2, initialCoordinates=list(crane.START), **still
    )
    return int(
        system.AddObject(
            items.HydraulicActuatorSimple(
                nodeNumbers=[system.AddNode(oil)],
                offsetLength=0.5 - crane.CHAMBER,
                strokeLength=2.0 * crane.CHAMBER,
                chamberCrossSection0=crane.CAP,
                chamberCrossSection1=crane.ROD,
                hoseVolume0=crane.HOSES[0],
                hoseVolume1=crane.HOSES[1],
                actuatorDamping=crane.VISCOUS,
                oilBulkModulus=crane.MODULI[0],
                hoseBulkModulus=crane.MODULI[1],
                cylinderBulkModulus=crane.MODULI[2],
                nominalFlow=crane.NOMINAL,
                systemPressure=crane.PUMP,
                tankPressure=crane.TANK,
                useChamberVolumeChange=True,
                **ends,
            )
        )
    )


def in_exudyn(seconds: float, steps: int = 1) -> History:
    """The crane by the explicit Runge-Kutta method of order 4, in so many steps to a frame.

    Raises `MissingExtraError` without exudyn, `RunError` where it cannot solve a step.
    """
    exudyn = require("exudyn", "verification")
    items = require("exudyn.itemInterface", "verification")
    system = exudyn.SystemContainer().AddSystem()
    cylinder = _crane(exudyn, items, system)
    system.Assemble()
    step, frames = FRAME / steps, round(seconds / FRAME)
    spools = _spools((np.arange(frames * steps) + 0.5) * step)
    kept, data = np.zeros((4, frames)), system.systemData
    kept[:3, 0] = (*crane.START, crane.ANGLE)

    def begin(_system: Any, time: float) -> bool:
        spool = float(spools[round(time / step) - 1])  # the time is that of the step's end
        system.SetObjectParameter(cylinder, "valveOpening0", spool)
        system.SetObjectParameter(cylinder, "valveOpening1", -spool)
        return True

    def keep(_system: Any, time: float) -> bool:
        row, rest = divmod(round(time / step), steps)
        if rest == 0 and row < frames:
            angle, speed = data.GetODE2Coordinates()[0], data.GetODE2Coordinates_t()[0]
            kept[:, row] = (*data.GetODE1Coordinates(), angle, speed)
        return True

    system.SetPreStepUserFunction(begin)
    system.SetPostStepUserFunction(keep)
    settings = exudyn.SimulationSettings()
    settings.timeIntegration.numberOfSteps = frames * steps
    settings.timeIntegration.endTime = frames * FRAME
    settings.timeIntegration.verboseMode = 0
    settings.solution.file.write = False
    if not system.SolveDynamic(settings, solverType=exudyn.DynamicSolverType.RK44):
        raise RunError(f"Exudyn could not solve {frames * steps} steps")
    return history(*kept)
