"""The result `Inspection`: measurements of a transport, and their picture."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from os import PathLike
from typing import TYPE_CHECKING

from clmorph._shared.notebook import figure
from clmorph.analysis.figures import draw_inspection, has_plotting, inspection_png, plotted
from clmorph.analysis.report import Report

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False, eq=False)
class Inspection(Report):
    """Measurements of a transport, and estimates of the time and memory of a morph by it.

    Attributes
    ----------
    source, target : Measure
    potentials : Potentials
    plan : Plan or None
        None if its pairs would take more memory than allowed.
    pairs : int
        Number of pairs that the plan keeps, even if it was not built.
    displacement : Displacement
        Displacement by the kept pairs; without a plan, by all pairs, computed in streaming.
    divergence : Divergence or None
        With an interval that certainly contains it.
    no_divergence : str
        The reason why there is no divergence; empty if there is one.
    memory : Memory
        Estimate for a morph.
    seconds : Seconds
    n_frames : int
        Number of frames for which `seconds.frames` is estimated.
    moving : int
        Number of particles of a morph that travel, between pixels: pairs of the plan, or draws
        from them.
    shapes : two of (height, width)
        Shapes of the images that a morph draws.
    device : str
        The device that was used.
    marks : Marks
        Landmarks.

    Examples
    --------
    >>> import clmorph
    >>> import numpy as np
    >>> left, right = np.zeros((2, 6, 6, 3))
    >>> left[:, :3] = right[:, 3:] = 1.0
    >>> found = clmorph.inspect(left, right, blur=0.1, reach=0.3, backend="numpy")
    >>> found.potentials.status
    'converged'
    >>> found.displacement.max > 0
    True
    """

    def plot(self) -> Figure:
        """Draw the picture of the transport with matplotlib, and return its figure.

        It shows both images, the displacement of pixels as arrows, the mass that is destroyed and
        created, how far mass travels, the residuals of the solver, and the main numbers. It is a
        figure of `matplotlib.pyplot`, so that ``plt.show()`` shows it.

        Raises
        ------
        OutputError
            If matplotlib is not installed: ``pip install "clmorph[plot]"``.

        Examples
        --------
        >>> import clmorph
        >>> import numpy as np
        >>> left, right = np.zeros((2, 6, 6, 3))
        >>> left[:, :3] = right[:, 3:] = 1.0
        >>> found = clmorph.inspect(left, right, blur=0.1, reach=0.3, backend="numpy")
        >>> try:
        ...     titles = [axes.get_title() for axes in found.plot().axes]
        ... except clmorph.OutputError:  # without matplotlib
        ...     titles = ["Source"]
        >>> titles[0]
        'Source'
        """
        return plotted(self)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the picture of `plot` to a file, as ``clmorph inspect -o`` does.

        Parameters
        ----------
        path : path
            Path of the file, which ends in ``.png``, ``.svg`` or ``.pdf``. An existing file is
            replaced.

        Raises
        ------
        OutputError
            If the file cannot be written, or matplotlib is not installed.

        Examples
        --------
        >>> import tempfile
        >>> from pathlib import Path
        >>> import clmorph
        >>> import numpy as np
        >>> left, right = np.zeros((2, 6, 6, 3))
        >>> left[:, :3] = right[:, 3:] = 1.0
        >>> found = clmorph.inspect(left, right, blur=0.1, reach=0.3, backend="numpy")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     try:
        ...         found.save(Path(folder) / "report.svg")
        ...     except clmorph.OutputError as error:  # without matplotlib
        ...         assert "clmorph[plot]" in str(error)
        """
        draw_inspection(self, path)

    def _repr_html_(self) -> str:
        """Show the picture in a notebook; without matplotlib the numbers alone."""
        if has_plotting():
            return figure(inspection_png(self), repr(self)[1:-1])
        lines = "\n".join(self.lines())
        return f"<pre>{escape(lines)}</pre>"
