"""Tuning of hyper-parameters by Optuna: what to search, the study, its report, the command."""
