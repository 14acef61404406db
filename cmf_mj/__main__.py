"""`python -m cmf_mj`."""

from cmf_mj.cli import main

if __name__ == "__main__":
    main()
