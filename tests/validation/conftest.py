import pytest

from surface_gym.validation.comparison import PUSHED, SlopeCase, run_case


@pytest.fixture(scope="session")
def mujoco():
    reason = "MuJoCo, of the extra `validation`, is not installed"
    return pytest.importorskip("mujoco", reason=reason)


@pytest.fixture(scope="session")
def tilted(mujoco):
    """Figure 12a."""
    del mujoco  # which it needs
    return run_case(SlopeCase(10.0))


@pytest.fixture(scope="session")
def pushed(mujoco):
    """Figure 12b."""
    del mujoco  # which it needs
    return run_case(PUSHED)
