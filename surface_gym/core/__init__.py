"""Many environments at once: actions, resets, and the compiled kernel that steps them."""
