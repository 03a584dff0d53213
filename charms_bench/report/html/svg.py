"""Figures inside a page: SVG whose ink follows the page, light or dark."""

import re
from dataclasses import dataclass
from io import StringIO

import matplotlib
from markupsafe import Markup
from matplotlib.figure import Figure

from charms_bench.report.figures import take_text_as_it_is

COLOURS = (
    "#0072b2", "#d55e00", "#009e73", "#b5679a", "#b07900", "#3a96d0", "#7a8290", "#96602c"
)  # fmt: skip
"""After Okabe & Ito 2008, in tones that stand out from white and from black by 3 to 1."""
STYLES = ("-", "--", ":", "-.")
MARKERS = "osD^vPX*"


@dataclass(frozen=True)
class Picture:
    """A figure of a page."""

    id: str
    title: str
    caption: str
    svg: Markup
    wide: bool = False
    """Whether it needs the width of the page."""


def in_page(figure: Figure, name: str, label: str) -> Markup:
    """A figure as an SVG element.

    Args:
        figure: What is drawn; what it draws in black is the page's ink.
        name: Tells its parts from those of other figures of the page.
        label: What it shows, for who does not see it.
    """
    take_text_as_it_is(figure)
    text = StringIO()
    # Text stays text: it can be searched, read aloud and set in the page's font.
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        figure.savefig(
            text,
            format="svg",
            transparent=True,
            metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")),
        )
    found = text.getvalue()
    found = found[found.index("<svg") :]
    found = re.sub(r"<metadata>.*?</metadata>", "", found, flags=re.DOTALL)
    found = re.sub(r'\bid="', f'id="{name}.', found)
    found = re.sub(r'(url\(#|href="#)', rf"\g<1>{name}.", found)
    found = found.replace("#000000", "currentColor")
    described = Markup('<svg role="img" aria-label="{}" ').format(label)
    # Its width in points is that of paper; in a page the view box decides.
    head, _, rest = found.removeprefix("<svg ").partition(">")
    head = re.sub(r'\b(width|height|version)="[^"]*"', "", head)
    return Markup(f"{described}{' '.join(head.split())}>{rest}")
