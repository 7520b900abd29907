"""The only physics: compiled scalar functions, and slower references to hold them against."""
