"""The one error type that means "the input is wrong", as opposed to a bug."""


class InputError(ValueError):
    """Input that cannot be used: a file, a design, a name, a folder, a full disk.

    The message is one sentence that names the thing and what to do about it. The command line
    prints it and exits with code 2.
    """
