"""Words that the package does not use, since the field has others: see CONTRIBUTING.md."""

import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("surface_gym", "agents", "tests", "docs", "examples", "benchmarks")
ENDINGS = (".py", ".md", ".ipynb", ".yml", ".toml")
LEFT_OUT = ("tests/test_words.py", "CHANGELOG.md", "CONTRIBUTING.md", "docs/learners/")

# A word as a regular expression, the field's word, and what may contain it all the same.
GONE = {
    r"\b[Ll]anes?\b|(?<![a-z])lanes?_|_lanes?\b|LANES?\b": (
        "environment",
        r"changes? of lanes?|lane[ _]change|random_lane",
    ),
    r"\b[Pp]lants?\b|_plant\b": ("line", ""),
    r"\b(Shadow|SideBySide|LearningCamera|FlowEnv|FlowVectorEnv|FlowSettings)\b": ("", ""),
    r"\bSettings\b": ("EnvConfig", ""),
    r"\b[Cc]ontenders?\b": ("method", ""),
    r"\b[Ss]eats?\b|seat_": ("agent slot", ""),
    r"\bpractices?\b|practised": ("training env", ""),
    r"\b[Cc]rews?\b": ("executor", ""),
    r"\b(told|telling)\b": ("commanded, described, reported", ""),
    r"\bin company\b|\bcompany\b|\bcompanies\b": ("bodies, island", ""),
    r"\b[Rr]eckon": ("compute", ""),
    r"\bcondition=|--condition\b|\bCONDITIONS\b": ("preset", ""),
    r"\bplaces=": ("max_parcels", ""),
    r"\b(def|functions\.|task\.|state\.)(?: ?)(over|judge|figures)\b": (
        "is_done, outcome",
        r".*list\[Figure\].*",
    ),
    r"\b(bear_load|bear_lanes|forget_contacts|facing|settling)\b": ("contact solver's words", ""),
    r"\bone's own\b": ("custom, your own", ""),
    r"\baims\b|\bfooting\b|\bknowing\b(?! all)": ("cost, contact span, oracle", ""),
    r"surface_gym\.(settings|conditions|presets|plants|dynamics|gpu|lanes|batch|faces)\b"
    r"|surface_gym\.(record|sharing)\b": (
        "config, presets, lines, physics, cuda, state, core, trajectory, parallel",
        "",
    ),
    r"\bagents\.(flow|search|episodes|policies|modules|mirror)\b": ("rules, tuning, rollout", ""),
    r"(from|import) agents\b(?! import)": ("surface_gym.agents", r"surface_gym import agents"),
    r"agents\.evaluation\.(contenders|command|main|cell|trials|columns)\b": ("methods, cli", ""),
    r"\bpython -m agents\b": ("surface-gym, python -m surface_gym.agents", ""),
}


def texts() -> list[Path]:
    """Every file whose words count."""
    found = [file for folder in FOLDERS for file in (ROOT / folder).rglob("*")]
    found += [ROOT / name for name in ("README.md", "train.py", "evaluate.py", "mkdocs.yml")]
    return sorted(
        file
        for file in found
        if file.suffix in ENDINGS and not str(file.relative_to(ROOT)).startswith(LEFT_OUT)
    )


@cache
def lines() -> list[tuple[str, str]]:
    """Place and text of every line."""
    return [
        (f"{file.relative_to(ROOT)}:{number}", line)
        for file in texts()
        for number, line in enumerate(file.read_text().splitlines(), start=1)
    ]


@pytest.mark.parametrize("word", GONE)
def test_a_word_is_gone(word):
    instead, allowed = GONE[word]
    pattern = re.compile(word)
    found = [
        f"{place}: {line.strip()}"
        for place, line in lines()
        if pattern.search(re.sub(allowed, "", line) if allowed else line)
    ]
    assert not found, f"{len(found)} lines, say {instead or 'the new name'}:\n" + "\n".join(found)
