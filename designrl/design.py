"""The learnable body: unbounded parameters -> bounded scales -> named dimensions.

A design is a vector of scales, one per dimension of the body, each between a space's bounds. The
paper lets every part vary by ±75 % of its original size: 0.25 to 1.75 (section 4, "we allow each
part to be scaled to a range of ±75% of its original value").
"""

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from numbers import Real

import numpy as np

from designrl.errors import InputError
from designrl.numeric import real_numbers

FORMS = {"bounded": 0.75, "lognormal": 4.0}  # of scales, and the limit of each: the author's
SMALLEST, LARGEST = 0.01, 100.0  # scales that a space may have


@dataclass(frozen=True)
class DesignSpace:
    """The dimensions of one kind of body, and how far they may go from the original.

    Attributes:
        names: one per dimension, in the paper's words ("top leg 1 width").
        originals: (D,) the original dimensions, in ``unit``; a negative one is a direction that a
            scale cannot flip.
        unit: what ``originals`` are measured in.
        limit: how far a scale may be from 1: with the form "bounded" 1 ± limit, with "lognormal"
            from 1 / limit to limit; None: as FORMS has it.
        form: "bounded", the paper's, 1 + 0.75 tanh(p), with its own slope to either side where
            the bounds are not alike; "lognormal", exp(p) cut at the bounds, of which the author's
            web page shows bodies. p = 0 is the original.
        bounds: in place of ``limit``, the lowest and the highest scale: two numbers, or two of (D,)
            numbers, around 1.
        low, high: (D,) the bounds.

    Raises:
        InputError: another form, or limits that are not around 1 or beyond SMALLEST and LARGEST.
    """

    names: tuple[str, ...]
    originals: np.ndarray = field(repr=False)
    unit: str
    limit: float | None = None
    form: str = "bounded"
    bounds: tuple | None = None
    low: np.ndarray = field(init=False, repr=False)
    high: np.ndarray = field(init=False, repr=False)

    def __post_init__(self):
        if self.form not in FORMS:
            raise InputError(f"design form is {self.form!r}; it must be one of {', '.join(FORMS)}")
        bounds = self.bounds
        if bounds is None:
            limit = FORMS[self.form] if self.limit is None else self.limit
            if not isinstance(limit, Real):
                raise InputError(f"design limit is {limit!r}; it must be a number")
            bounds = (1 - limit, 1 + limit)
            least, most = 0, 1 - SMALLEST
            if self.form == "lognormal":
                bounds, least, most = (1 / limit if limit else 0, limit), 1, LARGEST
            if not least < limit <= most:
                raise InputError(
                    f"design limit is {limit}; it must be above {least} and at most {most:g} for "
                    f"the form {self.form!r}"
                )
        try:
            low, high = (np.broadcast_to(real_numbers(each), self.size) for each in bounds)
        except (TypeError, ValueError):
            low = high = np.full(self.size, np.nan)
        if not ((low >= SMALLEST) & (low <= 1) & (high >= 1) & (high <= LARGEST)).all():
            raise InputError(
                f"design bounds are {bounds}; they must be the lowest scale, from {SMALLEST} to 1, "
                f"and the highest, from 1 to {LARGEST:g}, one for all or {self.size} each"
            )
        object.__setattr__(self, "low", low)
        object.__setattr__(self, "high", high)

    @property
    def size(self) -> int:
        """D, the number of dimensions."""
        return len(self.names)

    def within(self, bounds: tuple | None) -> "DesignSpace":
        """The same dimensions with other bounds; None: with these."""
        return self if bounds is None else replace(self, limit=None, bounds=bounds)

    @property
    def limits(self) -> dict:
        """Form and bounds, ready for JSON; `replace(space, **limits)` takes them."""
        each = [x.tolist() if np.ptp(x) else float(x[0]) for x in (self.low, self.high)]
        return {"form": self.form, "bounds": each}

    @property
    def in_words(self) -> str:
        """The limits: "0.25 to 1.75 times the original, bounded"."""
        low, high = self.limits["bounds"]
        return f"{low} to {high} times the original, {self.form}"

    def scales(self, parameters: np.ndarray) -> np.ndarray:
        """Bounded scales of unbounded parameters, of any shape (..., D)."""
        p = np.asarray(parameters, dtype=np.float64)
        if self.form == "lognormal":
            # NumPy's own exponential can have another last bit, depending on the processor.
            scales = np.vectorize(math.exp, otypes=[np.float64])(np.clip(p, -700.0, 700.0))
        else:
            share = np.tanh(p)
            scales = 1.0 + np.where(share < 0.0, 1.0 - self.low, self.high - 1.0) * share
        return np.clip(scales, self.low, self.high)

    def dimensions(self, scales: np.ndarray) -> np.ndarray:
        """Sizes in ``unit`` of scales of shape (..., D)."""
        return self.originals * np.asarray(scales, dtype=np.float64)

    def validate(self, scales) -> np.ndarray:
        """The scales as a new float64 array of shape (D,).

        Raises:
            InputError (a ValueError): wrong length, not numbers, NaN or out of bounds; the message
                names the dimension and what is allowed.
        """
        array = self._vector(scales)
        wrong = ~((array >= self.low) & (array <= self.high))  # also true for NaN
        if wrong.any():
            i = int(np.argmax(wrong))
            raise InputError(
                f"design scale {i} ({self.names[i]}) is {array[i]}; {self._allowed(i)} "
                "(in Python, an environment's design_bounds= sets other bounds)"
            )
        return array

    def _vector(self, scales) -> np.ndarray:
        try:
            array = real_numbers(scales)
        except ValueError:
            raise InputError(f"a design must be {self.size} numbers; {self._allowed(0)}") from None
        if array.shape != (self.size,):
            raise InputError(
                f"a design for this body has {self.size} scales ({self.names[0]}, ...), "
                f"got an array of shape {array.shape}; {self._allowed(0)}"
            )
        return array

    def _allowed(self, i: int) -> str:
        who = "it" if np.ptp(self.low) or np.ptp(self.high) else "each"
        return f"{who} must be in [{self.low[i]}, {self.high[i]}]"

    def changed(self, own: np.ndarray, design) -> np.ndarray:
        """Another body: (D,) scales, of whatever bounds.

        Args:
            own: (D,) scales of the body that is changed.
            design: (D,) scales, or a mapping from some of `names` to their scales.

        Raises:
            InputError: a name that there is not, a wrong length, or what is no number.
        """
        if not isinstance(design, Mapping):
            return self._vector(design)
        scales = dict(zip(self.names, own.tolist(), strict=True))
        for name in design:
            if name not in scales:
                near = difflib.get_close_matches(str(name), self.names, n=1)
                known = f"did you mean {near[0]!r}?" if near else f"it has {', '.join(self.names)}"
                raise InputError(f"this body has no dimension {name!r}; {known}")
        return self._vector(list({**scales, **design}.values()))

    def changes(self, own: np.ndarray, scales: np.ndarray) -> dict[str, float]:
        """Names of the dimensions in which a body differs from the agent's own -> their scales."""
        every = zip(self.names, own.tolist(), scales.tolist(), strict=True)
        return {name: scale for name, mine, scale in every if scale != mine}


def changes_in_words(changes: Mapping[str, float]) -> str:
    """`DesignSpace.changes` as a title has it; of more than three, how many."""
    if len(changes) > 3:
        return f"{len(changes)} dimensions changed"
    return ", ".join(f"{name} = {scale:.4g}" for name, scale in changes.items())
