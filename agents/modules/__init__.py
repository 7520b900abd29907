"""One agent for surfaces of any size: each module chooses its own axis, by weights all share."""
