"""Says on which roads policies choose lower target speeds than those of the suite's profile."""

from charms_bench.runs.suite import Suite


def said_of(suite: Suite) -> str:
    """The sentence for the tables of a suite; empty if there is no such road."""
    if not suite.roads:
        return ""
    from charms_bench.roads.settings import profiles_of  # slow to import

    least = suite.scene.profile.target_speed_min_mps
    scenes = {each.road.title: each.scene for each in suite.cells if each.road is not None}
    begin = {title: profiles_of(scene)[0].target_speed_min_mps for title, scene in scenes.items()}
    lower = [f"{speed:.3g} m/s on {title}" for title, speed in begin.items() if speed < least]
    if not lower:
        return ""
    return (
        f"The target speeds of policies begin at the ego's first speed where it is below the "
        f"{least:g} m/s of the profile: {', '.join(lower)}."
    )
