"""Reading settings files: TOML in, validated immutable models out, one clear error if not."""

import tomllib
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError


class Settings(BaseModel):
    """A table of a settings file: immutable, no unknown keys, no infinities or NaN."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


Model = TypeVar("Model", bound=Settings)


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        ValueError: the file is missing or is not TOML; the message gives line and column.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: is not valid TOML: {error}") from error


def validated(model: type[Model], table: object, where: str) -> Model:
    """Build `model` from a table of a file.

    Args:
        model: the settings class.
        table: what the file holds there.
        where: how the table is called in errors, e.g. `my.toml: stiff`.

    Raises:
        ValueError: one line per fault, each naming field, value and what is allowed.
    """
    try:
        return model.model_validate(table)
    except ValidationError as error:
        raise ValueError("\n".join(_explain(model, e, where) for e in error.errors())) from None


def overlaid(model: type[Model], shipped: Path, source: Path | None) -> Model:
    """Build `model` from the shipped file, with the entries of a user's file in their place.

    Tables are merged one level deep: an entry `key` of a user's table replaces that of the shipped
    table of the same name and leaves its other entries.

    Args:
        model: the settings class.
        shipped: file of the package that holds every entry.
        source: file that repeats what it changes; None for the shipped values.

    Raises:
        ValueError: a file cannot be read, or one line per refused field.
    """
    table = read_toml(shipped)
    if source is None:
        return validated(model, table, shipped.name)
    return validated(model, laid_over(table, read_toml(source)), str(source))


def laid_over(table: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """A table with the entries of another in their place, tables merged one level deep."""
    found = dict(table)
    for name, change in changes.items():
        before = table.get(name)
        merge = isinstance(before, dict) and isinstance(change, dict)
        found[name] = before | change if merge else change
    return found


def _explain(model: type[BaseModel], error: Any, where: str) -> str:
    # Names pydantic gives to the alternatives of a union are no keys of the file.
    location = [str(part) for part in error["loc"] if not set("[(-") & set(str(part))]
    field = ".".join(location)
    message = error["msg"].removeprefix("Value error, ")
    allowed = message[0].lower() + message[1:]
    if not field:
        return f"{where}: {message}"
    if error["type"] == "extra_forbidden":
        names = _field_names(model, location[:-1])
        return f"{where}: {field}: is not a known field; allowed: {', '.join(names)}"
    if error["type"] == "missing":
        return f"{where}: {field}: is missing"
    return f"{where}: {field}: {error['input']!r} is refused: {allowed}"


def _field_names(model: type[BaseModel], path: list[str]) -> list[str]:
    for part in path:
        if part in model.model_fields:
            within = _models_in(model.model_fields[part].annotation)
            tags = {tag: one for one in within for tag in _tags(one)}
            model = within[0] if len(within) == 1 else model
        elif part in tags:
            model = tags[part]
    return sorted(field.alias or name for name, field in model.model_fields.items())


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    """Settings classes in an annotation: itself, of a list's elements, or of a union."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models_in(part)]


def _tags(model: type[BaseModel]) -> tuple[Any, ...]:
    """Values of `kind` that tell a class from the others of its union."""
    kind = model.model_fields.get("kind")
    return () if kind is None else get_args(kind.annotation)
