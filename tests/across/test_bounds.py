"""Every bound and unit that any settings class declares is kept, and refused by its name."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import pytest
import tomlkit
from pydantic import AfterValidator, BaseModel
from pydantic.fields import FieldInfo

from cmf_mj import InputError, signals
from cmf_mj.core.quantity import Kind
from cmf_mj.core.settings import Settings, validated
from cmf_mj.core.units import from_si
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.pilot.washout_settings import load_washout
from cmf_mj.report_2014.ledger import load_ledger
from cmf_mj.report_2014.posterior.study import load_posterior
from cmf_mj.studies.fit.campaign import load_campaign
from cmf_mj.studies.settings import load_study
from tests.across.test_fuzz_files import loaders, refused

SIGNALS = (
    signals.step("heave", 0.1).signal,
    signals.pulse("heave", 0.1).signal,
    signals.sine("heave", 0.1, frequency=1.0, rest=1.0).signal,
    signals.chirp("heave", 0.1).signal,
    signals.noise("heave", 0.1, seed=1).signal,
    signals.multisine("heave", 0.1, fade=1.0, seed=1).signal,
    signals.seven_sines("heave", 0.1, number=1).signal,
    signals.orthogonal_multisines({"heave": 0.1}).signal,
    signals.acceleration_step("heave", 1.0, 0.5).signal,
)


def instances(thing: Any) -> Iterator[Settings]:
    """Settings in settings, lists and tables."""
    if isinstance(thing, Settings):
        yield thing
        thing = dict(thing)
    if isinstance(thing, dict):
        thing = tuple(thing.values())
    if isinstance(thing, list | tuple):
        for one in thing:
            yield from instances(one)


def declared(annotation: Any, rules: tuple[Any, ...] = ()) -> Iterator[tuple[Any, tuple[Any, ...]]]:
    """Types of an annotation, each with the rules on it."""
    if get_origin(annotation) is Annotated:
        inner, *more = get_args(annotation)
        yield from declared(inner, (*rules, *more))
    elif get_origin(annotation) in (Union, UnionType):
        for one in get_args(annotation):
            yield from declared(one, rules)
    else:
        flat = [r.metadata if isinstance(r, FieldInfo) else [r] for r in rules]
        yield annotation, tuple(rule for several in flat for rule in several)


def wrong(rule: Any, value: Any) -> Iterator[Any]:
    """Values beyond a rule; `value` keeps it."""
    if isinstance(value, Mapping):
        kind = getattr(getattr(rule, "func", None), "__self__", None)
        if isinstance(rule, AfterValidator) and isinstance(kind, Kind):
            sizes = [] if kind.signed else [-1.0 if kind.zero else 0.0]
            sizes += [
                from_si(value["unit"], s) for s in (kind.below, 1.01 * kind.at_most) if s < 1e9
            ]
            yield from (value | {"value": size} for size in sizes)
            yield value | {"unit": "V" if "V" not in kind.units else "kg"}
    elif isinstance(value, float | int):
        for name, step in (("gt", 0), ("ge", -1), ("lt", 0), ("le", 1)):
            if getattr(rule, name, None) is not None:
                yield type(value)(getattr(rule, name) + step)
    elif getattr(rule, "min_length", 0) == 1:
        yield value[:0]


def broken(
    model: type[BaseModel], table: Mapping[str, Any]
) -> Iterator[tuple[str, dict[str, Any]]]:
    """The dotted name of each number that a table states, and the table with it beyond a bound."""
    for name, field in model.model_fields.items():
        value = table.get(name)
        for kind, rules in declared(Annotated[field.annotation, *field.metadata, None]):
            for inner, changed in within(kind, value):
                yield f"{name}.{inner}", {**table, name: changed}
            values = [one for rule in rules for one in wrong(rule, value)]
            if kind in (float, int) and isinstance(value, kind):
                values += ["1", True, [1.0], 1e300, 2**70, float("nan"), -float("inf")]
            for one in values:
                yield name, {**table, name: one}


def within(kind: Any, value: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    """As `broken`, of a value that is a table of settings, or several by name."""
    if not isinstance(value, Mapping):
        return
    if get_origin(kind) is Mapping:
        for key, one in value.items():
            for inner, changed in within(get_args(kind)[1], one):
                yield f"{key}.{inner}", {**value, key: changed}
    elif isinstance(kind, type) and issubclass(kind, BaseModel):
        yield from broken(kind, value)


def test_every_settings_class_comes_back_and_keeps_its_bounds(tmp_path: Path) -> None:
    """What a class dumps makes it again; what is beyond a bound of it is refused by its name."""
    studies = load_study("mismatch"), load_posterior("rotation"), load_campaign("hardware")
    loaded = [*SIGNALS, load_washout("optimal"), load_ledger()[0], load_motion_limits()]
    loaded += [study.settings for study in studies]
    path = tmp_path / "mine.toml"
    for read, table in loaders():
        path.write_text(tomlkit.dumps(table))
        loaded += [] if refused(read, path) else [read(path)]
    found = {type(one): one for one in reversed(list(instances(loaded)))}
    assert len(found) > 70
    for model, one in found.items():
        table = one.model_dump(exclude_none=True)
        assert validated(model, table, "again") == one, model
        for name, changed in broken(model, table):
            with pytest.raises(InputError, match=re.escape(f"again: {name}")) as raised:
                validated(model, changed, "again")
            assert len(str(raised.value)) < 2000
