"""Valve calculations: the compensator's output, clamped to +-100 % (section 2.3.3)."""

from cmf_mj.core.compiled import compiled


@compiled
def clamp(output):  # type: ignore[no-untyped-def]
    """Valve command of one leg as a fraction, -1 to 1."""
    return min(max(output, -1.0), 1.0)
