"""Learning of modules that decide each for itself: PPO with draws they share."""
