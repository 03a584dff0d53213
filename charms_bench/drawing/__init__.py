"""What animations and environments draw: the picture of a scene, its colours, and a window."""
