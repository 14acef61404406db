"""Where the MJCF models and data files lie, in a checkout and in an installed wheel."""

from functools import cache
from pathlib import Path

CMF = "cmf"
"""Name of the Cockpit Motion Facility among the machines."""

CABS = ("gfd", "rfd", "ifd")
"""Its three flight decks: Generic, Research and Integration."""

_PACKAGE = Path(__file__).resolve().parents[1]


def directory(name: str = "models") -> Path:
    """A folder of data files: inside the wheel, or next to the package in a checkout."""
    installed = _PACKAGE / name
    return installed if installed.is_dir() else _PACKAGE.parent / name


def model_path(name: str) -> Path:
    """A file of the models, by name: `scene.xml`, `cmf_hexapod.xml`, `single_legs.xml` ...

    The excavator has its hydraulics and control law as TOML and a digging cycle, time [s] and
    cylinder lengths [m], as CSV.
    """
    return directory() / name


@cache
def machine_names() -> tuple[str, ...]:
    """Names of the shipped machines, the CMF first."""
    names = {path.stem for path in (directory() / "machines").glob("*.toml")}
    return (CMF, *sorted(names - {CMF}))
