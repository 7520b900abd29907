"""What a flow pays, parcel by parcel, and for the surface as a whole."""

from surface_gym.flow.features import exit_start
from surface_gym.flow.memory import LEFT_RIGHT, LEFT_WRONG, REACH, SIDE, TOUCHED
from surface_gym.physics.jit import inlined
from surface_gym.physics.types import THETA, VX, VY, X, Y
from surface_gym.state import EnvState, reach_along
from surface_gym.tasks.sort import lateral_reach

# The reward, term by term; the first are paid for each parcel.
PARCEL_TERMS: tuple[str, ...] = ("right", "wrong", "touch", "reach", "time")
TERMS: tuple[str, ...] = (*PARCEL_TERMS, "waiting", "jam")
RIGHT_REWARD = 1.0  # once, as a parcel leaves by its exit
WRONG_REWARD = -1.0  # once, as it leaves by another, or between exits
TOUCH_REWARD = -0.5  # for each parcel that begins to touch another
REACH_REWARD = 1.0  # per metre of reach gained
ON_THE_WAY = 0.2  # [-] what a metre towards the exit's start, or the line's end, counts of it
REACH_ENOUGH = 0.6  # [m] reach beyond this earns nothing more
TIME_REWARD = -0.2  # per second of each parcel on the line
WAITING_REWARD = -0.1  # per second of each parcel that waits to enter
JAM_REWARD = -10.0  # once, as nothing moves any more
WAITING, JAMMED = len(PARCEL_TERMS), len(PARCEL_TERMS) + 1  # places of the surface's own


@inlined
def _reach(state: EnvState) -> float:
    """[m] how far a parcel has come towards its exit: along the line, and from the exit's start on
    in lateral reach to the asked side; straight on, how near the middle it has stayed.
    """
    truth = state.truth
    side = state.goal[SIDE]
    offset = truth[Y] - state.elements.line_y
    rear = truth[X] - reach_along(state, truth[THETA], -1.0, 0.0)
    if side == 0.0:
        return ON_THE_WAY * rear - abs(offset)
    start = exit_start(state)
    way = ON_THE_WAY * min(rear, start)
    if rear < start:
        return way
    lateral = lateral_reach(side * offset, truth[VX], side * truth[VY])
    return way + max(0.0, min(REACH_ENOUGH, lateral))


@inlined
def begin_reward(state: EnvState) -> None:
    """A parcel has entered: what it has reached so far earns nothing; its true motion is up to
    date.
    """
    state.memory[REACH] = _reach(state)
    state.memory[TOUCHED] = 0.0


@inlined
def reward_parcel(state: EnvState, outcome: int) -> float:
    """Write a parcel's terms, and give their sum; its true motion is up to date."""
    reach = _reach(state)
    terms = state.terms
    terms[0] = RIGHT_REWARD if outcome == LEFT_RIGHT else 0.0
    terms[1] = WRONG_REWARD if outcome == LEFT_WRONG else 0.0
    terms[2] = TOUCH_REWARD * state.memory[TOUCHED]
    terms[3] = REACH_REWARD * (reach - state.memory[REACH])
    terms[4] = TIME_REWARD * state.period
    state.memory[REACH] = reach
    state.memory[TOUCHED] = 0.0
    return terms[0] + terms[1] + terms[2] + terms[3] + terms[4]
