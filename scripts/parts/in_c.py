"""Laws as C source beside Python, on three processors.

Random valid laws and all shipped ones run on random demands and feedback, and every bit of outputs,
commands and last states has to be that of Python, on x86-64 and, under emulation, on AArch64 and on
64-bit PowerPC, where the highest byte comes first. Says what cppcheck
says of MISRA.

Needs, of Debian: gcc, gcc-aarch64-linux-gnu, gcc-powerpc64-linux-gnu, qemu-user-static, cppcheck.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj import law_names, load_cab, load_law
from cmf_mj.analysis.modes import bound
from cmf_mj.control.dcl import DclState, make_dcl
from cmf_mj.control.engage import engaged_state
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.control.law import SIGNALS, Law
from cmf_mj.export.law_source import LEGS, law_source
from cmf_mj.facility.replay import _run

Array = NDArray[np.float64]
HOST = Path(__file__).resolve().parents[2] / "tests" / "export" / "export_law_source_host.c"

NATIVE = "x86_64"
TARGETS = {
    "aarch64": ("aarch64-linux-gnu-gcc", "qemu-aarch64-static", "gcc-aarch64-linux-gnu"),
    "powerpc64": ("powerpc64-linux-gnu-gcc", "qemu-ppc64-static", "gcc-powerpc64-linux-gnu"),
}
"""Other processors: compiler, emulator, and the Debian package of the compiler."""

_SCALES = dict(zip(SIGNALS, (50, 2e-7, 1e-7, 100, 3, 3, 3, 50, 0.05, 0.01), strict=True))
"""Sizes of published gains."""


class Motion(NamedTuple):
    """Inputs of a law, frame by frame, and the state it begins in."""

    reference: Array  #: (N, 6).
    feedback: LegFeedback  #: Of arrays (N, 6).
    begun: DclState


def random_law(rng: np.random.Generator) -> Law:
    """A valid law of any coordinates, blocks, machine and rate."""
    cab = load_cab(None, str(rng.choice(["cmf", "lab", "simona"])))
    modal, rate = bool(rng.random() < 0.5), int(rng.choice([2048, 2048, 500, 1000, 5000]))
    state_gain = rng.uniform(0.0 if rate != 2048 else -0.99, 0.99)

    def per_mode(low: float, high: float) -> Any:
        drawn = np.exp(rng.uniform(np.log(low), np.log(high), LEGS)).tolist()
        return drawn if modal and rng.random() < 0.5 else drawn[0]

    def gains() -> dict[str, Any]:
        return {
            name: np.multiply(rng.choice([-1.0, 1.0]), per_mode(0.1 * size, 2.0 * size)).tolist()
            for name, size in _SCALES.items()
            if rng.random() < 0.5
        }

    table: dict[str, Any] = {
        "name": "random",
        "title": "Random",
        "state_gain": state_gain,
        "output_gain": rng.choice([0.0, rng.uniform(-50.0, 50.0)]),
        "input_gain": gains(),
        "direct_gain": gains(),
        "derivative_pole": rng.uniform(1.0, 900.0),
        "integrator_limit": rng.uniform(0.01, 50.0),
        "integrator_trigger": rng.uniform(-40.0, 37.5),
        "accelerometer_pole": rng.choice([0.0, rng.uniform(0.0, 0.999)]),
        "accelerometer_gain": rng.uniform(-1.0, 1.0),
        "gravity_compensation": bool(rng.random() < 0.5),
    }
    if modal:
        table |= {"coordinates": "hydraulic_modes", "modes": _modes(rng, cab.name)}
    kind = rng.choice(["none", "model", "adaptive", "plan", "plan"])
    if kind in ("model", "adaptive"):
        table["reference_model"] = _model(rng, kind == "adaptive")
    if kind == "plan":
        table["plan"] = _plan(rng, per_mode, modal)
    if rng.random() < 0.5:
        table["load_feedback"] = {"gain": per_mode(0.01, 30.0), "corner": rng.uniform(0.1, 50.0)}
    return bound(load_law(table), cab).at_rate(rate)


def _modes(rng: np.random.Generator, cab: str) -> dict[str, Any]:
    shape = np.linalg.qr(rng.normal(size=(LEGS, LEGS)))[0]
    modes = {
        "frequency": np.sort(rng.uniform(3.0, 50.0, LEGS)).tolist(),
        "mass": rng.uniform(100.0, 40_000.0, LEGS).tolist(),
        "shape": shape.tolist(),
        "follow_pose": bool(rng.random() < 0.6),
    }
    return {cab: modes}


def _model(rng: np.random.Generator, adaptive: bool) -> dict[str, Any]:
    model = {
        "natural_frequency": rng.uniform(0.2, 50.0),
        "damping_ratio": rng.uniform(0.05, 2.0),
        "position": rng.uniform(-30.0, 30.0),
        "rate": rng.choice([0.0, rng.uniform(-3.0, 3.0)]),
        "velocity": rng.uniform(-5.0, 5.0),
        "acceleration": rng.uniform(-0.2, 0.2),
    }
    if adaptive:
        model["adaptation"] = {
            "rate": rng.uniform(0.01, 20.0),
            "slope": rng.uniform(0.1, 20.0),
            "corner": rng.uniform(0.1, 50.0),
            "level": rng.uniform(0.1, 20.0),
            "dead_zone": rng.choice([0.0, rng.uniform(0.0, 1.0)]),
            "leak": rng.choice([0.0, rng.uniform(0.0, 1.0)]),
            "lowest": rng.uniform(0.1, 1.0),
            "highest": rng.uniform(1.0, 3.0),
        }
    return model


def _plan(rng: np.random.Generator, per_mode: Any, modal: bool) -> dict[str, Any]:
    plan = {
        "speed": rng.uniform(0.1, 1.0),
        "drive_lag": rng.uniform(1.0, 200.0),
        "valve_lag": rng.uniform(1.0, 200.0),
        "leak_rate": rng.choice([0.0, rng.uniform(0.0, 30.0)]),
        "pairs": [[rng.uniform(1.0, 200.0), rng.uniform(0.1, 2.0)] for _ in range(2)],
        "pole": rng.uniform(1.0, 200.0),
        "rate": per_mode(5.0, 80.0),
        "acceleration": per_mode(50.0, 2000.0),
        "smooth": rng.uniform(0.5, 50.0),
        "approach": rng.uniform(0.5, 50.0),
        "position": per_mode(1.0, 100.0),
        "velocity": per_mode(0.1, 10.0),
    }
    if rng.random() < 0.5:
        plan["stall"] = rng.uniform(1.0, 50.0)
    return plan if modal else plan | {"frequency": rng.uniform(3.0, 50.0)}


def random_motion(rng: np.random.Generator, law: Law, frames: int) -> Motion:
    """Demands that wander, jump and leave the stroke; feedback of any kind; any state to begin."""
    stroke = law.machine.half_stroke

    def wandering(size: float) -> Array:
        time, shape = np.arange(frames)[:, None] / law.rate, (1, LEGS)
        slow = sum(
            rng.uniform(0.0, size, shape)
            * np.sin(rng.uniform(0.1, 60.0, shape) * time + rng.uniform(0.0, 6.3, shape))
            for _ in range(3)
        )
        jumps = rng.normal(0.0, size, (frames, LEGS)) * (rng.random((frames, LEGS)) < 2e-3)
        return np.ascontiguousarray(slow + 0.3 * np.cumsum(jumps, axis=0))

    noise = [rng.normal(0.0, size, (frames, LEGS)) for size in (1e-4, 1e-2, 1.0, 1e5, 1e5)]
    sizes = (0.5 * stroke, 0.5, 5.0, 5e6, 5e6)
    feedback = [wandering(size) + more for size, more in zip(sizes, noise, strict=True)]
    reference = wandering(0.5 * stroke)
    first = LegFeedback(*(channel[0].copy() for channel in feedback))
    begun = engaged_state(make_dcl(law, LEGS), reference[0].copy(), first)
    begun.offset[:] = rng.choice([0.0, 0.3], LEGS)
    return Motion(reference, LegFeedback(*feedback), begun)


def states_in_c(law: Law, state: DclState) -> list[Array]:
    """States in the order of the C structure, which has those of the law's blocks alone."""
    model = law.reference_model
    adapts = model is not None and make_dcl(law, LEGS).model.is_adapting
    has = {
        "model.adaptation": adapts,
        "model": model is not None,
        "plan": law.plan is not None,
        "load_filter": law.load_feedback is not None,
    }
    return [
        values
        for name, values in state.arrays().items()
        if has.get(name.rpartition(".")[0] or name, True)
    ]


def in_python(law: Law, motion: Motion) -> tuple[Array, Array]:
    """Outputs (N, 6) and last states of a law."""
    state, output = DclState.of(motion.begun.arrays()), np.empty(motion.reference.shape)
    dcl = make_dcl(law, LEGS)
    _run(dcl, state, motion.reference, motion.feedback, output, np.empty(output.shape))
    return output, np.array(states_in_c(law, state))


def needed(name: str, package: str) -> str:
    """A program, or an end with one sentence where it is not there."""
    if shutil.which(name) is None:
        sys.exit(f"in_c: {name} is missing; apt-get install {package}")
    return name


def in_c(
    folder: Path, law: Law, motion: Motion, target: str = NATIVE
) -> tuple[Array, Array, Array]:
    """Outputs (N, 6), commands (N, 6) and last states of a law's source on a processor."""
    folder.mkdir(exist_ok=True, parents=True)
    for name, text in law_source(law, "a test").items():
        (folder / name).write_text(text)
    command, emulator, package = TARGETS.get(target, ("gcc", "", "gcc"))
    options = ["-std=c99", "-O2", "-ffp-contract=off", "-static", "-I.", str(HOST)]
    built = [needed(command, package), *options, "cmf_law.c", "-lm", "-o", "host"]
    subprocess.run(built, cwd=folder, check=True)
    states = np.array(states_in_c(law, motion.begun))
    rows = np.concatenate([motion.reference, *motion.feedback], axis=1)
    (folder / "in").write_bytes(states.tobytes() + rows.tobytes())
    under = [needed(emulator, "qemu-user-static")] if emulator else []
    subprocess.run([*under, "./host", "in", "out"], cwd=folder, check=True)
    found, count = np.fromfile(folder / "out"), 2 * motion.reference.size
    both = found[:count].reshape(-1, 2, LEGS)
    return both[:, 0].copy(), both[:, 1].copy(), found[count:].reshape(-1, LEGS)


def differing(folder: Path, law: Law, motion: Motion, target: str = NATIVE) -> list[str]:
    """What of a law's source on a processor differs from Python in any bit."""
    output, states = in_python(law, motion)
    expected = output, np.minimum(np.maximum(output, -1.0), 1.0), states
    found = in_c(folder, law, motion, target)
    names = ("output", "command", "states")
    return [
        name
        for name, one, other in zip(names, expected, found, strict=True)
        if one.tobytes() != other.tobytes()
    ]


def shipped() -> Iterator[Law]:
    """All shipped laws, bound to the cabs they are shipped for."""
    for name in law_names("all"):
        yield bound(load_law(name), load_cab())
    lab = load_cab(None, "lab")
    yield bound(load_law(lab.machine.law), lab)


def broken(folder: Path, law: Law) -> set[str]:
    """Rules of MISRA that a law's source breaks, and errors."""
    folder.mkdir()
    for name, text in law_source(law, "a test").items():
        (folder / name).write_text(text)
    command = [needed("cppcheck", "cppcheck"), "--addon=misra", "--std=c99", "--enable=all", "-q"]
    command += ["--suppress=missingIncludeSystem", "cmf_law.c"]
    said = subprocess.run(command, cwd=folder, capture_output=True, text=True).stderr
    return set(re.findall(r"\[(misra-c2012-[\d.]+|uninitvar|\w*[eE]rror)\]", said))


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--laws", type=int, default=600, help="random laws")
    parser.add_argument("--seed", type=int, default=0, help="of the first; each has its own")
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--targets", default=",".join((NATIVE, *TARGETS)))


def run(options: argparse.Namespace) -> None:
    """Compare laws, then look for broken rules in the shipped ones."""
    seeds = range(options.seed, options.seed + options.laws)
    laws = [*((law.name, law, 0) for law in shipped()), *((f"{n}", None, n) for n in seeds)]
    failed = 0
    with tempfile.TemporaryDirectory() as place:
        for name, law, seed in laws:
            rng = np.random.default_rng(seed)
            law = law or random_law(rng)
            motion = random_motion(rng, law, options.frames)
            for target in options.targets.split(","):
                found = differing(Path(place) / target, law, motion, target)
                failed += bool(found)
                if found:
                    print(f"law {name} on {target}: {', '.join(found)} differ from Python")
        print(f"{len(laws)} laws of {options.frames} frames on {options.targets}: {failed} differ")
        rules = set().union(*(broken(Path(place) / law.name, law) for law in shipped()))
    print("cppcheck:", ", ".join(sorted(rules)) or "nothing")
    sys.exit(failed > 0)
