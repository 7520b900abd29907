"""The comparison behind `python evaluate.py`: methods, benchmarks, tables, plots and videos."""
