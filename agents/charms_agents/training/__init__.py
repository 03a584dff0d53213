"""How the packaged networks are trained; needs the extra `train`."""
