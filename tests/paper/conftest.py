import pytest

from surface_gym.paper.reproduction import reproduce


@pytest.fixture(scope="session")
def reproduction():
    """Everything the paper tabulates, computed once for all tests of a worker."""
    return reproduce()
