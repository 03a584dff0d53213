"""Numbers and nouns in messages."""


def counted(number: int, noun: str) -> str:
    """A number with its noun: 1 episode, 1,800 episodes."""
    return f"{number:,} {noun}{'s' * (number != 1)}"
