"""Ground for all rooms: units, settings, files, filters, the compiler; and where caches go.

Numba keeps compiled code next to the sources, matplotlib its list of fonts in the user's folders.
A package that its user may not write to has its compiled code in the user's cache folder, and a
user without one has both in a folder of his own below the system's for temporary files. Who sets
NUMBA_CACHE_DIR or MPLCONFIGDIR has chosen.
"""

import os
import sys
import tempfile
from pathlib import Path

_NUMBA_VARIABLE, _MATPLOTLIB_VARIABLE = "NUMBA_CACHE_DIR", "MPLCONFIGDIR"


def _is_writable(folder: Path) -> bool:
    """Whether a folder can be written to, or made."""
    existing = next((path for path in (folder, *folder.parents) if os.path.exists(path)), folder)
    return folder.is_absolute() and existing.is_dir() and os.access(existing, os.W_OK | os.X_OK)


def _private_folder() -> Path:
    """A folder that only this user can write to: compiled code is run as it stands there."""
    if not hasattr(os, "getuid"):
        return Path(tempfile.gettempdir()) / "cmf-mj"
    folder = Path(tempfile.gettempdir()) / f"cmf-mj-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    is_private = status.st_uid == os.getuid() and not status.st_mode & 0o077
    return folder if is_private and not folder.is_symlink() else Path(tempfile.mkdtemp("cmf-mj"))


def place_caches() -> None:
    """Set the variables of the caches that have to go elsewhere, before their owners look."""
    package = Path(__file__).parents[1]
    home = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    config = Path(os.environ.get("XDG_CONFIG_HOME") or os.path.expanduser("~/.config"))
    has_home = _is_writable(home) and _is_writable(config / "matplotlib")
    if not has_home and _MATPLOTLIB_VARIABLE not in os.environ:
        os.environ[_MATPLOTLIB_VARIABLE] = str(_private_folder() / "matplotlib")
    if _NUMBA_VARIABLE not in os.environ and not _is_writable(package / "core" / "__pycache__"):
        cache = (home / "cmf-mj" if has_home else _private_folder()) / "numba"
        os.environ[_NUMBA_VARIABLE] = str(cache)
        if not cache.exists():
            place = f"{cache}, for {package} cannot be written to"
            print(f"cmf: compiled code is kept in {place}", file=sys.stderr)


place_caches()
