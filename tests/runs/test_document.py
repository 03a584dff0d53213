"""YAML from users: errors name file, line and field."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from charms_bench.errors import SuiteError
from charms_bench.runs.document import Document, value_of
from charms_bench.runs.suite import Suite

SUITE = """\
suite: small
episodes: 4
scene:
  profile: charms
  lanes: 3
egos:
  - agent: idm_mobil
  - agent: stackelberg
traffic_models:
  - traffic: idm_mobil
"""


def complaint(tmp_path: Path, text: str) -> str:
    path = tmp_path / "suite.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SuiteError) as caught:
        Document(path).validate(Suite)
    return str(caught.value).removeprefix(f"{tmp_path}/")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("lanes: 3", "lanes: three", "suite.yaml:5: scene.lanes: Input should be a valid integer"),
        ("lanes: 3", "lane: 3", "suite.yaml:5: scene.lane: unknown key"),
        ("episodes: 4", "episodes: 0", "suite.yaml:2: episodes: Input should be greater than"),
        ("episodes: 4\n", "", "suite.yaml:1: episodes: Field required"),
        ("profile: charms", "profile: charm", "suite.yaml:4: scene.profile: no profile named"),
        ("profile: charms", "profile: charm", "Did you mean 'charms'?"),
        ("agent: stackelberg", "agent: 7", "suite.yaml:8: egos[1].agent"),
        ("stackelberg", "idm_mobil", "two egos are called 'idm_mobil'"),
        ("suite: small", "suite: ../small", "suite.yaml:1: suite: String should match"),
        ("lanes: 3", "lanes: 3\n  lanes: 4", "suite.yaml:6: the key 'lanes' is given twice"),
        ("lanes: 3", "lanes: [3", "is not YAML"),
        ("lanes: 3", "lanes: &a 3\n  density: *a", "suite.yaml:6: aliases (*name) are not"),
        ("lanes: 3", "lanes: !!python/name:os.system 3", "suite.yaml:5: tags (!name) are not"),
        ("lanes: 3", "duration_s: 0.1", "duration_s is shorter than one decision"),
        ("lanes: 3", "decision_hz: 4", "simulation_hz 15 is not a multiple of decision_hz 4"),
    ],
)
def test_a_mistake_is_named_with_its_line_and_field(
    tmp_path: Path, old: str, new: str, expected: str
) -> None:
    assert expected in complaint(tmp_path, SUITE.replace(old, new))


@pytest.mark.parametrize(
    "text", ["010", "-010", "09", "0o10", "0b11", "1:30", "1:30.5", "yes", "No", "on", "OFF"]
)
def test_what_versions_of_yaml_read_differently_is_an_error(tmp_path: Path, text: str) -> None:
    said = complaint(tmp_path, SUITE.replace("episodes: 4", f"episodes: 4\nseed: {text}"))
    assert f"suite.yaml:3: {text} is " in said
    with pytest.raises(ValueError, match=f"^{text} is "):
        value_of(text)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1_000", 1000),
        ("1e5", 1e5),
        ("-1.5e-3", -1.5e-3),
        ("2024-01-01", "2024-01-01"),
        ("2024-99-01", "2024-99-01"),
        ("'010'", "010"),
        ("'no'", "no"),
        ("=", "="),
        ("0x10", 16),
        ("~", None),
        ("true", True),
    ],
)
def test_a_value_is_what_its_author_means(text: str, value: object) -> None:
    assert value_of(text) == value
    assert type(value_of(text)) is type(value)


def test_merge_keys_are_an_error(tmp_path: Path) -> None:
    text = SUITE.replace("lanes: 3", "<<: {lanes: 3}")
    assert "suite.yaml:5: merge keys (<<) are not supported" in complaint(tmp_path, text)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("A", "A "),
        ("A B", "A  B"),
        ("é", "e\u0301"),
        ("ＰＰＯ", "PPO"),
        ("PPO", "РРО"),
        ("PPO", "PPO\ufe0f"),
        ("PPO", "PPO\u3164"),
        ("A", "Α"),
    ],
)
@pytest.mark.parametrize("kind", ["egos", "traffic_models"])
def test_labels_that_look_alike_are_an_error(
    one: str, other: str, kind: str, tmp_path: Path
) -> None:
    entry = '- {%s: idm_mobil, label: "%s"}\n'
    what = "agent" if kind == "egos" else "traffic"
    lines = "".join(f"  {entry % (what, label)}" for label in (one, other))
    old = "  - agent: idm_mobil\n" if kind == "egos" else "  - traffic: idm_mobil\n"
    assert "look in tables as if called" in complaint(tmp_path, SUITE.replace(old, lines))


def test_labels_that_differ_may_look_similar(tmp_path: Path) -> None:
    path = tmp_path / "suite.yaml"
    labels = ("PPO", "ppo", "PPO 1", "PPO-1", "P.P.O", "Ümit", "Umit")
    entries = "".join(f"  - {{agent: idm_mobil, label: {label}}}\n" for label in labels)
    path.write_text(SUITE.replace("  - agent: idm_mobil\n", entries), encoding="utf-8")
    assert len(Document(path).validate(Suite).egos) == 8


def test_a_key_by_the_name_that_run_folders_have_is_rejected(tmp_path: Path) -> None:
    both = f"{SUITE}traffics:\n  - traffic: idm_mobil\n"
    assert "suite.yaml:11: traffics: unknown key" in complaint(tmp_path, both)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SuiteError, match=r"nowhere\.yaml: no such file"):
        Document(tmp_path / "nowhere.yaml")


def test_a_file_that_is_not_text_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "suite.yaml"
    path.write_bytes(b"suite: \xff\xfe")
    with pytest.raises(SuiteError, match="is not UTF-8 text"):
        Document(path)


def test_an_enormous_file_is_rejected_unread(tmp_path: Path) -> None:
    path = tmp_path / "suite.yaml"
    path.write_bytes(b"#" * (2**17 + 1))
    with pytest.raises(SuiteError, match="larger than 131,072 bytes"):
        Document(path)


@settings(
    derandomize=True,
    deadline=None,
    max_examples=200,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    position=st.integers(0, len(SUITE)),
    removed=st.integers(0, 12),
    inserted=st.text("ab:-[]{}&*!%@#'\"\n\t 019.,|>?~\x00é", max_size=12),
)
def test_a_damaged_suite_is_valid_or_rejected_in_words(
    tmp_path: Path, position: int, removed: int, inserted: str
) -> None:
    path = tmp_path / "suite.yaml"
    text = SUITE[:position] + inserted + SUITE[position + removed :]
    path.write_text(text, encoding="utf-8")
    message = f"{path}: nothing"
    try:
        Document(path).validate(Suite)
    except SuiteError as error:
        message = str(error)
    assert message.startswith(f"{path}:")
