"""What no `cmf` command says of laws: `python scripts/laws.py PART`, each with --help.

`make laws` writes all tables; `in_c` compares the laws' C source with Python. Laws along other axes
or with noisy electronics are `cmf compare --dofs roll,pitch,yaw` and `cmf compare --noise`; a
search with other limits is `cmf tune --peak 1 --overshoot 10`.
"""

from parts import ablate, accept, averaged, confirm, fly, in_c, linear, run_one, stiffness

if __name__ == "__main__":
    run_one(__doc__, confirm, linear, accept, fly, ablate, stiffness, averaged, in_c)
