"""The simulated world: profiles, scenes, lanes, actions, observations, and their pictures."""
