"""`python -m cmf_mj.cli`."""

from cmf_mj.cli import main

main()
