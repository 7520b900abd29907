"""Bounded reading of YAML files: names and values, with numbers in plain decimal digits.

Files may use earlier names of options.
"""

import re
from collections import Counter
from pathlib import Path
from typing import Any

import yaml

from surface_gym.files import DAMAGE, describe_damage, parse_integer, parse_number, read_text

NODES = 100_000  # maximum nodes of a YAML file, with aliases expanded
YAML = 30_000  # [bytes] maximum size, parsed in a second; the largest here has 6000
BRACKETS = 1000

# Earlier names of fields, still accepted in files and command lines.
RENAMED = {
    "lanes": "num_envs",
    "condition": "preset",
    "parted": "split_probability",
}


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader, with plain decimal numbers and limited aliases."""

    yaml_implicit_resolvers = {
        first: [each for each in some if not each[0].endswith((":int", ":float"))]
        for first, some in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose a node, and count its content, since an alias may expand to billions of nodes."""
        named: Any = self.check_event(yaml.AliasEvent)
        node: Any = super().compose_node(parent, index)
        if named:
            if not hasattr(node, "total"):
                raise ValueError("an alias must not stand inside of what it names")
            return node
        parts = node.value if isinstance(node.value, list) else []
        if isinstance(node, yaml.MappingNode):
            names = [name.value for name, _ in parts if isinstance(name, yaml.ScalarNode)]
            for name, times in Counter(names).items():
                if times > 1:
                    raise ValueError(f"{name!r:.60} must stand once, got it {times} times")
            parts = [part for pair in parts for part in pair]
        node.total = 1 + sum(part.total for part in parts)
        if node.total > NODES:
            raise ValueError(f"it must hold at most {NODES} values, got more by its aliases")
        return node

    def construct_whole(self, node: Any) -> int:
        """Return an integer in digits 0 to 9; Python would also read 1_0 and other scripts."""
        return parse_integer("!!int", str(self.construct_scalar(node)))

    def construct_real(self, node: Any) -> float:
        """Return a number in digits 0 to 9, or .inf or .nan."""
        text = str(self.construct_scalar(node))
        named = text.lower().lstrip("+-").removeprefix(".")
        return (
            float(text.replace(".", ""))
            if named in ("inf", "nan")
            else parse_number("!!float", text)
        )


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:int", re.compile(r"[+-]?(?:0|[1-9][0-9]*)\Z"), list("+-0123456789")
)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"(?:[+-]?(?:[0-9]+\.[0-9]*|\.[0-9]+)(?:[eE][+-][0-9]+)?|[+-]?\.inf|\.nan)\Z"),
    list("+-.0123456789"),
)
_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_whole)
_Loader.add_constructor("tag:yaml.org,2002:float", _Loader.construct_real)


def parse_yaml(text: str) -> dict[str, Any]:
    """Parse names and values from YAML, or raise a ValueError that names the problem.

    No code is executed. Numbers are plain decimals; PyYAML would read 1_0 as ten and 010 as eight.
    """
    if len(text) > YAML:
        raise ValueError(f"it must have at most {YAML} characters, got {len(text)}")
    if text.count("[") + text.count("{") > BRACKETS:
        raise ValueError(f"it must have at most {BRACKETS} brackets, got more")
    try:
        found = yaml.load(text, _Loader)
    except (yaml.YAMLError, *DAMAGE) as error:
        raise ValueError(describe_damage(error)) from None
    if not isinstance(found, dict) or not all(isinstance(name, str) for name in found):
        raise ValueError(f"it must hold names and values, got {found!r:.60}")
    return found


def read_yaml(file: Path, by_hand: bool = False) -> dict[str, Any]:
    """Read the names and values of a YAML file; see `parse_yaml`.

    Args:
        by_hand: whether the last line may lack its line break, which marks complete files
            otherwise.

    Raises:
        ValueError: the file is invalid; the message says why.
        FileNotFoundError: the file does not exist.
    """
    text = read_text(file, YAML)
    if not by_hand and not text.endswith("\n"):
        raise ValueError("it is cut: its last line must end in a line break")
    return parse_yaml(text)


def current_option(argument: str) -> str:
    """Return an argument with the current name of its option."""
    option, equals, value = argument.partition("=")
    name = option.removeprefix("--")
    if option == name or name not in RENAMED:
        return argument
    return f"--{RENAMED[name].replace('_', '-')}{equals}{value}"
