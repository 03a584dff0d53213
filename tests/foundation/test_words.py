"""Numbers with their nouns."""

import pytest

from charms_bench.foundation.words import counted


@pytest.mark.parametrize(
    ("number", "said"), [(0, "0 episodes"), (1, "1 episode"), (1800, "1,800 episodes")]
)
def test_one_is_singular(number: int, said: str) -> None:
    assert counted(number, "episode") == said
