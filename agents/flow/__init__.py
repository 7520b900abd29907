"""Controllers of a flow, how they are compared, and what no controller can exceed."""
