"""Certificates: the box of machines a law is proven to survive, and the one an attack breaks it in.

**Proven.** In each pose the machines of a box, and more, are in the loop with parameters of
`certificate_family`, where the lags, ports, chambers and leak of each leg are free on their own.
`peak_bound` of it is the reciprocal of a scale within which no pole gets to the ray of a damping
ratio.

**Attacked.** Latin hypercubes over the unit box; and from many starts the corner to which the
slopes of the least damping ratio point, then CMA-ES (N. Hansen, package `cma`). A machine that
fails is drawn in to where it just does, and the next attack has to stay within that scale.

All is linear. The simulation replays the machine that fails first, a little beyond and within.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
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
from cmf_mj.core.result import Field, Result
from cmf_mj.core.settings import Settings
from cmf_mj.facility.scenario import load_scenario
from cmf_mj.facility.unknowns import Unknowns, cube
from cmf_mj.machine.cab import load_cab
from cmf_mj.machine.geometry import DOFS, by_kind, pose_text
from cmf_mj.plant.cylinder import Contact, contact_text
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import HYDRAULICS, load_hydraulics
from cmf_mj.studies.case import REPORT_AMPLITUDES, SMALL_STEP, measure_swing
from cmf_mj.studies.certificate_box import DIMENSIONS, LARGEST_SCALE, Box
from cmf_mj.studies.certificate_family import SLOW_POLE, Family
from cmf_mj.studies.tuning.search import save_law

Array = NDArray[np.float64]

_CHUNK = 256  #: Machines whose poles are found together.
_SHRINKAGE = 0.98  #: Scale that is attacked over the least that is known to break the law.
_SLOPE_STEP = 0.02  #: Step of a slope of the damping ratio, over the side of the box.
_ATTACKED_POSES = 5  #: Those with the least damped machines drawn.
_BOX_MARGIN = 1.1  #: Box whose widths are taken over the one found with those of a larger.
BEYOND, WITHIN = 1.5, 0.5  #: Scales of the replays over that at which the machine just fails.


class Effort(NamedTuple):
    """How many machines, attacks and poses a certificate takes."""

    samples: int = 100_000  #: Machines drawn from the unit box, over all poses.
    starts: int = 20  #: Attacks.
    rounds: int = 60  #: Rounds of CMA-ES in each, of 16 machines.
    poses: int = 21  #: How many of the box's.
    ratios: int = 3  #: Damping ratios that are proven, from 0 towards the nominal.
    seed: int = 1  #: Of machines drawn and of attacks.


QUICK = Effort(samples=2_000, starts=4, rounds=15, poses=3, ratios=1)


class Proof(NamedTuple):
    """The proof of one damping ratio."""

    ratio: float
    proven: float  #: Scale of the box in which all machines have at least this ratio.
    attacked: float  #: The least damping ratio that an attack finds in that box.


class Certificate(NamedTuple):
    """What is known of a law with a cab; damping ratios are the least of any pole and pose."""

    law: str
    cab: str
    friction: str  #: How dry friction entered: none, stuck, or the speed of sliding legs.
    nominal_damping: float  #: Damping ratio of the nominal machine.
    proofs: tuple[Proof, ...]  #: By damping ratio, from 0 on; none where nominal is unstable.
    breaking_scale: float
    """Least scale at which a machine was found that is unstable; NaN for none."""
    stable_share: float  #: Of machines drawn from the unit box.
    least_damping: float  #: Least damping ratio of these machines.
    breaking_pose: Array  #: Where the law breaks first, (6,) [m, rad].
    swing_beyond: float
    """Swing of that machine's legs 10 s after a step, over the step, in the simulation, `BEYOND`
    the scale; infinite where it leaves the bounds of the model."""
    swing_within: float  #: Likewise `WITHIN` the scale.

    @property
    def proven_scale(self) -> float:
        """Scale within which all machines are stable."""
        return self.proofs[0].proven if self.proofs else 0.0


def _two_digits_down(scale: float) -> str:
    """A scale to two digits, never more than it is."""
    digit = 10.0 ** (np.floor(np.log10(scale)) - 1.0) if scale > 0.0 else 1.0
    return f"{np.floor(scale / digit) * digit:.2g}"


def _pose_coordinate(index: int) -> Callable[[Certificate], float]:
    return lambda certificate: float(certificate.breaking_pose[index])


_CASE_NAMES = ("law", "cab", "friction")
_CASE_FIELDS = tuple(map(Field, _CASE_NAMES))
_CERTIFICATE_FIELDS = (
    *_CASE_FIELDS,
    Field("nominal", "zeta", ".3f", of="nominal_damping"),
    Field("proven", form=_two_digits_down, of="proven_scale"),
    Field("broken", form=".2g", of="breaking_scale"),
    *(Field(f"pose_{dof}", of=_pose_coordinate(i), printed=False) for i, dof in enumerate(DOFS)),
    Field("", "breaks at", lambda pose: pose_text(pose, ".2g"), of="breaking_pose"),
    Field("share", "stable", ".1f %", "%", of="stable_share"),
    Field("least", "least zeta", ".3f", of="least_damping"),
    Field("beyond", form=".0f %", unit="%", of="swing_beyond"),
    Field("within", form=".1f %", unit="%", of="swing_within"),
)
_PROOF_FIELDS = (
    *_CASE_FIELDS,
    Field("ratio", "zeta kept", ".3f"),
    Field("proven", "in a box of", ".3f"),
    Field("attacked", "least zeta found there", ".3f"),
)
_LEGEND = (
    "zeta: least damping ratio, in all poses, of the nominal machine. proven: scale of the box "
    "within which every machine is stable; broken: scale at which one is not, -: none up to "
    f"{LARGEST_SCALE:g}. stable, least zeta: of machines drawn from the unit box. beyond, within: "
    f"swing of the machine that breaks first, 10 s after a step, over the step, at {BEYOND:g} and "
    f"{WITHIN:g} times that scale."
)


def certificate_tables(certificates: Sequence[Certificate]) -> dict[str, Result[Any]]:
    """Certificates, and the damping ratios that are proven, by name."""
    proofs = [
        {name: getattr(certificate, name) for name in _CASE_NAMES} | proof._asdict()
        for certificate in certificates
        for proof in certificate.proofs
    ]
    title = "How far machines may be off, all numbers at once; 1 is the whole unit box"
    proof_title = "Scale of the box within which every machine keeps a damping ratio"
    return {
        "certificates": Result(certificates, _CERTIFICATE_FIELDS, title, _LEGEND),
        "proofs": Result(proofs, _PROOF_FIELDS, proof_title),
    }


class _Machine(NamedTuple):
    """A machine in a pose."""

    family: Family  #: That of the pose.
    point: Array  #: Of the unit box.
    damping: float  #: Least damping ratio, where the machine is off by what an attack allows.
    scale: float = float("inf")  #: At which it just fails.


def certify(
    plant: Hexapod,
    law: Law,
    folder: Path,
    box: Box,
    effort: Effort = QUICK,
    friction: Contact | None = None,
) -> Certificate:
    """Certify a law on a machine with a cab; the machine that breaks it goes to `folder`.

    `friction` is how dry friction enters the loop, see `plant.cylinder`; None refuses it. The
    simulation replays a machine with all its friction. Raises `InputError` as `Family` does.

    >>> from cmf_mj.studies.certificate_box import load_box
    >>> from cmf_mj.studies.certificate import certify
    >>> plant, law = cmf_mj.Hexapod("ifd"), cmf_mj.load_law("velocity")
    >>> result = certify(plant, law, Path("out/certify"), load_box())
    >>> 0.15 < result.proven_scale < result.breaking_scale < 0.25
    True
    """
    poses = box.poses(plant)[: effort.poses]
    families = [_draw_in(plant, law, box, pose, friction) for pose in poses]
    damping, weakest = _draw_machines(families, box, effort)
    nominal = [family.nominal_damping() for family in families]
    breaking = _Machine(families[int(np.argmin(nominal))], np.zeros(DIMENSIONS), min(nominal), 0.0)
    proofs: tuple[Proof, ...] = ()
    if breaking.damping > 0.0:
        starts = sorted(weakest, key=lambda machine: machine.damping)[:_ATTACKED_POSES]
        breaking = _break_law(starts, box, effort)
        families.sort(key=lambda family: family is not breaking.family)
        edge = min(breaking.scale, LARGEST_SCALE)
        ratios = np.arange(effort.ratios) / effort.ratios * min(nominal)
        proofs = tuple(_prove(families, starts, box, effort, ratio, edge) for ratio in ratios)
    swing = {}
    for name, factor in (("beyond", BEYOND), ("within", WITHIN)):
        scale = factor * min(breaking.scale, LARGEST_SCALE)
        changes = box.changes(scale * breaking.point[None])
        case_folder, pose = plain_path(folder, name), breaking.family.pose
        swing[name] = replayed_swing(save_case(case_folder, name, plant, law, pose, box, changes))
    return Certificate(
        law=law.name,
        cab=plant.cab,
        friction=contact_text(friction),
        nominal_damping=min(nominal),
        proofs=proofs,
        breaking_scale=breaking.scale if np.isfinite(breaking.scale) else float("nan"),
        stable_share=float((damping > 0.0).mean()),
        least_damping=float(damping.min()),
        breaking_pose=breaking.family.pose,
        swing_beyond=swing["beyond"],
        swing_within=swing["within"],
    )


def _draw_in(plant: Hexapod, law: Law, box: Box, pose: Array, friction: Contact | None) -> Family:
    """Draw a pose in until closed valves hold the largest box there; the machines in that pose.

    Where closed valves do not hold it even at neutral, the pose is drawn in until open ones do.
    """
    for closed, share in product((True, False), (1.0, 0.75, 0.5, 0.25, 0.1, 0.0)):
        family = Family(plant, law, share * pose, friction)
        if family.holds(box, LARGEST_SCALE, closed=closed):
            return family
    return family


def _draw_machines(
    families: Sequence[Family], box: Box, effort: Effort
) -> tuple[Array, list[_Machine]]:
    """Damping ratios of machines drawn from the unit box, and the least damped of each pose."""
    points = 2.0 * cube("latin_hypercube", effort.samples, DIMENSIONS, effort.seed) - 1.0
    dampings, weakest = [], []
    for family, pose_points in zip(families, np.array_split(points, len(families)), strict=True):
        chunks = np.array_split(pose_points, len(pose_points) // _CHUNK + 1)
        damping = np.concatenate([family.damping_in(box, chunk) for chunk in chunks])
        dampings.append(damping)
        weakest.append(_Machine(family, pose_points[damping.argmin()], float(damping.min())))
    return np.concatenate(dampings), weakest


def _prove(
    families: Sequence[Family],
    starts: Sequence[_Machine],
    box: Box,
    effort: Effort,
    ratio: float,
    edge: float,
) -> Proof:
    """Prove a damping ratio in all poses, within the box of scale `edge`, and attack the proof.

    The bound of the first pose narrows the box, so that slopes differ less in it.
    """

    def beta(family: Family, least: float) -> float:
        loop = family.widen(family.widths(box, edge))
        return peak_bound(loop, float(np.arcsin(ratio)), least, SLOW_POLE)

    edge = min(edge, _BOX_MARGIN / beta(families[0], 1.0 / edge))
    largest_beta = 1.0 / edge
    for family in families:
        largest_beta = beta(family, largest_beta)
    scale = 1.0 / largest_beta
    attacks = [_attack(start, box, effort, scale) for start in starts]
    return Proof(float(ratio), scale, min(attack.damping for attack in attacks))


def _break_law(starts: Sequence[_Machine], box: Box, effort: Effort) -> _Machine:
    """The machine that fails at the least scale, from several starts and then from corners."""

    def damping_at(scale: float, family: Family, point: Array) -> float:
        return float(family.damping_in(box, scale * point[None])[0])

    breaking, scale = starts[0], LARGEST_SCALE
    generator = np.random.default_rng([effort.seed, 1])
    for number in range(effort.starts):
        machine = starts[number % len(starts)]
        if number >= len(starts):
            corner = 2.0 * cube("corners", 1, DIMENSIONS, generator)[0] - 1.0
            machine = machine._replace(point=corner)
        while True:
            machine = _attack(machine, box, effort, scale, target=0.0, number=number)
            if machine.damping > 0.0:
                break
            limit = optimize.bisect(damping_at, 0.0, scale, (machine.family, machine.point), 1e-4)
            largest = np.abs(machine.point).max()
            scale = float(limit) * largest
            breaking = machine._replace(point=machine.point / largest, scale=scale)
            scale *= _SHRINKAGE
    return breaking


def _attack(
    start: _Machine, box: Box, effort: Effort, scale: float, target: float = -1.0, number: int = 0
) -> _Machine:
    """The least damped machine found in a box; the search ends at a damping ratio of `target`."""

    def damping(points: Array) -> Array:
        return start.family.damping_in(box, scale * points)

    best = start._replace(damping=float(damping(start.point[None])[0]))
    for _ in range(4):
        corner = np.sign(best.damping - damping(best.point + _SLOPE_STEP * np.eye(DIMENSIONS)))
        corner_damping = float(damping(corner[None])[0])
        if corner_damping >= best.damping:
            break
        best = best._replace(point=corner, damping=corner_damping)
    seed = (effort.seed + number) % (2**32 - 1) + 1
    options = {"bounds": [-1.0, 1.0], "seed": seed, "verbose": -9, "popsize": 16}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import cma

        strategy = cma.CMAEvolutionStrategy(0.95 * best.point, 0.3, options)
    for _ in range(effort.rounds):
        if best.damping <= target or strategy.stop():
            break
        points = np.array(strategy.ask())
        dampings = damping(points)
        strategy.tell(points, dampings.tolist())
        if dampings.min() < best.damping:
            best = best._replace(point=points[dampings.argmin()], damping=float(dampings.min()))
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
    cab, oil = plant.cab_parameters, plant.parameters
    assert cab is not None
    unknowns, values = Unknowns(box.unknowns), box.values(changes)
    base_oil = load_hydraulics(oil.name if oil.name in HYDRAULICS else None)
    base_cab = load_cab(cab.base, plant.machine)
    own_machine = plant.machine.recorded()
    modes = bound(law, plant).bound_modes
    changed = {"name": f"{law.name}_{name}", "modes": {} if modes is None else {name: modes}}
    save_law(law.model_copy(update=changed), plain_path(folder, "law.toml"))
    sizes = [float(SMALL_STEP * size) for size in REPORT_AMPLITUDES]
    steps = [
        {"kind": "step", "dof": dof, "amplitude": [size, by_kind(dof, "m", "rad")], "at": 0.5}
        for dof, size in zip(DOFS, sizes, strict=True)
    ]
    rest: dict[str, Any] = {"kind": "waypoints", "times": [0.0, 12.0], "poses": [pose.tolist()] * 2}
    own_oil = _changed_fields(base_oil, unknowns.apply(values, oil, name))
    own_cab = _changed_fields(base_cab, unknowns.apply(values, cab, name))
    files: dict[str, dict[str, Any]] = {
        "hydraulics.toml": {"base": base_oil.name, name: own_oil},
        "cab.toml": {"base": cab.base, name: own_cab},
        "scenario.toml": {
            "title": f"{law.title}: the machine of its certificate that breaks it",
            "machine": "machine.toml" if own_machine else plant.machine.name,
            "cab": "cab.toml",
            "hydraulics": "hydraulics.toml",
            "law": "law.toml",
            "duration": 12.0,
            "record_every": 16,
            "signal": [rest, *steps],
        },
    }
    if own_machine:
        files["machine.toml"] = own_machine
    for file, table in files.items():
        write_text(folder / file, tomlkit.dumps(table))
    return folder / "scenario.toml"


def _changed_fields(base: Settings, changed: Settings) -> dict[str, Any]:
    """Fields of a changed part that differ from those of its base, as TOML values."""
    options: dict[str, Any] = {"mode": "json", "exclude_none": True, "exclude": {"nominal", "name"}}
    before, after = base.model_dump(**options), changed.model_dump(**options)
    return {field: value for field, value in after.items() if value != before.get(field)}


def replayed_swing(scenario: Path) -> float:
    """Swing of the legs left at the end of a case over its largest leg step, in the simulation."""
    try:
        return float(measure_swing(load_scenario(scenario).record())["last"])
    except FloatingPointError:  # it left the bounds of the model
        return float("inf")
