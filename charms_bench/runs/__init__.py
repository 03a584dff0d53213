"""Suite -> cells -> shards -> rows: YAML, workers, clusters and run folders."""
