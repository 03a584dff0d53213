"""Single episodes: criticality, edge cases, replays, descriptions of what happened, animations."""
