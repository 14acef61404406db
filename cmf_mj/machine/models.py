"""Where the MJCF models and data files lie, in a checkout and in an installed wheel."""

from pathlib import Path

from cmf_mj.core.errors import check_name

CABS = ("gfd", "rfd", "ifd")
"""The three flight decks: Generic, Research and Integration."""

_PACKAGE = Path(__file__).resolve().parents[1]


def directory() -> Path:
    """Folder of the MJCF models: inside the wheel, or beside the package in a checkout."""
    installed = _PACKAGE / "models"
    return installed if installed.is_dir() else _PACKAGE.parent / "models"


def scenario_directory() -> Path:
    """Folder of the shipped scenarios: inside the wheel, or beside the package in a checkout."""
    installed = _PACKAGE / "scenarios"
    return installed if installed.is_dir() else _PACKAGE.parent / "scenarios"


def hexapod_path() -> Path:
    """The hexapod with its default cab."""
    return directory() / "cmf_hexapod.xml"


def single_legs_path() -> Path:
    """Six uncoupled legs, the report's original mechanics."""
    return directory() / "single_legs.xml"


def excavator_path() -> Path:
    """An excavator with boom, stick and bucket; no motors, see `attach_hydraulics`."""
    return directory() / "excavator.xml"


def excavator_hydraulics_path() -> Path:
    """The excavator's hydraulic parameters."""
    return directory() / "excavator_hydraulics.toml"


def excavator_laws_path() -> Path:
    """The excavator's control law."""
    return directory() / "excavator_laws.toml"


def excavator_cycle_path() -> Path:
    """A digging cycle: time [s] and cylinder lengths [m] as CSV with a header."""
    return directory() / "excavator_cycle.csv"


def cab_path(cab: str) -> Path:
    """The MJCF of one cab.

    Raises:
        InputError: the cab is not one of `CABS`.
    """
    return directory() / "cabs" / f"{check_name('cab', cab, CABS)}.xml"
