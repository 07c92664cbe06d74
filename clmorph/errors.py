"""Exceptions and warnings of clmorph.

Every message is one line that says what was wrong, what was expected, and what to do. File
names and values that it quotes may be foreign: whatever they hold, the message is printable and
of bounded length.
"""

from clmorph._shared.printable import MESSAGE, printable


class ClmorphError(Exception):
    """Base class of every error that clmorph raises on purpose.

    Examples
    --------
    >>> import clmorph
    >>> try:
    ...     clmorph.read_image("missing.png")
    ... except clmorph.ClmorphError as error:
    ...     print(type(error).__name__)
    FileError
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(printable(message, MESSAGE))


class InputError(ClmorphError, ValueError):
    """A value given by the caller cannot be used: wrong shape, range, name or file.

    Examples
    --------
    It is a `ValueError`, too:

    >>> import clmorph
    >>> import numpy as np
    >>> try:
    ...     clmorph.lift(np.zeros((4, 4, 3)), color_weight=-1)
    ... except ValueError as error:
    ...     print(isinstance(error, clmorph.InputError))
    True
    """


class FileError(InputError):
    """An image file cannot be read; the message begins with its name.

    Examples
    --------
    >>> import clmorph
    >>> try:
    ...     clmorph.read_image("missing.png")
    ... except clmorph.FileError as error:
    ...     print(str(error).startswith("missing.png: "))
    True
    """


class PlanSizeError(InputError):
    """A plan would keep more pairs than it may.

    Attributes
    ----------
    pairs : int
        The number of pairs that the plan would keep.

    Examples
    --------
    >>> import clmorph
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> source, target = ((np.full(30, 1 / 30), rng.random((30, 2))) for _ in range(2))
    >>> result = clmorph.sinkhorn(source, target, blur=0.3, backend="numpy")
    >>> try:
    ...     clmorph.transport_plan(source, target, result, max_bytes=1000, backend="numpy")
    ... except clmorph.PlanSizeError as error:
    ...     print(error.pairs)
    900
    """

    def __init__(self, message: str, pairs: int) -> None:
        super().__init__(message)
        self.pairs = pairs

    def __reduce__(self) -> tuple[type["PlanSizeError"], tuple[str, int]]:
        """Return how it is made again, which pools of processes need to pass it on."""
        return type(self), (str(self), self.pairs)


class DeviceError(ClmorphError, RuntimeError):
    """No OpenCL device fits the request, or the device failed.

    Examples
    --------
    >>> import clmorph
    >>> try:
    ...     clmorph.get_backend("a device that does not exist")
    ... except clmorph.DeviceError:
    ...     operations = clmorph.get_backend("numpy")
    """


class OutputError(ClmorphError, RuntimeError):
    """A result cannot be written where it was asked for.

    Examples
    --------
    >>> import clmorph
    >>> import numpy as np
    >>> result = clmorph.morph(np.zeros((2, 2, 3)), np.ones((2, 2, 3)), n_frames=2, backend="numpy")
    >>> try:
    ...     result.save("missing/out.gif")
    ... except clmorph.OutputError:
    ...     print("there is no such folder")
    there is no such folder
    """


class ClmorphWarning(UserWarning):
    """Base class of every warning that clmorph gives.

    Examples
    --------
    Raise warnings as errors:

    >>> import clmorph, warnings
    >>> import numpy as np
    >>> images = np.zeros((2, 2, 3)), np.ones((2, 2, 3))
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("error", clmorph.ClmorphWarning)
    ...     result = clmorph.morph(*images, n_frames=2, backend="numpy")
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(printable(message, MESSAGE))


class ConvergenceWarning(ClmorphWarning):
    """The transport solver stopped before it reached the tolerance.

    Examples
    --------
    >>> import clmorph, warnings
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> pair = [(np.full(20, 0.05), rng.random((20, 2))) for _ in range(2)]
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     result = clmorph.sinkhorn(*pair, blur=0.01, max_iter=1, backend="numpy")
    >>> caught[0].category.__name__, result.status
    ('ConvergenceWarning', 'max_iter')
    """


class MemoryWarning(ClmorphWarning):
    """Not all pairs of a plan fit into the memory allowed, so fewer particles are drawn.

    Examples
    --------
    Refuse to draw fewer particles:

    >>> import clmorph, warnings
    >>> import numpy as np
    >>> images = np.zeros((2, 2, 3)), np.ones((2, 2, 3))
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("error", clmorph.MemoryWarning)
    ...     result = clmorph.morph(*images, n_frames=2, backend="numpy")
    """


class PruningWarning(ClmorphWarning):
    """A threshold on log pi drops much of a plan's mass: it is too high for so many points.

    Examples
    --------
    >>> import clmorph, warnings
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> images = rng.random((2, 5, 5, 3))
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     result = clmorph.morph(*images, blur=0.1, log_threshold=-3.5, backend="numpy")
    >>> caught[0].category.__name__
    'PruningWarning'
    """


class OptionWarning(ClmorphWarning):
    """A value of an option has another name now; the old one works until version 1.0.

    Examples
    --------
    >>> import clmorph, warnings
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     options = clmorph.MorphOptions(detail="carried")
    >>> caught[0].category.__name__, options.detail
    ('OptionWarning', 'layers')
    """


class ImageWarning(ClmorphWarning):
    """An image file was read, but not all of it was used: a color profile, bits, later pictures.

    Examples
    --------
    >>> import clmorph, warnings
    >>> from PIL import Image
    >>> pictures = [Image.new("RGB", (4, 4), color) for color in ("red", "blue")]
    >>> pictures[0].save("two.gif", save_all=True, append_images=pictures[1:])
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     image = clmorph.read_image("two.gif")
    >>> caught[0].category.__name__
    'ImageWarning'
    """
