"""The simulated world: profiles, scenes, lanes, actions and observations."""
