"""Agents and traffics: the contracts, the registry, ONNX policies and the scaffold."""
