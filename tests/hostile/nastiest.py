"""Twelve of the nastiest inputs, and the message with which each is rejected."""

import json
from pathlib import Path

NASTIEST: dict[str, str] = json.loads((Path(__file__).parent / "messages.json").read_bytes())[
    "inputs"
]
"""The message by the title of the input, without the folder that it names."""
