"""UFF 58, the universal file format of modal-analysis tools, through pyuff."""

import json
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError, require
from cmf_mj.core.files import whole_file
from cmf_mj.record.layout import UFF_TYPES, check_dataset
from cmf_mj.record.record import Record


def write_uff(record: Record, path: str | Path) -> Path:
    """Write every channel as a UFF dataset 58, a time response; the file appears when complete.

    Binary datasets (58b, double precision): values come back bit for bit. A channel with several
    columns is one dataset a column, named `leg_position_1` to `_6`, with its number as response
    node. The abscissa is even; UFF states its increment to six digits, so rate and start are also
    in the ID lines 2 to 5, with plant, law and command where 320 characters hold them.

    Args:
        record: of any rate and any channels, at least two samples.
        path: where to; folders are made.

    Raises:
        InputError: a value that is not finite, a name or unit UFF cannot hold.
        MissingExtraError: pyuff is not installed.
    """
    pyuff, target = require("pyuff", "uff"), Path(path)
    if record.time.size < 2:
        raise InputError(f"record: has {record.time.size} samples; allowed: at least 2")
    columns = list(_scalars(record))
    names = [name for _, name, _, _ in columns]
    for name in names:
        if len(name.encode()) > 80 or names.count(name) > 1:
            raise InputError(f"{name}: is longer than 80 characters or the name of two columns")
    lines = _id_lines(record, len(columns))
    datasets = []
    for channel, name, node, values in columns:
        unit = record.units[channel]
        if len(unit.encode()) > 20:
            raise InputError(f"{channel}: unit {unit!r} is longer than 20 characters")
        if not np.isfinite(values).all():
            sample = int(np.argmin(np.isfinite(values)))
            raise InputError(f"{name}: {values[sample]} at sample {sample} is not finite")
        datasets.append(
            pyuff.prepare_58(
                binary=1,
                func_type=1,
                id1=name,
                **lines,
                rsp_node=node,
                rsp_dir=0,
                ref_node=0,
                ref_dir=0,
                abscissa_spacing=1,
                abscissa_spec_data_type=17,
                ordinate_spec_data_type=UFF_TYPES.get(unit, 0),
                orddenom_spec_data_type=0,
                data=np.array(values, dtype=float),
                x=record.time,
            )
            | {
                "abscissa_axis_lab": "time",
                "abscissa_axis_units_lab": "s",
                "ordinate_axis_lab": channel[:20],
                "ordinate_axis_units_lab": unit,
            }
        )
    with whole_file(target) as partial, warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # pyuff leaves its handle to be collected
        # mode "overwrite" of pyuff 2.5.8 loses the header of the first binary dataset
        pyuff.UFF(str(partial)).write_sets(datasets, mode="add")
    return target


def read_uff(path: str | Path) -> Record:
    """Read the time responses of a UFF file; datasets other than 58 are passed over.

    Names come from ID line 1 (the ordinate's label or `channel_<n>` where it is NONE), units from
    the ordinate's label as they stand: files of others may not be in SI.

    Raises:
        InputError: the file is not whole, holds no time response, or its time responses differ in
            length or rate.
        MissingExtraError: pyuff is not installed.
    """
    pyuff, source = require("pyuff", "uff"), Path(path)
    try:
        source.open("rb").close()
        sets = pyuff.UFF(str(source)).read_sets()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except Exception as error:  # pyuff raises nothing more special
        raise InputError(f"{path}: is not a readable UFF file: {error}") from error
    sets = [sets] if isinstance(sets, dict) else sets
    datasets = [each for each in sets if each.get("type") == 58 and each["func_type"] == 1]
    if not datasets:
        raise InputError(f"{path}: holds no time response (dataset 58, function type 1)")
    first = datasets[0]
    for i, each in enumerate(datasets, start=1):
        check_dataset(f"{path}: dataset {i} ({each['id1']})", each, first)
    metadata = _from_id_lines(first) or {
        "sample_rate": float(1.0 / (first["x"][1] - first["x"][0])),
        "start": float(first["x"][0]),
    }
    written = metadata.pop("datasets", len(datasets))
    if written != len(datasets):
        raise InputError(
            f"{path}: holds {len(datasets)} datasets 58; allowed: {written}, as written"
        )
    channels, channel_units = _channels(path, datasets)
    time = metadata.pop("start") + np.arange(first["x"].size) / metadata["sample_rate"]
    metadata.setdefault("command", {"kind": "recording"})
    metadata["recording"] = {"file": source.name}
    return Record(time, channels, channel_units, metadata)


def _scalars(record: Record) -> Iterator[tuple[str, str, int, NDArray[np.float64]]]:
    """Channel, name, number (0 for a channel without a leg axis) and values of each column."""
    for channel, values in record.channels.items():
        if values.ndim == 1:
            yield channel, channel, 0, values
        else:
            for i, column in enumerate(values.T, start=1):
                yield channel, f"{channel}_{i}", i, column


def _id_lines(record: Record, datasets: int) -> dict[str, str]:
    """As much of the metadata as the ID lines 2 to 5 hold."""
    least = {
        "sample_rate": float(record.metadata["sample_rate"]),
        "start": float(record.time[0]),
        "datasets": datasets,
    }
    more = {k: record.metadata[k] for k in ("command", "plant", "law") if k in record.metadata}
    for kept in (more, {"command": more.get("command")}, {}):
        text = json.dumps(least | kept, separators=(",", ":")).replace(" ", "\\u0020")
        if len(text) <= 4 * 80:
            break
    return {f"id{i + 2}": text[80 * i : 80 * (i + 1)] or "NONE" for i in range(4)}


def _from_id_lines(dataset: dict[str, Any]) -> dict[str, Any] | None:
    """What `_id_lines` wrote; None in the files of others."""
    lines = [dataset[f"id{i}"] for i in range(2, 6)]
    try:
        content = json.loads("".join(line for line in lines if line != "NONE"))
    except ValueError:
        return None
    numbers = ("sample_rate", "start")
    if not isinstance(content, dict) or not all(
        isinstance(content.get(name), float) for name in numbers
    ):
        return None
    return content


def _channels(
    path: str | Path, datasets: list[dict[str, Any]]
) -> tuple[dict[str, NDArray[np.float64]], dict[str, str]]:
    """Datasets `name_1` to `name_k` with nodes 1 to k together, all others one by one."""
    parts: dict[str, list[tuple[int, NDArray[np.float64]]]] = {}
    channel_units: dict[str, str] = {}
    for i, each in enumerate(datasets, start=1):
        labels = (each["id1"], each["ordinate_axis_lab"], f"channel_{i}")
        name = next(label for label in labels if label not in ("", "NONE"))
        node = each["rsp_node"]
        grouped = node > 0 and name.endswith(f"_{node}")
        channel = name.removesuffix(f"_{node}") if grouped else name
        part = parts.setdefault(channel, [])
        if node * grouped != (len(part) + 1) * grouped or (part and not grouped):
            raise InputError(f"{path}: dataset {i} ({name}): is there twice or out of order")
        part.append((node * grouped, each["data"]))
        channel_units[channel] = each["ordinate_axis_units_lab"]
    channels = {
        name: np.column_stack([values for _, values in part]) if part[0][0] else part[0][1]
        for name, part in parts.items()
    }
    return channels, channel_units
