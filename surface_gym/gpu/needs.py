"""What a batch on a GPU needs, and errors that say what is missing."""

from importlib.util import find_spec

from surface_gym.flow.settings import FlowSettings
from surface_gym.settings import Settings

EXTRA = 'pip install "surface_gym[gpu]"'


class DeviceMissing(RuntimeError):
    """There is no GPU to run on, or not what it takes to use one."""


def check_device() -> None:
    """Raise DeviceMissing where there is no GPU, or a library to use it is not installed."""
    for module in ("torch", "numba_cuda"):
        if find_spec(module) is None:
            raise DeviceMissing(f"device='cuda' needs {module}, which is not installed: {EXTRA}")
    import torch
    from numba import cuda

    if not torch.cuda.is_available():
        why = "was built without CUDA" if torch.version.cuda is None else "finds none"
        raise DeviceMissing(f"device='cuda' needs an NVIDIA GPU; torch {torch.__version__} {why}")
    if not cuda.is_available():
        raise DeviceMissing("device='cuda' needs an NVIDIA GPU that Numba can use; it finds none")


def check_settings(settings: Settings) -> None:
    """Raise a ValueError for what is not there on a GPU yet: all that is drawn from a lane's
    generator after its start, whose place in the stream the host does not know; and infos that the
    host works out.
    """
    check_sensor(settings)
    varies, share = settings.randomisation, settings.actuators.stuck_share
    for name, refused, allowed, value in (
        ("randomisation", varies.varies, "Randomisation(), without variation", varies),
        ("stuck_share", share > 0.0, "0; stuck names modules that are", share),
        ("info", bool(settings.info), "()", settings.info),
    ):
        if refused:
            raise ValueError(f"{name} must be {allowed}, where device is 'cuda', got {value!r}")


def check_sensor(settings: Settings | FlowSettings) -> None:
    """Raise a ValueError for a sensor with noise."""
    if settings.draws > 0:
        raise ValueError(
            f"sensors must be one without noise, such as Exact(), where device is 'cuda', "
            f"got {settings.sensors!r}"
        )
