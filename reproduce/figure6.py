"""Figure 6: walkers rewarded for smaller legs, on flat terrain above, hardcore below.

Reads the checkpoints of both experiments in pretrained/; with ZOO=path the author's weights
instead.
Writes paper/figures/figure6.svg, .pdf and .png.

    make reproduce-figure6
"""

from pathlib import Path

from reproduce import build, drawing, scores

ROWS = [
    ("Smaller legs", "biped-morphology-smaller-leg", 0),
    ("Smaller legs, hardcore", "biped-hardcore-morphology-smaller-leg", 0),
]


def reads() -> list[Path]:
    """The files that the figure depends on."""
    return scores.read_for(*(experiment for _, experiment, _ in ROWS))


def main() -> list[Path]:
    """Draw the figure; returns its files."""
    return drawing.strips("figure6", ROWS)


if __name__ == "__main__":
    build.command("figure6")
