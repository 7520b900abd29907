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


_STEPS = ("tests/physics", "tests/test_simulation.py")
_WORLDS = ("tests/physics/test_contact_solver.py", "tests/test_together.py")
_ENVS = (
    "tests/test_env_physics.py",
    "tests/test_env.py",
    "tests/test_vector_env.py",
    "tests/test_vector_env_resets.py",
    "tests/test_axes.py",
)
_PAGES = "tests/test_pages.py"  # what the environments show is checked there
_TASKS = ("tests/tasks", "tests/test_env.py")


def _physics(name: str, *wide: str, near: str = "") -> Target:
    """Make the target of a module of the physics."""
    tests = (f"tests/physics/test_{near or name}.py",)
    return Target("physics", f"surface_gym/physics/{name}.py", tests, wide or _STEPS)


def _task(name: str) -> Target:
    """Make the target of a task."""
    near = (f"tests/tasks/test_{name}.py", _PAGES)
    return Target("tasks", f"surface_gym/tasks/{name}.py", near, _TASKS)


def _env(module: str, near: tuple[str, ...], *wide: str) -> Target:
    """Make the target of a module that environments are made of."""
    tests = tuple(f"tests/{name}.py" for name in near)
    return Target("environments", f"surface_gym/{module}.py", tests, wide)


def _sensor(name: str, near: str, *wide: str) -> Target:
    """Make the target of a module of the sensors."""
    tests = (f"tests/sensors/test_{near}.py",)
    return Target("sensors", f"surface_gym/sensors/{name}.py", tests, ("tests/sensors", *wide))


def _agent(module: str, *near: str, wide: tuple[str, ...] = ()) -> Target:
    """Make the target of a module of the agents."""
    tests = tuple(f"tests/agents/{name}" for name in near)
    return Target("agents", f"agents/{module}.py", tests, tuple(f"tests/agents/{w}" for w in wide))


def _design(name: str) -> Target:
    """Make the target of a module that designs a line."""
    near = (f"tests/design/test_{name}.py",)
    return Target("design", f"surface_gym/design/{name}.py", near, ("tests/design",))


def _flow(name: str, near: str = "") -> Target:
    """Make the target of a module of streams of parcels."""
    tests = (f"tests/flow/test_{near or name}.py",)
    return Target("flow", f"surface_gym/flow/{name}.py", tests, ("tests/flow",))


TARGETS = (
    _physics("normal_forces"),
    _physics("friction"),
    _physics("contacts"),
    _physics("step", *_STEPS, "tests/test_axes.py"),
    _physics("references", near="step"),
    _physics("signed_distance", *_WORLDS),
    _physics("island", *_WORLDS),
    _physics("contact_solver", *_WORLDS[1:]),
    _physics("impact", *_WORLDS),
    _task("sort"),
    _task("slow"),
    _task("stop"),
    _task("orient"),
    _task("track"),
    Target(
        "tasks",
        "surface_gym/tasks/base.py",
        ("surface_gym/tasks/slow.py", "tests/tasks/test_slow.py", "tests/tasks/test_stop.py",
         _PAGES),
        _TASKS,
    ),
    _sensor("base", "camera", "tests/test_config.py"),
    _sensor("camera", "camera", "tests/test_config.py", "tests/agents/runtime/test_estimator.py"),
    _env("parcel", ("test_parcel",), "tests/test_presets.py"),
    _env("state", ("tasks/test_base", "tasks/test_sort"), *_TASKS, *_ENVS),
    _env(
        "vector_env", ("test_vector_env_resets",),
        "tests/test_vector_env.py", "tests/test_own.py",
    ),
    _env("core/resets", ("core/test_batch",), *_ENVS),
    _env("core/actions", ("core/test_batch",), "tests/test_actuators.py", "tests/test_axes.py",
         "tests/test_presets.py"),
    _env(
        "randomisation", ("test_actuators", "test_randomisation"),
        "tests/test_env_starts.py", "tests/test_config.py",
    ),
    *(
        _agent(f"rules/{name}", f"rules/test_{near}.py", wide=("rules",))
        for name, near in (
            ("braking", "braking"), ("base", "braking"), ("steering", "steering"),
            ("sorting", "layouts"), ("layouts", "layouts"), ("streams", "streams"),
        )
    ),
    *(
        _agent(f"scheduling/{name}", f"scheduling/test_{name}.py", wide=("scheduling",))
        for name in ("trajectories", "maneuvers", "scheduler", "bounds", "features", "decisions")
    ),
    _agent("planning/planner", "planning/test_planner.py"),
    _agent("planning/models", "planning/test_models.py", wide=("planning",)),
    _agent("planning/oracle", "planning/test_oracle.py", wide=("planning",)),
    _agent("planning/receding_horizon", "planning/test_receding_horizon.py"),
    _agent("vec_env", "test_vec_env.py", wide=("test_symmetry.py",)),
    _agent("base", "test_symmetry.py", wide=("test_vec_env.py",)),
    _agent("rollout", "test_rollout.py", wide=("evaluation",)),
    _agent("module_policy", "test_module_view.py", wide=("test_module_policy.py",)),
    _agent("export/onnx", "export/test_export.py", wide=("export",)),
    *(
        _agent(f"runtime/{name}", f"runtime/test_{name}.py", wide=("runtime",))
        for name in ("controller", "estimator", "protocol", "simulator")
    ),
    _agent("learning/runs", "learning/test_runs.py", wide=("learning",)),
    *(
        _agent(
            f"evaluation/{name}", f"evaluation/test_{near}.py",
            wide=("evaluation", "test_programs.py"),
        )
        for name, near in (
            ("benchmark", "benchmark"), ("capacity", "streams"), ("robustness", "robustness"),
            ("report", "report"),
        )
    ),
    _agent("tuning/study", "tuning/test_study.py", wide=("tuning",)),
    *(_design(name) for name in ("case", "limits", "search", "sweep", "control")),
    *(_flow(name) for name in ("arrivals", "exits", "stream")),
    _flow("batch", "env"),
    _flow("task", "features"),
)  # fmt: skip


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
        "sine = (octant == 2.0) * 1.0 - (octant == 6.0) * 1.0",
        "sine = (octant == 2.0) / 1.0 - (octant == 6.0) * 1.0",
        "over 1 is times 1",
    ),
    Equivalent(
        "surface_gym/physics/contact_solver.py",
        "resolve_overlaps",
        "apart = True",
        "apart = False",
        "further sweeps find every pair apart and move nothing",
    ),
    Equivalent(
        "surface_gym/parcel.py",
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
        "watch",
        "if state.sensor_state[place + TAKEN] > 0.0:",
        "if state.sensor_state[place - TAKEN] > 0.0:",
        "TAKEN is 0",
    ),
    Equivalent(
        "surface_gym/sensors/camera.py",
        "_take",
        "row = state.noise_row[0]",
        "row = state.noise_row[ -1]",
        "the array has one number, which is its first and its last",
    ),
    Equivalent(
        "surface_gym/sensors/base.py",
        "enter",
        "state.sensor_state[3 + k] = state.truth[3 + k] + velocity_error * state.noise[row + 1, k]",
        "state.sensor_state[3 + k] = state.truth[3 + k] - velocity_error * state.noise[row + 1, k]",
        "the noise is as likely to be the other way round",
    ),
    Equivalent(
        "agents/vec_env.py",
        "finish",
        '"reward_terms": dict(zip(self._names, self._terms[i].tolist(), strict=True)),',
        '"reward_terms": dict(zip(self._names, self._terms[i].tolist(), strict=False)),',
        "there are as many sums as names",
    ),
    Equivalent(
        "surface_gym/randomisation.py",
        "_draw_parcel",
        "moved = offset + self.com_offset * half * rng.uniform(-1.0, 1.0, 2)",
        "moved = offset - self.com_offset * half * rng.uniform(-1.0, 1.0, 2)",
        "a load is as likely to lie to the other side",
    ),
    Equivalent(
        "surface_gym/design/limits.py",
        "curve_rows",
        "for value, share in zip(span.values.tolist(), span.share.tolist(), strict=True):",
        "for value, share in zip(span.values.tolist(), span.share.tolist(), strict=False):",
        "there are as many shares as values",
    ),
    Equivalent(
        "agents/rollout.py",
        "run_sequentially",
        "pose=stack_poses([run.pose[:, 0] for run in runs]),",
        "pose=stack_poses([run.pose[:, -1] for run in runs]),",
        "each run is of one environment, which is its first and its last",
    ),
    Equivalent(
        "agents/base.py",
        "mirrored_orientations",
        "if (apart[np.arange(len(angles)), nearest] > SAME).any():",
        "if (apart[np.arange(len(angles)), nearest] >= SAME).any():",
        "angles exactly 1e-6 rad apart: their round-off is on either side of it",
    ),
)
