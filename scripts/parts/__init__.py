"""What `scripts/laws.py` and `scripts/machines.py` run: each part with options of its own."""

import argparse
from types import ModuleType


def run_one(doc: str | None, *parts: ModuleType) -> None:
    """Run the part that the command line names."""
    parser = argparse.ArgumentParser(description=(doc or "").splitlines()[0])
    names = parser.add_subparsers(dest="part", required=True)
    by_name = {part.__name__.rpartition(".")[2]: part for part in parts}
    for name, part in by_name.items():
        first = (part.__doc__ or "").splitlines()[0]
        part.add_options(names.add_parser(name, help=first, description=first))
    options = parser.parse_args()
    by_name[options.part].run(options)
