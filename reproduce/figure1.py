"""Figure 1: the walker on hardcore terrain, original body above, learned body below.

Reads the checkpoints of both experiments in pretrained/; with ZOO=path the author's weights
instead.
Writes paper/figures/figure1.svg, .pdf and .png.

    make reproduce-figure1
"""

from pathlib import Path

from reproduce import build, drawing, scores

ROWS = [
    ("Original body", "biped-hardcore", 0),
    ("Learned body", "biped-hardcore-morphology", 0),
]


def reads() -> list[Path]:
    """The files that the figure depends on."""
    return scores.read_for(*(experiment for _, experiment, _ in ROWS))


def main() -> list[Path]:
    """Draw the figure; returns its files."""
    return drawing.strips("figure1", ROWS)


if __name__ == "__main__":
    build.command("figure1")
