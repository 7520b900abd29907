"""How agents learn: configuration, runs, checkpoints and the algorithms."""
