"""Numbers as they come from outside, of any library's types, and as we take them."""

import operator

import numpy as np

from designrl.errors import InputError


def whole_number(name: str, value, low: int, high: int | None = None) -> int:
    """A Python int of anything that is a whole number (NumPy's, PyTorch's).

    Raises:
        InputError: no whole number, or not from `low` to `high` (None: no end).
    """
    try:
        number = operator.index(value)
    except (TypeError, ValueError):
        number = None
    if number is None or number < low or (high is not None and number > high):
        end = "on" if high is None else f"to {_in_words(high)}"
        raise InputError(f"{name} is {value!r}; it must be a whole number from {low} {end}")
    return number


def _in_words(number: int) -> str:
    power = (number + 1).bit_length() - 1
    return f"2**{power} - 1" if power > 30 and number == 2**power - 1 else str(number)


def real_numbers(values) -> np.ndarray:
    """A new float64 array of the shape that the values have.

    Raises:
        ValueError: complex numbers, masked ones, texts, rows of unequal lengths, integers beyond
            float64.
    """
    # What a step is given: nothing of the below can be wrong with it, and looking takes longer.
    if type(values) is np.ndarray and values.dtype.char in "fd":
        return np.array(values, dtype=np.float64, order="C")
    if np.ma.is_masked(values):
        raise ValueError("some values are masked")
    try:
        found = np.asarray(values)
        if found.dtype.kind not in "biufO":
            raise ValueError(f"numbers of type {found.dtype}")
        with np.errstate(over="ignore"):  # of longer floats: they are infinite then
            return np.array(found, dtype=np.float64, order="C")
    except (TypeError, OverflowError, RuntimeError) as error:  # RuntimeError: PyTorch's tensors
        raise ValueError(str(error)) from None


def whole_numbers(values) -> np.ndarray:
    """An array of NumPy's integers, of the shape that the values have.

    Raises:
        ValueError: anything else, as `real_numbers`.
    """
    if np.ma.is_masked(values):
        raise ValueError("some values are masked")
    found = np.asarray(values)
    if found.dtype.kind not in "iu":
        raise ValueError(f"numbers of type {found.dtype}")
    return found
