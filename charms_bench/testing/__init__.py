"""Plugins held against their contract, engines against each other and against the clock."""

from charms_bench.testing.contract import agent_rules, example_scene, traffic_rules

__all__ = ["agent_rules", "example_scene", "traffic_rules"]
