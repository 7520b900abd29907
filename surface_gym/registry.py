"""Registries of tasks, sensors, rules and algorithms by name, from this package and plugins.

Your package becomes a plugin by an entry point of the group `surface_gym.plugins`. The entry point
names a module that registers its definitions, as the modules of this package do:

    [project.entry-points."surface_gym.plugins"]
    mine = "my_package.surface"
"""

import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from importlib import import_module
from importlib.metadata import entry_points
from types import MappingProxyType
from typing import Any, TypeVar, cast

from surface_gym import checks

GROUP = "surface_gym.plugins"  # group of entry points

Value = TypeVar("Value")


class Registry(Mapping[str, Value]):
    """Values of one kind by name, in the order of their registration.

    The first access imports the package's modules that register values, then plugins.

    Args:
        kind: name of the argument that selects a value, e.g. "task". Error texts contain this name.
        modules: modules of this package that register values on import.
        imports: import path of each value by name, e.g. "module:Class". A value is imported on
            first use.
    """

    def __init__(
        self, kind: str, *modules: str, imports: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        self._kind = kind
        self._modules = modules
        self._own = frozenset(imports)  # names that cannot be replaced
        self._imports = dict(imports)  # values not imported yet
        self._values: dict[str, Value | None] = dict.fromkeys(imports)
        self._complete = False

    def register(self, name: str, value: Value, replace: bool = False) -> Value:
        """Register a value by a name and return it.

        Args:
            replace: whether `value` may replace an older value of this name, e.g. if a file is
                loaded again. Values of the class's argument `imports` are never replaced.

        Raises:
            ValueError: the name belongs to another value.
        """
        if replace and name not in self._own:
            self._values.pop(name, None)
        if name in self._imports or self._values.setdefault(name, value) is not value:
            raise ValueError(
                f"{self._kind} must have a name of its own, got {name!r}, "
                f"which is {self._get(name)!r}"
            )
        return value

    def holds(self, name: str, same: Callable[[Value], bool]) -> bool:
        """Return whether the value `name` is loaded and satisfies `same`. Nothing is imported."""
        value = self._values.get(name)
        return value is not None and same(value)

    def registered(self, name: str) -> Callable[[Value], Value]:
        """Decorate a class or a function to register it by a name."""
        return lambda value: self.register(name, value)

    def find(self, name: str) -> Value:
        """Return the value with a name; raise a ValueError if there is none."""
        return self[checks.one_of(self._kind, name, tuple(self))]

    def __getitem__(self, name: str) -> Value:
        self._load()
        return self._get(name)

    def __contains__(self, name: object) -> bool:
        self._load()
        return name in self._values

    def __iter__(self) -> Iterator[str]:
        self._load()
        return iter(self._values)

    def __len__(self) -> int:
        self._load()
        return len(self._values)

    def _get(self, name: str) -> Value:
        """Return a value; import it if necessary."""
        if name in self._imports:
            self._values[name] = import_place(self._imports[name])
            del self._imports[name]
        return cast(Value, self._values[name])

    def _load(self) -> None:
        if not self._complete:
            self._complete = True  # set first, since registering modules may read the registry
            for module in self._modules:
                import_module(module)
            load_plugins()


def import_place(place: str) -> Any:
    """Import an object. The text `place` names module and object, e.g. "module:name"."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


@lru_cache(maxsize=1)
def load_plugins() -> None:
    """Import the plugins of other packages, once per process."""
    for plugin in entry_points(group=GROUP):
        try:
            plugin.load()
        except Exception as error:  # an error of another package must not stop this one
            warnings.warn(
                f"the plugin {plugin.name} = {plugin.value} was left out: "
                f"{type(error).__name__}: {error}",
                RuntimeWarning,
                stacklevel=2,
            )
