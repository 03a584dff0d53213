"""The page: templates filled, scripts and styles inside, nothing from outside."""

import hashlib
from base64 import b64encode
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

TEMPLATES = Path(__file__).with_name("templates")
SCRIPTS = ("tables.js", "player.js", "controls.js")


def render(content: Mapping[str, Any]) -> str:
    """The page with this content; names in it are text, whatever they look like."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["packed"] = lambda replays: {each["id"]: each["packed"] for each in replays}
    scripts = [(TEMPLATES / name).read_text(encoding="utf-8") for name in SCRIPTS]
    style = (TEMPLATES / "page.css").read_text(encoding="utf-8")
    return environment.get_template("page.html").render(
        content,
        scripts=[Markup(script) for script in scripts],
        style=Markup(style),
        # Should a name ever get past the escaping, the browser still runs our scripts alone.
        policy=f"default-src 'none'; style-src 'unsafe-inline'; script-src {_hashes(scripts)}; "
        "base-uri 'none'; form-action 'none'",
    )


def _hashes(scripts: list[str]) -> str:
    """What a content security policy calls these scripts."""
    digests = [hashlib.sha256(script.encode()).digest() for script in scripts]
    return " ".join(f"'sha256-{b64encode(digest).decode()}'" for digest in digests)
