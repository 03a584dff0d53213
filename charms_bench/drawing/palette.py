"""The colours, markers and line styles of every figure, page and animation."""

SERIES = (
    "#0072b2", "#d55e00", "#009e73", "#b5679a", "#b07900", "#3a96d0", "#7a8290", "#96602c"
)  # fmt: skip
"""For lines and points, after Okabe & Ito 2008; each stands out from white and black by 3 to 1."""
MARKERS = "osD^vPX*"
LINE_STYLES = ("-", "--", ":", "-.")
GREY = "#b9c2cb"
EDGE = "#6b7785"
INK = "#1a1a1a"
"""Text on light fields of colour, whatever is behind the figure."""

Tones = tuple[str, str]
"""A colour on a light page, and on a dark one."""
AGENTS: tuple[Tones, ...] = (
    ("#1f5f9e", "#7db4f0"),
    ("#00704f", "#4fc79a"),
    ("#8a3b78", "#e39ac9"),
    ("#7a4a12", "#d9a45b"),
    ("#0b6e7a", "#58c6d4"),
    ("#4a5361", "#aab4c2"),
    ("#5d6410", "#c5c95a"),
    ("#a02c5a", "#f08aa8"),
)
"""The vehicles of each agent, in the order in which the agents are met."""
VEHICLES: dict[str, Tones] = {
    "ego": ("#b83a06", "#ffa066"),
    "wreck": ("#c2122d", "#ff5a6a"),
    "brake": ("#ff2d3d", "#ff2d3d"),
    "indicator": ("#e09400", "#ffc53d"),
    "asphalt": ("#dde0e4", "#262d36"),
    "paint": ("#ffffff", "#5b6673"),
}
"""The road, and what vehicles show."""


def series(place: int) -> dict[str, str]:
    """The colour and line style of a line, different for the first 32 places."""
    style = LINE_STYLES[(place + place // len(SERIES)) % len(LINE_STYLES)]
    return {"color": SERIES[place % len(SERIES)], "linestyle": style}


def points(place: int) -> dict[str, str]:
    """The colour and marker of a group of points."""
    return {"color": SERIES[place % len(SERIES)], "marker": MARKERS[place % len(MARKERS)]}
