"""What `reset` and `step` take."""

import numpy as np

from designrl.design import DesignSpace
from designrl.errors import InputError


def checked_options(options: dict | None, *names: str) -> dict:
    """The options of a `reset`, as a new dict.

    Raises:
        InputError: one that has none of these names.
    """
    options = dict(options or {})
    if unknown := sorted(set(options) - set(names)):
        known = " and ".join(map(repr, names))
        raise InputError(f"unknown reset option {unknown[0]!r}; there is {known}")
    return options


def chosen_design(options: dict | None, space: DesignSpace, current: np.ndarray) -> np.ndarray:
    """The scales (D,) of `reset(options={"design": scales})`; without them, the current ones.

    Raises:
        InputError: a design that is not one of the space's, or another option.
    """
    design = checked_options(options, "design").get("design")
    return current if design is None else space.validate(design)


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
