"""Tables of laws that no `cmf` command writes: what `scripts/laws.py` runs."""
