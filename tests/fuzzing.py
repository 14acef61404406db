"""What fuzzers of files and command lines share: hostile values, and where work would begin."""

import copy
import inspect
import shutil
import signal
import time
import typing
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest
import tomlkit
import typer
from typer.testing import CliRunner

from cmf_mj.cli.common import app

LONGEST = 5.0  #: Seconds that a refusal, or what comes before the work, may take.

SEAMS = (
    "facility.session:Session.run",
    "facility.host.udp:send_stream",
    "pilot.washout:Washout.run",
    "analysis.linear.linear:operating_point",
    "analysis.modes:sweep",
    "report_2014.model_tables:measure_loop",
    "pilot.airframe:Airframe.__init__",
    "studies.certificate:Family",
    "studies.engine:_start_workers",
    "studies.tuning.search:cost",
    "studies.fit.evidence:Linear",
)
"""Functions in which the work of commands begins, besides joblib's."""

NUMBERS = (
    *("nan", "inf", "-inf", "0", "-1", "-0.0", "1e-300", "1e300", "1e9", "1e17", "1e400", "0x10"),
    *("", " ", "1_0", "--", "2147483648", "9223372036854775808", "9" * 5000, "1.5", "3", "0.5"),
)
TEXTS = (
    *("", " ", ",", "all", "none", "../../x", "/dev/null", "/proc/x/y.toml", "a" * 300, "a[/b]c"),
    *("velocity,velocity", "velocity,all", "heave,heave", r"$\foo$", "missing.toml", "missing.csv"),
    *("missing.parquet", "é\u202e", "-1", "1 in", "0 in", "nan in", "inf deg", "1e300 in", "-5 in"),
    *("3 deg", "1 kg", "in", "1  in", "1,2,3", "0,0,0,0,0,0", "nan,0,0,0,0,0", "9e9,0,0,0,0,0"),
    *("0,0,0", "4,3,1", "99999999,1,1", "127.0.0.1:9", "256.0.0.1:x", ":", "x.html", "x.xyz"),
)
VALUES: tuple[Any, ...] = (
    *(0, -1, 1, 2**31, 2**70, 0.0, -0.0, 1e-320, 1e17, 1e300, float("nan"), float("inf"), True),
    *("", "x", "../x", "velocity", "a\x00b", "x" * 5000, [], [1.0], [[[]]], {}, {"value": 1.0}),
    *({"value": "1", "unit": "kg"}, [1.0, "in"], [1e300, "in"], ["in", 1.0], {"a": {"b": []}}),
)


class Begun(BaseException):
    """The line was accepted: its work would begin here."""


class TooSlow(BaseException):
    """Neither refused nor begun in time."""


@contextmanager
def seams() -> Iterator[None]:
    """Have every command end where its work begins."""

    def begun(*_: Any, **__: Any) -> Any:
        raise Begun

    def slow(*_: Any) -> None:
        raise TooSlow

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(joblib.Parallel, "__call__", begun)
        for seam in SEAMS:
            module, name = seam.split(":")
            owner = import_module(f"cmf_mj.{module}")
            *classes, last = name.split(".")
            for part in classes:
                owner = getattr(owner, part)
            patch.setattr(owner, last, begun)
        before = {number: signal.signal(number, slow) for _, number, _ in _TIMERS}
        try:
            yield
        finally:
            _limit(0.0)
            for number, handler in before.items():
                signal.signal(number, handler)


_TIMERS = (
    (signal.ITIMER_PROF, signal.SIGPROF, 300.0),
    (signal.ITIMER_REAL, signal.SIGALRM, 3600.0),
)
"""Longest time of a line: of the processor, and of the clock for one that waits for ever [s]."""


def _limit(share: float) -> None:
    """Set the timers to a share of their times; 0 stops them."""
    for timer, _, seconds in _TIMERS:
        signal.setitimer(timer, share * seconds)


def commands() -> dict[tuple[str, ...], Any]:
    """Every command of the tree, by its words."""

    def walk(group: Any, words: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
        for name, one in group.commands.items():
            if getattr(one, "invoke_without_command", True):
                yield (*words, name), one
            if hasattr(one, "commands"):
                yield from walk(one, (*words, name))

    return dict(walk(typer.main.get_command(app), ()))


def pick(generator: np.random.Generator, choices: Any) -> Any:
    """One of several things of any kind."""
    return choices[int(generator.integers(len(choices)))]


def value_of(
    parameter: Any, kind: Any, generator: np.random.Generator, files: list[str], *, good: bool
) -> str:
    """A value of an option or argument: one of its names or a file, or a hostile one."""
    numeric = {int, float} & {kind, *typing.get_args(kind)}
    if numeric and (not good or generator.random() < 0.5):
        return str(pick(generator, NUMBERS))
    if numeric:
        return str(generator.integers(1, 9))
    names = [item.value for item in parameter.shell_complete(typer.Context(parameter_owner()), "")]
    chance = generator.random()
    if names and (good or chance < 0.3):
        return str(pick(generator, names))
    return str(pick(generator, files if good or chance < 0.65 else TEXTS))


def parameter_owner() -> Any:
    """Any command, for the context that completion asks for."""
    return next(iter(commands().values()))


def line(
    words: tuple[str, ...], command: Any, generator: np.random.Generator, files: list[str]
) -> list[str]:
    """A command line: what is required, and up to four options, each as likely bad as good."""
    hints = typing.get_type_hints(inspect.unwrap(command.callback))
    given = list(words)
    options = [p for p in command.params if p.param_type_name == "option" and p.name != "help"]
    chosen = list(generator.permutation(len(options))[: generator.integers(0, 5)])
    for number, option in enumerate(options):
        required = bool(getattr(option, "required", False))
        if option.name in ("out", "file", "target") or not (required or number in chosen):
            continue
        flags = [*option.opts, *option.secondary_opts]
        if option.is_flag:
            given.append(str(pick(generator, flags)))
            continue
        value = value_of(
            option, hints.get(option.name, str), generator, files, good=generator.random() < 0.5
        )
        given += [option.opts[-1], value]
    for argument in command.params:
        if argument.param_type_name == "argument":
            several = "list" in str(hints[argument.name])
            count = generator.integers(0, 3) if several else 1
            good = generator.random() < 0.8
            kind = hints[argument.name]
            given += [value_of(argument, kind, generator, files, good=good) for _ in range(count)]
    for option in options:
        if option.name == "out":
            given += ["--out", "out"]
        elif option.name in ("file", "target"):
            given += ["--file", str(pick(generator, ("out/x.html", "out/x.csv", "out/x.toml")))]
    return given


def outcome(given: list[str]) -> tuple[str, str, float]:
    """How a line ended in the working folder, what it printed and the time it took [s].

    The time is the processor's. A line that takes long is tried again, without what it wrote: what
    was compiled or loaded once does not count.
    """
    how, said, took = _attempt(given)
    if took <= LONGEST:
        return how, said, took
    shutil.rmtree("out", ignore_errors=True)
    return _attempt(given)


def _attempt(given: list[str]) -> tuple[str, str, float]:
    begun = time.process_time()
    _limit(1.0)
    try:
        result = CliRunner().invoke(app, given)
    except Begun:
        return "begun", "", time.process_time() - begun
    except TooSlow:
        return "slow", "", time.process_time() - begun
    finally:
        _limit(0.0)
    error = result.exception
    if error is not None and not isinstance(error, SystemExit):
        return "defect", f"{type(error).__name__}: {str(error)[:200]}", time.process_time() - begun
    return f"exit {result.exit_code}", result.output, time.process_time() - begun


def places(table: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Paths to every entry of nested tables and lists."""
    entries = table.items() if isinstance(table, dict) else enumerate(table)
    for key, value in entries:
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from places(value, (*path, key))


def mutated(table: dict[str, Any], generator: np.random.Generator) -> dict[str, Any]:
    """A table with one to three entries changed, taken out, renamed or doubled."""
    table = copy.deepcopy(table)
    for _ in range(generator.integers(1, 4)):
        paths = list(places(table))
        if not paths:
            break
        *way, last = pick(generator, paths)
        holder: Any = table
        for key in way:
            holder = holder[key]
        act = generator.integers(6)
        if act <= 2:
            holder[last] = copy.deepcopy(pick(generator, VALUES))
        elif act == 3:
            del holder[last]
        elif act == 4 and isinstance(holder, dict):
            holder[str(pick(generator, TEXTS))] = holder.pop(last)
        else:
            other: Any = table
            for key in pick(generator, paths):
                if (
                    not isinstance(other, dict | list)
                    or isinstance(other, list)
                    and (not isinstance(key, int) or key >= len(other))
                ):
                    break
                if isinstance(other, dict) and key not in other:
                    break
                other = other[key]
            holder[last] = copy.deepcopy(other)
    return table


def toml_bytes(table: dict[str, Any], generator: np.random.Generator) -> bytes:
    """A mutated table as TOML, sometimes with damage to the text."""
    text = tomlkit.dumps(mutated(table, generator)).encode("utf-8", "replace")
    return damaged(text, generator) if generator.random() < 0.3 else text


def damaged(content: bytes, generator: np.random.Generator) -> bytes:
    """Bytes with a flip, a cut, a hole, a repetition, or something foreign in them."""
    place, other = sorted(generator.integers(0, len(content) + 1, 2))
    act = generator.integers(6)
    if act == 0 and content:
        flipped = bytearray(content)
        flipped[min(place, len(content) - 1)] ^= 1 << int(generator.integers(8))
        return bytes(flipped)
    if act == 1:
        return content[:place]
    if act == 2:
        return content[:place] + content[other:]
    if act == 3:
        return content[:other] + content[place:]
    foreign = (
        *(b"\xef\xbb\xbf", b"\xff\xfe", b"\x00", b"\r", b"[" * 3000, b"2020-01-01", b"a.a" * 900),
        *(b"=", b'"""', b"\x1b[31m", b"1" * 5000, b"nan", b",,,,", b"#"),
    )
    return content[:place] + pick(generator, foreign) + content[place:]


def below(folder: Path) -> set[str]:
    """Names of everything in a folder."""
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}
