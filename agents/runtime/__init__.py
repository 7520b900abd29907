"""The control loop in real time: a policy, a filter and a watchdog over a machine of any make.

`device` says what a machine's driver offers; `python -m agents.runtime` runs a policy on one.
"""
