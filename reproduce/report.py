"""The report: all tables and figures, what they rest on, where we differ, what it cost.

Reads report_template.md, the tables and figures with their manifests (paper/inputs/), pretrained/
and logs/. Writes paper/report.md, and paper/report.html: one file with all pictures inside, which
git does not keep.

    make reproduce-report
"""

import base64
import contextlib
import html
import json
import re
from pathlib import Path

import markdown
import numpy as np

from designrl.checkpoint import read_tensors
from designrl.errors import InputError
from designrl.experiments import EXPERIMENTS
from designrl.files import file_hash, write_atomically
from designrl.recording import read
from designrl.settings import COUNTS, TrainSettings, describe_schedule
from designrl.train import STATE_FORMAT
from reproduce import build, figure5, publish, scores, statistics, table3
from reproduce.scores import Score
from reproduce.table2 import BLOCKS, ROWS, WALKERS

TEMPLATE = Path(__file__).with_name("report_template.md")
TABLES = ("table1", "table2", "table3", "table4", "statistics", "intervals")
CAPTIONS = {
    "figure1": "Hardcore terrain: the original body above, the learned one below; several moments "
    "of one rollout each, on the terrain of the same seed, drawn from the environment's shapes. "
    "The rollout is the one closest to both agents' medians over the evaluation.",
    "figure2": "Left, Gym's loop. Right, the paper's: the agent's parameters also set the body, "
    "once before a rollout, and the reward may depend on it.",
    "figure3": "The ant: moments of one rollout as the environment renders them, original body "
    "above, learned body below; then both bodies from above with the legs stretched out flat.",
    "figure4": "Flat terrain: the original body above, the learned one below.",
    "figure5": "Hardcore learning curves, with the original and a learned body. Above, the "
    "population's return as training sees it (a fall costs nothing, success earns 100 more); "
    "below, evaluated agents, and the best one so far. Each experiment's best run has the "
    "population's ± 2 standard deviations, its other runs are pale. Dashed: 300 points, solved. "
    "Dotted: when the paper's runs had solved it.",
    "curves": "The same curves for the walkers on flat terrain.",
    "curves_smaller_leg": "The same curves for the walkers that are rewarded for smaller legs; "
    "their points are those of training's reward, with the factor for the legs' area.",
    "curves_ant": "The same curves for the ants.",
    "figure6": "Walkers rewarded for smaller legs, on flat terrain above, hardcore below.",
    "figure7": "Further designs: of each experiment another run than in the figures before.",
}
CURVES = {
    "curves": "Curves on flat terrain",
    "curves_smaller_leg": "Curves of the walkers with smaller legs",
    "curves_ant": "Curves of the ants",
}
MADE_BY = {
    "intervals": "statistics",
    **dict.fromkeys(CURVES, "figure5"),
}  # of another item


def reads() -> list[Path]:
    """The files that the report depends on."""
    folder = scores.output_folder()
    items = [name for name in build.ITEMS if name != "report"]
    return [
        TEMPLATE,
        *(folder / "tables" / f"{name}.md" for name in TABLES),
        *(folder / "figures" / f"{name}.svg" for name in CAPTIONS),
        *(folder / "inputs" / f"{name}.json" for name in items),
        *scores.read_for(*EXPERIMENTS),
        *figure5.reads(),
    ]


# ------------------------------------------------------------------------------------- contents


def origin_line(name: str) -> str:
    """Command, inputs and outputs of an item, as one line under it."""
    item = MADE_BY.get(name, name)
    made = json.loads((scores.output_folder() / "inputs" / f"{item}.json").read_text())
    read = [Path(path).parts for path in made["inputs"]]
    letters = {EXPERIMENTS[p[1]].letter for p in read if p[0] in ("pretrained", "logs")}
    links = [f"[({letter})](#origin-{letter})" for letter in sorted(letters)]
    used = f"; our runs of {' '.join(links)}" if links else ""
    kinds = ("tables", ("md", "tex", "csv")) if name in TABLES else ("figures", ("svg", "pdf"))
    files = ", ".join(f"[{suffix}]({kinds[0]}/{name}.{suffix})" for suffix in kinds[1])
    return f"*`make reproduce-{item}`{used}; [hashes of what it read](inputs/{item}.json); {files}*"


def letter_of(cells: list[str]) -> str:
    """The experiment of a table's row: its letter, or b for the rows of Table 1."""
    found = re.search(r"\((\w)\)", " ".join(cells[:2]))
    if found:
        return found[1]
    if cells[0] in BLOCKS:
        return EXPERIMENTS[WALKERS[BLOCKS.index(cells[0]) * 3 + ROWS.index(cells[1])]].letter
    return "b"


def linked(table: str) -> str:
    """A Markdown table whose numbers link to where they come from."""
    lines, header = [], None
    for line in table.splitlines():
        if not line.startswith("|") or set(line) <= set("|-"):
            lines.append(line)
            continue
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if header is None:
            header = cells
            lines.append(line)
            continue
        origin = f"#origin-{letter_of(cells)}"
        source = next((c for c in cells if c == "paper" or c.startswith("ours")), "")
        start = cells.index(source) + 1 if source else 0
        for i, cell in enumerate(cells):
            numeric = re.search(r"\d", cell) and not re.match(r"0( runs|, )", cell)
            if numeric and (header[i] == "Ours" or source.startswith("ours") and i >= start):
                cells[i] = f"[{cell}]({origin})"
            elif cell == "paper" or header[i].startswith("Paper") and numeric:
                cells[i] = f"[{cell}]({TO_PAPER})"
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


TO_PAPER = "paper.toml"  # beside the report


def table(name: str) -> str:
    """A table with its notes, its numbers linked, and its origin."""
    text = (scores.output_folder() / "tables" / f"{name}.md").read_text(encoding="utf-8")
    title, _, rest = text.partition("\n")
    # How scores were made, and from which checkpoints, is under Origins, once for all.
    notes = rest.split("\n\nCheckpoints:")[0].strip()
    notes = "\n\n".join(n for n in notes.split("\n\n") if not n.startswith("Scored on"))
    return f"### {title.removeprefix('# ')}\n\n{linked(notes)}\n\n{origin_line(name)}"


def figure(name: str) -> str:
    """A figure with its caption and origin."""
    title = CURVES.get(name, f"Figure {name[-1]}")
    caption = CAPTIONS[name]
    image = f"![{title}: {caption}](figures/{name}.png)"
    return f"### {title}\n\n{image}\n\n{caption}\n\n{origin_line(name)}"


def summary(ours: dict[str, list[Score]]) -> str:
    """What there is so far, in a few sentences."""
    have = [name for name in EXPERIMENTS if any(not s.problem for s in ours[name])]
    count = sum(not s.problem for found in ours.values() for s in found)
    if not have:
        return (
            "There is no checkpoint of ours yet, so the tables below show the paper's numbers "
            "alone, and the figures the paper's bodies at rest."
        )
    printed = scores.paper()
    which = "all eight" if len(have) == len(EXPERIMENTS) else f"{len(have)} of the eight"
    lines = [f"{count} runs of {which} experiments:", ""]
    for name in have:
        e = EXPERIMENTS[name]
        means = [s.mean for s in ours[name] if not s.problem]
        words = table3.in_words(means, printed["table3"][name][0], printed["table4"][name])
        value = f"[{np.mean(means):.0f}](#origin-{e.letter})"
        paper_value = f"[{printed['table3'][name][0]}]({TO_PAPER})"
        lines.append(f"- ({e.letter}) {e.title}: {value}, the paper {paper_value}; {words}.")
    left = [f"({e.letter}) {e.title}" for n, e in EXPERIMENTS.items() if n not in have]
    if left:
        lines += ["", f"Without a checkpoint yet: {', '.join(left)}."]
    return "\n".join(lines)


def answer() -> str:
    """The statistics' answer in one paragraph, for the paper's runs and ours."""
    means, _ = statistics.run_means()
    names = {"paper": "In the paper's own runs", "ours": "In ours"}
    sentences = []
    for source, values in means.items():
        said = []
        for without, with_ in statistics.PAIRS:
            if EXPERIMENTS[with_].leg_area_reward:
                continue  # they trade score for smaller legs
            a, b = values[without], values[with_]
            words = "there are no runs of both yet"
            if len(a) and len(b):
                c = statistics.compare(a, b)
                words = f"{c['difference']:+.0f} points ({statistics.verdict(c)})"
            said.append(f"{EXPERIMENTS[without].title}: {words}")
        start = names.get(source, f"With the {source}")
        sentences.append(f"{start}, a learned body against the original one: {'; '.join(said)}.")
    return " ".join(sentences)


def progress(log: Path) -> dict | None:
    """Generations, settings, steps and seconds of a run; None where it has no state."""
    try:
        tensors, state = read_tensors(log / "state.safetensors", STATE_FORMAT)
        generations = int(tensors["generation"])
        return {"generations": generations, "settings": state["settings"], **state["progress"]}
    except (InputError, KeyError):
        return None


def spent_cells(steps: float, cpu_seconds: float, seconds: float) -> list[str]:
    """Steps, core-hours and hours as a table has them."""
    return [f"{steps / 1e6:,.0f} M", f"{cpu_seconds / 3600:.2f}", f"{seconds / 3600:.2f}"]


def costs(ours: dict[str, list[Score]]) -> str:
    """A table of what each run cost and when it had solved its task, beside the paper's."""
    lines = [
        "| Run | Generations (paper) | Population × rollouts (paper 192 × 16) | Steps | "
        "Core-hours | Hours | Solved: generation | Solved: core-hours | "
        "Solved in the paper: generation; core-hours |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    text = scores.paper()["text"]
    totals = np.zeros(3)  # steps and seconds of all of them
    for name, found in ours.items():
        e = EXPERIMENTS[name]
        for s in found:
            if s.problem or "settings" not in s.agent.metadata:
                continue
            log = scores.log_of(s.path)
            cost = progress(log)
            settings = (cost or s.agent.metadata)["settings"]  # the agent's own may be older
            done = cost["generations"] if cost else settings["generations"]
            population, rollouts = (describe_schedule(settings[n], done) for n in COUNTS)
            spent = ["no recording", "", ""]
            if cost:
                amounts = [cost["total_steps"], cost["cpu_seconds"], cost["seconds"]]
                totals += amounts
                spent = spent_cells(*amounts)
            solved = [""] * 2
            if e.is_walker and not e.leg_area_reward and (log / "generations.mcap").exists():
                try:
                    c = figure5.curve(read(log / "generations.mcap"))
                    i = figure5.solved_at(c)
                    solved = (
                        ["not yet", ""]
                        if i is None
                        else [
                            f"{c.at[0, i] + 1:.0f}",  # the updates by then, as a card counts
                            f"{c.at[2, i]:.2f}",
                        ]
                    )
                except (InputError, KeyError, ZeroDivisionError) as error:
                    solved = [f"unknown ({error})", ""]
            paper = ""
            if "hours" in text.get(name, {}):
                hours = text[name]["hours"] * figure5.PAPER_CORES
                paper = f"{text[name]['generations']:,}; {hours:,}"
            label = f"[({e.letter}) {e.title}, {scores.seed_of(s.path)}](#origin-{e.letter})"
            row = [label, f"{done:,} ({e.generations:,})"]
            row += [f"{population} × {rollouts}", *spent, *solved, paper]
            lines.append("| " + " | ".join(row) + " |")
    if len(lines) == 2:
        return "No run is published yet."
    row = [f"All {len(lines) - 2} published runs", "", "", *spent_cells(*totals), "", "", ""]
    return "\n".join([*lines, "| " + " | ".join(row) + " |"])


def differences(ours: dict[str, list[Score]]) -> str:
    """One line per experiment whose mean is not within the paper's runs."""
    printed = scores.paper()
    lines = []
    for name, found in ours.items():
        means = [s.mean for s in found if not s.problem]
        if not means:
            continue
        words = table3.in_words(means, printed["table3"][name][0], printed["table4"][name])
        e = EXPERIMENTS[name]
        kept = [s.agent.metadata for s in found if not s.problem]
        trained = ", ".join(
            f"{m['environment_steps'] / 1e6:,.0f} M" for m in kept if "environment_steps" in m
        )
        after = f" Its kept agents saw {trained} environment steps." if trained else ""
        cards = ", ".join(
            f"[{scores.seed_of(s.path)}](../{scores.shown(s.path.with_suffix('.md'))})"
            for s in found
            if not s.problem
        )
        lines.append(f"- **({e.letter}) {e.title}**: {words}.{after} Cards: {cards}.")
    return "\n".join(lines) or "- No run of ours is published yet."


def origins(ours: dict[str, list[Score]]) -> str:
    """Each checkpoint: file, hash, how it was scored and trained."""
    used = scores.used_versions()
    lines = [
        f"All scores: {scores.EPISODES} episodes on the reference environments, the episodes' "
        f"seeds drawn by `designrl.evaluation.episode_seeds({scores.SEED}, {scores.EPISODES})`. "
        f"Versions: {', '.join(f'{name} {value}' for name, value in used.items())}. Printed "
        f"numbers are in [paper.toml]({TO_PAPER})."
    ]
    for name, e in EXPERIMENTS.items():
        lines += [f'<a id="origin-{e.letter}"></a>', f"### ({e.letter}) {e.title}"]
        if not ours[name]:
            lines.append("No checkpoint yet.")
        for s in ours[name]:
            shown = scores.shown(s.path)
            if s.problem:
                lines.append(f"`{shown}` is not used: {s.problem}.")
                continue
            m = s.agent.metadata
            log = scores.log_of(s.path) / "generations.mcap"
            card = scores.shown(s.path.with_suffix(".md"))
            items = [
                f"**[{shown}](../{shown})**, sha256 `{s.sha256}`; [its card](../{card})",
                f"score {s.mean:.2f} ± {s.std:.2f} (median {np.median(s.returns):.1f}, "
                f"{s.returns.min():.1f} to {s.returns.max():.1f}); "
                f"`designrl evaluate {shown} --episodes {scores.EPISODES} --seed {scores.SEED}`",
            ]
            if "settings" in m:
                settings = TrainSettings(**m["settings"])
                trained = f"trained by `{settings.command(with_defaults=False)}`"
                with contextlib.suppress(InputError, KeyError):  # no recording, or a damaged one
                    if publish.evaluated_in_parts(read(log)):
                        trained += (
                            ", evaluated otherwise at first (see its card), so that this command "
                            "gives the same distribution but may keep another agent"
                        )
                items.append(trained)
                items.append(
                    f"kept at generation {m['generation']:,} after {m['environment_steps']:,} "
                    f"steps, with {m['score']:.1f} over {m['score_episodes']} episodes then"
                )
                items.append(
                    "by " + ", ".join(f"{library} {v}" for library, v in m["versions"].items())
                )
            if log.exists():
                path = scores.shown(log)
                items.append(f"recording [{path}](../{path}), sha256 `{file_hash(log)}`")
            lines.append("\n".join(f"- {item}" for item in items))
    return "\n\n".join(lines)


# ----------------------------------------------------------------------------------------- page

STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff;
  max-width: 54rem; margin: 0 auto; padding: 1rem; overflow-wrap: break-word; }
h1, h2, h3 { line-height: 1.2; }
h2 { margin-top: 2.5rem; border-bottom: 1px solid #ccc; }
img { width: 100%; max-width: 44rem; height: auto; display: block; margin: 0 auto; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.8rem; }
th, td { padding: 0.2rem 0.5rem; border-bottom: 1px solid #ddd; text-align: left;
  vertical-align: top; }
td { min-width: 2.5rem; }
td a { white-space: nowrap; }
pre { overflow-x: auto; background: #f4f4f4; padding: 0.7rem; }
code { font-size: 0.85em; overflow-wrap: anywhere; }
em { font-size: 0.85em; color: #444; }
nav a { margin-right: 1rem; }
"""


def page(text: str, folder: Path) -> str:
    """The report's Markdown as one HTML file: pictures inside, no script, nothing to load."""
    body = markdown.markdown(text, extensions=["tables", "fenced_code", "toc"])
    body = body.replace("<table>", '<div class="wide"><table>')
    body = body.replace("</table>", "</table></div>")

    def inside(match: re.Match) -> str:
        data = (folder / match[1]).with_suffix(".svg").read_bytes()
        return f'src="data:image/svg+xml;base64,{base64.b64encode(data).decode()}"'

    body = re.sub(r'src="(figures/[^"]+)"', inside, body)
    heads = re.findall(r'<h2 id="([^"]+)">(.*?)</h2>', body)
    contents = "".join(f'<a href="#{anchor}">{name}</a>' for anchor, name in heads)
    title = html.escape(re.search(r"^# (.*)", text)[1])
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{title}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        f"{body.replace('</h1>', f'</h1><nav>{contents}</nav>', 1)}\n</body>\n</html>\n"
    )


def main() -> list[Path]:
    """Write the report; returns its files."""
    ours = scores.pretrained_scores()
    parts = {
        "summary": summary(ours),
        "answer": answer(),
        "costs": costs(ours),
        "differences": differences(ours),
        "origins": origins(ours),
        **{name: table(name) for name in TABLES},
        **{name: figure(name) for name in CAPTIONS},
    }
    text = TEMPLATE.read_text(encoding="utf-8")
    text = re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], text)
    folder = scores.output_folder()
    if folder != scores.ROOT / "paper":  # one folder deeper
        text = text.replace("](../", "](../../").replace(f"]({TO_PAPER})", f"](../{TO_PAPER})")
    paths = [folder / "report.md", folder / "report.html"]
    write_atomically(paths[0], text.encode())
    write_atomically(paths[1], page(text, folder).encode())
    return paths


if __name__ == "__main__":
    build.command("report")
