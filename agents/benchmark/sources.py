"""Sources of a policy: a file of Python, a policy of this package, ONNX, or a zip file.

The policy's own process reads them: a file of Python is executed, and a zip file of
Stable-Baselines3 may execute code as it is read.
"""

import importlib.util
import json
import sys
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.files import read_bytes

from .. import library
from ..base import Controller, Singles

MODULE = "benchmarked_policy"  # name of a file's module in the policy's process
MAX_MODEL = 2**28  # [bytes] of an ONNX file or of the description in a zip file
# Fields of Stable-Baselines3's files that only one algorithm has; DDPG is a kind of TD3.
ZIP_ALGORITHMS = {
    "clip_range": "PPO",
    "exploration_fraction": "DQN",
    "policy_delay": "TD3",
    "target_entropy": "SAC",
    "gae_lambda": "A2C",  # PPO has it, too
}
ONNX_TEXTS = ("actions", "control_period", "orientations", "observe")  # arguments in the metadata


class PolicySource(ABC):
    """A policy that is made for an environment."""

    def env_kwargs(self, task: str, preset: str | None) -> Any:
        """Return the arguments of an environment that the policy asks for."""
        del task, preset
        return {}

    @abstractmethod
    def make(self, config: EnvConfig, seed: int) -> Controller:
        """Make the policy for an environment's configuration."""


class PythonSource(PolicySource):
    """A class in a file, called with the environment's configuration and a seed.

    Its attribute `env_kwargs` is a dictionary, or a function of a task's and a preset's name.
    Modules beside the file can be imported.
    """

    def __init__(self, file: Path, name: str) -> None:
        sys.path.append(str(file.parent))
        spec = importlib.util.spec_from_file_location(MODULE, file)
        assert spec is not None
        assert spec.loader is not None
        module = sys.modules[MODULE] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        self._class: Any = getattr(module, name, None)
        if not callable(self._class):
            raise ValueError(f"{file.name} must have a class {name}, got none")

    def env_kwargs(self, task: str, preset: str | None) -> Any:
        asked = getattr(self._class, "env_kwargs", {})
        return asked(task, preset) if callable(asked) else asked

    def make(self, config: EnvConfig, seed: int) -> Controller:
        return self._class(config, seed)


class PackageSource(PolicySource):
    """A policy of this package in a folder."""

    def __init__(self, folder: Path, _: str) -> None:
        self._files = library.read_files(folder)
        self._card = library.read_card(self._files)

    def env_kwargs(self, task: str, preset: str | None) -> Any:
        del preset
        checks.one_of("task", library.card_env_id(task), (self._card.env_id,))
        return self._card.env_kwargs

    def make(self, config: EnvConfig, seed: int) -> Controller:
        del seed
        options = library.ALGORITHMS.find(self._card.algo).build_options or ()
        own = config if "config" in options else None
        return library.from_files(self._files, None, own)


class OnnxSource(PolicySource):
    """An ONNX model without memory, run on one core.

    Its input is the observation. A model of `surface-gym export` has its environment in its
    metadata, and the output "choices". The first output of any other model is the action.
    """

    def __init__(self, file: Path, _: str) -> None:
        onnxruntime: Any = import_module("onnxruntime")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self._session = onnxruntime.InferenceSession(
            read_bytes(file, MAX_MODEL), options, providers=["CPUExecutionProvider"]
        )
        self._metadata = self._session.get_modelmeta().custom_metadata_map
        (self._input,) = [each.name for each in self._session.get_inputs()]
        outputs = [each.name for each in self._session.get_outputs()]
        self._encodes = "choices" in outputs
        self._output = "choices" if self._encodes else outputs[0]

    def env_kwargs(self, task: str, preset: str | None) -> Any:
        del preset
        found, asked = self._metadata, library.card_env_id(task)
        checks.one_of("task", asked, (found.get("task", asked),))
        return {
            name: found[name] if name == "actions" else json.loads(found[name])
            for name in ONNX_TEXTS
            if name in found
        }

    def make(self, config: EnvConfig, seed: int) -> Controller:
        del seed
        if "features" in self._metadata:
            shown = [each.name for each in config.features]
            checks.one_of("features", json.dumps(shown), (self._metadata["features"],))
        self._kind, self._axes = config.action_kind, len(config.observation_space().shape)
        return self

    def predict(
        self,
        observation: Singles,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        """Choose actions; see `Controller`."""
        del episode_start, deterministic
        is_one = observation.ndim == self._axes
        batch = observation[np.newaxis] if is_one else observation
        (found,) = self._session.run([self._output], {self._input: batch})
        actions = self._kind.encode(found) if self._encodes else found
        return (actions[0] if is_one else actions), state


class ZipSource(PolicySource):
    """A model saved by Stable-Baselines3: PPO, A2C, DQN, SAC or TD3."""

    def __init__(self, file: Path, _: str) -> None:
        import stable_baselines3

        with zipfile.ZipFile(file) as archive:
            entry = archive.getinfo("data")
            if entry.file_size > MAX_MODEL:
                raise ValueError(f"data must have at most {MAX_MODEL} bytes, got {entry.file_size}")
            fields = json.loads(archive.read(entry))
        known = [name for field, name in ZIP_ALGORITHMS.items() if field in fields]
        if not known:
            raise ValueError(
                f"{file.name} must hold {', '.join(ZIP_ALGORITHMS.values())}, got none"
            )
        # Schedules are code of the Python that wrote them; decisions do without.
        schedules = {"learning_rate": 0.0, "lr_schedule": None, "clip_range": 0.0}
        algorithm = getattr(stable_baselines3, known[0])
        self._model = algorithm.load(file, device="cpu", custom_objects=schedules)

    def make(self, config: EnvConfig, seed: int) -> Controller:
        own, wanted = self._model.observation_space, config.observation_space()
        checks.one_of("features", own.shape, (wanted.shape,))
        self._model.set_random_seed(seed)
        return self._model


# By kind; called with the path and the name of a class.
SOURCES: dict[str, Callable[[Path, str], PolicySource]] = {
    "python": PythonSource,
    "package": PackageSource,
    "onnx": OnnxSource,
    "zip": ZipSource,
}
