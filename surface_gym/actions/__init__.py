"""What an action says, which modules it sets, and what an observation shows of them."""

from surface_gym.actions.kinds import ANY, KINDS, ActionKind

__all__ = ["ANY", "KINDS", "ActionKind"]
