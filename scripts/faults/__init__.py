"""The whole system under odd timing: what `scripts/simulate_faults.py` runs and checks."""
