"""The comparison behind `python evaluate.py`: who is compared, under what, and how it is told."""
