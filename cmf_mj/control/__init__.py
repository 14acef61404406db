"""The digital control law (DCL), one module per block of Figure 2-6, in signal order."""

from cmf_mj.control.law import Law, law_names, load_law

__all__ = ["Law", "law_names", "load_law"]
