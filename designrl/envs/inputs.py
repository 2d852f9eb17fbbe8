"""What `reset` and `step` take."""

import numpy as np

from designrl.design import DesignSpace
from designrl.errors import InputError


def chosen_design(options: dict | None, space: DesignSpace, current: np.ndarray) -> np.ndarray:
    """The scales (D,) of `reset(options={"design": scales})`; without them, the current ones.

    Raises:
        InputError: a design that is not one of the space's, or another option.
    """
    options = dict(options or {})
    design = options.pop("design", None)
    if options:
        raise InputError(f"unknown reset option {next(iter(options))!r}; there is 'design'")
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
