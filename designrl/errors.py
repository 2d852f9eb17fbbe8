"""The one error type that means "the input is wrong", as opposed to a bug, and how it is said."""

import contextlib
import sys
from collections.abc import Iterator

MAX_SENTENCE = 2000  # characters of one that are kept


class InputError(ValueError):
    """Input that cannot be used: a file, a design, a name, a folder, a full disk.

    The message is one sentence that names the thing and what to do about it. The command line
    prints it and exits with code 2. Of a long one, its two ends are kept: a stranger's file may be
    quoted in it.
    """

    def __init__(self, sentence: str):  # or another such error: Gymnasium's workers pass that
        super().__init__(_shortened(str(sentence)))


class MissingPartError(InputError, ImportError):
    """A package of one of the extras is needed and not installed."""


@contextlib.contextmanager
def optional(what: str, extra: str, in_a_clone: str = "make setup") -> Iterator[None]:
    """For the imports of what not every installation has.

    Args:
        what: needs them.
        extra: of pyproject.toml, which has them.
        in_a_clone: the command that installs them there.

    Raises:
        MissingPartError: one of them is not installed, or not to be used here.
    """
    try:
        yield
    except Exception as error:  # protobuf refuses an older one by an error of its own
        reason = " ".join(str(error).split()).partition(". ")[0]
        raise MissingPartError(
            f"{what} cannot be used here ({reason}); install designrl[{extra}], or in a clone run "
            f"{in_a_clone}"
        ) from None


def printable(text: str) -> str:
    """Text from a stranger's file or a file's name, without what would command the terminal."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def remark(text: str) -> None:
    """Print a sentence on stderr, in one line."""
    print(_shortened(printable(text)), file=sys.stderr)


def _shortened(sentence: str) -> str:
    half = MAX_SENTENCE // 2
    return sentence if len(sentence) <= 2 * half else f"{sentence[:half]} … {sentence[-half:]}"
