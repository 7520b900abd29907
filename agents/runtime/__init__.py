"""The control loop in real time: a policy, a state estimator and a watchdog, over any machine.

`protocol` has what a machine's driver offers; `surface-gym runtime` runs a policy on one.
"""
