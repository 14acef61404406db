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
"""Largest number of a settings file: none of a machine in any unit of the field is beyond, and its
square and cube are still numbers."""

_SMALLEST = sys.float_info.min
_MOST = 2**53  #: Whole numbers to here are exact as a double.

Time = Annotated[float, Field(ge=0.0, le=LONGEST)]
"""A time in a run [s], at most that of the longest."""

Count = Annotated[int, Field(ge=1, lt=2**31)]
"""A number of frames, cycles or legs, at least 1 and in 32 bits."""

Seed = Annotated[int, Field(ge=0)]  #: Seed of a random generator.


def in_range(value: Any) -> Any:
    """A value whose numbers, those in lists and tables too, can be computed with.

    Refused are sizes above `LARGEST`, subnormal ones and whole numbers that a double cannot hold.
    Arrays, sets and whole numbers of NumPy pass unseen; strict fields have none.
    """
    if isinstance(value, Mapping):
        in_range(tuple(value.values()))
    elif isinstance(value, list | tuple):
        for one in value:
            in_range(one)
    elif isinstance(value, float) and not (value == 0.0 or _SMALLEST <= abs(value) <= LARGEST):
        raise InputError(f"a number must be 0 or {_SMALLEST:.3g} to {LARGEST:.3g} in size")
    elif isinstance(value, int) and abs(value) > _MOST:
        raise InputError(f"a whole number must be at most {_MOST} in size")
    return value


_UNKNOWN = "unknown_field"  #: Kind of the error of a key that a table has not.


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
        taken: set[str] = set()
        named: list[str] = []
        for name, field in cls.model_fields.items():
            named += [] if field.exclude else [field.serialization_alias or name]
            taken |= {name, *getattr(field.validation_alias, "choices", ())}
        others = table.keys() - taken if isinstance(table, Mapping) else ()
        if others and cls.model_config["extra"] == "forbid":
            allowed = f"is not a known field; allowed: {', '.join(sorted(named))}"
            said = [f"{key}: {allowed}{similar(key, named)}" for key in sorted(others, key=str)]
            raise PydanticCustomError(_UNKNOWN, "{said}", {"said": "\n".join(said)})
        return table


def name_or(*loaded: type) -> PlainValidator:
    """Validator of a field that takes a name or file of settings, or what is `loaded` already."""
    loaded_ones = "".join(f", or {one.__name__} as its `load_` function makes it" for one in loaded)

    def check(value: Any) -> Any:
        if not isinstance(value, (str, Path, *loaded)):
            kind = type(value).__name__
            raise InputError(f"a {kind} is refused; allowed: a name, a TOML file{loaded_ones}")
        return value

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
    """A name of a law, cab, set, machine or study, fit for files, tables and commands.

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
    same = [name for name in names if folded.count(name.casefold()) > 1]
    if same:
        raise InputError(
            f"{field}: {', '.join(same)} must differ in name, not in capitals alone; one of a file "
            "can get another name there"
        )


Name = Annotated[str, AfterValidator(checked_name)]  #: What `checked_name` accepts.


def as_tuples(value: Any) -> Any:
    """TOML's lists as tuples, down to the numbers."""
    return tuple(as_tuples(v) for v in value) if isinstance(value, list | tuple) else value


def check_file(path: Path) -> Path:
    """Refuse what is no file: nothing, a folder, or a pipe, which would be waited for."""
    if "\0" in str(path):
        raise InputError(f"{str(path)!r}: cannot be read: no name has a null character")
    if not os.path.isfile(path):
        there = "it is a folder or a device, not a file"
        fault = there if os.path.exists(path) else "there is no such file"
        raise InputError(f"{path}: cannot be read: {fault}")
    return path


def beside(folder: Path, name: str | None) -> Any:
    """A TOML file, or `FILE.toml:law`, which counts from a folder; any other name as it is."""
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


_LEVELS = 16  #: Levels of tables and lists allowed in a file, itself the first.
_SHOWN = 200  #: Characters that errors show of a refused value.
_FAULTS = 10  #: Faults that an error shows.


def parsed_toml(text: str, where: str) -> dict[str, Any]:
    """The tables of a TOML text, called `where` in errors."""
    try:
        table = tomllib.loads(text.removeprefix("\ufeff"))
    except RecursionError:
        raise _too_deep(where) from None
    except ValueError as error:  # also a number with more digits than Python reads
        raise InputError(f"{where}: is not valid TOML: {reason(error)}") from error
    return _shallow(table, where)


def parsed_json(text: str | bytes, where: str) -> Any:
    """What a JSON text says, called `where` in errors."""
    try:
        content = json.loads(text)
    except RecursionError:
        raise _too_deep(where) from None
    except ValueError as error:
        raise InputError(f"{where}: is not valid JSON: {reason(error)}") from error
    return _shallow(content, where)


def _shallow(content: Any, where: str) -> Any:
    """The same, if nothing that walks through it can run out of stack."""
    layer = [content] if isinstance(content, dict | list) else []
    for _ in range(_LEVELS):
        nested = [v.values() if isinstance(v, dict) else v for v in layer]
        layer = [v for values in nested for v in values if isinstance(v, dict | list)]
        if not layer:
            return content
    raise _too_deep(where)


def _too_deep(where: str) -> InputError:
    return InputError(f"{where}: tables and lists are nested too deep; allowed: {_LEVELS} levels")


def validated(model: type[Model], table: object, where: str) -> Model:
    """Build `model` from a table that errors call `where`; refusals have one line per fault."""
    try:
        return model.model_validate(table)
    except ValidationError as error:
        raise _refusal(error, where) from None


def _refusal(error: ValidationError, where: str) -> InputError:
    said = [line for e in error.errors() for line in _explain(e, where)]
    more = [f"{where}: and {len(said) - _FAULTS} more"] if len(said) > _FAULTS else []
    return InputError("\n".join(said[:_FAULTS] + more))


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
        before = table.get(name)
        if levels > 0 and isinstance(before, Mapping) and isinstance(change, Mapping):
            table[name] = merged(before, change, levels - 1)
        else:
            table[name] = change
    return table


Fitting = Callable[[dict[str, Any]], dict[str, Any]]
"""What makes the shipped table, which is for the CMF, that of another machine."""


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
    name, changes = next(iter(content.items()))
    checked_name(name, f"{path}: name of the table")
    for field in ("name", *fixed):
        if field in changes:
            origin = "the table" if field == "name" else "the base"
            raise InputError(f"{path}: {name}: {field}: is taken from {origin}; leave it out")
    return UserSet(str(base), name, changes, f"{path}: {name}")


@dataclass(frozen=True)
class Loader(Generic[Model]):
    """Loads the settings of a shipped file, called as `load(source)`.

    The file is one table, or has shipped sets: a table each, beside `[common]`, whose entries all
    have. A user's file repeats what it changes of the whole; or names a shipped set as `base` and
    holds one table, named after the new set, with what that changes.
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
        chosen = self.default if source is None else str(source)
        if fitted is None and chosen in (self.names or (self.default,)):
            return _cached_shipped(self, chosen)
        made = validated(self.model, *self.table(chosen, fitted))
        name = getattr(made, "name", "")
        if chosen not in self.names and name in self.names and made != _cached_shipped(self, name):
            raise InputError(
                f"{chosen}: {name!r} is the name of a shipped set; another one needs another name"
            )
        return made

    def table(
        self, chosen: str | Path, fitted: Fitting | None = None
    ) -> tuple[dict[str, Any], str]:
        """The table of a shipped set, with its `name`, or a user's, and what errors call it."""
        chosen, shipped = str(chosen), read_toml(self.shipped)
        shipped = shipped if fitted is None else fitted(shipped)
        if not self.names:
            if chosen == self.default:
                return shipped, self.shipped.name
            if self.what:
                user_file(self.what, (self.default,), chosen)
            return merged(shipped, read_toml(Path(chosen)), self.levels), chosen
        sets = {name: shipped.get("common", {}) | shipped[name] for name in self.names}
        if chosen in sets:
            return sets[chosen] | {"name": chosen}, f"{self.shipped.name}: {chosen}"
        user = user_set(self.what, self.names, chosen, fixed=self.fixed, based=self.based)
        start = sets[user.base] if self.based else {}
        return merged(start, user.changes, self.levels) | {"name": user.name}, user.where


@cache
def _cached_shipped(loader: Loader[Model], chosen: str) -> Model:
    """A shipped set, read once: settings are not to be changed."""
    return validated(loader.model, *loader.table(chosen))


def user_file(what: str, names: Sequence[str], source: str | Path) -> Path:
    """The TOML file that a source names which is none of the shipped `names`."""
    path = Path(source)
    if path.suffix != ".toml":
        raise unknown_name(what, str(source), names, " nor a .toml file")
    return path


_NO_KEY = re.compile(r"[a-z-]*\[.*|constrained-(str|int|float)$")
"""What pydantic calls the alternatives of a union, and keys, which are no keys of the file."""


def _explain(error: Any, where: str) -> list[str]:
    """Lines of a refusal, one a fault."""
    location = [part for part in map(str, error["loc"]) if not _NO_KEY.match(part)]
    field = ".".join(location)
    message = error["msg"].removeprefix("Value error, ")
    allowed = message[0].lower() + message[1:]
    if error["type"] == _UNKNOWN:
        return [f"{where}: {'.'.join([*location, line])}" for line in message.splitlines()]
    if not field:
        return [f"{where}: {line}" for line in message.splitlines()]
    if error["type"] == "missing":
        return [f"{where}: {field}: is missing"]
    if error["type"] == "value_error" and isinstance(error["input"], Mapping):
        return [f"{where}: {field}: {line}" for line in message.splitlines()]
    given = repr(error["input"])
    given = given if len(given) <= _SHOWN else f"{given[:_SHOWN]}..."
    return [f"{where}: {field}: {given} is refused: {allowed}"]
