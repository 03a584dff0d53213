"""Human driving as CHARMS learns from it: intents, soft labels and samples. Needs no torch."""
