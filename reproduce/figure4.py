"""Figure 4: the walker on flat terrain, original body above, learned body below.

Reads the checkpoints of both experiments in pretrained/; with ZOO=path the author's weights
instead.
Writes paper/figures/figure4.svg, .pdf and .png.

    make reproduce-figure4
"""

from pathlib import Path

from reproduce import build, drawing, scores

ROWS = [
    ("Original body", "biped", 0),
    ("Learned body", "biped-morphology", 0),
]


def reads() -> list[Path]:
    """The files that the figure depends on."""
    return scores.read_for(*(experiment for _, experiment, _ in ROWS))


def main() -> list[Path]:
    """Draw the figure; returns its files."""
    return drawing.strips("figure4", ROWS)


if __name__ == "__main__":
    build.command("figure4")
