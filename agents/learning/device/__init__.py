"""PPO whose tensors stay on a device."""
