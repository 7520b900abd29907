"""Inlined functions of the physics for callers in Python: the same source, standing alone."""

from surface_gym.dynamics import contacts, explicit, friction, normal_forces, step
from surface_gym.dynamics.compiled import compiled

find_contacts = compiled(contacts.find_contacts.py_func)
dual_normal_forces = compiled(normal_forces.dual_normal_forces.py_func)
implicit_velocity = compiled(friction.implicit_velocity.py_func)
explicit_acceleration = compiled(explicit.explicit_acceleration.py_func)
load_point = compiled(step.load_point.py_func)
find_support = compiled(step.find_support.py_func)
why_unborne = compiled(step.why_unborne.py_func)
bear_load = compiled(step.bear_load.py_func)
step_implicit = compiled(step.step_implicit.py_func)
step_explicit = compiled(step.step_explicit.py_func)
advance_implicit = compiled(step.advance_implicit.py_func)
advance_explicit = compiled(step.advance_explicit.py_func)
