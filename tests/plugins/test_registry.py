"""Plugins by name: found without import, blamed by distribution, never ambiguous."""

import re
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from command_line import charms_bench

from charms_bench.errors import RegistryError
from charms_bench.foundation.workers import _end_spare
from charms_bench.plugins.event import Event
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import (
    AGENTS,
    EVENTS,
    TRAFFIC,
    make,
    make_agent,
    make_traffic,
    plugins,
)
from charms_bench.plugins.traffic import OneAgent


def test_the_outside_plugin_is_listed_with_its_distribution_and_version() -> None:
    plugin = plugins(AGENTS)["outside_policy"]
    assert (plugin.distribution, plugin.version) == ("outside-plugin", "1.2.3")
    assert plugins(TRAFFIC)["outside_traffic"].role == "traffic"


def test_listing_imports_no_plugin() -> None:
    code = (
        "import sys; from charms_bench.plugins.registry import *; plugins(AGENTS); "
        "plugins(TRAFFIC); "
        "print([name for name in sys.modules if 'outside' in name or 'charms_b' in name])"
    )
    listed = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert "outside_plugin" not in listed
    assert "charms_baselines" not in listed


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(RegistryError, match=r"no agent named 'stackelbrg'.*Did you mean 'stack"):
        make_agent("stackelbrg")


def test_a_broken_plugin_is_blamed_on_its_distribution_when_it_is_asked_for() -> None:
    expected = r"agent 'outside_broken' of outside-plugin 1\.2\.3 cannot be imported: Module"
    with pytest.raises(RegistryError, match=expected):
        make_agent("outside_broken")


def test_something_that_is_no_agent_is_rejected() -> None:
    with pytest.raises(RegistryError, match="is a NoAgent, not a Policy or a DriverModel"):
        make_agent("outside_no_agent")


CLASSES = {
    "Undefined": ("Event", "definition = 1"),
    "Silent": ("Event", ""),
    "Late": ("Traffic", "agents = ('idm_mobil',)\n    after_deviation = None"),
    "Nameless": ("Traffic", "agents = ('',)"),
    "Numbered": ("DriverModel", "files_sha256 = 7"),
    "Weighed": ("Policy", "weights_sha256 = b'x'"),
}
METHODS = "\n".join(f"    def {name}(self, *given): pass" for name in ("level", "assign", "drive"))


@pytest.mark.parametrize(
    ("name", "group", "message"),
    [
        ("Silent", EVENTS, "has no `definition`; expected a text"),
        ("Undefined", EVENTS, "has definition 1; expected a text"),
        ("Late", TRAFFIC, "has after_deviation None; expected a text"),
        ("Nameless", TRAFFIC, r"has agents \('',\); a name is empty"),
        ("Numbered", AGENTS, "has files_sha256 7; expected a text"),
        ("Weighed", AGENTS, "has weights_sha256 b'x'; expected a text"),
    ],
)
def test_an_attribute_of_another_type_is_named(
    name: str, group: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    base, body = CLASSES[name]
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / f"of_{name.lower()}.py").write_text(
        f"from charms_bench import {base}\n\nclass {name}({base}):\n"
        f"    {body}\n{METHODS}\n    def decide(self, *given): pass\n"
    )
    known = tmp_path / "attributes-0.1.dist-info"
    known.mkdir()
    (known / "METADATA").write_text("Metadata-Version: 2.1\nName: attributes\nVersion: 0.1\n")
    (known / "entry_points.txt").write_text(f"[{group}]\nmade = of_{name.lower()}:{name}\n")
    of_events = partial(make, EVENTS, options=None, kind=Event)
    made_by = {AGENTS: make_agent, TRAFFIC: make_traffic, EVENTS: of_events}[group]
    with pytest.raises(RegistryError, match=message):
        made_by("made")


def test_options_an_agent_does_not_take_are_named() -> None:
    with pytest.raises(RegistryError, match=r"has no option 'gian'\. Did you mean 'gain'"):
        make_agent("stackelberg", {"gian": 0.2})


def test_a_plugin_that_is_installed_later_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    assert "late" not in plugins(AGENTS)
    known = tmp_path / "late-0.1.dist-info"
    known.mkdir()
    (known / "METADATA").write_text("Metadata-Version: 2.1\nName: late\nVersion: 0.1\n")
    (known / "entry_points.txt").write_text(f"[{AGENTS}]\nlate = late:Late\n")
    assert plugins(AGENTS)["late"].distribution == "late"


def test_a_name_that_two_distributions_claim_cannot_be_used_and_the_others_can(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = tmp_path / "thief-0.1.dist-info"
    known.mkdir()
    (known / "METADATA").write_text("Metadata-Version: 2.1\nName: thief\nVersion: 0.1\n")
    lines = (f"[{AGENTS}]", "idm_mobil = thief:A", f"[{TRAFFIC}]", "stackelberg = thief:T")
    (known / "entry_points.txt").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(tmp_path)
    _end_spare()  # one that another test left would not find the folder
    claim = "is claimed by two distributions, .*thief.*; uninstall one of them"
    for each in (make_agent, make_traffic):
        with pytest.raises(RegistryError, match=f"'idm_mobil' {claim}"):
            each("idm_mobil")
    with pytest.raises(RegistryError, match=f"the traffic 'stackelberg' {claim}"):
        make_traffic("stackelberg")
    assert make_agent("stackelberg")
    listed = charms_bench("agents")
    assert listed.returncode == 0
    assert re.search(r" and .*: unusable, uninstall one\n[^:]* idm_mobil ", listed.stdout)
    used = charms_bench("check", "idm_mobil")
    assert used.returncode == 2
    assert "charms-bench and thief" in used.stderr or "thief and charms-bench" in used.stderr


def test_an_agents_name_is_also_that_of_a_traffic() -> None:
    traffic = make_traffic("stackelberg")
    assert isinstance(traffic, OneAgent)
    assert traffic.agents == ("stackelberg",)


def test_a_name_that_ends_in_onnx_is_the_path_of_a_network(
    network_file: Callable[..., Path],
) -> None:
    path = str(network_file())
    assert isinstance(make_agent(path), OnnxPolicy)
    assert make_traffic(path).agents == (path,)
    with pytest.raises(RegistryError, match=r"policy\.onnx takes no options, got gain"):
        make_agent(path, {"gain": 1})


def test_an_unknown_traffic_lists_traffics_and_agents() -> None:
    with pytest.raises(RegistryError, match=r"no traffic named 'x'.*outside_traffic.*stackelberg"):
        make_traffic("x")


def test_a_message_has_no_address_of_an_object() -> None:
    with pytest.raises(RegistryError) as caught:
        make_agent("stackelberg", {"gain": object()})
    assert " at 0x" not in str(caught.value)
    assert str(RegistryError(f"found {object()!r}")) == "found <object object>"
