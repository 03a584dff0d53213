"""Small real runs whose names do their worst, for reports."""

from pathlib import Path

from command_line import charms_bench

SCRIPT = "<script>window.broken = true</script>"
IMAGE = "<img src=x onerror='window.broken = true'>"
DOLLARS = 'A $x^2$ & "B" </script>'

SCENE = "{duration_s: 4.0, traffic_vehicles: 8}"
SUITES = {
    "egos": f"""\
suite: egos
title: {SCRIPT}
episodes: 6
scene: {SCENE}
egos:
  - {{agent: idm_mobil, label: "{IMAGE}", paper: {{speed_mean: 23.67}}}}
  - {{agent: stackelberg, label: '{DOLLARS}'}}
traffic_models: [{{traffic: idm_mobil, label: "{SCRIPT}"}}]
columns: [speed_mean, crashed_episodes]
pairs: true
""",
    "people": f"""\
suite: people
episodes: 6
scene: {SCENE}
egos: [{{agent: idm_mobil}}]
traffic_models: [{{traffic: idm_mobil}}, {{traffic: stackelberg, label: "{IMAGE}"}}]
references: [i24, us101]
""",
    "crossplay": f"""\
suite: crossplay
title: Who is good in whose company
episodes: 4
scene: {SCENE}
egos: [{{agent: idm_mobil}}, {{agent: stackelberg, label: '{DOLLARS}'}}]
traffic_models: [{{traffic: idm_mobil}}, {{traffic: stackelberg}}]
""",
}
CURVES = """\
stage,steps,return_mean,crashed_share,loss,epoch,agreement
<b>first</b>,100,1.5,0.9,,,
<b>first</b>,200,3.5,0.4,,,
second,,,,2.5,0,0.20
second,,,,2.25,1,0.25
"""
STAGES = "stage,style,steps,wall_s,return\n<b>first</b>,safe,200,1.5,3.5\nsecond,human,,0.5,\n"


def make_run(folder: Path, name: str) -> Path:
    """Runs one of `SUITES`; returns its run folder."""
    suite = folder / f"{name}.yaml"
    suite.write_text(SUITES[name], encoding="utf-8")
    made = charms_bench("run", suite, "--workers", "1", "--output", folder / name)
    assert made.returncode == 0, made.stderr
    return folder / name


def make_training(folder: Path) -> Path:
    """What is left of a training."""
    training = folder / "training"
    training.mkdir()
    (training / "curves.csv").write_text(CURVES)
    (training / "stages.csv").write_text(STAGES)
    return training
