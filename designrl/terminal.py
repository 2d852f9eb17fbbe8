"""Where a command was started: its streams may be closed or full, its signals ignored."""

import io
import os
import signal
import sys

LOUD = "strict", "surrogateescape"  # handlers of a character that the charset lacks: they raise


class _Words(io.FileIO):
    """A standard stream whose words are dropped once they cannot be said."""

    error: OSError | None = None

    def write(self, data) -> int | None:
        try:
            return super().write(data)
        except OSError as error:
            self.error = error
            return len(data)


def open_streams() -> None:
    """Let no word stop the work: what a closed or full stream does not take is dropped.

    A character that the terminal's charset lacks becomes a question mark.
    """
    while (file := os.open(os.devnull, os.O_RDWR)) <= 2:  # else a file of ours would be stdout
        pass
    os.close(file)
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(number, "w" if number else "r", closefd=False))  # noqa: SIM115
        elif number and stream is getattr(sys, f"__{name}__"):  # nobody has put his own there
            stream.flush()
            file = _Words(stream.fileno(), "w", closefd=False)
            unbuffered = isinstance(stream.buffer, io.RawIOBase)  # with PYTHONUNBUFFERED
            words = io.TextIOWrapper(
                file if unbuffered else io.BufferedWriter(file),
                encoding=stream.encoding,
                errors="replace" if stream.errors in LOUD else stream.errors,
                line_buffering=stream.line_buffering,
                write_through=stream.write_through,
            )
            setattr(sys, name, words)


def unsaid() -> OSError | None:
    """Why words on stdout were dropped, if any were."""
    sys.stdout.flush()
    file = getattr(sys.stdout, "buffer", None)
    return getattr(getattr(file, "raw", file), "error", None)


def heed_signals() -> None:
    """A polite kill and a closed terminal interrupt like Ctrl-C, unless ignored (`nohup`)."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)
