"""A short guide for tests."""

from pathlib import Path

SHORT = """title = "short"
repetitions = 3
[tests.all]
title = "all at once"
source = "this test"
share = 0.3
measures = ["response"]
no_limit = "a test"
diagnosed = true
sought = { "surge peak [dB]" = 0.2, "signature [deviations]" = 1e4 }
[tests.all.signal]
kind = "orthogonal_multisines"
period = 4.0
periods = 2
stop = 8.0
spectrum = "acceleration"
fade = 1.0
[tests.all.signal.amplitudes]
surge = 1.0
sway = 1.0
heave = 1.0
roll = 1.0
pitch = 1.0
yaw = 1.0
"""


def written(folder: Path, text: str) -> Path:
    """A guide's file."""
    (file := folder / "mine.toml").write_text(text)
    return file
