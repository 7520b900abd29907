import pytest

from surface_gym.paper.reproduction import Reproduction, reproduce


@pytest.fixture(scope="session")
def reproduction() -> Reproduction:
    """Everything the paper tabulates, computed once for all tests of a worker."""
    return reproduce()
