"""What is simulated: profiles, scenes, lanes, actions and observations."""
