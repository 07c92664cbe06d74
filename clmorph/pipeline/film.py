"""What the results of morphs and of rearrangements have in common."""

from os import PathLike
from typing import Any

import numpy as np

from clmorph._shared.typing import Array
from clmorph.frames.sequence import FrameSequence
from clmorph.measures.measure import Measure
from clmorph.output.html.summary import repr_html
from clmorph.output.save import save


class Film(FrameSequence):
    """Frames that are saved and shown."""

    def save(self, path: str | PathLike[str], **options: Any) -> None:
        """Write the frames to a file whose ending selects the format.

        Parameters
        ----------
        path : path
            Path of the file, such as ``out.gif``, ``out.mp4`` or ``out.html``.
        **options
            See `clmorph.save`.

        Raises
        ------
        InputError
            If an option cannot be used.
        OutputError
            If the file cannot be written.

        Examples
        --------
        >>> import tempfile
        >>> from pathlib import Path
        >>> import clmorph
        >>> import numpy as np
        >>> left, right = np.zeros((2, 6, 6, 3))
        >>> left[:, :3] = right[:, 3:] = 1.0
        >>> morph = clmorph.morph(left, right, n_frames=5, backend="numpy")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     morph.save(Path(folder) / "out.gif", fps=10)
        ...     sorted(path.name for path in Path(folder).iterdir())
        ['out.gif']
        """
        save(self, path, **options)

    def _repr_html_(self) -> str:
        """Show the frames in a notebook as an interactive page."""
        return repr_html(self)


def picture_of(measure: Measure) -> Array:
    """Return the pixels of a lifted image, with its opacity if it has some: (H, W, 3 or 4)."""
    channels = [measure.colors]
    channels += [] if measure.alpha is None else [measure.alpha[:, None]]
    return np.hstack(channels).reshape(*measure.shape, -1)
