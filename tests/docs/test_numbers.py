"""Success rates on pages are those of shipped agents; the README repeats the results."""

import re

import pytest
import yaml

from tests.docs.reading import DOCS, ROOT

# Rows of the tables of one parcel in docs/comparison.md, and of its lab.
EXACT = {
    "sort": "Sort: success, both boxes",
    "slow": "Slow: success, speed ratio within 0.01 of the goal",
    "stop": "Stop: success, within 5 mm; median error [mm]",
    "track": "Track: success on sine waves, field tilted by 10 to 15 deg; "
    "rms distance from the path [mm]; rms speed error [m/s]",
    "orient": "Orient: success, within 2 deg of 15, 30 or 45 deg",
}
PPO, DQN, PPO_LAB, DQN_LAB = 4, 5, 5, 6  # columns


def read_rows(page: str) -> dict[str, list[list[str]]]:
    """Return the cells of all rows of a page's tables, by their first cell."""
    rows: dict[str, list[list[str]]] = {}
    for line in (ROOT / page).read_text().splitlines():
        if line.startswith("| "):
            cells = [cell.strip().replace("**", "") for cell in line.strip("|").split("|")]
            rows.setdefault(cells[0], []).append(cells)
    return rows


def read_success(agent: str, preset: str) -> str:
    """Return a shipped agent's success rate, as pages write it."""
    card = yaml.safe_load((ROOT / "agents" / "shipped" / agent / "card.yaml").read_text())
    return f"{card['results'][preset]['success']:.3f}"


@pytest.mark.parametrize("task", EXACT)
def test_success_of_agents_is_that_of_their_cards(task):
    rows = read_rows("docs/comparison.md")
    ((*exact, _),) = rows[EXACT[task]]
    for agent, column in (("ppo", PPO), ("dqn", DQN)):
        assert exact[column].split(";")[0] == read_success(f"{task}-{agent}", "exact")
    ((*lab, last),) = rows[task.capitalize()]
    assert lab[PPO_LAB] == read_success(f"{task}-ppo-lab", "lab")
    assert last == (read_success("sort-dqn-lab", "lab") if task == "sort" else "")


@pytest.mark.parametrize(
    "agent", ["sort-ppo", "sort-dqn", *(f"{task}-ppo" for task in [*EXACT][1:])]
)
def test_agents_for_the_lab_also_succeed_with_exact_sensors(agent):
    """docs/robustness.md states the bound of 0.02."""
    plain = float(read_success(agent, "exact"))
    for preset in ("exact", "camera"):
        assert float(read_success(f"{agent}-lab", preset)) >= plain - 0.021


def test_the_readme_repeats_numbers_of_the_results():
    results, readme = read_rows("docs/comparison.md"), read_rows("README.md")
    for task, row in EXACT.items():
        ((_, *shown),) = readme[task.capitalize()]
        _, _, *exact = results[row][0]
        assert shown[:3] == [cell.split(";")[0] for cell in exact[:3]], task
        _, best, rule, _, _, ppo, *_ = results[task.capitalize()][0]
        assert shown[3:] == [best, rule, ppo], task
    text = re.sub(r" ±\d+", "", (DOCS / "comparison.md").read_text())
    known = set(re.findall(r"\d+", text))
    streams = (ROOT / "README.md").read_text().partition("**A stream of parcels.**")[2]
    rates = re.findall(r"(?<=\| )\**(\d{3,5})(?=\**)", streams)
    assert len(rates) > 35
    assert set(rates) <= known
