"""`python -m cmf_mj.cli`."""

from cmf_mj.cli import main

if __name__ == "__main__":
    main()
