"""Certificates: the box of machines a law is proven to survive, and the one an attack breaks it in.

**Proven.** In each pose the machines of a box, and more, are in the loop with parameters of
`certificate_family`, where lags, ports, chambers and leak of each leg are free on their own; their
`peak_bound` is the reciprocal of a scale within which no pole gets to the ray of a damping ratio.

**Attacked.** Latin hypercubes over the unit box; and from many starts the corner to which the
slopes of the least damping ratio point, then CMA-ES (N. Hansen, package `cma`). A machine that
fails is drawn in to where it just does, and the next attack has to stay within that scale.

All is linear. The simulation replays the machine that fails first, a little beyond and within.
"""

import warnings
from collections.abc import Callable, Mapping
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomlkit
from numpy.typing import NDArray
from scipy import optimize

from cmf_mj.analysis.linear.structured import peak_bound
from cmf_mj.analysis.modes import bound
from cmf_mj.control.law import Law
from cmf_mj.core.files import plain_path, write_text
from cmf_mj.core.result import Field
from cmf_mj.facility.scenario import load_scenario
from cmf_mj.facility.unknowns import Unknowns, cube
from cmf_mj.machine.cab import load_cab
from cmf_mj.machine.geometry import DOFS, pose_text
from cmf_mj.plant.cylinder import Contact, contact_text
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import HYDRAULICS, load_hydraulics
from cmf_mj.studies.case import REPORT_AMPLITUDES, SMALL, measure_swing
from cmf_mj.studies.certificate_box import DIMENSIONS, LARGEST_SCALE, Box
from cmf_mj.studies.certificate_family import SLOW_POLE, Family
from cmf_mj.studies.tuning.search import save_law

Array = NDArray[np.float64]

_CHUNK = 256
_CLOSER = 0.98  #: Scale that is attacked over the least that is known to break the law.
_STEP = 0.02  #: Step of a slope of the damping ratio, over the side of the box.
_PLACES = 5  #: Poses that are attacked: those with the least damped machines drawn.
_WIDER = 1.1  #: Box whose widths are taken over the one found with those of a larger.
BEYOND, WITHIN = 1.5, 0.5  #: Scales of the replays over that at which the machine just fails.


class Effort(NamedTuple):
    """How much is spent."""

    samples: int = 100_000  #: Machines drawn from the unit box, over all poses.
    starts: int = 20  #: Attacks.
    rounds: int = 60  #: Rounds of CMA-ES in each, of 16 machines.
    poses: int = 21  #: How many of the box's.
    ratios: int = 3  #: Damping ratios that are proven, from 0 towards the nominal.


QUICK = Effort(samples=2_000, starts=4, rounds=15, poses=3, ratios=1)


class Proof(NamedTuple):
    """One damping ratio."""

    ratio: float
    proven: float  #: Scale of the box in which all machines have at least as much.
    attacked: float  #: The least that an attack finds in that box.


class Certificate(NamedTuple):
    """What is known of a law with a cab; damping ratios are the least of any pole and pose."""

    law: str
    cab: str
    friction: str  #: How dry friction entered: none, stuck, or the speed of sliding legs.
    nominal: float  #: Damping ratio of the nominal machine.
    proofs: tuple[Proof, ...]  #: By damping ratio, from 0 on; none where nominal is unstable.
    broken: float  #: Least scale at which a machine was found that is unstable; NaN for none.
    share: float  #: Of machines drawn from the unit box, the share that is stable.
    least: float  #: Damping ratio of them.
    pose: Array  #: Where it breaks first, (6,) [m, rad].
    beyond: float
    """Swing of that machine's legs 10 s after a step, over the step, in the simulation, `BEYOND`
    the scale; infinite where it leaves the bounds of the model."""
    within: float  #: Likewise `WITHIN` the scale.

    @property
    def proven(self) -> float:
        """Scale within which all machines are stable."""
        return self.proofs[0].proven if self.proofs else 0.0


def _down(scale: float) -> str:
    """A scale to two digits, never more than it is."""
    digit = 10.0 ** (np.floor(np.log10(scale)) - 1.0) if scale > 0.0 else 1.0
    return f"{np.floor(scale / digit) * digit:.2g}"


def _along(index: int) -> Callable[[Certificate], float]:
    return lambda one: float(one.pose[index])


CERTIFICATES = (
    *map(Field, ("law", "cab", "friction")),
    Field("nominal", "zeta", ".3f"),
    Field("proven", form=_down),
    Field("broken", form=".2g"),
    *(Field(f"pose_{dof}", of=_along(i), printed=False) for i, dof in enumerate(DOFS)),
    Field("", "breaks at", lambda pose: pose_text(pose, ".2g"), of="pose"),
    Field("share", "stable", ".1f %", "%"),
    Field("least", "least zeta", ".3f"),
    Field("beyond", form=".0f %", unit="%"),
    Field("within", form=".1f %", unit="%"),
)
PROOFS = (
    *map(Field, ("law", "cab", "friction")),
    Field("ratio", "zeta kept", ".3f"),
    Field("proven", "in a box of", ".3f"),
    Field("attacked", "least zeta found there", ".3f"),
)
ABOUT_CERTIFICATES = (
    "How far machines may be off, all numbers at once; 1 is the whole unit box",
    "zeta: least damping ratio, in all poses, of the nominal machine. proven: scale of the box "
    "within which every machine is stable; broken: scale at which one is not, -: none up to "
    f"{LARGEST_SCALE:g}. stable, least zeta: of machines drawn from the unit box. beyond, within: "
    f"swing of the machine that breaks first, 10 s after a step, over the step, at {BEYOND:g} and "
    f"{WITHIN:g} times that scale.",
)
ABOUT_PROOFS = ("Scale of the box within which every machine keeps a damping ratio",)


def certify(
    plant: Hexapod,
    law: Law,
    folder: Path,
    box: Box,
    effort: Effort = QUICK,
    *,
    seed: int = 1,
    friction: Contact | None = None,
) -> Certificate:
    """Certify a law on a machine with a cab; the machine that breaks it goes to `folder`.

    `friction` is how dry friction enters the loop, see `plant.cylinder`; None refuses it. The
    simulation replays a machine with all its friction. Raises `InputError` as `Family` does.

    >>> from cmf_mj.studies.certificate_box import load_box
    >>> from cmf_mj.studies.certificate import certify
    >>> plant, law = cmf_mj.Hexapod("ifd"), cmf_mj.load_law("velocity")
    >>> result = certify(plant, law, Path("out/certify"), load_box())
    >>> 0.15 < result.proven < result.broken < 0.25
    True
    """
    poses = [_pose(plant, law, box, pose, friction) for pose in box.poses(plant)[: effort.poses]]
    points = cube("latin_hypercube", effort.samples, DIMENSIONS, seed)
    drawn, worst = [], []
    for pose, some in zip(poses, np.array_split(2.0 * points - 1.0, len(poses)), strict=True):
        parts = np.array_split(some, len(some) // _CHUNK + 1)
        drawn.append(np.concatenate([pose.damping_in(box, part) for part in parts]))
        worst.append(some[drawn[-1].argmin()])
    nominal = [pose.nominal_damping() for pose in poses]
    weakest = sorted(range(len(poses)), key=lambda i: drawn[i].min())
    broken, proofs = (poses[int(np.argmin(nominal))], np.zeros(DIMENSIONS), 0.0), []
    if min(nominal) > 0.0:
        begins = [(poses[i], worst[i]) for i in weakest[:_PLACES]]
        broken = _break(box, begins, effort, seed)
        poses.sort(key=lambda pose: pose is not broken[0])
        for ratio in np.arange(effort.ratios) / effort.ratios * min(nominal):
            edge, turn = min(broken[2], LARGEST_SCALE), float(np.arcsin(ratio))
            loop = poses[0].widen(poses[0].widths(box, edge))
            first = peak_bound(loop, turn, 1.0 / edge, SLOW_POLE)
            edge = min(edge, _WIDER / first)  # slopes differ less in a smaller box
            beta = 1.0 / edge
            for pose in poses:
                beta = peak_bound(pose.widen(pose.widths(box, edge)), turn, beta, SLOW_POLE)
            proven = 1.0 / beta
            found = [_attack(p, box, proven, x, effort.rounds, seed, -1.0)[0] for p, x in begins]
            proofs.append(Proof(float(ratio), proven, min(found)))
    pose, point, scale = broken
    swing = []
    for name, factor in (("beyond", BEYOND), ("within", WITHIN)):
        changes = box.changes(factor * min(scale, LARGEST_SCALE) * point[None])
        case = save_case(plain_path(folder, name), name, plant, law, pose.pose, box, changes)
        swing.append(replayed(case))
    every, limit = np.concatenate(drawn), scale if np.isfinite(scale) else float("nan")
    tried = limit, float((every > 0.0).mean()), float(every.min()), pose.pose
    stated = contact_text(friction)
    return Certificate(law.name, plant.cab, stated, min(nominal), tuple(proofs), *tried, *swing)


def _pose(plant: Hexapod, law: Law, box: Box, pose: Array, friction: Contact | None) -> Family:
    """The machines in a pose, drawn in until closed valves hold all of the largest box there.

    Where closed valves do not even at neutral, it is drawn in until open ones do.
    """
    for closed, share in product((True, False), (1.0, 0.75, 0.5, 0.25, 0.1, 0.0)):
        family = Family(plant, law, share * pose, friction)
        if family.holds(box, LARGEST_SCALE, closed=closed):
            break
    return family


def _break(
    box: Box, begins: list[tuple[Family, Array]], effort: Effort, seed: int
) -> tuple[Family, Array, float]:
    """The machine that fails at the least scale: its pose, its point of the unit box, the scale."""

    def damped(share: float, pose: Family, point: Array) -> float:
        return float(pose.damping_in(box, share * point[None])[0])

    best, scale = (*begins[0], np.inf), LARGEST_SCALE
    generator = np.random.default_rng([seed, 1])
    for start in range(effort.starts):
        pose, point = begins[start % len(begins)]
        if start >= len(begins):
            point = 2.0 * cube("corners", 1, DIMENSIONS, generator)[0] - 1.0
        while True:
            damping, point = _attack(pose, box, scale, point, effort.rounds, seed + start, 0.0)
            if damping > 0.0:
                break
            reach = (
                float(optimize.bisect(damped, 0.0, scale, (pose, point), 1e-4))
                * np.abs(point).max()
            )
            best, scale = (pose, point / np.abs(point).max(), reach), _CLOSER * reach
    return best


def _attack(
    pose: Family, box: Box, scale: float, point: Array, rounds: int, seed: int, enough: float
) -> tuple[float, Array]:
    """The least damping ratio found in a box, and where; ends at `enough`."""

    def damping(points: Array) -> Array:
        return pose.damping_in(box, scale * points)

    best = float(damping(point[None])[0]), point
    for _ in range(4):
        corner = np.sign(best[0] - damping(best[1] + _STEP * np.eye(DIMENSIONS)))
        here = float(damping(corner[None])[0])
        if here >= best[0]:
            break
        best = here, corner
    options = {"bounds": [-1.0, 1.0], "seed": seed % (2**32 - 1) + 1, "verbose": -9, "popsize": 16}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import cma

        strategy = cma.CMAEvolutionStrategy(0.95 * best[1], 0.3, options)
    for _ in range(rounds):
        if best[0] <= enough or strategy.stop():
            break
        points = np.array(strategy.ask())
        found = damping(points)
        strategy.tell(points, found.tolist())
        if found.min() < best[0]:
            best = float(found.min()), points[found.argmin()]
    return best


def save_case(
    folder: Path,
    name: str,
    plant: Hexapod,
    law: Law,
    pose: Array,
    box: Box,
    changes: Mapping[str, Array],
) -> Path:
    """Write a machine with its law as files, and the scenario that `cmf run` replays it by.

    The law knows the nominal cab. The run begins in the pose and steps all axes by a small step.
    """
    cab, oil, tables = plant.cab_parameters, plant.parameters, []
    assert cab is not None
    based = load_hydraulics(oil.name if oil.name in HYDRAULICS else None)
    shipped = load_cab(cab.base, plant.machine)
    for part, base in ((oil, based), (cab, shipped)):
        changed = Unknowns(box.unknowns).apply(box.values(changes), part, name)
        before, after = (
            one.model_dump(mode="json", exclude_none=True, exclude={"nominal", "name"})
            for one in (base, changed)
        )
        tables.append(
            {field: value for field, value in after.items() if value != before.get(field)}
        )
    own = plant.machine.recorded()
    modes = dict(zip((name,), bound(law, plant).modes.values(), strict=False))  # none in legs
    known_law = law.model_copy(update={"name": f"{law.name}_{name}", "modes": modes})
    save_law(known_law, plain_path(folder, "law.toml"))
    steps = [
        {"kind": "step", "dof": dof, "amplitude": [float(SMALL * size), unit], "at": 0.5}
        for dof, size, unit in zip(DOFS, REPORT_AMPLITUDES, 3 * ("m",) + 3 * ("rad",), strict=True)
    ]
    stay: dict[str, Any] = {"kind": "waypoints", "times": [0.0, 12.0], "poses": [pose.tolist()] * 2}
    files: dict[str, dict[str, Any]] = {
        "hydraulics.toml": {"base": based.name, name: tables[0]},
        "cab.toml": {"base": cab.base, name: tables[1]},
        "scenario.toml": {
            "title": f"{law.title}: the machine of its certificate that breaks it",
            **{
                "machine": "machine.toml" if own else plant.machine.name,
                "cab": "cab.toml",
                "hydraulics": "hydraulics.toml",
            },
            **{"law": "law.toml", "duration": 12.0, "record_every": 16, "signal": [stay, *steps]},
        },
    }
    if own:
        files["machine.toml"] = own
    for file, table in files.items():
        write_text(folder / file, tomlkit.dumps(table))
    return folder / "scenario.toml"


def replayed(path: Path) -> float:
    """Swing of the legs left at the end of a case over its largest leg step, in the simulation."""
    try:
        return float(measure_swing(load_scenario(path).record())["last"])
    except FloatingPointError:  # it left the bounds of the model
        return float("inf")
