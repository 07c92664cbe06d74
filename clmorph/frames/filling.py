"""Fill the holes of a frame, which are pixels that hardly any kernel reaches, by wider kernels."""

import numpy as np
from numpy.typing import NDArray

#: Coverage under which a pixel is empty: its kernel mass as a share of what a uniform
#: spread of the particles would give.
HOLE_COVERAGE = 1e-3
#: Coverage under which a pixel is torn, as a share of the coverage around it, and the size in
#: pixels of these surroundings.
HOLE_SHARE, HOLE_SURROUNDINGS = 0.1, 3.0
#: The same share from which a pixel counts as closed: closing others raises the coverage around it.
CLOSED_SHARE = 0.15
#: A pixel is filled entirely below this share of the coverage from which it is not filled at all.
#: In between its color is a mixture, so that it depends continuously on the coverage.
OPEN = 0.5
#: The change of the share to be filled below which the repetition in `fill` ends.
SETTLED = 1 / 256
#: The largest number of repetitions with one kernel: filling some pixels can leave others torn.
CASCADE = 16


class Filling:
    """The share of each pixel's color that comes from kernels wider than the frame's own.

    The shares depend continuously on the kernels' masses. So a pixel has the same color on both
    sides of a threshold that rounding, or a pair dropped from the plan, could make it cross.
    `closed` fills pixels that are torn, but not empty, too; `where` masks the pixels that may be
    filled.

    All attributes are (H, W) arrays: `wanted` is the share of a pixel's color that wider kernels
    are to supply, `given` what they have supplied so far, and `coverage` the frame's own, with that
    of the wider kernels in the pixels that they have filled.
    """

    def __init__(
        self, coverage: NDArray[np.float64], closed: bool, where: bool | NDArray[np.bool_]
    ) -> None:
        self._own, self._closed, self._where = coverage, closed, where
        self.coverage = coverage
        self._around = surroundings(coverage) if closed else coverage
        self.wanted = self._openness(coverage, self._around) * where
        self.given = np.zeros_like(coverage)
        #: Coverage by the wider kernels relative to its surroundings, times the share supplied.
        self._relative = np.zeros_like(coverage)

    @property
    def left(self) -> NDArray[np.float64]:
        """Share of each pixel that is still to be filled: (H, W) array."""
        return self.wanted - self.given

    @property
    def missing(self) -> float:
        """The largest share that is still to be filled."""
        return float(self.left.max())

    def _openness(
        self, own: NDArray[np.float64], around: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the degree to which pixels are holes: 0 at the threshold, 1 at `OPEN` times it."""
        needed: NDArray[np.float64] | float = HOLE_COVERAGE
        if self._closed:
            needed = np.maximum(CLOSED_SHARE * around, HOLE_COVERAGE)
        return np.asarray(np.clip((1.0 - own / needed) / (1.0 - OPEN), 0.0, 1.0))

    def fill(
        self, share: NDArray[np.float64], whole: NDArray[np.bool_] | None = None
    ) -> NDArray[np.float64]:
        """Fill pixels that a wider kernel covers, and return its share of their colors: (H, W).

        `share`, (H, W), is the coverage by that kernel; `whole` masks the pixels to fill: others
        are not filled, even if they are torn.
        """
        around = surroundings(share) if self._closed else share
        covers = 1.0 - self._openness(share, around) if whole is None else whole.astype(float)
        before, relative_before = self.given, self._relative
        given = (self.wanted - before) * covers
        if self._closed:
            relative = share / np.maximum(around, HOLE_COVERAGE)
            for _ in range(CASCADE):
                self.given = before + given
                # A filled pixel gets the coverage, relative to its surroundings, of the kernel
                # that fills it. This raises the surroundings of others, which the same kernel may
                # close.
                self._relative = relative_before + given * relative
                self.coverage = (1.0 - self.given) * self._own + self._relative * self._around
                self._around = surroundings(self.coverage)
                wanted = self._openness(self._own, self._around) * self._where
                change = np.maximum(wanted - self.wanted, 0.0)
                if change.max() <= SETTLED:
                    break
                self.wanted = self.wanted + change
                given = (self.wanted - before) * covers
        self.given = before + given
        return given


def is_torn(coverage: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which pixels are holes: far less covered than their surroundings, or empty.

    Coverage, (H, W), is the kernel mass as a share of that of a uniform spread.
    """
    return (coverage < HOLE_SHARE * surroundings(coverage)) | (coverage < HOLE_COVERAGE)


def surroundings(coverage: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean coverage of the surroundings of each pixel: (H, W) array."""
    from scipy.ndimage import gaussian_filter

    # The mean is that of square roots, so that a few spikes of a narrow kernel hardly raise it.
    mean = gaussian_filter(np.sqrt(coverage), HOLE_SURROUNDINGS, mode="reflect")
    return np.asarray(mean**2)
