"""Figures inside a page: SVG whose black and `PAPER` follow the page, light or dark."""

import re
from io import StringIO

import matplotlib
from markupsafe import Markup
from matplotlib.figure import Figure

from charms_bench.report.figures.drawing import PAPER, any_letters, take_text_as_it_is


def in_page(figure: Figure, name: str, label: str) -> Markup:
    """A figure as an SVG element: black becomes the colour of text, and `PAPER` that of the page.

    `name` makes the ids of its parts unique in the page; `label` is for screen readers.
    """
    take_text_as_it_is(figure)
    text = StringIO()
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    # Text stays text, which can be searched, read aloud and set in the page's font.
    with any_letters(), matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        figure.savefig(text, format="svg", transparent=True, metadata=nothing)
    found = text.getvalue()
    found = found[found.index("<svg") :]
    found = re.sub(r"<metadata>.*?</metadata>", "", found, flags=re.DOTALL)
    found = re.sub(r"<[^>]*>", lambda tag: _adapted(tag[0], name), found)
    described = Markup('<svg role="img" aria-label="{}" ').format(label)
    # The width in points is for paper; in a page the view box decides.
    head, _, rest = found.removeprefix("<svg ").partition(">")
    head = re.sub(r'\b(width|height|version)="[^"]*"', "", head)
    return Markup(f"{described}{' '.join(head.split())}>{rest}")


def _adapted(tag: str, name: str) -> str:
    """A tag with the page's ids and colours; text between tags may look like either, and stays."""
    tag = re.sub(r'\bid="', f'id="{name}.', tag)
    tag = re.sub(r'(url\(#|href="#)', rf"\g<1>{name}.", tag)
    return tag.replace("#000000", "currentColor").replace(PAPER, "var(--card)")
