"""What takes long to make of compiled code, kept beside Numba's cache and never stale."""

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, cast

from cmf_mj.core.compiled import assign, digest
from cmf_mj.core.files import whole_file


def kept(name: str, of: Sequence[str], sources: Sequence[str], make: Callable[[], bytes]) -> bytes:
    """Bytes that `make` makes of the things `of` by these `sources` and all compiled code.

    Those of one name that other sources made are thrown away.
    """
    stamp, which = (
        hashlib.sha256("\0".join(texts).encode()).hexdigest()[:12]
        for texts in ([digest(), *sources], of)
    )
    folder = Path(cast("Any", assign).stats.cache_path)
    file = folder / f"{name}-{stamp}-{which}.o"
    if not file.is_file():
        made = make()
        for old in set(folder.glob(f"{name}-*.o")) - set(folder.glob(f"{name}-{stamp}-*.o")):
            old.unlink(missing_ok=True)
        with whole_file(file) as partial:
            partial.write_bytes(made)
    return file.read_bytes()
