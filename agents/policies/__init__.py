"""Policies of Stable-Baselines3's networks, and policies of all kinds on disk."""
