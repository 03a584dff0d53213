"""Drawing for animations and environments: the picture of a scene, its colours, and a window."""
