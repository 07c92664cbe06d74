"""Holes of a frame: pixels that hardly any kernel reaches, and how wider kernels fill them."""

import numpy as np
from numpy.typing import NDArray

#: Coverage under which a pixel is empty: its kernel mass as a share of what a uniform
#: spread of the particles would give.
HOLE_COVERAGE = 1e-3
#: The same as a share of that around it, within so many pixels: torn.
HOLE_SHARE, HOLE_SURROUNDINGS = 0.1, 3.0
#: The same from which on a pixel is closed: closing others raises what is around it.
CLOSED_SHARE = 0.15
#: A pixel is filled altogether below this share of the coverage at which it is left as it is. In
#: between it is a mixture, so that nothing depends on which side of a threshold a pixel is.
OPEN = 0.5
#: Change of what is to be filled that ends the cascade below.
SETTLED = 1 / 256
#: How often, at most, pixels that others leave torn by being filled are filled by the same kernel.
CASCADE = 16


class Filling:
    """How much of each pixel's color comes from kernels wider than the frame's own.

    All of it depends continuously on the kernels' masses: a pixel at a threshold, where rounding
    or a pair that the plan has dropped would tip it, has the same color on both sides.

    Parameters
    ----------
    coverage : (H, W) array
        By the frame's own kernel.
    closed : bool
        Whether pixels are filled that are only torn out of their surroundings.
    where : bool or (H, W) array of bool
        Which pixels may be filled.

    Attributes
    ----------
    wanted : (H, W) array
        Share of a pixel's color that is to come from wider kernels.
    given : (H, W) array
        Share of it that has come from them so far.
    coverage : (H, W) array
        The frame's coverage, with that of the wider kernels where these have filled it.
    """

    def __init__(
        self, coverage: NDArray[np.float64], closed: bool, where: bool | NDArray[np.bool_]
    ) -> None:
        self._own, self._closed, self._where = coverage, closed, where
        self.coverage = coverage
        self._around = surroundings(coverage) if closed else coverage
        self.wanted = self._openness(coverage, self._around) * where
        self.given = np.zeros_like(coverage)
        #: Coverage of what was given beside its surroundings, times its share.
        self._relative = np.zeros_like(coverage)

    @property
    def left(self) -> NDArray[np.float64]:
        """(H, W) share that is still to be filled."""
        return self.wanted - self.given

    @property
    def missing(self) -> float:
        """The largest share that is still to be filled."""
        return float(self.left.max())

    def _openness(
        self, own: NDArray[np.float64], around: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return how torn pixels are: from 0 at the threshold to 1 at the share `OPEN` of it."""
        needed: NDArray[np.float64] | float = HOLE_COVERAGE
        if self._closed:
            needed = np.maximum(CLOSED_SHARE * around, HOLE_COVERAGE)
        return np.asarray(np.clip((1.0 - own / needed) / (1.0 - OPEN), 0.0, 1.0))

    def fill(
        self, share: NDArray[np.float64], whole: NDArray[np.bool_] | None = None
    ) -> NDArray[np.float64]:
        """Fill what a wider kernel covers, and return its share of each pixel's color: (H, W).

        Parameters
        ----------
        share : (H, W) array
            Coverage by that kernel.
        whole : (H, W) array of bool, optional
            Pixels that it is to fill, and no others, however torn.
        """
        around = surroundings(share) if self._closed else share
        covers = 1.0 - self._openness(share, around) if whole is None else whole.astype(float)
        before, relative_before = self.given, self._relative
        given = (self.wanted - before) * covers
        if self._closed:
            relative = share / np.maximum(around, HOLE_COVERAGE)
            for _ in range(CASCADE):
                self.given = before + given
                # As covered, beside its surroundings, as it is with the kernel that covers it;
                # this raises what surrounds others, which the same kernel may close.
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
    """Return which pixels are holes: far less covered than what surrounds them, or not at all.

    Parameters
    ----------
    coverage : (H, W) array
        Kernel mass as a share of a uniform spread's.
    """
    return (coverage < HOLE_SHARE * surroundings(coverage)) | (coverage < HOLE_COVERAGE)


def surroundings(coverage: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how well the surroundings of each pixel are covered: (H, W) array."""
    from scipy.ndimage import gaussian_filter

    # A mean of roots: a few spikes of a narrow kernel say nothing about their surroundings.
    mean = gaussian_filter(np.sqrt(coverage), HOLE_SURROUNDINGS, mode="reflect")
    return np.asarray(mean**2)
