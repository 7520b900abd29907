"""Which tests go first, and which are enough for a first look."""

# By the beginning of their names: those that compile most, then those that take longest. Whoever
# comes later finds the code compiled, and short tests at the end leave no processor waiting.
FIRST = (
    "tests/test_vector_env.py::TestBesideSingles",
    "tests/flow/test_env.py",
    "tests/test_env.py",
    "tests/test_axes.py",
    "tests/agents/rules/",
    "tests/test_own.py",
    "tests/agents/test_programs.py",
    "tests/agents/test_tasks.py",
    "tests/parallel/",
    "tests/agents/learning/",
    "tests/design/test_control.py",
    "tests/agents/evaluation/",
    "tests/docs/test_notebooks.py",
    "tests/cuda/test_ptx.py",
)

# Of each part those that fail first when it breaks, and one environment of each class.
SMOKE = (
    "tests/agents/learning/test_config.py",
    "tests/agents/test_library.py",
    "tests/agents/rules/test_sorting.py",
    "tests/design/test_search.py",
    "tests/physics/test_step.py",
    "tests/physics/test_friction.py",
    "tests/physics/test_signed_distance.py",
    "tests/flow/test_env.py::TestEpisodes::test_action_spaces",
    "tests/flow/test_exits.py",
    "tests/flow/test_stream.py",
    "tests/rendering/test_scene.py",
    "tests/test_env.py::TestEpisodes::test_outcomes_of_sort",
    "tests/test_layouts.py",
    "tests/test_parcel.py",
    "tests/test_config.py",
    "tests/test_simulation.py",
    "tests/test_surface.py",
    "tests/test_vector_env.py::TestBesideSingles::test_one_by_one",
)


def place_of(name: str) -> int:
    """Place of a test in the order, by its name; those not in FIRST share the last."""
    found = (k for k, beginning in enumerate(FIRST) if name.startswith(beginning))
    return next(found, len(FIRST))
