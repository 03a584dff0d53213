"""How often styles of the second plan crash as traffic: `python tools/styles_in_traffic.py`.

Prints, for one style in all vehicles, both competitive ones, and PCH with all eight, in how many
scenes of 20 s vehicles of the traffic collide, and how many collide per 1,000 km. The ego is
IDM+MOBIL.
"""

import sys
import tempfile
from pathlib import Path

import polars as pl

import charms_bench

NETWORKS = Path(__file__).resolve().parent.parent / "networks"
SEEDS = range(1030, 1035)
EPISODES, FIRST_EPISODE = 100, 606_117_000
STYLES = [
    f"{priority}-{svo}"
    for priority in ("efficient", "safe")
    for svo in ("competitive", "egoistic", "prosocial", "altruistic")
]
SUITE = """\
suite: styles-in-traffic
episodes: {episodes}
seed: {first}
scene: {{profile: charms, lanes: 3, traffic_vehicles: 20, density: 1.0, ego_slots: 6}}
egos: [{{agent: idm_mobil, label: IDM+MOBIL}}]
traffic_models:
{models}
"""


def models() -> dict[str, list[str]]:
    """The traffic models in YAML, one for each seed, by what drives in them."""
    paths = {
        seed: {style: f"{NETWORKS}/seed-{seed}/charms_{style.replace('-', '_')}.onnx"
               for style in STYLES}
        for seed in SEEDS
    }  # fmt: skip
    found = {style: [paths[seed][style] for seed in SEEDS] for style in STYLES}
    every = [
        ", ".join(f"{style}: {path}" for style, path in each.items()) for each in paths.values()
    ]
    for name, tau in (
        ("both competitive styles (PCH, tau 0)", 0.0),
        ("PCH, tau 1.5, beta 0.5", 1.5),
    ):
        found[name] = [
            f"{{name: pch, options: {{tau: {tau}, beta: 0.5, styles: {{{styles}}}}}}}"
            for styles in every
        ]
    return found


def main() -> None:
    """Runs the episodes and prints the table."""
    lines = [
        f'  - {{traffic: {model}, label: "{name}, {seed}"}}'
        for name, each in models().items()
        for seed, model in zip(SEEDS, each, strict=True)
    ]
    text = SUITE.format(episodes=EPISODES, first=FIRST_EPISODE, models="\n".join(lines))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "styles-in-traffic.yaml")
        path.write_text(text, encoding="utf-8")
        episodes = charms_bench.run(path, Path(folder, "run")).episodes
    name = pl.col("traffic").str.replace(r", \d+$", "")
    by_seed = episodes.group_by(driver=name, seed="traffic", maintain_order=True).agg(
        scenes=(pl.col("traffic_crashed") > 0).mean(),
        per_1000km=pl.sum("traffic_crashed") / pl.sum("traffic_distance_m") * 1e6,
    )
    table = by_seed.group_by("driver", maintain_order=True).agg(
        pl.mean("scenes"),
        least=pl.min("scenes"),
        most=pl.max("scenes"),
        per_1000km=pl.mean("per_1000km"),
    )
    with pl.Config(tbl_rows=-1, tbl_cols=-1, fmt_str_lengths=60):
        sys.stdout.write(f"{table}\n")


if __name__ == "__main__":
    main()
