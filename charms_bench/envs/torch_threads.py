"""Warns of torch's threads, which slow a training with small networks down."""

import sys
import warnings


def warn_of_torch_threads() -> None:
    """Warns once per process if torch is in use with several threads; torch is never imported.

    Networks for these observations are small. With several threads, torch spends most of the time
    on handing out work, and each thread takes a core that the environment needs.
    """
    count = getattr(sys.modules.get("torch"), "get_num_threads", None)  # None while it is imported
    threads = count() if count else 1
    if threads > 1 and not _warned:
        _warned.append(threads)
        warnings.warn(
            f"torch computes with {threads} threads, which makes training with small networks many "
            "times slower; call torch.set_num_threads(1) before the training",
            stacklevel=3,
        )


_warned: list[int] = []
