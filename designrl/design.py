"""The learnable body: unbounded parameters -> bounded scales -> named dimensions.

A design is a vector of scales, one per dimension of the body, each in [0.25, 1.75]: the paper lets
every part vary by ±75 % of its original size (section 4, "we allow each part to be scaled to a
range of ±75% of its original value").
"""

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from designrl.errors import InputError
from designrl.numeric import real_numbers

SCALE_RANGE = 0.75  # the ±75 % of section 4
SCALE_MIN, SCALE_MAX = 1.0 - SCALE_RANGE, 1.0 + SCALE_RANGE


@dataclass(frozen=True)
class DesignSpace:
    """The dimensions of one kind of body.

    Attributes:
        names: one per dimension, in the paper's words ("top leg 1 width").
        originals: (D,) the original dimensions, in ``unit``; a negative one is a direction that a
            scale cannot flip.
        unit: what ``originals`` are measured in.
    """

    names: tuple[str, ...]
    originals: np.ndarray = field(repr=False)
    unit: str

    @property
    def size(self) -> int:
        """D, the number of dimensions."""
        return len(self.names)

    def scales(self, parameters: np.ndarray) -> np.ndarray:
        """Bounded scales of unbounded parameters: 1 + 0.75 tanh(p), of any shape (..., D)."""
        return 1.0 + SCALE_RANGE * np.tanh(np.asarray(parameters, dtype=np.float64))

    def dimensions(self, scales: np.ndarray) -> np.ndarray:
        """Sizes in ``unit`` of scales of shape (..., D)."""
        return self.originals * np.asarray(scales, dtype=np.float64)

    def validate(self, scales) -> np.ndarray:
        """The scales as a new float64 array of shape (D,).

        Raises:
            InputError (a ValueError): wrong length, not numbers, NaN or outside [0.25, 1.75]; the
                message names the dimension and what is allowed.
        """
        allowed = f"each must be in [{SCALE_MIN}, {SCALE_MAX}]"
        try:
            array = real_numbers(scales)
        except ValueError:
            raise InputError(f"a design must be {self.size} numbers; {allowed}") from None
        if array.shape != (self.size,):
            raise InputError(
                f"a design for this body has {self.size} scales ({self.names[0]}, ...), "
                f"got an array of shape {array.shape}; {allowed}"
            )
        wrong = ~((array >= SCALE_MIN) & (array <= SCALE_MAX))  # also true for NaN
        if wrong.any():
            i = int(np.argmax(wrong))
            raise InputError(f"design scale {i} ({self.names[i]}) is {array[i]}; {allowed}")
        return array

    def changed(self, own: np.ndarray, design) -> np.ndarray:
        """Another body: (D,) scales.

        Args:
            own: (D,) scales of the body that is changed.
            design: (D,) scales, or a mapping from some of `names` to their scales.

        Raises:
            InputError: a name that there is not, or as `validate`.
        """
        if not isinstance(design, Mapping):
            return self.validate(design)
        scales = dict(zip(self.names, own.tolist(), strict=True))
        for name in design:
            if name not in scales:
                near = difflib.get_close_matches(str(name), self.names, n=1)
                known = f"did you mean {near[0]!r}?" if near else f"there is {self.names[0]!r}, ..."
                raise InputError(f"this body has no dimension {name!r}; {known}")
        return self.validate(list({**scales, **design}.values()))

    def changes(self, own: np.ndarray, scales: np.ndarray) -> dict[str, float]:
        """Names of the dimensions in which a body differs from the agent's own -> their scales."""
        every = zip(self.names, own.tolist(), scales.tolist(), strict=True)
        return {name: scale for name, mine, scale in every if scale != mine}


def in_words(changes: Mapping[str, float]) -> str:
    """`DesignSpace.changes` as a title has it; of more than three, how many."""
    if len(changes) > 3:
        return f"{len(changes)} dimensions changed"
    return ", ".join(f"{name} = {scale:.4g}" for name, scale in changes.items())
