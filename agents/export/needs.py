"""What a machine has to know of each feature of an observation."""

from surface_gym.core.actions import GROUPS, group_features
from surface_gym.tasks.base import Feature

POSE = "the parcel's place and angle: a camera, or switches in the modules, and a filter"
VELOCITY = "the parcel's velocity: a filter's, from its pose over time"
BOTH = "the parcel's pose and velocity, as above, and what is asked of it"
OUTLINE = "the parcel's outline: a scale drawing, or a picture of it"
POSE_AND_OUTLINE = "the parcel's pose and its outline"
ASKED = "what is asked of this parcel: the order"
TO_GO = "the parcel's pose, and what is asked of it"
CLOCK = "a clock, started as the parcel enters"
ENTRY = "the parcel's speed as it enters: the conveyor's before the surface"
PATH = "the path that is asked for, and the parcel's place beside it"
TILT = "how the surface stands: measured once"
AXES = "each axis' angle: an encoder, or reckoned from what it was told; and the parcel's pose"
WINDOW = "the parcel's pose and outline, or a switch in each module"
LOAD = "a filter that learns where the parcel's load lies and how it rubs, from how it moves"
UNKNOWN = "what its meaning says: see `observe` of the task"

# By a feature's name, by how it begins, or by the group that it is of.
_NAMES = {
    "lateral offset": POSE, "sine of theta": POSE, "cosine of theta": POSE,
    "sine of phase x": POSE, "cosine of phase x": POSE,
    "sine of phase y": POSE, "cosine of phase y": POSE,
    "forward speed": VELOCITY, "lateral speed": VELOCITY, "turning speed": VELOCITY,
    "size": OUTLINE, "length": OUTLINE, "width": OUTLINE, "fill": OUTLINE,
    "clearance": POSE_AND_OUTLINE, "distance into zone": POSE_AND_OUTLINE,
    "front in zone": POSE_AND_OUTLINE, "rear to go": POSE_AND_OUTLINE,
    "side": ASKED, "asked ratio": ASKED, "asked angle": ASKED, "asked speed": ASKED,
    "to go": TO_GO, "to go, near": TO_GO, "to go, nearest": TO_GO,
    "angle to turn": TO_GO, "angle to turn, near": TO_GO,
    "excess of speed": BOTH, "fine excess": BOTH, "speed error": BOTH,
    "entry speed": ENTRY, "time": CLOCK, "tilt": TILT,
    "cross error": PATH, "fine cross error": PATH,
}  # fmt: skip
_BEGIN = {
    "slope ": PATH, "occupied ": WINDOW, "rotors ": AXES, "cosine of rotors ": AXES,
    "sine of rotors ": AXES, "cosine of axis ": AXES, "sine of axis ": AXES,
}  # fmt: skip
_LEARNED = tuple(name for name in GROUPS if name == "load")


def need_of(feature: Feature) -> str:
    """What has to be known for a feature; `UNKNOWN` for one of a task of one's own."""
    if feature.name in _NAMES:
        return _NAMES[feature.name]
    if any(feature.name == each.name for each in group_features(_LEARNED)):
        return LOAD
    begins = (told for name, told in _BEGIN.items() if feature.name.startswith(name))
    return next(begins, UNKNOWN)
