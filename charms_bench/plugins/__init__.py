"""Who drives: the contracts, the registry of entry points, ONNX policies, the scaffold."""
