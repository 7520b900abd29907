"""Batches of environments on a GPU, compiled from the CPU's source. Experimental."""

from importlib.util import find_spec

EXTRA = 'pip install "surface_gym[gpu]"'


class DeviceMissing(RuntimeError):
    """Error: there is no GPU to run on, or a library for GPUs is missing."""


def has_numba_cuda() -> bool:
    """Return whether importing `numba.cuda` gives the package numba-cuda.

    Numba contains an obsolete `numba.cuda`, which fails to compile `max` of two numbers after any
    function was compiled for the CPU. A .pth file of the package numba-cuda replaces the obsolete
    module, but Python reads this file only in a folder for installed packages.
    """
    found = find_spec("numba.cuda") if find_spec("numba_cuda") else None
    return found is not None and "numba_cuda" in (found.origin or "")


def check_device() -> None:
    """Raise DeviceMissing if there is no GPU, or if a required library is missing."""
    for module in ("torch", "numba_cuda"):
        if find_spec(module) is None:
            raise DeviceMissing(f"device='cuda' needs {module}, which is not installed: {EXTRA}")
    if not has_numba_cuda():
        raise DeviceMissing(f"device='cuda' needs numba-cuda beside the other packages: {EXTRA}")
    import torch
    from numba import cuda

    if not torch.cuda.is_available():
        why = "was built without CUDA" if torch.version.cuda is None else "finds none"
        raise DeviceMissing(f"device='cuda' needs an NVIDIA GPU; torch {torch.__version__} {why}")
    if not cuda.is_available():
        raise DeviceMissing("device='cuda' needs an NVIDIA GPU that Numba can use; it finds none")
