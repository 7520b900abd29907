"""A stream of parcels along a line of modules, each to leave by its own exit."""
