"""Files that appear only when they are complete, and folders that one run alone writes to."""

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from cmf_mj.core.errors import InputError, reason
from cmf_mj.core.settings import DEVICE

try:
    import fcntl
except ImportError:  # Windows has no locks of folders
    fcntl = None  # type: ignore[assignment]


@contextmanager
def whole_file(target: Path) -> Iterator[Path]:
    """A place to write at, moved to `target` if nothing went wrong and removed if it did."""
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        yield partial
        os.replace(partial, target)
    finally:
        partial.unlink(missing_ok=True)


def plain_path(folder: Path, name: str) -> Path:
    """The path of a plain file name in a folder; refused where the name leads anywhere else."""
    is_plain = Path(name).name == name and not name.startswith(".") and name.isprintable()
    if not name or not is_plain or DEVICE.match(name):
        raise InputError(f"file: {name!r} is refused: must be a plain name, without a folder")
    return folder / name


def check_target(target: Path, field: str = "file", shown: Path | None = None) -> Path:
    """The target, if a file can be written there; nothing is written, its folder may be missing.

    A refusal names the `field`, and the path `shown`, such as the folder, or else the target.
    """
    try:
        folder = next(path for path in target.absolute().parents if os.path.exists(path))
        fault = "is a folder; allowed: a file" if target.is_dir() else ""
        if not (folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)):
            fault = f"{folder} is not a folder that can be written to"
    except (OSError, ValueError) as error:
        fault = reason(error)
    if fault:
        raise InputError(f"{field}: {str(shown or target)!r} is refused: {fault}")
    return target


@contextmanager
def exclusive_folder(folder: Path) -> Iterator[Path]:
    """A folder that this run alone writes to; made, and removed again if it stays empty.

    The lock is the system's and on the folder itself, so that it ends with the process however
    that ends. What a process that has ended left half-written is removed. A file system without
    locks gives none.
    """
    check_target(folder / "any", "out", folder)
    made: list[Path] = []
    lock: int | None = None
    try:
        try:
            for path in (*reversed(folder.parents), folder):
                if not os.path.exists(path):
                    with suppress(FileExistsError):  # another run was faster
                        path.mkdir()
                        made.append(path)
            if fcntl:
                lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            made.clear()
            fault = "another run writes to it; allowed: another folder, or to wait"
            raise InputError(f"out: {str(folder)!r} is refused: {fault}") from None
        except OSError as error:
            if lock is None:
                raise InputError(f"out: {str(folder)!r} is refused: {error.strerror}") from None
        try:
            _remove_partial_files(folder)
            yield folder
        finally:
            _remove_partial_files(folder)
    finally:
        with suppress(OSError):  # not empty
            for path in reversed(made):
                path.rmdir()
        if lock is not None:
            os.close(lock)


def _remove_partial_files(folder: Path) -> None:
    """Remove what this process and those that have ended began here and one folder below."""
    for partial in (*folder.glob(".*.part"), *folder.glob("*/.*.part")):
        _, process, _ = partial.name.rsplit(".", 2)
        if process.isdecimal() and not _is_another_process(int(process)):
            partial.unlink(missing_ok=True)


def _is_another_process(process: int) -> bool:
    """Whether another process may have this number; on Windows, where to ask ends it, all may."""
    try:
        if fcntl:
            os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # of another user, or no number of a process
        return True
    return process != os.getpid()


def write_text(target: Path, text: str) -> Path:
    """Write text in UTF-8."""
    with whole_file(target) as partial:
        partial.write_text(text, encoding="utf-8")
    return target


def write_json(target: Path, content: Mapping[str, Any]) -> Path:
    """Write a mapping as indented JSON; NaN is refused."""
    return write_text(target, json.dumps(content, indent=2, allow_nan=False) + "\n")
