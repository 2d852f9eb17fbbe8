"""The page, docs/page/index.html: walkers and ants in the browser, and every result beside them.

    python -m reproduce.page

One file that asks for nothing else, except figures and films beside it. Reads docs/page/src/, the
engine's sources, README.md, the scores (reproduce/scores.py), pretrained/ and logs/. The
engine becomes WebAssembly by the clang of ziglang (requirements-extras.lock).
"""

import base64
import hashlib
import html
import json
import re
import subprocess
import sys
import tempfile
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import markdown
import numpy as np

from designrl.envs.tasks import engine_task
from designrl.errors import InputError
from designrl.evaluation import episode_seeds
from designrl.files import write_atomically
from designrl.policy import noise_stds
from designrl.recording import read
from designrl.settings import TrainSettings
from reproduce import scores
from reproduce.paths import EIGHT, ROOT, pretrained, recording_of, recordings
from reproduce.program import program
from reproduce.readme import ANSWERS, ANSWERS_END, END, START
from reproduce.scores import EPISODES, SEED, Score

SOURCE, TARGET = ROOT / "docs/page/src", ROOT / "docs/page/index.html"
NATIVE = ROOT / "designrl/engine/native"
LIMIT = 2_000_000  # bytes of the page
MAX_POLICIES = 4  # of a run, besides the published one
MAX_GAP = 0.1  # of a run's generations, between two bodies, for a slider over them

FLAGS = """
    -target wasm32-wasi -mexec-model=reactor -msimd128 -nostdlib++ -s -std=c++17 -O2 -g0
    -ffp-contract=off -fno-math-errno -fno-trapping-math -fno-exceptions -fno-rtti
    -fno-threadsafe-statics -fvisibility=hidden -Wl,--export-dynamic
"""
COMPILE = [sys.executable, "-m", "ziglang", "c++", *FLAGS.split(), f"-I{NATIVE}"]

FIGURES = {
    "figure1": "The hardcore walker, before and after it learned its legs",
    "figure2": "The loop of an agent and its environment, and the one that learns the design too",
    "figure3": "The ant, before and after",
    "figure4": "The walker on flat ground, before and after",
    "figure5": "Learning curves on hardcore ground",
    "figure6": "Walkers that were rewarded for smaller legs",
    "figure7": "Further designs: another run of each experiment",
}


def sources() -> dict[str, bytes]:
    """All that decides the page, by name."""
    code = [NATIVE / "page.cpp", *(NATIVE / "common").glob("*.h")]
    code += [path for task in ("walker", "ant") for path in (NATIVE / task).rglob("*.h")]
    found = {str(path): re.sub(rb"//.*", b"", path.read_bytes()) for path in code}  # no comments
    read = [*SOURCE.iterdir(), Path(__file__)]
    for name in EIGHT:
        read += (ROOT / "pretrained" / name).glob("*.safetensors")
        read += recordings(name)
    found |= {str(path): path.read_bytes() for path in read if path.is_file()}
    found |= {
        "films": repr(films()).encode(),
        "README": (answers() + table3() + install()).encode(),
    }
    return {name.removeprefix(f"{ROOT}/"): found[name] for name in sorted(found)}


def digest() -> str:
    """One hash of the sources; the page holds that of what it was built from."""
    found = hashlib.sha256()
    for name, data in sources().items():
        found.update(f"{name} {hashlib.sha256(data).hexdigest()}\n".encode())
    return found.hexdigest()[:16]


# --------------------------------------------------------------------------------------- script


def engine() -> bytes:
    """The engine as WebAssembly.

    Raises:
        InputError: there is no compiler for it.
    """
    if find_spec("ziglang") is None:
        raise InputError("no ziglang; pip install -c requirements-extras.lock ziglang")
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "engine.wasm"
        done = subprocess.run(
            [*COMPILE, NATIVE / "page.cpp", "-o", target], capture_output=True, text=True
        )
        if done.returncode:
            raise InputError(f"the engine does not compile to WebAssembly: {done.stderr}")
        return target.read_bytes()


def script() -> str:
    """The modules as one: each after those that it imports, without their imports and exports."""
    placed: dict[str, str] = {}

    def place(name: str) -> None:
        text = (SOURCE / name).read_text()
        for other in re.findall(r'^import [^;]* from "\./(.*)";$', text, re.M):
            if other not in placed:
                place(other)
        text = re.sub(r"^import [^;]*;\n", "", text, flags=re.M)
        placed[name] = re.sub(r"^export ", "", text, flags=re.M)

    place("main.js")
    return "\n".join(placed.values())


# ----------------------------------------------------------------------------------------- data


def agents() -> dict[str, Score]:
    """The published agents by name, with their scores."""
    files = [(path, name) for name in EIGHT for path in pretrained(name)]
    found = scores.usable(scores.score_all(files))
    return {f"{score.agent.experiment.name}/{score.path.stem}": score for score in found}


class Policies:
    """Policies as the script reads them: weights one after the other, and where each begins."""

    def __init__(self):
        self.weights = []

    def add(self, network, parameters: np.ndarray) -> dict:
        """Keep a policy's weights; returns its row for agents.js."""
        weights = parameters[: network.num_weights].astype(np.float32)
        log_stds = parameters[network.num_weights : network.num_parameters]
        row = {"at": sum(map(len, self.weights)) if weights.any() else None}  # None: zeros
        if weights.any():
            self.weights.append(weights)
        return row | ({"stds": noise_stds(log_stds[None])[0].tolist()} if network.noise else {})


def data(found: dict[str, Score]) -> tuple[dict, np.ndarray]:
    """What the script reads (agents.js), and the policies' weights, (N,) float32."""
    policies, rows, runs = Policies(), [], {}
    for name, score in found.items():
        agent, experiment = score.agent, score.agent.experiment
        row = {
            "name": name,
            "experiment": experiment.name,
            "task": experiment.body.name,
            "hardcore": "hardcore" in experiment.name,
            "limit": engine_task(experiment.env_id)[0].max_steps,
            "design": agent.scales.tolist(),
            "scores": score.returns.tolist(),
            "mean": round(score.mean, 2),
        }
        rows.append(row | policies.add(agent.network, agent.parameters))
    for name, score in found.items():
        if recording_of(score.path).is_file():
            runs[name] = run(score, policies)
    experiments = {name: experiment.title for name, experiment in EIGHT.items()}
    courses = episode_seeds(SEED, EPISODES).tolist()
    about = {"agents": rows, "courses": courses, "experiments": experiments, "runs": runs}
    return about, np.concatenate(policies.weights)


def run(score: Score, policies: Policies) -> dict:
    """A run's evaluations, bodies and policies."""
    agent, path = score.agent, recording_of(score.path)
    recording = read(path)
    means = recording.array("/evaluation", "mean").tolist()
    about = {
        "kept": agent.metadata["generation"],
        "generations": int(recording.array("/summary", "generation").max()) + 1,
        "scores": [
            {"generation": int(generation) + 1, "mean": round(mean, 1)}
            for generation, mean in zip(
                recording.array("/evaluation", "generation"), means, strict=True
            )
        ],
    }
    if not usable_history(path):
        return about
    generations = recording.array("/design", "generation").astype(int)
    scales = recording.array("/design", "dimensions") / agent.experiment.body.design.originals
    about["bodies"] = [
        {"generation": g, "scales": row}
        for g, row in zip(generations.tolist(), scales.round(4).tolist(), strict=True)
    ]
    first = next(filter(usable_history, map(recording_of, pretrained(agent.experiment.name))))
    generations = recording.array("/distribution", "generation")
    means = recording.array("/distribution", "mu")
    kept = np.flatnonzero(generations < about["kept"])
    if path == first:  # of one run each: a policy has 15 to 23 kB
        shown = kept[np.unique(np.linspace(0, len(kept) - 1, MAX_POLICIES).round().astype(int))]
    else:
        shown = kept[generations[kept] == 0]
    about["policies"] = [
        {"generation": int(generations[i])} | policies.add(agent.network, means[i]) for i in shown
    ]
    return about


@cache
def usable_history(path: Path) -> bool:
    """Whether there is a recording, with bodies all along."""
    if not path.is_file():
        return False
    recording = read(path)
    if not recording.topics.get("/design"):
        return False
    last = recording.array("/summary", "generation").max() + 1
    return np.diff(recording.array("/design", "generation").astype(int)).max() <= MAX_GAP * last


# ----------------------------------------------------------------------------------------- text


def readme() -> str:
    return (ROOT / "README.md").read_text()


def between(start: str, end: str) -> str:
    """What stands between two marks of README; nothing where it has none."""
    found = re.search(f"{start}(.*?){end}", readme(), re.S)
    return found[1] if found else ""


def answers() -> str:
    """What README answers."""
    return markdown.markdown(
        re.sub(r"\]\((?!https?:|#)", "](../../", between(ANSWERS, ANSWERS_END))
    )


def install() -> str:
    """README's commands to install."""
    found = re.search(r"^## Install.*?\n(.*?```.*?```)", readme(), re.S | re.M)
    return markdown.markdown(found[1], extensions=["fenced_code"])


def table3() -> str:
    """README's Table 3, whose verdicts are short. Cells name their column, for narrow screens."""
    table = markdown.markdown(between(START, END), extensions=["tables"])
    columns = re.findall("<th>(.*?)</th>", table)
    names = iter(columns * table.count("<tr>"))
    table = re.sub("<td>", lambda _: f'<td data-column="{next(names)}">', table)
    return re.sub("<td (?=[^>]*>–<)", '<td class="empty" ', table)


def figures() -> str:
    """The paper's figures, as far as they are there."""
    return "".join(
        f'<figure><a href="../../paper/figures/{name}.png"><img loading="lazy" '
        f'src="../../paper/figures/{name}.png" alt="{html.escape(title)}"></a>'
        f"<figcaption>Figure {name[-1]}. {html.escape(title)}.</figcaption></figure>"
        for name, title in FIGURES.items()
        if (ROOT / f"paper/figures/{name}.png").is_file()
    )


def films() -> list[str]:
    """Names of the films."""
    names = [*EIGHT, *(f"{kind}-{name}" for kind in ("fall", "blooper") for name in EIGHT)]
    return [name for name in names if (ROOT / f"paper/gallery/{name}.webp").is_file()]


def film_figures() -> str:
    """The films with their names."""

    def title(name: str) -> str:
        if name in EIGHT:
            return EIGHT[name].title
        kind, _, experiment = name.partition("-")
        return f"{EIGHT[experiment].title}: a {kind}"

    return "".join(
        f'<figure><img loading="lazy" src="../../paper/gallery/{name}.webp" alt="{title(name)}">'
        f"<figcaption>{title(name)}</figcaption></figure>"
        for name in films()
    )


def run_tables(found: dict[str, Score]) -> str:
    """Every published run with its card, curve, recording and command."""
    parts = []
    for experiment in EIGHT.values():
        rows = ["| | score | | |", "|---|---|---|---|"]
        commands = set()
        for path in sorted((ROOT / "pretrained" / experiment.name).glob("*.safetensors")):
            name = f"{experiment.name}/{path.stem}"
            card = path.with_suffix(".md")
            links = [f"[card](../../pretrained/{name}.md)"] if card.is_file() else []
            if path.with_suffix(".png").is_file():
                links.append(f"[curve](../../pretrained/{name}.png)")
            if recording_of(path).is_file():
                links.append(f"[recording](../../logs/{name}/generations.mcap)")
            watch = f'<button data-watch="{name}">Watch</button>' if name in found else ""
            score = f"{found[name].mean:.1f} ± {found[name].std:.1f}" if name in found else ""
            cells = [path.stem, score, ", ".join(links), watch]
            rows.append(f"| {' | '.join(cells)} |")
            if name in found:
                settings = TrainSettings(**found[name].agent.metadata["settings"])
                commands.add(settings.command().replace(f"--seed {settings.seed}", "--seed K"))
        if len(rows) == 2:
            continue
        table = markdown.markdown("\n".join(rows), extensions=["tables"])
        command = "".join(f"<pre><code>{c}</code></pre>" for c in sorted(commands))
        parts.append(
            f"<details><summary>({experiment.letter}) {experiment.title}, {len(rows) - 2} runs"
            f'</summary>{command}<div class="scroll">{table}</div></details>'
        )
    return "".join(parts)


def build() -> str:
    """The page."""
    found = agents()
    about, weights = data(found)
    fill = {
        "sources": digest(),
        "style": (SOURCE / "style.css").read_text(),
        "answers": answers(),
        "table3": table3(),
        "figures": figures(),
        "films": film_figures(),
        "runs": run_tables(found),
        "install": install(),
        "data": json.dumps(about, separators=(",", ":")).replace("</", "<\\/"),
        "weights": base64.b64encode(weights.tobytes()).decode(),
        "engine": base64.b64encode(engine()).decode(),
        "script": script(),
    }
    template = (SOURCE / "page.html").read_text()
    page = re.sub(r"\{\{(\w+)\}\}", lambda match: fill[match[1]], template)
    if len(page.encode()) > LIMIT:
        raise InputError(f"the page would have {len(page.encode()):,} bytes, {LIMIT:,} at most")
    return page


def main() -> None:
    page = build()
    write_atomically(TARGET, page.encode())
    print(f"{TARGET.relative_to(ROOT)}: {len(page.encode()):,} bytes")


if __name__ == "__main__":
    with program("page"):
        main()
