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

LEGS = 6  #: Of a motion base.

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
    features = _features(dcl)
    values = _template_values(law, dcl, features)
    blocks = [name for name, feature in _BLOCKS.items() if features.get(feature, True)]
    source = "\n".join(_fill_template(f"{name}.c", features, values) for name in blocks)
    modes = f"modes of {law.bound_modes.source}" if law.bound_modes else ""
    sentences = [f"{law.title}, law {law.name}", law.source, f"For {carrier}", modes]
    head = ". ".join([*filter(None, sentences), f"{law.rate} frames a second."])
    # Nothing in a comment ends it, or joins lines.
    plain = re.sub(r"[*\\]|\?\?", "", head).encode("ascii", "replace").decode()
    values["head"] = _wrap(plain, " * ")
    return {"cmf_law.h": _fill_template("cmf_law.h", features, values), "cmf_law.c": source}


def _features(dcl: Dcl) -> dict[str, bool]:
    """What a law has, by the names in `#if`."""
    features = {
        "MODAL": dcl.is_modal,
        "MODELLED": dcl.model.is_active,
        "ADAPTING": dcl.model.is_adapting,
        "DAMPED": dcl.has_load_feedback,
        "PLANNED": dcl.has_plan,
        "FOLLOWS": dcl.has_plan and dcl.plan.inverse.follows_pose,
        "STALLS": dcl.has_plan and bool(np.isfinite(dcl.plan.inverse.stall)),
    }
    features["FOLLOWING"] = features["MODELLED"] or features["PLANNED"]
    return features | {"MATHS": features["ADAPTING"] or features["PLANNED"]}


def _template_values(law: Law, dcl: Dcl, features: Mapping[str, bool]) -> dict[str, Any]:
    """Values by the name with which a path of the templates begins."""
    modal, follows = features["MODAL"], features["FOLLOWING"]
    compensator, inverse_plant = dcl.compensator, dcl.plan.inverse
    leg_compensator = compensator._replace(
        state_gain=compensator.state_gain[0], output_gain=compensator.output_gain[0]
    )
    reference_model = "model" if features["MODELLED"] else "plan"
    leg_reference = "reference" if modal else "limited"
    return {
        "law": law,
        "dcl": dcl._replace(compensator=leg_compensator),
        "modes": law.bound_modes,
        "name": law.name,
        "legs": LEGS,
        "rate": law.rate,
        "gravity": "without" if law.gravity_compensation else "with",
        "errors_from": f"the {reference_model}" if follows else "the limited demand",
        "less": ", less the force m a that the plan asks for" if features["PLANNED"] else "",
        "input_gain": _gain_rows(compensator.input_gain, law.input_gain, "1", modal),
        "direct_gain": _gain_rows(compensator.direct_gain, law.direct_gain, "%", modal),
        "per_mode": "[LEGS]" if modal else "",
        "by_mode": "[leg]" if modal else "",
        "near_stall": inverse.NEAR_STALL,
        "small_flow": inverse.SMALL_FLOW,
        "farthest": 0.5 * np.pi,
        "plan_mass": inverse_plant.spring * inverse_plant.mass_per_spring,
        "followed": reference_model,
        "feedback": "&modes" if modal else "&input->feedback",
        "reference": leg_reference,
        "integral": "integral" if modal else "state->error.integral",
        "sum": "sum" if modal else "output->output",
        "target": "target" if follows else leg_reference,
    }


def _gain_rows(values: Any, published: Gains, unit: str, modal: bool) -> str:
    """Rows of a table of gains in a unit per signal, with the published gains as comments."""
    rows = []
    for number, (name, signal_unit) in enumerate(zip(SIGNALS, UNITS, strict=True)):
        gain = getattr(published, name)
        is_compound = "/" in signal_unit or " " in signal_unit
        gain_unit = f"{unit}/({signal_unit})" if is_compound else f"{unit}/{signal_unit}"
        comment = f"/* {_c_text(gain)} {gain_unit} */" if np.any(gain) else ""
        row = f"[{name.upper()}] = {_c_text(values[:, number] if modal else values[0, number])},"
        rows += [comment, row] if modal and comment else [f"{row} {comment}".strip()]
    return textwrap.indent("\n".join(rows), "    ")


def _fill_template(name: str, features: Mapping[str, bool], values: Mapping[str, Any]) -> str:
    """A template for a law with these features and values."""
    lines, conditions = [], list[bool]()
    for line in (_TEMPLATES / name).read_text(encoding="utf-8").splitlines():
        word, _, condition = line.partition(" ")
        feature = condition.removeprefix("!")
        if word == "#if" and (feature in features or conditions):
            conditions.append(features[feature] != condition.startswith("!"))
        elif word == "#else" and conditions:
            conditions.append(not conditions.pop())
        elif word == "#endif" and conditions:
            conditions.pop()
        elif all(conditions):
            lines.append(line)
    paths = SimpleNamespace(**values)
    text = _TOKEN.sub(lambda token: _c_text(attrgetter(token[1])(paths)), "\n".join(lines))
    return text + "\n"


def _c_text(value: Any) -> str:
    """A number, a table or a text as it stands in C."""
    if isinstance(value, tuple):
        return ", ".join(map(_c_text, value))
    if isinstance(value, np.ndarray):
        rows = [", ".join(map(_c_text, row)) for row in np.atleast_2d(value)]
        if value.ndim == 1 and len(rows[0]) < _WIDTH // 2:
            return f"{{{rows[0]}}}"
        rows = rows if value.ndim == 1 else [f"{{{row}}}" for row in rows]
        filled = ",\n".join(_wrap(row, " " * (value.ndim - 1)) for row in rows)
        return "{\n" + textwrap.indent(filled, "  ") + "\n}"
    return repr(float(value)) if isinstance(value, float | np.floating) else str(value)


def _wrap(text: str, indent: str) -> str:
    wrapper = textwrap.TextWrapper(_WIDTH - 8, subsequent_indent=indent, break_on_hyphens=False)
    wrapper.break_long_words = False
    return wrapper.fill(text)
