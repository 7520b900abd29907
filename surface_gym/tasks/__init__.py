"""What is asked of the surface: a task owns starts, observation, reward terms and the end."""

from surface_gym.tasks.sort import Sort

TASKS = {"sort": Sort}
