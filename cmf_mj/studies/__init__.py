"""Studies: comparisons of laws, and tables of many cases with their engine."""

from cmf_mj.studies.comparison import (
    AMPLITUDE,
    DEFAULT_LAWS,
    PLANTS,
    ROTATION_PER_TRANSLATION,
    STEP_PER_AMPLITUDE,
    Case,
    CaseResult,
    Comparison,
    ComparisonRow,
    compare,
    run_case,
)

__all__ = [
    "AMPLITUDE",
    "DEFAULT_LAWS",
    "PLANTS",
    "ROTATION_PER_TRANSLATION",
    "STEP_PER_AMPLITUDE",
    "Case",
    "CaseResult",
    "Comparison",
    "ComparisonRow",
    "compare",
    "run_case",
]
