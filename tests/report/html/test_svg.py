"""Figures in a page: ids and colours are the page's, and labels stay what they are."""

from xml.etree import ElementTree

from matplotlib.figure import Figure

from charms_bench.report.figures.drawing import PAPER
from charms_bench.report.html.svg import in_page


def test_a_label_that_looks_like_a_colour_or_an_id_stays() -> None:
    label = f'#000000 id="q url(#r href="#s {PAPER}'
    figure = Figure()
    figure.text(0.5, 0.5, label, color="black")
    svg = in_page(figure, "figure", "a figure").replace("xlink:href", "href")
    root = ElementTree.fromstring(svg)
    (text,) = root.findall(".//{*}text")
    assert text.text == label
    ids = [each.attrib["id"] for each in root.iter() if "id" in each.attrib]
    assert ids
    assert all(each.startswith("figure.") for each in ids)
