"""Tables of laws that no `cmf` command writes: `python scripts/laws.py TABLE`, each with --help.

`make laws` writes them all. Laws along other axes or with noisy electronics are
`cmf compare --dofs roll,pitch,yaw` and `cmf compare --noise`; a search with other limits is
`cmf tune --peak 1 --overshoot 10`.
"""

import argparse
from types import ModuleType

from law_tables import ablate, accept, confirm, fly, linear, stiffness

TABLES: dict[str, ModuleType] = {
    one.__name__.rpartition(".")[2]: one
    for one in (confirm, linear, accept, fly, ablate, stiffness)
}


def main() -> None:
    """Write the table that is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    tables = parser.add_subparsers(dest="table", required=True)
    for name, table in TABLES.items():
        first = (table.__doc__ or "").splitlines()[0]
        table.add_options(tables.add_parser(name, help=first, description=first))
    options = parser.parse_args()
    TABLES[options.table].run(options)


if __name__ == "__main__":
    main()
