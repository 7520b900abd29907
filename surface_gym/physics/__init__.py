"""The only physics: compiled scalar functions, and slower references to check them against."""
