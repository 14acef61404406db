"""`cmf export library`: a machine as a C library that needs no Python.

The folder holds the library, its header, MuJoCo with its headers, the sources and object files to
build it again, an example, and the licences. The library depends on MuJoCo and the C library alone.
"""

import os
import platform
import shutil
import subprocess
from collections.abc import Iterable
from importlib.metadata import distribution
from pathlib import Path

import mujoco

from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import InputError, RunError
from cmf_mj.core.files import write_text
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.export.header import contents
from cmf_mj.export.machine import Frozen, freeze
from cmf_mj.export.machine_code import constant_data
from cmf_mj.plant.plant import Plant

_SOURCES = Path(__file__).with_name("c")
"""What is the same in every export."""


def export_library(
    plant: Plant,
    law: str | Path | Law | None,
    out: Path,
    *,
    electronics: ElectronicsSettings | None = None,
    protection: bool = True,
) -> list[Path]:
    """Write a machine as a C library into a folder and build it; the files written.

    Args:
        plant: `Hexapod`, `SingleLegs`, or any plant of `attach_hydraulics`.
        law: by name, TOML file or loaded; None to command the valves.
        out: folder.
        electronics: sensors, converters and servo electronics; default ideal.
        protection: whether detected faults make an emergency stop; a parameter, and this its start.

    Raises:
        InputError: there is no C compiler, or the law does not fit the plant.
        RunError: the compiler refuses the code.
    """
    loaded = None if law is None else load_law(law)
    frozen = freeze(plant, loaded, electronics, protection)
    files = [*copy_sources("library", out), *write_machine(frozen, out), *copy_mujoco(out)]
    library = out / "libcmf.so"
    build(out, library, ["cmf.c"], [name for name in os.listdir(out) if name.endswith(".o")])
    return [*files, library]


def copy_sources(kind: str, out: Path) -> list[Path]:
    """Copy what is the same in every export of a kind; first of all, nothing lies there before."""
    _compiler()
    out.mkdir(parents=True, exist_ok=True)
    return [Path(shutil.copy(path, out)) for path in sorted((_SOURCES / kind).iterdir())]


def write_machine(frozen: Frozen, out: Path) -> list[Path]:
    """Write header and object files of a machine."""
    blocks, header = contents(frozen)
    files = []
    objects = frozen.objects() | {"cmf_data": constant_data(blocks)}
    for name, code in objects.items():
        files.append(out / f"{name}.o")
        files[-1].write_bytes(code)
    files.append(write_text(out / "cmf_machine.h", header))
    return files


def copy_mujoco(out: Path) -> list[Path]:
    """Copy MuJoCo's library and headers, with the licences."""
    home = Path(mujoco.__file__).parent
    library = next(home.glob("libmujoco.so.*"))
    shutil.copytree(home / "include", out / "include", dirs_exist_ok=True)
    return [Path(shutil.copy(library, out)), *copy_licences(out, ["mujoco", "cmf-mj"])]


def copy_licences(out: Path, packages: Iterable[str]) -> list[Path]:
    """Copy the licences of packages that travel along, named after them."""
    licences = out / "licences"
    licences.mkdir(exist_ok=True)
    return [
        Path(shutil.copy(file.locate(), licences / f"{package}_{file.name}"))
        for package in packages
        for file in distribution(package).files or ()
        if "licenses" in file.parts
    ]


def build(folder: Path, library: Path, sources: list[str], objects: Iterable[str]) -> None:
    """Build a shared library of C sources and object files in their folder."""
    command = [_compiler(), "-std=c99", "-O2", "-fPIC", "-fvisibility=hidden", "-ffp-contract=off"]
    command += [
        "-shared",
        "-isystem",
        "include",
        *sources,
        *sorted(objects),
        "-o",
        library.name,
        "-s",
    ]
    command += ["-Wl,-z,defs,-z,text,-z,now", "-Wl,-rpath,$ORIGIN", "-lm"]
    command += [path.name for path in folder.glob("libmujoco.so.*")] + ["-o", library.name]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if run.returncode:
        raise RunError(f"cc: {run.stderr.strip()[:1000]}")


def _compiler() -> str:
    """The C compiler of a system that exports are made for."""
    system = f"{platform.system()} {platform.machine()}"
    if system != "Linux x86_64":
        raise InputError(f"system: {system} has no exports; allowed: Linux x86_64")
    compiler = shutil.which(os.environ.get("CC", "cc"))
    if compiler is None:
        raise InputError("cc: there is no C compiler; install one, such as gcc, or set CC")
    return compiler
