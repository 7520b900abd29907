"""Modules of the mutation test with the tests that should detect a fault in each, and the mutants
that none can detect.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Target:
    """A module and its tests: paths from the repository's root, as pytest takes them."""

    area: str
    module: str
    near: tuple[str, ...]  # its own tests, run first, after the examples in its text
    wide: tuple[str, ...] = ()  # of what is built on it, run for the mutants that are left


_STEPS = ("tests/dynamics", "tests/test_simulation.py")
_TOGETHER = ("tests/physics/test_contact_solver.py", "tests/test_together.py")
_LANES = (
    "tests/test_env_physics.py",
    "tests/test_env.py",
    "tests/test_vector_env.py",
    "tests/test_vector_env_resets.py",
    "tests/test_axes.py",
)
_PAGES = "tests/test_pages.py"  # of the environments: what they show is told there
_TASKS = ("tests/tasks", "tests/test_env.py")
_RULES = ("tests/agents/rules/test_rules.py",)


def _physics(name: str, *wide: str) -> Target:
    near = (f"tests/dynamics/test_{name}.py",)
    return Target("physics", f"surface_gym/dynamics/{name}.py", near, wide or _STEPS)


def _task(name: str) -> Target:
    near = (f"tests/tasks/test_{name}.py", _PAGES)
    return Target("tasks", f"surface_gym/tasks/{name}.py", near, _TASKS)


def _agent(module: str, *near: str, wide: tuple[str, ...] = ()) -> Target:
    return Target("agents", f"agents/{module}.py", tuple(f"tests/agents/{n}" for n in near), wide)


TARGETS = (
    _physics("normal_forces"),
    _physics("friction"),
    _physics("contacts"),
    _physics("step"),
    _physics("explicit"),
    _physics("axes", *_STEPS, "tests/test_axes.py"),
    _physics("gap", *_TOGETHER),
    _physics("solving", *_TOGETHER),
    Target("physics", "surface_gym/physics/contact_solver.py", _TOGETHER[:1], _TOGETHER[1:]),
    _task("sort"),
    _task("slow"),
    _task("stop"),
    _task("orient"),
    _task("track"),
    Target(
        "tasks",
        "surface_gym/tasks/line.py",
        (
            "surface_gym/tasks/slow.py",
            "tests/tasks/test_slow.py",
            "tests/tasks/test_stop.py",
            _PAGES,
        ),
        _TASKS,
    ),
    Target(
        "sensors",
        "surface_gym/sensors/camera.py",
        ("tests/sensors/test_camera.py",),
        ("tests/sensors", "tests/test_settings.py"),
    ),
    Target(
        "sensors",
        "surface_gym/sensors/base.py",
        ("tests/sensors/test_camera.py",),
        ("tests/sensors", "tests/test_settings.py"),
    ),
    Target(
        "sensors",
        "surface_gym/sensors/adaptive.py",
        ("tests/sensors/test_adaptive.py",),
        ("tests/sensors", "tests/agents/runtime/test_shadow.py"),
    ),
    Target(
        "sensors",
        "surface_gym/sensors/camera.py",
        ("tests/sensors/test_adaptive.py",),
        ("tests/sensors", "tests/agents/runtime/test_shadow.py"),
    ),
    Target(
        "environments",
        "surface_gym/parcel.py",
        ("tests/test_parcel.py",),
        ("tests/test_conditions.py",),
    ),
    Target(
        "environments",
        "surface_gym/state.py",
        ("tests/tasks/test_base.py", "tests/tasks/test_sort.py"),
        (*_TASKS, *_LANES),
    ),
    Target(
        "environments",
        "surface_gym/faces/vector.py",
        ("tests/test_vector_env_resets.py",),
        ("tests/test_vector_env.py", "tests/test_vector_env_contract.py", "tests/test_own.py"),
    ),
    Target(
        "environments",
        "surface_gym/core/resets.py",
        ("tests/core/test_resets.py",),
        _LANES,
    ),
    Target(
        "environments",
        "surface_gym/core/actions.py",
        ("tests/core/test_actions.py",),
        ("tests/actions", "tests/test_actuators.py", "tests/test_axes.py"),
    ),
    Target(
        "environments",
        "surface_gym/randomisation.py",
        ("tests/test_actuators.py",),
        ("tests/test_settings.py",),
    ),
    Target(
        "environments",
        "surface_gym/randomisation.py",
        ("tests/test_randomisation.py",),
        ("tests/test_env_starts.py", "tests/test_settings.py"),
    ),
    *(
        _agent(f"rules/{name}", "rules/test_braking.py", wide=_RULES)
        for name in ("braking", "brake_model", "footing", "friction_estimate")
    ),
    _agent(
        "rules/turning",
        "rules/test_steering.py::test_the_turning_rule_turns_to_any_angle",
        "rules/test_steering.py::test_modules_that_turn_a_parcel_drag_its_front_one_way_and_its_rear"
        "_the_other",
        wide=_RULES,
    ),
    _agent("planning/search", "test_planner.py"),
    _agent("planning/aims", "test_planner.py"),
    _agent("planning/known", "planning/test_known.py", wide=("tests/agents/planning",)),
    _agent("planning/knowing", "planning/test_knowing.py", wide=("tests/agents/planning",)),
    _agent("vec_env", "test_vec_env.py", wide=("tests/agents/test_mirror.py",)),
    _agent("mirror", "test_mirror.py", wide=("tests/agents/test_vec_env.py",)),
    _agent("episodes", "test_episodes.py", wide=("tests/agents/evaluation",)),
    _agent("modules/view", "modules/test_view.py", wide=("tests/agents/modules",)),
    _agent("modules/outline", "modules/test_outline.py", wide=("tests/agents/modules",)),
    _agent("export/formula", "export/test_formula.py", wide=("tests/agents/export",)),
    _agent("runtime/loop", "runtime/test_loop.py", wide=("tests/agents/runtime",)),
    _agent("learning/checkpoint", "learning/test_resume.py", wide=("tests/agents/learning",)),
    _agent(
        "evaluation/statistics", "evaluation/test_statistics.py", wide=("tests/agents/evaluation",)
    ),
)


@dataclass(frozen=True)
class Equivalent:
    """A mutant that no test can distinguish from the code."""

    module: str  # path from the repository's root
    function: str  # that the line is in
    was: str
    becomes: str
    why: str


EQUIVALENTS = (
    Equivalent(
        "surface_gym/physics/friction.py",
        "",
        "MAX_ITERATIONS = 100",
        "MAX_ITERATIONS = 99",
        "a guard: Newton ends after a few of them",
    ),
    Equivalent(
        "surface_gym/physics/step.py",
        "axis_direction",
        "sine = (place == 2.0) * 1.0 - (place == 6.0) * 1.0",
        "sine = (place == 2.0) / 1.0 - (place == 6.0) * 1.0",
        "over 1 is times 1",
    ),
    Equivalent(
        "surface_gym/physics/contact_solver.py",
        "part",
        "apart = True",
        "apart = False",
        "further sweeps find every pair apart and move nothing",
    ),
    Equivalent(
        "surface_gym/core/resets.py",
        "",
        "NO_EDGE = (0.0, 1.0, 1e9)  # that no point lies beyond, to fill a parcel's edges up",
        "NO_EDGE = ( 1.0, 1.0, 1e9)  # that no point lies beyond, to fill a parcel's edges up",
        "at such a distance an edge of any direction bounds nothing",
    ),
    Equivalent(
        "surface_gym/state.py",
        "reach_along",
        "farthest = -1.0",
        "farthest = - 0.0",
        "corners are about their centroid: one of them reaches beyond 0, or all are a disc's, at 0",
    ),
    Equivalent(
        "surface_gym/sensors/camera.py",
        "look",
        "if lane.sensor_state[place + TAKEN] > 0.0:",
        "if lane.sensor_state[place - TAKEN] > 0.0:",
        "TAKEN is 0",
    ),
    Equivalent(
        "surface_gym/sensors/camera.py",
        "_take",
        "row = lane.noise_row[0]",
        "row = lane.noise_row[ -1]",
        "the array has one number, which is its first and its last",
    ),
    Equivalent(
        "surface_gym/sensors/base.py",
        "enter",
        "lane.sensor_state[3 + k] = lane.truth[3 + k] + velocity_error * lane.noise[row + 1, k]",
        "lane.sensor_state[3 + k] = lane.truth[3 + k] - velocity_error * lane.noise[row + 1, k]",
        "the noise is as likely to be the other way round",
    ),
    Equivalent(
        "agents/vec_env.py",
        "step_wait",
        '"reward_terms": dict(zip(names, self._terms[:, lane].tolist(), strict=True)),',
        '"reward_terms": dict(zip(names, self._terms[:, lane].tolist(), strict=False)),',
        "there are as many sums as names",
    ),
    Equivalent(
        "agents/symmetry.py",
        "mirrored_orientations",
        "if (apart[np.arange(len(angles)), nearest] > SAME).any():",
        "if (apart[np.arange(len(angles)), nearest] >= SAME).any():",
        "angles exactly 1e-6 rad apart: their round-off is on either side of it",
    ),
)
