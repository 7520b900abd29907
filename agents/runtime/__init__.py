"""The control loop in real time: a policy, a state estimator and a watchdog for any machine.

`protocol` defines the interface of a machine's driver. `surface-gym runtime` runs a policy.
"""
