"""Reading settings files: TOML in, validated immutable models out, one clear error if not."""

import json
import os
import re
import sys
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Generic, NamedTuple, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PlainValidator,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from cmf_mj.core.errors import InputError, reason, similar, unknown_name
from cmf_mj.core.units import LONGEST

LARGEST = 1e20
"""Largest number of a settings file: above any of a machine in any unit; its cube is a number."""

_SMALLEST = sys.float_info.min
_LARGEST_WHOLE = 2**53  #: Whole numbers to here are exact as a double.

Time = Annotated[float, Field(ge=0.0, le=LONGEST)]
"""A time in a run [s], at most that of the longest."""

Count = Annotated[int, Field(ge=1, lt=2**31)]
"""A number of frames, cycles or legs, at least 1 and in 32 bits."""

Seed = Annotated[int, Field(ge=0)]  #: Seed of a random generator.


def in_range(value: Any) -> Any:
    """The value, if its numbers, those in lists and tables too, can be computed with.

    Refused are sizes above `LARGEST`, subnormal ones and whole numbers that a double cannot hold.
    Arrays, sets and whole numbers of NumPy are not checked; strict fields have none.
    """
    if isinstance(value, Mapping):
        in_range(tuple(value.values()))
    elif isinstance(value, list | tuple):
        for entry in value:
            in_range(entry)
    elif isinstance(value, float) and not (value == 0.0 or _SMALLEST <= abs(value) <= LARGEST):
        raise InputError(f"a number must be 0 or {_SMALLEST:.3g} to {LARGEST:.3g} in size")
    elif isinstance(value, int) and abs(value) > _LARGEST_WHOLE:
        raise InputError(f"a whole number must be at most {_LARGEST_WHOLE} in size")
    return value


_UNKNOWN_FIELD = "unknown_field"  #: Kind of error of a key that a table may not have.


class Settings(BaseModel):
    """A table of a settings file: immutable, no unknown keys, numbers `in_range`."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)

    @field_validator("*")
    @classmethod
    def _numbers(cls, value: Any) -> Any:
        return in_range(value)

    @model_validator(mode="before")
    @classmethod
    def _no_other_keys(cls, table: Any) -> Any:
        accepted_keys: set[str] = set()
        public_keys: list[str] = []
        for name, field in cls.model_fields.items():
            public_keys += [] if field.exclude else [field.serialization_alias or name]
            accepted_keys |= {name, *getattr(field.validation_alias, "choices", ())}
        others = table.keys() - accepted_keys if isinstance(table, Mapping) else ()
        if others and cls.model_config["extra"] == "forbid":
            allowed = f"is not a known field; allowed: {', '.join(sorted(public_keys))}"
            keys = sorted(others, key=str)
            faults = "\n".join(f"{key}: {allowed}{similar(key, public_keys)}" for key in keys)
            raise PydanticCustomError(_UNKNOWN_FIELD, "{faults}", {"faults": faults})
        return table


def name_or(*loaded: type) -> PlainValidator:
    """Validator of a field that takes a name or file of settings, or an instance of `loaded`."""
    classes = "".join(f", or {kind.__name__} as its `load_` function makes it" for kind in loaded)

    def check(value: Any) -> Any:
        if isinstance(value, (str, Path, *loaded)):
            return value
        kind = type(value).__name__
        raise InputError(f"a {kind} is refused; allowed: a name, a TOML file{classes}")

    return PlainValidator(check, json_schema_input_type=str)


class FileHeader(Settings):
    """What a file of this project says of its content: results, whose numbers may be any."""

    @field_validator("*")
    @classmethod
    def _numbers(cls, value: Any) -> Any:
        return value


Model = TypeVar("Model", bound=Settings)

DEVICE = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\.|$)", re.IGNORECASE)
"""Names that are devices in Windows, whatever their ending."""

_NAME = re.compile(r"[A-Za-z0-9_](?:[A-Za-z0-9_ .,+-]{0,62}[A-Za-z0-9_+-])?")


def checked_name(name: str, field: str = "") -> str:
    """The name of a law, cab, set, machine or study, if it fits files, tables and commands.

    Five of them and an ending fit into one file name, and none leaves a folder.
    """
    if not _NAME.fullmatch(name) or DEVICE.match(name):
        start = f"{field}: {name!r} is refused: " if field else ""
        raise InputError(
            f"{start}a name has 1 to 64 of the characters a-z, A-Z, 0-9, space and _ - + . , and "
            "begins with a letter, digit or _ and does not end with a space, full stop or comma; "
            "con, prn, aux, nul, com1 and lpt1 are names of devices"
        )
    return name


def check_distinct(field: str, names: Sequence[str]) -> None:
    """Refuse names that cannot stand beside one another on a disk that ignores capitals."""
    folded = [name.casefold() for name in names]
    alike = ", ".join(name for name in names if folded.count(name.casefold()) > 1)
    if alike:
        raise InputError(
            f"{field}: {alike} must differ in name, not in capitals alone; one of a file can get "
            "another name there"
        )


Name = Annotated[str, AfterValidator(checked_name)]  #: What `checked_name` accepts.


def as_tuples(value: Any) -> Any:
    """TOML's lists as tuples, down to the numbers."""
    return tuple(map(as_tuples, value)) if isinstance(value, list | tuple) else value


def check_file(path: Path) -> Path:
    """The path, if it is that of a file; a pipe, which would be waited for, is none."""
    if "\0" in str(path):
        raise InputError(f"{str(path)!r}: cannot be read: no name has a null character")
    if not os.path.isfile(path):
        exists = os.path.exists(path)
        fault = "it is a folder or a device, not a file" if exists else "there is no such file"
        raise InputError(f"{path}: cannot be read: {fault}")
    return path


def beside(folder: Path, name: str | None) -> Any:
    """The path of a TOML file, or `FILE.toml:law`, from a folder; any other name as it is."""
    return folder / name if name and re.search(r"\.toml(:[^:/]*)?$", name) else name


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file."""
    check_file(path)
    try:
        return parsed_toml(path.read_text(encoding="utf-8"), str(path))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not valid TOML: {reason(error)}") from error


_MAX_LEVELS = 16  #: Levels of tables and lists allowed in a file, itself the first.
_MAX_CHARACTERS = 200  #: Characters that errors show of a refused value.
_MAX_FAULTS = 10  #: Faults that an error shows.


def parsed_toml(text: str, where: str) -> dict[str, Any]:
    """The tables of a TOML text, called `where` in errors."""
    try:
        table = tomllib.loads(text.removeprefix("\ufeff"))
    except RecursionError:
        raise _too_deep(where) from None
    except ValueError as error:  # also a number with more digits than Python reads
        raise InputError(f"{where}: is not valid TOML: {reason(error)}") from error
    return _check_depth(table, where)


def parsed_json(text: str | bytes, where: str) -> Any:
    """What a JSON text says, called `where` in errors."""
    try:
        content = json.loads(text)
    except RecursionError:
        raise _too_deep(where) from None
    except ValueError as error:
        raise InputError(f"{where}: is not valid JSON: {reason(error)}") from error
    return _check_depth(content, where)


def _check_depth(content: Any, where: str) -> Any:
    """The content, if nothing that walks through it can run out of stack."""
    level = [content] if isinstance(content, dict | list) else []
    for _ in range(_MAX_LEVELS):
        entries = [table.values() if isinstance(table, dict) else table for table in level]
        level = [entry for row in entries for entry in row if isinstance(entry, dict | list)]
        if not level:
            return content
    raise _too_deep(where)


def _too_deep(where: str) -> InputError:
    fault = "tables and lists are nested too deep"
    return InputError(f"{where}: {fault}; allowed: {_MAX_LEVELS} levels")


def validated(model: type[Model], table: object, where: str) -> Model:
    """Build `model` from a table that errors call `where`; refusals have one line per fault."""
    try:
        return model.model_validate(table)
    except ValidationError as error:
        raise _refusal(error, where) from None


def _refusal(error: ValidationError, where: str) -> InputError:
    faults = [line for fault in error.errors() for line in _fault_lines(fault, where)]
    rest = len(faults) - _MAX_FAULTS
    more = [f"{where}: and {rest} more"] if rest > 0 else []
    return InputError("\n".join(faults[:_MAX_FAULTS] + more))


class Arguments(Settings):
    """Settings that a program makes by their fields; what is refused is an `InputError`."""

    def __init__(self, **fields: Any) -> None:
        """Check the fields."""
        try:
            super().__init__(**fields)
        except ValidationError as error:
            lines = str(_refusal(error, "")).splitlines()
            raise InputError("\n".join(line.removeprefix(": ") for line in lines)) from None


def merged(
    base: Mapping[str, Any], changes: Mapping[str, Any], levels: float = float("inf")
) -> dict[str, Any]:
    """A table with the entries of another in their place.

    Two tables of one name are merged down to so many levels below these; deeper ones are replaced
    whole.
    """
    table = dict(base)
    for name, change in changes.items():
        entry = table.get(name)
        if levels > 0 and isinstance(entry, Mapping) and isinstance(change, Mapping):
            table[name] = merged(entry, change, levels - 1)
        else:
            table[name] = change
    return table


Fitting = Callable[[dict[str, Any]], dict[str, Any]]
"""A function from the shipped table, which is for the CMF, to that of another machine."""


class UserSet(NamedTuple):
    """The one table of a user's file."""

    base: str  #: Shipped set that it changes; empty where files have none.
    name: str  #: Name of the table.
    changes: dict[str, Any]
    where: str  #: What errors call it.


def user_set(
    what: str,
    names: Sequence[str],
    source: str | Path,
    *,
    fixed: Sequence[str] = (),
    based: bool = True,
) -> UserSet:
    """Read the table of a user's set; arguments as of `Loader`."""
    path = user_file(what, names, source)
    content = read_toml(path)
    base = content.pop("base", None) if based else ""
    if based and base not in names:
        raise unknown_name(f"{path}: base", base, names)
    if len(content) != 1 or not isinstance(next(iter(content.values())), dict):
        raise InputError(f"{path}: has the entries {sorted(content)}; exactly one table is allowed")
    ((name, changes),) = content.items()
    checked_name(name, f"{path}: name of the table")
    for field in ("name", *fixed):
        if field in changes:
            origin = "the table" if field == "name" else "the base"
            raise InputError(f"{path}: {name}: {field}: is taken from {origin}; leave it out")
    return UserSet(str(base), name, changes, f"{path}: {name}")


@dataclass(frozen=True)
class Loader(Generic[Model]):
    """Loads the settings of a shipped file, called as `load(source)`.

    The file is one table, or a table a shipped set beside `[common]`, whose entries every set has.
    A user's file holds the changed entries of the one table; or the name of a shipped set, `base`,
    and one table with the changes, named after the new set.
    """

    model: type[Model]  #: Settings class.
    shipped: Path  #: File of the package that holds every entry.
    levels: int = 1  #: Levels down to which tables are merged, as for `merged`.
    what: str = ""  #: How the settings are called in errors; checks the name of the user's file.
    names: tuple[str, ...] = ()  #: Shipped sets; none where the whole file is one, `default`.
    default: str = "default"  #: What is loaded without a source.
    based: bool = True  #: Whether a user's set has a `base`; else it holds every entry.
    fixed: tuple[str, ...] = ()  #: What a user's set may not change.

    def __call__(
        self, source: str | Path | Model | None = None, fitted: Fitting | None = None
    ) -> Model:
        """Load `source`: a shipped set by name, a user's TOML file, or what is loaded already.

        Shipped numbers are `fitted` to a machine first; those of a file stay as they are.
        """
        if isinstance(source, self.model):
            return source
        origin = self.default if source is None else str(source)
        if fitted is None and origin in (self.names or (self.default,)):
            return _cached_shipped(self, origin)
        settings = validated(self.model, *self.table(origin, fitted))
        name = getattr(settings, "name", "")
        is_user_file = origin not in self.names
        if is_user_file and name in self.names and settings != _cached_shipped(self, name):
            fault = f"{name!r} is the name of a shipped set; another one needs another name"
            raise InputError(f"{origin}: {fault}")
        return settings

    def table(
        self, source: str | Path, fitted: Fitting | None = None
    ) -> tuple[dict[str, Any], str]:
        """The table of a shipped set, with its `name`, or a user's, and what errors call it."""
        origin, shipped = str(source), read_toml(self.shipped)
        shipped = shipped if fitted is None else fitted(shipped)
        if not self.names:
            if origin == self.default:
                return shipped, self.shipped.name
            if self.what:
                user_file(self.what, (self.default,), origin)
            return merged(shipped, read_toml(Path(origin)), self.levels), origin
        sets = {name: shipped.get("common", {}) | shipped[name] for name in self.names}
        if origin in sets:
            return sets[origin] | {"name": origin}, f"{self.shipped.name}: {origin}"
        user = user_set(self.what, self.names, origin, fixed=self.fixed, based=self.based)
        base = sets[user.base] if self.based else {}
        return merged(base, user.changes, self.levels) | {"name": user.name}, user.where


@cache
def _cached_shipped(loader: Loader[Model], name: str) -> Model:
    """A shipped set, read once: settings are not to be changed."""
    return validated(loader.model, *loader.table(name))


def user_file(what: str, names: Sequence[str], source: str | Path) -> Path:
    """The path of the user's TOML file that a source is; it is none of the shipped `names`."""
    path = Path(source)
    if path.suffix != ".toml":
        raise unknown_name(what, str(source), names, " nor a .toml file")
    return path


_NO_KEY = re.compile(r"[a-z-]*\[.*|constrained-(str|int|float)$")
"""Parts of pydantic's locations that are no keys of the file: alternatives of a union, and keys."""


def _fault_lines(error: Any, where: str) -> list[str]:
    """Lines of a refusal from one of pydantic's errors."""
    location = [part for part in map(str, error["loc"]) if not _NO_KEY.match(part)]
    field, message = ".".join(location), error["msg"].removeprefix("Value error, ")
    allowed = message[0].lower() + message[1:]
    if error["type"] == _UNKNOWN_FIELD:
        return [f"{where}: {'.'.join([*location, line])}" for line in message.splitlines()]
    if not field:
        return [f"{where}: {line}" for line in message.splitlines()]
    if error["type"] == "missing":
        return [f"{where}: {field}: is missing"]
    if error["type"] == "value_error" and isinstance(error["input"], Mapping):
        return [f"{where}: {field}: {line}" for line in message.splitlines()]
    text = repr(error["input"])
    value = text if len(text) <= _MAX_CHARACTERS else f"{text[:_MAX_CHARACTERS]}..."
    return [f"{where}: {field}: {value} is refused: {allowed}"]
