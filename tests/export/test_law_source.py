"""Laws as C source: the bits of Python, and what a reader finds in them."""

import re
import runpy
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hydraulic_equations import changed
from lengths import examples

from cmf_mj import Hexapod, Run, law_names, load_cab, load_law, pose_to_legs
from cmf_mj.analysis.modes import bound
from cmf_mj.control.law import SIGNALS
from cmf_mj.export.law_source import law_source
from cmf_mj.export.library import export_law, export_library
from cmf_mj.facility.front import from_table
from cmf_mj.plant.parameters import hydraulics_of

SCRIPT = runpy.run_path(str(Path(__file__).parents[2] / "scripts" / "parts" / "in_c.py"))
LOOP = Path(__file__).with_name("export_law_loop_host.c")


def source_of(name: str, **changes: object) -> dict[str, str]:
    law = load_law(name).model_copy(update=changes)
    return law_source(bound(law, load_cab("rfd")), "a test")


@pytest.mark.fuzz
def test_random_laws_are_those_of_python_bit_for_bit(tmp_path: Path) -> None:
    """Any blocks, coordinates, machine and rate: outputs, commands and last states."""
    for seed in range(examples(60)):
        rng = np.random.default_rng(seed)
        law = SCRIPT["random_law"](rng)
        motion = SCRIPT["random_motion"](rng, law, 10_000)
        assert SCRIPT["differing"](tmp_path, law, motion) == [], f"seed {seed}"


@pytest.mark.slow
def test_shipped_laws_are_those_of_python_bit_for_bit(tmp_path: Path) -> None:
    for law in SCRIPT["shipped"]():
        motion = SCRIPT["random_motion"](np.random.default_rng(0), law, 10_000)
        assert SCRIPT["differing"](tmp_path, law, motion) == [], law.name


def test_nothing_moves_nothing(tmp_path: Path) -> None:
    """Every zero has Python's sign. The host begins at another rate, which is refused."""
    law = bound(load_law("modal_plan"), load_cab())
    motion = SCRIPT["random_motion"](np.random.default_rng(0), law, 50)
    for values in (motion.reference, *motion.feedback, *motion.begun.arrays().values()):
        values[:] = 0.0
    assert SCRIPT["differing"](tmp_path, law, motion) == []
    assert not any(part.any() for part in SCRIPT["in_c"](tmp_path, law, motion))


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 60.0])
def test_a_loop_around_the_exported_machine_is_the_closed_loop(
    friction: float, tmp_path: Path
) -> None:
    """The lab machine with its own law, with and without Coulomb friction [N].

    Both begin in the configuration that the model itself has.
    """
    cab = load_cab(None, "lab")
    rubbing = {"coulomb_friction": (friction, "N"), "breakaway_friction": (friction, "N")}
    oil = changed(hydraulics_of(cab.machine, None), name="rubbing", **(rubbing if friction else {}))
    law = bound(load_law(cab.machine.law), cab)
    time = np.arange(2 * law.rate)[:, None] / law.rate
    wave = np.sin(2.0 * np.pi * np.array([0.7, 1.1, 1.7, 1.3, 0.9, 1.9]) * time)
    legs = pose_to_legs(0.02 * (1.0 - np.exp(-time)) ** 3 * wave, cab.machine)
    record = Run(plant=Hexapod(cab, oil), law=law, source=from_table(legs)).record()
    export_library(Hexapod(cab, oil), None, tmp_path)
    export_law(law, tmp_path, cab)
    begun = SCRIPT["DclState"].of(record.metadata["law_state"])
    states = np.array(SCRIPT["states_in_c"](law, begun))
    (tmp_path / "in").write_bytes(states.tobytes() + legs.tobytes())
    built = ["cc", "-std=c99", "-O2", "-ffp-contract=off", "-I.", LOOP, "cmf_law.c", "libcmf.so"]
    subprocess.run([*built, "-lm", "-Wl,-rpath,$ORIGIN", "-o", "loop"], cwd=tmp_path, check=True)
    subprocess.run([tmp_path / "loop", "in", "out"], cwd=tmp_path, env={}, check=True)
    found = np.fromfile(tmp_path / "out").reshape(-1, 2, 6)
    assert found[:, 1].copy().tobytes() == record["valve_command"].tobytes()
    assert found[:, 0].copy().tobytes() == record["leg_extension"].tobytes()
    assert np.abs(found[:, 0]).max() > 0.01


def test_a_source_has_the_blocks_of_its_law_and_no_others() -> None:
    always = {f"{b}_calculations" for b in ("limit", "feedback", "error", "compensator", "valve")}
    some = {"to_modes", "reference_model", "adapt", "load_feedback", "plan_calculations"}
    expected = {
        "velocity": set(),
        "dynamic_pressure": {"load_feedback"},
        "model_following": {"reference_model"},
        "model_reference_adaptive": {"reference_model", "adapt"},
        "modal_feedback": {"to_modes", "load_feedback"},
        "modal_plan": {"to_modes", "load_feedback", "plan_calculations"},
    }
    for name, own in expected.items():
        text = source_of(name)["cmf_law.c"]
        functions = set(re.findall(r"^static \w+ (\w+)\(", text, re.MULTILINE))
        assert (functions & some, always - functions) == (own, set()), name
        assert re.findall("#include <.*>", text) == ["#include <math.h>"] * (
            bool(own & {"adapt", "plan_calculations"})
        )


def test_published_gains_stand_behind_those_in_si() -> None:
    """Table 2-5: 47 %/in on the reference, -37.1759 % on the state, six gains in all."""
    files = source_of("velocity")
    row = re.search(r"\[REFERENCE\] = (\S+), /\* 47.0 %/in \*/", files["cmf_law.c"])
    assert row and float(row[1]) == pytest.approx(0.47 / 0.0254, rel=1e-15)
    assert "#define OUTPUT_GAIN -0.371759 /* C [fraction] -37.1759 % */" in files["cmf_law.c"]
    assert files["cmf_law.c"].count("] = 0.0,\n") == 2 * len(SIGNALS) - 6
    assert files["cmf_law.h"].startswith("/* Velocity FB, law velocity. Table 2-5. For a test.")


@pytest.mark.parametrize("title", ["**//", "*\\\n/", "x */ #error", "??/\n*/", "\u202e*/"])
def test_no_title_ends_the_comment_it_stands_in(title: str) -> None:
    """Nor does a line that is joined, or a backslash that is written as a trigraph."""
    plain, named = (source_of("velocity", title=text)["cmf_law.h"] for text in ("x", title))
    assert named.isascii() and named.count("*/") == plain.count("*/")
    assert "\\\n" not in named and "??/" not in named


def test_compilers_have_nothing_to_say(tmp_path: Path) -> None:
    options = ["-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-pedantic"]
    command = ["gcc", "-std=c99", "-O2", *options, "-Werror", "-c", "cmf_law.c"]
    for name in ("velocity", "model_reference_adaptive", "modal_feedback", "modal_plan"):
        for file, text in source_of(name).items():
            assert max(map(len, text.splitlines())) <= 100
            (tmp_path / file).write_text(text)
        subprocess.run(command, cwd=tmp_path, check=True)


def test_a_source_needs_no_compiler_and_no_system(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    monkeypatch.setattr("platform.machine", lambda: "arm64")
    names = {path.name for path in export_law("modal_plan", tmp_path, "ifd")}
    assert names == {"cmf_law.c", "cmf_law.h", "example.c", "CMakeLists.txt", "cmf-mj_LICENSE"}


@pytest.mark.slow
def test_cmake_builds_the_example_of_every_law(tmp_path: Path) -> None:
    """An inch on leg 1 opens its valve by the law's gain on the reference: velocity, 47 %/in."""
    for name in ("velocity", *law_names("beyond")):
        export_law(name, tmp_path / name)
        build = tmp_path / name / "build"
        for command in (["-S", tmp_path / name, "-B", build], ["--build", build]):
            subprocess.run(["cmake", *command], check=True, capture_output=True)
        said = subprocess.run([build / "example"], capture_output=True, text=True).stdout
        assert len(said.splitlines()) == 8
        if name == "velocity":
            assert "0.000 s  leg 1 +0.4700  leg 2 +0.0000" in said
