"""What `reset` and `step` take."""

import numpy as np
from gymnasium.utils import EzPickle

from designrl.bodies import Body
from designrl.errors import InputError


def checked_options(options: dict | None, *names: str) -> dict:
    """The options of a `reset`, as a new dict.

    Raises:
        InputError: one that has none of these names, or no dict.
    """
    if not isinstance(options, dict | None):
        raise InputError(f"reset options are a dict, as {{{names[0]!r}: ...}}, or None")
    options = dict(options or {})
    if unknown := sorted(set(options) - set(names)):
        known = " and ".join(map(repr, names))
        raise InputError(f"unknown reset option {unknown[0]!r}; there is {known}")
    return options


class HasDesign(EzPickle):
    """An environment with a `body`, in a design that is checked whenever it is set.

    The design is the first argument of `EzPickle.__init__`, which comes before it is set.
    """

    body: Body

    @property
    def design(self) -> np.ndarray:
        """(D,) scales, read-only; the body has those that are set from the next reset on.

        Raises:
            InputError: when set to what is not one of the body's designs.
        """
        return self._design

    @design.setter
    def design(self, scales) -> None:
        self._design = self.body.design.validate(scales)
        self._design.setflags(write=False)
        self._ezpickle_args = self._design, *self._ezpickle_args[1:]  # what a copy is made with

    def choose_design(self, options: dict | None) -> None:
        """Take `reset(options={"design": scales})`; without it, the design stays.

        Raises:
            InputError: not one of the body's designs, or another option.
        """
        design = checked_options(options, "design").get("design")
        if design is not None:
            self.design = design


def checked_action(action, size: int) -> np.ndarray:
    """(size,) float64.

    Raises:
        InputError: anything else than that many finite numbers.
    """
    try:
        found = np.asarray(action, dtype=np.float64)
    except (TypeError, ValueError):
        found = np.empty(0)
    if found.shape != (size,) or not np.isfinite(found).all():
        raise InputError(f"an action must be {size} finite numbers, got {action}")
    return found
