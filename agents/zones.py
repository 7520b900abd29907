"""Lines whose zone is longer or shorter than the study's."""

from dataclasses import replace

from surface_gym.lines import Line


def with_zone(line: Line, columns: int) -> Line:
    """A line whose zone has so many columns, and as many behind it as before."""
    longer = columns - line.zone_columns
    return replace(line, columns=line.columns + longer, zone_columns=columns)


def time_for(line: Line, columns: int) -> float:
    """[-] times as long as on a line an episode may last where the zone has so many columns."""
    return max(1.0, columns / line.zone_columns)
