"""Laws as TOML text, with where their numbers come from."""

from collections.abc import Iterable
from pathlib import Path

from cmf_mj.control.coordinates import Modes
from cmf_mj.control.law import Law
from cmf_mj.core.files import write_text


def law_text(law: Law) -> str:
    """A law as the tables of a law file; `load_law` reads the same law back."""
    table = law.model_dump(mode="json", exclude_defaults=True, exclude={"name", "modes"})
    lines = [f"[{law.name}]"]
    nested = {key: value for key, value in table.items() if isinstance(value, dict)}
    lines += [f"{key} = {_value(value)}" for key, value in table.items() if key not in nested]
    for key, inner in nested.items():
        lines += ["", f"[{law.name}.{key}]", *(f"{k} = {_value(v)}" for k, v in inner.items())]
    for cab, modes in law.modes.items():
        lines += ["", f"[{law.name}.modes.{cab}]", *_modes(modes)]
    return "\n".join(lines) + "\n"


def _modes(modes: Modes) -> Iterable[str]:
    """Frequencies and masses to six digits, shapes to twelve: they have to be orthonormal."""
    yield f"source = {_value(modes.source)}"
    for name in ("frequency", "mass"):
        yield f"{name} = [{', '.join(f'{value:.6g}' for value in getattr(modes, name))}]"
    yield "shape = ["
    for row in modes.shape:
        yield f"  [{', '.join(f'{value + 0.0:.12f}' for value in row)}],"
    yield "]"


def _value(value: object) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, list):
        return f"[{', '.join(_value(v) for v in value)}]"
    return repr(value)


def save_law(law: Law, path: str | Path, heading: str = "") -> Path:
    """Write a law file whole or not at all.

    `heading` becomes comment lines above.
    """
    comment = "".join(f"# {line}".rstrip() + "\n" for line in heading.splitlines())
    return write_text(Path(path), comment + law_text(law))
