"""A state space as a JSON file: matrices row by row, names, sampling time, what it is of."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import control
import numpy as np

from cmf_mj.core.files import write_text


def save_system(system: control.StateSpace, path: Path, description: Mapping[str, Any]) -> Path:
    """Write a state space as JSON; numbers read back bit for bit.

    `A` to `D`, `sampling_time` and the labels make a `control.ss` of it again; `description` are
    plain JSON values kept with it, such as plant and pose.
    """
    content: dict[str, Any] = {
        "name": system.name,
        "sampling_time": system.dt,
        "units": "SI; commands as fractions; angles in rad",
        "description": dict(description),
    }
    labels = ("input_labels", "output_labels", "state_labels")
    content |= {name: list(getattr(system, name)) for name in labels}
    content |= {name: np.asarray(getattr(system, name)).tolist() for name in "ABCD"}
    return write_text(path, json.dumps(content, allow_nan=False) + "\n")
