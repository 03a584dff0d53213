"""Tests of plugins against their rules, a comparison of the engines, and speed measurements."""

from charms_bench.testing.contract import agent_rules, example_scene, traffic_rules

__all__ = ["agent_rules", "example_scene", "traffic_rules"]
