"""The learning curve of a stage."""

import csv
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from charms_bench.engine.simulation import OFF_ROAD, TIME
from charms_bench.world.files import write_atomically


@dataclass(frozen=True)
class Point:
    """The episodes that ended since the point before; empty where there were none."""

    steps: int
    """Steps so far."""
    episodes: int
    return_mean: float | None
    """Sum of the rewards of an episode."""
    length_mean: float | None
    """Decisions of an episode."""
    crashed_share: float | None
    off_road_share: float | None
    loss: float | None
    """Of the last gradient steps."""
    exploration: float
    """Probability of a random action."""


class LearningCurve:
    """Gathers ended episodes into a point every so many steps."""

    def __init__(self) -> None:
        self.points: list[Point] = []
        self._returns: list[float] = []
        self._lengths: list[int] = []
        self._endings: list[int] = []

    def add(self, final_info: dict[str, Any]) -> None:
        """Takes note of an ended episode."""
        self._returns.append(final_info["episode_return"])
        self._lengths.append(final_info["steps"])
        self._endings.append(final_info["ending"])

    def close(self, steps: int, loss: float, exploration: float) -> Point:
        """Adds the point of everything since the last one."""
        episodes = len(self._returns)
        off_road = self._endings.count(OFF_ROAD)
        crashed = episodes - off_road - self._endings.count(TIME)
        point = Point(
            steps=steps,
            episodes=episodes,
            return_mean=sum(self._returns) / episodes if episodes else None,
            length_mean=sum(self._lengths) / episodes if episodes else None,
            crashed_share=crashed / episodes if episodes else None,
            off_road_share=off_road / episodes if episodes else None,
            loss=loss if loss == loss else None,
            exploration=exploration,
        )
        self.points.append(point)
        self._returns, self._lengths, self._endings = [], [], []
        return point

    def state(self) -> dict[str, Any]:
        """Everything, for JSON."""
        return {
            "points": [asdict(point) for point in self.points],
            "returns": self._returns,
            "lengths": self._lengths,
            "endings": self._endings,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Takes over what `state` returned."""
        self.points = [Point(**point) for point in state["points"]]
        self._returns = list(state["returns"])
        self._lengths = list(state["lengths"])
        self._endings = list(state["endings"])

    def write_csv(self, path: Path) -> None:
        """One row a point."""

        def write(partial: Path) -> None:
            with partial.open("w", newline="", encoding="utf-8") as file:
                rows = csv.DictWriter(file, fieldnames=list(Point.__annotations__))
                rows.writeheader()
                rows.writerows(asdict(point) for point in self.points)

        write_atomically(path, write)

    def write_png(self, path: Path, title: str) -> None:
        """Return and failures over steps."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        points = [point for point in self.points if point.episodes]
        steps = [point.steps for point in points]
        figure = Figure(figsize=(6.4, 4.8), layout="constrained")
        FigureCanvasAgg(figure)
        above, below = figure.subplots(2, sharex=True)
        above.plot(steps, [point.return_mean for point in points], color="C0")
        above.set(title=title, ylabel="return")
        below.plot(steps, [point.crashed_share for point in points], color="C3", label="crashed")
        below.plot(steps, [point.off_road_share for point in points], color="C1", label="off road")
        below.set(xlabel="steps", ylabel="share of episodes", ylim=(0, 1))
        below.legend()
        write_atomically(path, lambda partial: figure.savefig(partial, format="png", dpi=120))
