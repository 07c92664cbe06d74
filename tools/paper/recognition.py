"""Test by the published Table 1 whether a pair of images is that of the authors."""

from collections.abc import Mapping
from dataclasses import dataclass

from paper.setting import PUBLISHED_DISPLACEMENTS, PUBLISHED_SIZE, reach_text

#: Pixels by which a number may differ from its published one: half a unit of the last digit, and
#: what float32, in which the authors computed, can add.
LAST_DIGIT = 0.005 + 0.001


@dataclass(frozen=True)
class Recognition:
    """What Table 1 says about a pair.

    Attributes
    ----------
    same : bool or None
        Whether it is the authors' pair; None if the images have another size than the published
        table's, which decides nothing.
    text : str
        The same for readers.
    """

    same: bool | None
    text: str

    @property
    def published(self) -> str:
        """How published numbers are named beside those of this pair."""
        return "published" if self.same else "published, authors' pair"


def difference(
    displacements: Mapping[float | None, tuple[float, float]],
) -> tuple[float, float | None]:
    """Return the largest difference from the published Table 1, in pixels, and at which reach.

    Parameters
    ----------
    displacements : mapping
        Largest and mean displacement in pixels, by reach.
    """
    differences = {
        reach: max(abs(ours - theirs) for ours, theirs in zip(own, published, strict=True))
        for (reach, published) in PUBLISHED_DISPLACEMENTS.items()
        for own in [displacements[reach]]
    }
    worst = max(differences, key=lambda reach: differences[reach])
    return differences[worst], worst


def recognize(displacements: Mapping[float | None, tuple[float, float]], size: int) -> Recognition:
    """Compare Table 1 of a pair, made by the paper's recipe, with the published one.

    Parameters
    ----------
    displacements : mapping
        Largest and mean displacement in pixels, by reach.
    size : int
        Side of the images, in pixels.
    """
    if size != PUBLISHED_SIZE:
        return Recognition(
            None,
            f"The published Table 1 is of images of {PUBLISHED_SIZE} × {PUBLISHED_SIZE} pixels, "
            f"this run's of {size} × {size}: whether this is the authors' pair shows in a run "
            "without --quick and --size.",
        )
    largest, reach = difference(displacements)
    if largest <= LAST_DIGIT:
        return Recognition(
            True,
            "Table 1 of these images is the published one, to its last digit at every reach: they "
            "are the authors' pair.",
        )
    return Recognition(
        False,
        f"Table 1 of these images differs from the published one by up to {largest:.2f} px "
        f"({reach_text(reach)}): they are another pair than the "
        "authors', and the published numbers are not to be expected of them. --source and "
        "--target take any two images.",
    )
