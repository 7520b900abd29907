"""Everything that decides axes: fixed layouts, learning agents, their files and comparison."""
