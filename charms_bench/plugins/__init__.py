"""Agents, traffics and events: their interfaces, the registry, ONNX policies and the scaffold."""
