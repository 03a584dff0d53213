"""`python -m charms_bench`, the same as `charms-bench`."""

import sys

if __name__ == "__main__":
    if not sys.flags.safe_path:
        del sys.path[0]  # the current folder, whose files are not modules of ours

    from charms_bench.cli import main

    main()
