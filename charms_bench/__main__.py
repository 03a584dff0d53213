"""`python -m charms_bench`, the same as `charms-bench`."""

from charms_bench.cli import main

if __name__ == "__main__":
    main()
