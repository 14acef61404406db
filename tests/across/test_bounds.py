"""Every bound and unit that a settings class declares is kept, and refused by the field's name."""

import re
from collections.abc import Iterator, Mapping
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import pytest
from pydantic import AfterValidator, BaseModel
from pydantic.fields import FieldInfo

import cmf_mj
from cmf_mj import signals
from cmf_mj.control.dcu.state import DcuSettings, load_dcu
from cmf_mj.control.law import Law
from cmf_mj.control.protection import ProtectionSettings, load_protection
from cmf_mj.control.states import StateSettings, load_state_settings
from cmf_mj.core.quantity import Kind
from cmf_mj.core.settings import Settings, validated
from cmf_mj.core.units import from_si
from cmf_mj.electronics.converter import ConverterSettings, load_converters
from cmf_mj.electronics.sensors import SensorSettings, load_sensors
from cmf_mj.electronics.servo_electronics import ServoSettings, load_servo_settings
from cmf_mj.machine.limits import MotionLimits
from cmf_mj.machine.machine import Machine, load_machine
from cmf_mj.machine.models import RigidBody
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.pilot.washout_settings import ClassicalSettings, OptimalSettings, load_washout
from cmf_mj.plant.parameters import HydraulicParameters, load_hydraulics
from cmf_mj.report_2014.ledger import LedgerEntry, load_ledger
from cmf_mj.report_2014.posterior.run import PosteriorSettings, load_posterior
from cmf_mj.studies.fit.campaign import CampaignSettings, load_campaign
from cmf_mj.studies.settings import StudySettings, load_study

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

SETTINGS: list[tuple[type[Settings], Any]] = [
    (Law, cmf_mj.load_law("velocity")),
    (Law, cmf_mj.load_law("modal_plan")),
    (Law, cmf_mj.load_law("model_reference_adaptive")),
    (DcuSettings, load_dcu()),
    (StateSettings, load_state_settings()),
    (ProtectionSettings, load_protection()),
    (ServoSettings, load_servo_settings()),
    (ConverterSettings, load_converters("sixteen_bit")),
    (SensorSettings, load_sensors("noisy")),
    (HydraulicParameters, load_hydraulics("lossy")),
    (MotionLimits, load_motion_limits()),
    (Machine, load_machine("lab").model_copy(update={"name": "mine"})),
    (ClassicalSettings, load_washout("simona")),
    (OptimalSettings, load_washout("optimal")),
    (StudySettings, load_study("mismatch").settings),
    (PosteriorSettings, load_posterior("rotation").settings),
    (CampaignSettings, load_campaign("hardware").settings),
    (LedgerEntry, load_ledger()[0]),
    (RigidBody, load_machine().platform),
    *((type(one), one) for one in SIGNALS),
]


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
                values += ["1", True, *([float("nan"), float("inf")] if kind is float else [])]
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


@pytest.mark.parametrize(("model", "settings"), SETTINGS)
def test_every_declared_bound_is_kept_and_named(model: type[Settings], settings: Settings) -> None:
    table = settings.model_dump(mode="json", exclude_none=True)
    assert validated(model, table, "mine") == settings
    found = list(broken(model, table))
    assert len(found) > 5
    for name, changed in found:
        with pytest.raises(cmf_mj.InputError, match=re.escape(f"mine: {name}")):
            validated(model, changed, "mine")
