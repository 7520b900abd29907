"""Control loop in real time: a policy controls a machine, with a state estimator and a watchdog.

`protocol` defines the interface of a machine's driver. `surface-gym runtime` runs a policy.
"""
