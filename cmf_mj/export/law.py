"""`cmf export law`: one control law as a C library, for a controller of one's own."""

from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from cmf_mj.control import dcl
from cmf_mj.control.engage import engaged
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.control.law import SIGNALS, Law, load_law
from cmf_mj.core.files import write_text
from cmf_mj.export.library import build, copy_licences, copy_sources
from cmf_mj.export.machine import Image, make_image
from cmf_mj.export.machine_code import constant_data, machine_code
from cmf_mj.facility.binding import bound
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.machine.machine import Machine

LEGS = 6
"""Those of the facility."""


class LawParts(NamedTuple):
    """All that a frame of a law works on."""

    dcl: dcl.Dcl
    state: dcl.DclState
    reference: NDArray[np.float64]
    feedback: LegFeedback


def law_frame(parts, first, last):  # type: ignore[no-untyped-def]
    """One frame of the law; compiled where it is used."""
    dcl.step(parts.dcl, parts.state, parts.reference, parts.feedback)


def law_parts(law: Law, machine: Machine | None = None) -> LawParts:
    """A law bound to its machine, by default the CMF, engaged at neutral at rest."""
    block, still = dcl.make_dcl(law, LEGS, machine), np.zeros(LEGS)
    feedback = LegFeedback(*(np.zeros(LEGS) for _ in LegFeedback._fields))
    return LawParts(block, engaged(block, still, feedback), still, feedback)


def law_code(parts: LawParts) -> bytes:
    """Object file of a law's frame, the same for every law."""
    return machine_code("cmf_law_code", law_frame, numba.typeof(parts))


def export_law(law: str | Path | Law, out: Path, cab: str | Path | Cab | None = None) -> list[Path]:
    """Write a law as a C library into a folder and build it; the files written.

    A law in hydraulic modes is bound to the cab, by default the CMF's first; stroke and piston area
    are those of the cab's machine. The library depends on the C library alone.

    Raises:
        InputError: there is no such law or cab, or no C compiler.
        RunError: the compiler refuses the code.
    """
    carried = load_cab(cab)
    chosen = bound(load_law(law), carried.known_as)
    parts = law_parts(chosen, carried.machine)
    image = make_image(parts)
    files = copy_sources("law", out)
    blocks = {
        "cmf_law_slots_data": np.frombuffer(image.slots.tobytes(), dtype=np.uint8),
        "cmf_law_memory_data": image.block,
    }
    objects = {"cmf_law_code": law_code(parts), "cmf_law_data": constant_data(blocks)}
    for name, code in objects.items():
        files.append(out / f"{name}.o")
        files[-1].write_bytes(code)
    files.append(write_text(out / "cmf_law_data.h", _header(chosen, parts, image)))
    files += copy_licences(out, ["cmf-mj"])
    build(out, out / "libcmf_law.so", ["cmf_law.c"], [f"{name}.o" for name in objects])
    return [*files, out / "libcmf_law.so"]


def _header(law: Law, parts: LawParts, image: Image) -> str:
    states = [f'{{"{name}", {image.at[f"state.{name}"]}}}' for name in parts.state.arrays()]
    inputs = ["reference", *(f"feedback.{name}" for name in LegFeedback._fields)]
    numbers = {
        "NAME": f'"{law.name}"',
        "LEGS": LEGS,
        "WORDS": image.block.size // 8,
        "SLOTS": image.slots.size,
        "STATES": ", ".join(states),
        "POINTERS": ", ".join(map(str, image.pointers)),
        "INPUTS": ", ".join(str(image.at[path]) for path in inputs),
        "OUTPUT": image.at["dcl.workspace.output"],
        "COMMAND": image.at["dcl.workspace.command"],
    }
    lines = [f"/* {law.title.replace('*/', '')}", " *"]
    lines += [" * x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k]; y in per cent of full command,"]
    lines += [" * u in in, in/s, in s, in/s^2, Pa, lbf, per leg or hydraulic mode."]
    lines += [f" * A frame is 1/{law.rate} s.", " *"]
    lines += [f" * A {law.state_gain}, C {law.output_gain}"]
    for letter, gains in (("B", law.input_gain), ("D", law.direct_gain)):
        values = {name: getattr(gains, name) for name in SIGNALS}
        lines += [f" * {letter} {name} {gain}" for name, gain in values.items() if np.any(gain)]
    lines += [" */", "#ifndef CMF_LAW_DATA_H", "#define CMF_LAW_DATA_H"]
    lines += [f"#define CMF_LAW_{name} {value}" for name, value in numbers.items()]
    return "\n".join([*lines, "#endif", ""])
