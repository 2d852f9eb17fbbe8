"""Every command and snippet of README and docs/ does what it says."""

import json
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from designrl.cli import parser
from designrl.experiments import EXPERIMENTS
from designrl.settings import TrainSettings
from reproduce import build

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
PAGES += [ROOT / "pretrained/README.md", *sorted((ROOT / "docs").glob("*.md"))]
SMALL = ["--generations", "1", "--population", "2", "--rollouts", "1", "--evaluation-episodes", "1"]


def blocks(page: Path, language: str) -> list[str]:
    """The fenced blocks of a page in a language ("" for commands)."""
    fences = re.findall(r"^```(\w*)\n(.*?)^```$", page.read_text(), re.DOTALL | re.MULTILINE)
    return [text for found, text in fences if found == language]


def commands(page: Path) -> list[str]:
    lines = "".join(blocks(page, "")).replace("\\\n", " ").splitlines()
    return [line.partition(" #")[0].strip() for line in lines if line.partition(" #")[0].strip()]


def run(words: list, folder: Path) -> None:
    """A command in a folder that has this project's checkpoints and recordings."""
    for name in ("pretrained", "logs"):
        if not (folder / name).exists():
            (folder / name).symlink_to(ROOT / name)
    done = subprocess.run(
        [sys.executable, *words], cwd=folder, capture_output=True, text=True, timeout=1800
    )
    assert done.returncode == 0, (words, done.stderr)


SCRIPTS = [page for page in PAGES if blocks(page, "python")]
SCRIPTS.remove(ROOT / "docs/using.md")  # each block is one: test_using.py
SCRIPTS.remove(ROOT / "docs/extending.md")  # test_extending.py


@pytest.mark.parametrize("page", SCRIPTS, ids=lambda page: page.name)
def test_snippets_run(page, tmp_path):
    end = "\nassert total > 340, total\n" if page == ROOT / "README.md" else ""  # it walks
    (tmp_path / "page.py").write_text("\n".join(blocks(page, "python")) + end)
    run(["page.py"], tmp_path)


BY_HAND = {"git", "cd", "source", "pip", "rerun", "export", "ray"}  # tried from a fresh clone


@pytest.mark.parametrize(
    ("page", "command"),
    [
        (page, words)
        for page in PAGES
        for words in commands(page)
        if words.split()[0] not in BY_HAND
    ],
    ids=lambda value: value.name if isinstance(value, Path) else value[:60],
)
def test_commands_are_as_written(page, command, tmp_path):
    words = shlex.split(command)
    if words[0] == "designrl":
        parser().parse_args(words[1:])
        files = [w for w in words if w.startswith(("pretrained/", "logs/"))]
        assert all((ROOT / file).exists() for file in files)
    elif words[0] == "make":
        dry = ["make", "-n", *words[1:]]
        done = subprocess.run(dry, cwd=ROOT, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        items = [word.removeprefix("reproduce-") for word in words if "reproduce-" in word]
        assert set(items) <= set(build.ITEMS), "make takes any name"
    else:
        pytest.fail(f"nothing here knows {command!r}")


def test_readmes_commands_work_one_after_the_other(tmp_path):
    """Train, evaluate, replay, record: with little training, and into files instead of windows."""
    for i, command in enumerate(commands(ROOT / "README.md")):
        words = shlex.split(command)
        if words[0] == "designrl":
            more = {"train": SMALL, "replay": ["--save", f"{i}.rrd"]}.get(words[1], [])
            run(["-m", *words, *more], tmp_path)


def test_extras_are_pinned_as_they_are_declared():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    pins = (ROOT / "requirements-extras.lock").read_text().splitlines()
    assert {*extras["ray"], *extras["envpool"]} <= set(pins)
    assert all(re.fullmatch(r"#.*|[\w.-]+==[\w.]+", line) for line in pins)


@pytest.mark.parametrize("page", [*PAGES, ROOT / "paper/report.md"], ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    for name, anchor in re.findall(r"\]\((?!https?:)([^)#\s]*)#?([^)\s]*)\)", page.read_text()):
        file = page.parent / name if name else page
        assert file.exists(), name
        assert not anchor or anchor in anchors(file.read_text()), f"{name}#{anchor}"


def anchors(text: str) -> set[str]:
    """Those of headings, as GitHub makes them: small letters, hyphens, no other signs; and ids."""
    headings = re.findall(r"^#+ (.*)$", text.lower(), re.MULTILINE)
    found = {re.sub(r"[^\w-]", "", heading.replace(" ", "-")) for heading in headings}
    return found | set(re.findall(r'id="([^"]+)"', text))


def learning_rate(s: TrainSettings) -> str:
    if s.learning_rate_decay == 1:
        return f"{s.learning_rate}, constant"
    falls = f"{s.learning_rate} × {s.learning_rate_decay} a generation"
    return f"{falls}, at least {s.learning_rate_floor}"


def cell(say, experiments: list, recipe: str) -> str:
    """What the experiments' settings say; where worlds differ, of each."""
    worlds = {"ants": "ab", "flat ground": "cde", "hardcore": "fgh"}
    said = {
        world: dict.fromkeys(
            say(TrainSettings.of(e, recipe)) for e in experiments if e.letter in letters
        )
        for world, letters in worlds.items()
    }
    found = dict.fromkeys("; ".join(values) for values in said.values() if values)
    if len(found) == 1:
        return next(iter(found))
    return "; ".join(f"{world} {'; '.join(values)}" for world, values in said.items())


def test_the_recipes_in_the_table_are_those_of_the_experiments():
    columns = [(list(EXPERIMENTS.values()), "paper")]
    for letters in ("ab", "cde", "gh", "f"):
        columns.append(([e for e in EXPERIMENTS.values() if e.letter in letters], "ours"))
    rows = {
        "candidates × rollouts": lambda s: f"{s.population} × {s.rollouts}",
        "generations": lambda s: f"{s.generations:,}",
        "learning rate": learning_rate,
        "σ": lambda s: f"× {s.sigma_decay} a generation",
        "agent": lambda s: {"best": "the best candidate of a generation", "mean": "μ"}[s.keep],
    }
    page = (ROOT / "pretrained/README.md").read_text()
    for name, say in rows.items():
        expected = [cell(say, experiments, recipe) for experiments, recipe in columns]
        cells = re.search(rf"^\| {name} \|(.+)\|$", page, re.MULTILINE)[1]
        assert [cell.strip() for cell in cells.split("|")] == expected


def test_readme_says_how_its_pictures_agent_ranks_among_ours():
    said = re.search(
        r"The picture shows `((.+)/\w+)`, the best of our (\w+)", (ROOT / "README.md").read_text()
    )
    index = json.loads((ROOT / "pretrained/index.json").read_text())
    means = {name: s["mean"] for name, s in index.items() if name.startswith(f"{said[2]}/seed")}
    assert max(means, key=means.get) == said[1]
    assert ("three", "four", "five").index(said[3]) + 3 == len(means)


def test_readme_says_what_the_runs_cost_as_the_report_does():
    said = re.search(r"The (\d+) runs took (\d+) core-hours", (ROOT / "README.md").read_text())
    report = (ROOT / "paper/report.md").read_text()
    assert f"The {said[1]} runs of Table 3 took {said[2]} core-hours" in report
