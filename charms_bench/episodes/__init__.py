"""One episode looked at: criticality, edge cases, replay, what happened, animation."""
