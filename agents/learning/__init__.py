"""Training of policies: configuration, run folders and the algorithms."""
