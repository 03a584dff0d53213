"""Which sources the vehicles of a scene come from."""

from charms_bench.engine.crossing import Crossing
from charms_bench.engine.open_road import Inflow
from charms_bench.engine.playback import Recorded, RecordedOnRoad
from charms_bench.engine.prescribed import Placed
from charms_bench.engine.running import RunningEpisodes
from charms_bench.engine.source import Drawn, Source


def sources_of(episodes: RunningEpisodes) -> tuple[Source, ...]:
    """The sources that the settings of episodes name, in the order in which they act.

    Raises an `InputError` if vehicles of one that need drivers are driven from outside.
    """
    settings = episodes.settings
    if settings.scenario is not None and settings.network is None:
        return (Placed(episodes),)
    if settings.recording is not None:
        return (Recorded(episodes),)
    if episodes.engine.moments is not None:
        return (RecordedOnRoad(episodes), Crossing(episodes))
    if episodes.engine.renewal_steps:
        return (Drawn(episodes), Crossing(episodes))
    return (Drawn(episodes), Inflow(episodes)) if settings.inflow else (Drawn(episodes),)
