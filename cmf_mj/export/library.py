"""`cmf export library` and `law`: a machine, or a law alone, in C that needs no Python.

The folder holds the library, its header, MuJoCo with its headers, the sources and object files to
build it again, an example, and the licences. The library depends on MuJoCo and the C library alone.
"""

import os
import platform
import shutil
import subprocess
from collections.abc import Sequence
from importlib.metadata import distribution
from pathlib import Path

import mujoco

from cmf_mj.analysis.modes import bound
from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import InputError, RunError
from cmf_mj.core.files import check_target, write_text
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.export.header import contents
from cmf_mj.export.law_source import law_source
from cmf_mj.export.machine import Export, make_export
from cmf_mj.export.machine_code import constant_data
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.plant.plant import Plant

_SOURCES = Path(__file__).with_name("c")  #: What is the same in every export.

Files = dict[str, bytes | str | Path]
"""Files of an export by their names: content, or the file or folder to copy."""


def export_library(
    plant: Plant,
    law: str | Path | Law | None,
    out: Path,
    *,
    electronics: ElectronicsSettings | None = None,
) -> list[Path]:
    """Write a machine as a C library into a folder and build it; the files written.

    The plant is a `Hexapod`, `SingleLegs`, or any of `attach_hydraulics`; without a law the valves
    are commanded; `electronics` are ideal by default. Raises `InputError` where there is no C
    compiler or the law does not fit the plant, `RunError` where the compiler refuses the code.
    """
    export = make_export(plant, None if law is None else load_law(law, plant.machine), electronics)
    return build(machine_files(export), out, "libcmf.so", ["cmf.c"])


def machine_files(export: Export) -> Files:
    """All that a machine's library is built of."""
    blocks, header = contents(export)
    rate = str(export.plant.machine.rate)
    code: Files = {f"{name}.o": code for name, code in export.objects().items()}
    machine: Files = {"cmf_data.o": constant_data(blocks), "cmf_machine.h": header}
    machine["cmf.h"] = (_SOURCES / "library" / "cmf.h").read_text("utf-8").replace("2048", rate)
    mujoco_folder = Path(mujoco.__file__).parent
    library = next(mujoco_folder.glob("libmujoco.so.*"))
    machine |= {library.name: library, "include": mujoco_folder / "include"}
    return sources("library") | code | machine | licences("mujoco", "cmf-mj")


def sources(kind: str) -> Files:
    """What is the same in every export of a kind."""
    return {path.name: path for path in sorted((_SOURCES / kind).iterdir())}


def licences(*packages: str) -> Files:
    """The licences of packages that travel along, named after them."""
    return {
        f"licences/{package}_{file.name}": Path(str(file.locate()))
        for package in packages
        for file in distribution(package).files or ()
        if "licenses" in file.parts
    }


def build(files: Files, out: Path, library: str, arguments: Sequence[str]) -> list[Path]:
    """Write files into a folder, and build a shared library of all objects and some sources there.

    The compiler's `arguments` name the sources. Returns the files written, the library last.
    Nothing is written where there is no C compiler.
    """
    compiler = _compiler()
    paths = write_files(files, out)
    command = [compiler, "-std=c99", "-O2", "-fPIC", "-fvisibility=hidden", "-ffp-contract=off"]
    command += ["-shared", "-s", "-isystem", "include", *arguments]
    command += sorted(name for name in files if name.endswith(".o"))
    command += ["-Wl,-z,defs,-z,text,-z,now", "-Wl,-rpath,$ORIGIN", "-lm"]
    command += [path.name for path in out.glob("libmujoco.so.*")] + ["-o", library]
    run = subprocess.run(command, cwd=out, capture_output=True, text=True)
    if run.returncode:
        raise RunError(f"cc: {run.stderr.strip()[:1000]}")
    return [*paths, out / library]


def write_files(files: Files, out: Path) -> list[Path]:
    """Write or copy files into a folder; the paths, folders left out."""
    check_target(out / "any", "out", out)
    for name, content in files.items():
        path = out / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if isinstance(content, bytes):
            path.write_bytes(content)
        elif isinstance(content, str):
            write_text(path, content)
        elif content.is_dir():
            shutil.copytree(content, path, dirs_exist_ok=True)
        else:
            shutil.copy(content, path)
    return [out / name for name in files if not (out / name).is_dir()]


def _compiler() -> str:
    """The C compiler of a system that exports are made for."""
    system = f"{platform.system()} {platform.machine()}"
    if system != "Linux x86_64":
        raise InputError(f"system: {system} has no exports; allowed: Linux x86_64")
    compiler = shutil.which(os.environ.get("CC", "cc"))
    if compiler is None:
        raise InputError("cc: there is no C compiler; install one, such as gcc, or set CC")
    return compiler


def export_law(law: str | Path | Law, out: Path, cab: str | Path | Cab | None = None) -> list[Path]:
    """Write a law as C into a folder; the files written.

    A law in hydraulic modes is bound to the cab, by default the CMF's first; stroke and piston area
    are those of the cab's machine. It is C99 for any processor, and is not compiled here. Raises
    `InputError` where there is no such law or cab.
    """
    assumed_cab = load_cab(cab).assumed
    bound_law = bound(load_law(law), assumed_cab)
    source = law_source(bound_law, f"{assumed_cab.machine.title}, cab {assumed_cab.name}")
    return write_files(sources("source") | source | licences("cmf-mj"), out)
