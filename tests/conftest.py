"""Settings of every test."""

from hypothesis import settings

# The same examples from run to run; the first one may wait for the compiler.
settings.register_profile("surface_gym", deadline=None, derandomize=True, max_examples=60)
settings.load_profile("surface_gym")
