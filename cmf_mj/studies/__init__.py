"""Studies: comparisons of laws, and tables of many cases with their engine."""
