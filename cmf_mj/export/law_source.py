"""`cmf export law`: a law as C99 that a reviewer reads.

The C stands in `c/blocks`, a file a block of the law, with two things for this module to fill in:
lines between `#if NAME` and `#endif` stay where the law has what NAME says, and `@path@` is the
number, table or text of that path in the law or its compiled parameters. So a law's source has its
own blocks and no others, and its numbers are those that Python computes with.
"""

import re
import textwrap
from collections.abc import Mapping
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from cmf_mj.control import inverse
from cmf_mj.control.dcl import Dcl, make_dcl
from cmf_mj.control.law import SIGNALS, Gains, Law

LEGS = 6  #: Those of a motion base.

UNITS = ("in", "Pa", "Pa", "in", "in/s", "in/s", "in/s", "in s", "in/s^2", "lbf")
"""What gains of `SIGNALS` are published per."""

_BLOCKS = {
    "law": "",
    "limit": "",
    "modes": "MODAL",
    "feedback": "",
    "error": "",
    "compensator": "",
    "model": "MODELLED",
    "load": "DAMPED",
    "plan": "PLANNED",
    "platform": "FOLLOWS",
    "inverse": "PLANNED",
    "valve": "",
    "step": "",
}
"""Blocks in the order of the source, and what a law has that has them."""

_TEMPLATES = Path(__file__).with_name("c") / "blocks"
_WIDTH = 100
_TOKEN = re.compile(r"@([\w.]+)@")


def law_source(law: Law, carrier: str) -> dict[str, str]:
    """Header and source of a law that is bound to its machine, by file name.

    `carrier` says in words what it is bound to.
    """
    dcl = make_dcl(law, LEGS)
    has = _has(law, dcl)
    numbers = _numbers(law, dcl, has)
    there = [name for name, needed in _BLOCKS.items() if has.get(needed, True)]
    source = "\n".join(_filled(f"{name}.c", has, numbers) for name in there)
    modes = f"modes of {law.bound_modes.source}" if law.bound_modes else ""
    said = [f"{law.title}, law {law.name}", law.source, f"For {carrier}", modes]
    head = ". ".join([*filter(None, said), f"{law.rate} frames a second."])
    # Nothing in a comment ends it, or joins lines.
    plain = re.sub(r"[*\\]|\?\?", "", head).encode("ascii", "replace").decode()
    numbers["head"] = _wrapped(plain, " * ")
    return {"cmf_law.h": _filled("cmf_law.h", has, numbers), "cmf_law.c": source}


def _has(law: Law, dcl: Dcl) -> dict[str, bool]:
    """What a law has, by the names in `#if`."""
    has = {
        "MODAL": dcl.is_modal,
        "MODELLED": dcl.model.is_active,
        "ADAPTING": dcl.model.is_adapting,
        "DAMPED": dcl.has_load_feedback,
        "PLANNED": dcl.has_plan,
        "FOLLOWS": dcl.has_plan and dcl.plan.inverse.follows_pose,
        "STALLS": dcl.has_plan and bool(np.isfinite(dcl.plan.inverse.stall)),
    }
    has["FOLLOWING"] = has["MODELLED"] or has["PLANNED"]
    return has | {"MATHS": has["ADAPTING"] or has["PLANNED"]}


def _numbers(law: Law, dcl: Dcl, has: Mapping[str, bool]) -> dict[str, Any]:
    """What the paths of the templates begin with."""
    modal, follows = has["MODAL"], has["FOLLOWING"]
    one = dcl._replace(
        compensator=dcl.compensator._replace(
            state_gain=dcl.compensator.state_gain[0], output_gain=dcl.compensator.output_gain[0]
        )
    )
    followed = "model" if has["MODELLED"] else "plan"
    back = dcl.plan.inverse
    return {
        "law": law,
        "dcl": one,
        "modes": law.bound_modes,
        "name": law.name,
        "legs": LEGS,
        "rate": law.rate,
        "gravity": "without" if law.gravity_compensation else "with",
        "errors_from": f"the {followed}" if follows else "the limited demand",
        "less": ", less the force m a that the plan asks for" if has["PLANNED"] else "",
        "input_gain": _gains(dcl.compensator.input_gain, law.input_gain, "1", modal),
        "direct_gain": _gains(dcl.compensator.direct_gain, law.direct_gain, "%", modal),
        "per_mode": "[LEGS]" if modal else "",
        "by_mode": "[leg]" if modal else "",
        "near_stall": inverse.NEAR_STALL,
        "small_flow": inverse.SMALL_FLOW,
        "farthest": 0.5 * np.pi,
        "plan_mass": back.spring * back.compliance,
        "followed": followed,
        "feedback": "&modes" if modal else "&input->feedback",
        "reference": "reference" if modal else "limited",
        "integral": "integral" if modal else "state->error.integral",
        "sum": "sum" if modal else "output->output",
        "target": "target" if follows else "reference" if modal else "limited",
    }


def _gains(values: Any, published: Gains, of: str, modal: bool) -> str:
    """Rows of a table of gains, with what was published behind them."""
    rows = []
    for number, (name, unit) in enumerate(zip(SIGNALS, UNITS, strict=True)):
        gain = getattr(published, name)
        per = f"{of}/({unit})" if "/" in unit or " " in unit else f"{of}/{unit}"
        said = f"/* {_text(gain)} {per} */" if np.any(gain) else ""
        row = f"[{name.upper()}] = {_text(values[:, number] if modal else values[0, number])},"
        rows += [said, row] if modal and said else [f"{row} {said}".strip()]
    return textwrap.indent("\n".join(rows), "    ")


def _filled(name: str, has: Mapping[str, bool], numbers: Mapping[str, Any]) -> str:
    """A template with what the law has."""
    lines, kept = [], [True]
    for line in (_TEMPLATES / name).read_text(encoding="utf-8").splitlines():
        word, _, rest = line.partition(" ")
        known = rest.removeprefix("!") in has
        if word == "#if" and (known or len(kept) > 1):
            kept.append(has[rest] if rest in has else not has[rest[1:]])
        elif word == "#else" and len(kept) > 1:
            kept[-1] = not kept[-1]
        elif word == "#endif" and len(kept) > 1:
            kept.pop()
        elif all(kept):
            lines.append(line)
    paths = SimpleNamespace(**numbers)
    text = _TOKEN.sub(lambda token: _text(attrgetter(token[1])(paths)), "\n".join(lines))
    return text + "\n"


def _text(value: Any) -> str:
    """A number, a table or a text as it stands in C."""
    if isinstance(value, tuple):
        return ", ".join(map(_text, value))
    if isinstance(value, np.ndarray):
        rows = [", ".join(map(_text, row)) for row in np.atleast_2d(value)]
        if value.ndim == 1 and len(rows[0]) < _WIDTH // 2:
            return f"{{{rows[0]}}}"
        rows = rows if value.ndim == 1 else [f"{{{row}}}" for row in rows]
        filled = ",\n".join(_wrapped(row, " " * (value.ndim - 1)) for row in rows)
        return "{\n" + textwrap.indent(filled, "  ") + "\n}"
    return repr(float(value)) if isinstance(value, float | np.floating) else str(value)


def _wrapped(text: str, indent: str) -> str:
    wrapper = textwrap.TextWrapper(_WIDTH - 8, subsequent_indent=indent, break_on_hyphens=False)
    wrapper.break_long_words = False
    return wrapper.fill(text)
