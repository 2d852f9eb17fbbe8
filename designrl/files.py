"""Files as a whole: written so that a kill loses nothing, read without taking all memory."""

import fcntl
import hashlib
import os
import re
import secrets
from pathlib import Path

from designrl.errors import InputError


def file_hash(path: str | Path) -> str:
    """SHA-256 of a file, in hex."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_atomically(path: str | Path, data: bytes) -> None:
    """Write a file so that it holds either its old content or all of the new one.

    Raises:
        InputError: the file cannot be written (no space, no permission).
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file, temporary = create_beside(path)
        try:
            try:
                rest = memoryview(data)
                while rest:
                    rest = rest[os.write(file, rest) :]
                os.fsync(file)
            finally:
                os.close(file)
            replace(temporary, path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise cannot_write(path, error) from None


def create_beside(path: Path) -> tuple[int, Path]:
    """A new file to write, and its name beside `path`, until `replace` gives it that one.

    Raises:
        OSError: as the system says.
    """
    # A name that nobody can foresee, and only if nothing is there: no link leads elsewhere.
    temporary = path.with_name(f".new-{path.name}-{secrets.token_hex(8)}")
    return os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666), temporary


def require_new(path: str | Path) -> None:
    """Raise InputError where there is something of that name already, be it a link to nothing."""
    if os.path.lexists(path):
        raise InputError(f"{path} exists already; remove it or choose another name")


def is_locked(path: Path) -> bool:
    """Another process, or another open file of this one, holds the lock of a file."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(file)
    return False


def remove_unfinished(folder: Path, names: str) -> None:
    """Remove what a kill has left of files whose names match a regular expression."""
    for path in folder.glob(".new-*"):
        ours = re.fullmatch(rf"\.new-(?:{names})-[0-9a-f]{{16}}", path.name)
        if ours and path.is_file() and not path.is_symlink():
            path.unlink(missing_ok=True)


def replace(temporary: Path, path: Path) -> None:
    """Give a file that is on the disk its name, so that a power cut spares the new name, too.

    Raises:
        OSError: as the system says.
    """
    os.replace(temporary, path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def cannot_write(path: Path, error: OSError) -> InputError:
    """What to say where a file cannot be written."""
    return InputError(
        f"{path} cannot be written ({error.strerror}); free some space, allow writing there or "
        "choose another place"
    )


def read_limited(path: str | Path, limit: int) -> bytes:
    """A file's first `limit` bytes and one more, if it has them; waits for no device.

    Raises:
        InputError: missing, a folder, not a plain file, or not readable.
    """
    path = Path(path)
    try:
        path.stat()
        if path.is_dir():
            raise InputError(f"{path} is a folder; name a file in it")
        if not path.is_file():
            raise InputError(f"{path} is not a file; name one")
        with path.open("rb") as file:
            return file.read(limit + 1)
    except OSError as error:
        raise InputError(
            f"{path} cannot be read ({error.strerror}); check its name and permissions"
        ) from None
