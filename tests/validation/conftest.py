import pytest

from surface_gym.validation.comparison import PUSHED, Case, run_case


@pytest.fixture(scope="session")
def tilted():
    """Figure 12a."""
    pytest.importorskip("mujoco", reason="MuJoCo, of the extra `validation`, is not installed")
    return run_case(Case(10.0))


@pytest.fixture(scope="session")
def pushed():
    """Figure 12b."""
    pytest.importorskip("mujoco", reason="MuJoCo, of the extra `validation`, is not installed")
    return run_case(PUSHED)
