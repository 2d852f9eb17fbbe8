"""What `step` takes."""

import numpy as np

from designrl.errors import InputError


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
