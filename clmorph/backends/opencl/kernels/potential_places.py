"""Where the potentials of an iteration on the device stand, and what the host reads of it."""

import numpy as np

from clmorph.backends.records import IterationNumbers


class PotentialPlaces:
    """The slots of the potentials of an iteration, of which the last and the next one are kept.

    Attributes
    ----------
    at : int
        The slot of the next iteration's g.
    parity : int
        Which of two slots the next image has.
    prepared : int
        The slot of the potential for which the softmin of the rows is prepared; -1 if none is.
    """

    at: int
    parity: int
    prepared: int

    def place(self, slots: tuple[str, ...]) -> None:
        """Begin with the host's potential; `slots` are those of the columns' vectors."""
        self._start = slots.index("START")
        self._images, self._guesses = (slots.index(f"{name}_0") for name in ("IMAGE", "GUESS"))
        self.parity = 0
        self.go_to_start()

    @property
    def image(self) -> int:
        """The slot of the last iteration's image."""
        return self._images + self.parity

    def go_to_start(self) -> None:
        """Take the host's potential as the next one."""
        self.at, self.prepared = self._start, -1

    def go_on(self, extrapolated: bool) -> None:
        """Take the last iteration's guess, or its image, as the next potential."""
        self.at = (self._guesses if extrapolated else self._images) + self.parity
        self.parity = 1 - self.parity

    def go_back(self) -> None:
        """Drop the last iteration, and take the image of the one before as the next potential."""
        self.at = self._images + 1 - self.parity

    def has_prepared(self, guess: bool) -> None:
        """Note that the softmin of the last guess, or of the last image, is prepared."""
        self.prepared = (self._guesses if guess else self._images) + self.parity

    def control(self, begun: bool, place: int, count: int) -> np.uint32:
        """Return what kernels need to know of an iteration; see ``cl_kernels/half_steps.cl``."""
        return np.uint32(self.at | self.parity << 6 | int(begun) << 7 | place << 8 | count << 12)


def read_numbers(found: dict[str, float]) -> IterationNumbers:
    """Return the numbers of an iteration, by their names in the slots of the kernels."""
    return IterationNumbers(
        found["MASS"], found["ROW_DUAL"], found["RESIDUAL_SIZE"], found["COLUMN_DUAL"],
        bool(found["FOUND"]), bool(found["CUT"]),
        found["ROW_FINITE"] == 0 and found["COLUMN_FINITE"] == 0, found.get("MOVED", 0.0),
    )  # fmt: skip
