"""The only users of Numba's internals: compiled functions, their cache, and other targets."""
