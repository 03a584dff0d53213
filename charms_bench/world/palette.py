"""The colours of the road and its vehicles in every picture, page and animation."""

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
