"""A header's decisions, by the C compiler of this machine."""

import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from .decision import Integers, Numbers, Singles
from .header import prefix_of

COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror")
_PROGRAM = """\
#include <stdio.h>
#include "{name}.h"

/* Observations in; for each, choices and angles out. */
int main(void) {{
    float observation[{capital}_FEATURES];
    int choices[{capital}_PARTS];
    double angles[{capital}_PARTS];
    while (fread(observation, sizeof observation, 1, stdin) == 1) {{
        {prefix}_choose(observation, choices);
        {prefix}_decide(observation, angles);
        fwrite(choices, sizeof choices, 1, stdout);
        fwrite(angles, sizeof angles, 1, stdout);
    }}
    return 0;
}}
"""


def compiler() -> str | None:
    """The path of a C compiler; None: there is none."""
    return next((found for found in map(shutil.which, COMPILERS) if found), None)


def compiled_decisions(
    path: str, header: str, name: str, parts: int
) -> Callable[[Singles], tuple[Integers, Numbers]]:
    """Decisions of a header.

    Args:
        path: of the compiler.
        header: its text.
        name: of the agent.
        parts: numbers of a decision.

    Raises:
        ValueError: it does not compile without a warning.
    """
    prefix = prefix_of(name)

    def decide(observations: Singles) -> tuple[Integers, Numbers]:
        with tempfile.TemporaryDirectory() as made:
            folder = Path(made)
            (folder / f"{name}.h").write_text(header)
            program = _PROGRAM.format(name=name, prefix=prefix, capital=prefix.upper())
            (folder / "main.c").write_text(program)
            built = subprocess.run(
                [path, *FLAGS, "-o", "decide", "main.c", "-lm"],
                cwd=folder,
                capture_output=True,
                text=True,
            )
            if built.returncode:
                raise ValueError(f"header must compile without a warning, got {built.stderr}")
            said = subprocess.run(
                [folder / "decide"], input=observations.tobytes(), capture_output=True, check=True
            ).stdout
        row = np.dtype([("choices", np.intc, (parts,)), ("angles", np.float64, (parts,))])
        rows = np.frombuffer(said, dtype=row)
        return rows["choices"].astype(np.int64), rows["angles"]

    return decide
