"""Names of files: safe, short, and never the same for two titles."""

import pytest

from charms_bench.foundation.names import name_of_agent, slug, slugs


@pytest.mark.parametrize(
    ("title", "name"),
    [
        ("CHARMS safe-prosocial", "charms-safe-prosocial"),
        ("idm_mobil", "idm_mobil"),
        ("../../etc/passwd", "etc-passwd"),
        ("<>", "unnamed"),
        ("Übung", "übung"),
    ],
)
def test_a_name_has_only_letters_digits_underscores_and_hyphens(title: str, name: str) -> None:
    assert slug(title) == name


def test_titles_that_differ_only_in_signs_get_different_names() -> None:
    assert slugs(["A/B", "A B", "a-b", "a-b-2"]) == ["a-b", "a-b-2", "a-b-3", "a-b-2-2"]


def test_a_long_title_fits_into_the_255_bytes_of_a_file_name() -> None:
    assert len(slug("界" * 80).encode()) <= 50


def test_networks_of_the_same_name_in_two_folders_get_different_names() -> None:
    assert name_of_agent("one/net.onnx") != name_of_agent("two/net.onnx")
    assert name_of_agent("charms-safe-altruistic") == "charms-safe-altruistic"
