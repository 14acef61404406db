"""Machines of all kinds: `python scripts/machines.py walk` or `compare`, each with --help."""

from parts import compare, run_one, walk

if __name__ == "__main__":
    run_one(__doc__, walk, compare)
