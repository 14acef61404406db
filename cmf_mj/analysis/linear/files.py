"""A state space as a JSON file: matrices row by row, names, sampling time, what it is of."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import control
import numpy as np

from cmf_mj.core.errors import InputError
from cmf_mj.core.files import write_text

_MATRICES = ("A", "B", "C", "D")
_LABELS = ("input_labels", "output_labels", "state_labels")


def save_system(
    system: control.StateSpace, path: str | Path, description: Mapping[str, Any] | None = None
) -> Path:
    """Write a state space as JSON; numbers come back bit for bit.

    Args:
        system: continuous or discrete.
        path: of the file.
        description: plain JSON values kept with it, such as plant and pose.
    """
    content: dict[str, Any] = {
        "name": system.name,
        "sampling_time": system.dt,
        "units": "SI; commands as fractions; angles in rad",
        "description": dict(description or {}),
    }
    content |= {name: list(getattr(system, name)) for name in _LABELS}
    content |= {name: np.asarray(getattr(system, name)).tolist() for name in _MATRICES}
    target = Path(path)
    write_text(target, json.dumps(content, allow_nan=False) + "\n")
    return target


def load_system(path: str | Path) -> control.StateSpace:
    """Read a state space written by `save_system`.

    Raises:
        InputError: the file is not one.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        # A system without states has empty matrices, whose shapes JSON does not keep.
        sizes = dict(zip(_LABELS, (len(content[name]) for name in _LABELS), strict=True))
        inputs, outputs, states = (sizes[name] for name in _LABELS)
        shapes = ((states, states), (states, inputs), (outputs, states), (outputs, inputs))
        return control.ss(
            *(
                np.array(content[name], dtype=float).reshape(shape)
                for name, shape in zip(_MATRICES, shapes, strict=True)
            ),
            content["sampling_time"],
            inputs=content["input_labels"],
            outputs=content["output_labels"],
            states=content["state_labels"],
            name=content["name"],
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: is not a state space of this project: {error!r}") from error
