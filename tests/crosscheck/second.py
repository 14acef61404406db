"""Numbers that matter a second time, by tools of other authors: how far apart, and why.

`python tests/crosscheck --second` writes docs/data/second_tools.csv. All tools but slycot are of
the extra `dev`; without one the comparison ends with a sentence that says so.
"""

import tempfile
import zipfile
from collections.abc import Callable, Sequence
from ctypes import CDLL, RTLD_GLOBAL
from importlib.metadata import distribution
from pathlib import Path
from typing import Any, NamedTuple

import control
import numpy as np
from matplotlib import mlab
from numpy.typing import NDArray
from scipy import signal

from cmf_mj import Hexapod
from cmf_mj.analysis.identification import Experiment, arx
from cmf_mj.analysis.linear.structured import Uncertain, peak_bound, point_bound
from cmf_mj.analysis.spectra import welch_response
from cmf_mj.core.errors import RunError, require
from cmf_mj.core.result import Table
from cmf_mj.export.fmu import export_fmu
from cmf_mj.machine.kinematics import pose_jacobian, pose_to_legs
from cmf_mj.machine.leg_motion import pose_motion_to_legs
from cmf_mj.machine.machine import geometry_of
from cmf_mj.show.look import save_files

Array = NDArray[np.float64]

RATE = 64.0
BOUNDS = Path(__file__).resolve().parents[1] / "references" / "ab13md.csv"
"""Seed and frequency of a matrix, and its bound by slycot 0.7.1."""


class Difference(NamedTuple):
    """The largest difference of a number here from that of another tool."""

    number: str
    tool: str
    largest: float
    unit: str
    source: str  #: Where it comes from.


def stable_loop(seed: int, size: int, sizes: tuple[int, ...]) -> Uncertain:
    """Random, with all poles at least 0.3 left of the imaginary axis."""
    generator, count = np.random.default_rng(seed), sum(sizes)
    a = generator.normal(size=(size, size))
    a -= (np.linalg.eigvals(a).real.max() + 0.3) * np.eye(size)
    b, c = generator.normal(size=(size, count)), generator.normal(size=(count, size))
    return Uncertain(a, b, c, 0.1 * generator.normal(size=(count, count)), sizes)


def matrix(seed: int, omega: float) -> NDArray[np.complex128]:
    """A loop's response to five real numbers at a frequency, (5, 5)."""
    loop = stable_loop(seed, 6, (1,) * 5)
    return np.asarray(loop.c @ np.linalg.solve(1j * omega * np.eye(6) - loop.a, loop.b) + loop.d)


def write_ab13md() -> None:
    """Bounds of SLICOT's AB13MD over a grid, for `BOUNDS`; asks for slycot, which has it.

    That is no dependency: where python-control finds it, it takes other routines than users have.
    """
    ab13md, ones = require("slycot", "dev").ab13md, np.ones(5, dtype=int)
    rows = [
        (seed, omega, repr(float(ab13md(matrix(seed, omega), ones, ones)[0])))
        for seed in range(4)
        for omega in (0.1, 0.5, 1.0, 2.0, 5.0, 20.0)
    ]
    save_files({BOUNDS.name: Table("", ("seed", "rad/s", "bound"), rows)}, BOUNDS.parent)


def structured() -> tuple[float, float]:
    """Least and largest bound for real numbers here over that of AB13MD, of a grid, less 1."""
    given = np.loadtxt(BOUNDS, delimiter=",", skiprows=1)
    found = [point_bound(matrix(int(seed), omega), (1,) * 5).beta for seed, omega, _ in given]
    apart = np.array(found) / given[:, 2] - 1.0
    return float(apart.min()), float(apart.max())


def margins() -> float:
    """Of the least change of a gain that makes a loop unstable, against python-control's margin.

    L = k w^2 / (s (s^2 + 2 z w s + w^2)), an integrator with an oil mode, as a leg.
    """
    worst = 0.0
    for gain, damping in ((4.0, 0.1), (12.0, 0.3), (25.0, 0.6)):
        w = 30.0
        line = control.tf([gain * w * w], [1.0, 2.0 * damping * w, w * w, 0.0])
        room = control.stability_margins(line)[0] - 1.0
        a, b, c, _ = (np.asarray(m) for m in control.ssdata(control.ss(line)))
        loop = Uncertain(a - b @ c, -b, c, np.zeros((1, 1)), (1,))
        worst = max(worst, abs(1.0 / (peak_bound(loop) * room) - 1.0))
    return worst


def noise(samples: int, seed: int) -> tuple[Array, Array]:
    """White noise through a filter of third order, with a tenth of noise on the output."""
    generator = np.random.default_rng(seed)
    u = generator.standard_normal(samples)
    y = signal.lfilter(*signal.butter(3, 0.2), u) + 0.1 * generator.standard_normal(samples)
    return u, y


def spectra() -> float:
    """Of Welch's H1 and its coherence, against matplotlib.mlab."""
    u, y = noise(round(120.0 * RATE), 1)
    ours = welch_response(u, y, RATE, segment=8.0)
    size = round(8.0 * RATE)
    options: dict[str, Any] = {"NFFT": size, "Fs": RATE, "noverlap": int(0.75 * size)}
    options |= {"window": signal.get_window("hann", size), "detrend": mlab.detrend_none}
    pairs = (u, u), (y, y), (u, y)
    uu, yy, uy = (np.asarray(mlab.csd(*pair, **options)[0]) for pair in pairs)
    lines = np.asarray(mlab.psd(u, **options)[1])
    at = np.searchsorted(lines, ours.frequency - 1e-9)
    return max(
        float(np.abs((uy / uu)[at] / ours.response - 1.0).max()),
        float(np.abs((np.abs(uy) ** 2 / (uu * yy))[at] - ours.coherence).max()),
    )


def _known(u: Array) -> Array:
    """A lag and a lightly damped mode, sampled."""
    w, lag = 2.0 * np.pi * 11.0, 2.0 * np.pi * 3.0
    line = control.tf([w * w * lag], np.polymul([1.0, 0.22 * w, w * w], [1.0, lag]))
    system = control.sample_system(control.ss(line), 1.0 / RATE, method="zoh")
    return np.asarray(control.forced_response(system, inputs=u).outputs)


def realised(impulses: int = 60) -> float:
    """Of the response of an ARX model, against Ho and Kalman's realisation (python-control)."""
    u = np.random.default_rng(3).standard_normal(3000)
    y = _known(u)
    lines = np.linspace(0.2, 15.0, 75)
    ours = arx([Experiment(u, y, 1.0 / RATE)], (3, 3, 1)).response(lines).response
    pulse = control.markov(y, u, impulses, dt=1.0 / RATE, truncate=True)
    theirs, _ = control.eigensys_realization(pulse, 3, m=25, n=25, dt=1.0 / RATE)
    found = theirs(np.exp(2j * np.pi * lines / RATE))
    return float(np.abs(found - ours).max() / np.abs(ours).max())


def kinematics(poses: int = 100) -> dict[str, float]:
    """Of legs, Jacobian, leg velocities and accelerations of the CMF, against Pinocchio."""
    pin = require("pinocchio", "dev")
    geometry, model, joint = geometry_of("cmf"), pin.Model(), 0
    kinds = ("PX", "PY", "PZ", "RZ", "RY", "RX")
    for kind in kinds:
        joint = model.addJoint(joint, getattr(pin, f"JointModel{kind}")(), pin.SE3.Identity(), kind)
    frames = [
        model.addFrame(pin.Frame(f"{i}", joint, pin.SE3(np.eye(3), point), pin.FrameType.OP_FRAME))
        for i, point in enumerate(geometry.upper)
    ]
    data, order, axes = model.createData(), [0, 1, 2, 5, 4, 3], pin.LOCAL_WORLD_ALIGNED
    names = ("extension [m]", "Jacobian [m/rad]", "leg velocity [m/s]", "leg acceleration [m/s2]")
    worst, generator = np.zeros(4), np.random.default_rng(0)
    for _ in range(poses):
        pose, rate, change = generator.uniform(-1.0, 1.0, (3, 6))
        pose *= [0.8, 0.8, 0.6, 0.35, 0.35, 0.35]
        pin.forwardKinematics(model, data, pose[order], rate[order], change[order])
        pin.computeJointJacobians(model, data, pose[order])
        pin.updateFramePlacements(model, data)
        rows = []
        for frame, lower, neutral in zip(frames, geometry.lower, geometry.neutral, strict=True):
            along = data.oMf[frame].translation - lower
            length = float(np.linalg.norm(along))
            along /= length
            speed = pin.getFrameVelocity(model, data, frame, axes).linear
            pull = pin.getFrameClassicalAcceleration(model, data, frame, axes).linear
            out = float(along @ speed)
            turned = along @ pull + (speed @ speed - out**2) / length
            jacobian = (along @ pin.getFrameJacobian(model, data, frame, axes)[:3])[order]
            rows.append([length - neutral, *jacobian, out, turned])
        theirs, motion = np.array(rows), pose_motion_to_legs(pose, rate, change)
        ours = np.column_stack([pose_to_legs(pose), pose_jacobian(pose), *motion])
        apart = np.abs(theirs - ours).max(axis=0)
        worst = np.maximum(worst, [apart[0], apart[1:7].max(), *apart[7:]])
    return dict(zip(names, worst.tolist(), strict=True))


Step = Callable[[Array], Array]
"""One step of an FMU: values of its inputs before, lengths of the legs after."""


def by_cosim(file: Path, step: float, inputs: Sequence[str], legs: Sequence[str]) -> Step:
    """An FMU of version 2 in FMI Library, by libcosim."""
    for part in ("Execution", "Slave", "Manipulator", "Observer", "Logging"):
        require(f"libcosimpy.Cosim{part}", "dev")
    cosim = require("libcosimpy", "dev")
    cosim.CosimLogging.log_output_level(cosim.CosimLogging.CosimLogLevel.ERROR)
    run = cosim.CosimExecution.CosimExecution.from_step_size(round(1e9 * step))
    one = run.add_local_slave(cosim.CosimSlave.CosimLocalSlave(str(file), "cmf"))
    there = {known.name.decode(): known.reference for known in run.slave_variables(one)}
    by_hand = cosim.CosimManipulator.CosimManipulator.create_override()
    seen = cosim.CosimObserver.CosimObserver.create_last_value()
    run.add_manipulator(by_hand)
    run.add_observer(seen)
    ports = [[there[name] for name in names] for names in (inputs, legs)]

    def stepped(values: Array) -> Array:
        by_hand.slave_real_values(one, ports[0], values.tolist())
        if not run.step(1):
            raise RunError(f"{file.name}: libcosim could not step")
        return np.array(seen.last_real_values(one, ports[1]))

    return stepped


def by_ecos(file: Path, step: float, inputs: Sequence[str], legs: Sequence[str]) -> Step:
    """An FMU of version 2 or 3 in fmi4c, by Ecos, which links with TBB."""
    for library in distribution("tbb").files or []:
        if library.name == "libtbb.so.12":
            CDLL(str(library.locate()), mode=RTLD_GLOBAL)
    ecos = require("ecospy", "dev")
    structure = ecos.EcosSimulationStructure()
    structure.add_model("one", str(file))
    run = ecos.EcosSimulation(step, structure=structure)
    if not run.init():
        raise RunError(f"{file.name}: Ecos could not start")

    def stepped(values: Array) -> Array:
        for name, value in zip(inputs, values.tolist(), strict=True):
            run.set_real(f"one::{name}", value)
        run.step(1)
        return np.array([run.get_real(f"one::{name}") for name in legs])

    return stepped


def played(file: Path, folder: Path, importer: Callable[..., Step]) -> float:
    """Of the legs of an FMU [m] in an importer, from the FMU's own reference."""
    with zipfile.ZipFile(file) as packed:
        packed.extractall(folder)
    given, expected = (folder / "resources" / f"reference_{part}.csv" for part in ("in", "out"))
    header = given.read_text(encoding="utf-8").split("\n")[0].split(",")
    rows, after = (np.loadtxt(path, delimiter=",", skiprows=1) for path in (given, expected))
    legs = [f"leg_extension[{leg}]" for leg in range(1, 7)]
    step = importer(file, float(rows[1, 0] - rows[0, 0]), header[1:], legs)
    pairs = zip(rows[:, 1:], after[1:, 1:7], strict=False)
    return max(float(np.abs(step(inputs) - lengths).max()) for inputs, lengths in pairs)


def exported(fmi: int, importer: Callable[..., Step]) -> float:
    """`played`, of the CMF under its velocity law."""
    with tempfile.TemporaryDirectory() as folder:
        file = export_fmu(Hexapod(), "velocity", Path(folder) / "cmf.fmu", fmi=fmi)
        return played(file, Path(folder), importer)


def compare() -> list[Difference]:
    """All comparisons, the numbers first."""
    two = "neither bound is the least one: two local searches"
    mu = max(np.abs(structured()).tolist())
    rows = [
        Difference("structured singular value", "SLICOT AB13MD", mu, "of it", two),
        Difference(
            *("gain margin", "python-control", margins(), "of it"),
            "the bound is kept 1 % above the one found",
        ),
        Difference("H1 and coherence, Welch", "matplotlib.mlab", spectra(), "of it", "rounding"),
        Difference(
            *("response of ARX, no noise", "python-control ERA", realised(), "of peak"),
            "60 impulses: what rings longer is cut off",
        ),
    ]
    for version, name, importer in ((2, "FMI Library", by_cosim), (3, "Ecos, fmi4c", by_ecos)):
        apart = exported(version, importer)
        rows.append(Difference(f"legs of an FMU {version}", name, apart, "m", "the same bits"))
    for name, largest in kinematics().items():
        number, unit = name.removesuffix("]").split(" [")
        rows.append(Difference(number, "Pinocchio", largest, unit, "rounding"))
    return rows


def save_second(folder: Path) -> list[Path]:
    """Write `second_tools.csv`."""
    columns = ("number", "second tool", ("largest difference", ".2g"), "unit", "where from")
    return save_files({"second_tools.csv": Table("", columns, compare())}, folder)
