"""Figure 7: two further designs, each of another run than in Figures 1 and 4.

Reads the checkpoints of both experiments in pretrained/; with ZOO=path the author's run 9 instead,
which is the one of the paper's figure.
Writes paper/figures/figure7.svg, .pdf and .png.

    make reproduce-figure7
"""

from pathlib import Path

from reproduce import build, drawing, scores

ROWS = [
    ("Another design", "biped-morphology", 1),
    ("Another design, hardcore", "biped-hardcore-morphology", 1),
]


def reads() -> list[Path]:
    """The files that the figure depends on."""
    return scores.read_for(*(experiment for _, experiment, _ in ROWS))


def main() -> list[Path]:
    """Draw the figure; returns its files."""
    return drawing.strips("figure7", ROWS)


if __name__ == "__main__":
    build.command("figure7")
