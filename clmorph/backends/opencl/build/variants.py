"""The variants in which kernel files are built."""

from dataclasses import dataclass

from clmorph.backends.opencl.build.constants import SLICED_FROM, BuildConstants
from clmorph.backends.opencl.build.kernel_files import KERNELS as KERNELS
from clmorph.backends.opencl.devices.verdicts import OPTIONAL


@dataclass(frozen=True)
class Variant:
    """A kernel file, and what its macros depend on beside the build constants."""

    file: str
    #: Dimension of the points, for the files that include the row loop; 0 for others. Variants for
    #: `SLICED_FROM` serve all larger dimensions, too.
    dimension: int = 0
    #: These and the following ones are explained in `BuildConstants.row_macros`.
    precise: bool = False
    listed: bool = False
    bounded: int = 0
    masked: bool = False

    @property
    def in_blocks(self) -> bool:
        """Whether work-items take several groups of rows: where rows suffice for all cores."""
        if self.file == "near_field.cl":
            return True
        return self.file == "log_sum_exp.cl" and (self.masked or self.is_sliced)

    @property
    def is_sliced(self) -> bool:
        """Whether the dimension is an argument of the kernels."""
        return self.dimension >= SLICED_FROM

    def stacks(self, constants: BuildConstants) -> int:
        """Return how many work-items of a group share their rows."""
        if self.file != "log_sum_exp.cl":
            return 1
        return constants.stacks(self.dimension, self.precise)

    def macros(self, constants: BuildConstants) -> dict[str, int | float]:
        """Return the macros of the program for these build constants."""
        if self.is_optional:
            sparse = self.file == "sparse_half_steps.cl"
            return constants.sparse_half_step_macros() if sparse else constants.half_step_macros()
        if not self.dimension:
            return constants.file_macros(self.file, self.precise)
        return constants.row_macros(
            self.dimension, self.precise, self.listed, self.bounded, self.masked, self.in_blocks,
            self.stacks(constants),
        )  # fmt: skip

    def suits(self, constants: BuildConstants) -> bool:
        """Return whether a device has what the file needs: float64, or long loops to iterate."""
        if self.file == "tile_levels.cl":
            return bool(constants.float64)
        if self.file == "grid_log_sum_exp.cl":
            return bool(not self.precise or constants.float64)
        return not (self.is_optional and constants.longest_loop)

    @property
    def is_optional(self) -> bool:
        """Whether the host does without the program."""
        return self.file in OPTIONAL

    def __str__(self) -> str:
        words = [f"dimension {self.dimension}"] if self.dimension else []
        words += [
            name for name in ("precise", "listed", "masked", "bounded") if getattr(self, name)
        ]
        words += ["powers in float32"] if self.bounded == 2 else []
        return f"{self.file} ({', '.join(words)})" if words else self.file


def usual_variants(dimension: int = 5) -> tuple[Variant, ...]:
    """Return the variants that a morph with default options uses; opaque pictures are in 5D."""
    return (
        Variant("log_sum_exp.cl", dimension),
        Variant("log_sum_exp.cl", dimension, precise=True, bounded=1),
        Variant("plan_rows.cl", dimension),
        Variant("plan_shares.cl", dimension),
        Variant("particles.cl"),
        Variant("splat.cl"),
        Variant("gauss_transform.cl"),
        Variant("layers.cl"),
    )


def further_variants(dimension: int = 5) -> tuple[Variant, ...]:
    """Return the variants that photographs and drawings use beside the usual ones."""
    return (
        Variant("tile_levels.cl"),
        Variant("near_field.cl", dimension, listed=True),
        Variant("log_sum_exp.cl", dimension, listed=True, masked=True),
        Variant("log_sum_exp.cl", dimension, precise=True),
        Variant("log_sum_exp.cl", dimension, precise=True, listed=True, bounded=2, masked=True),
        Variant("plan_shares.cl", dimension, listed=True, masked=True),
        Variant("plan_rows.cl", dimension, listed=True),
        Variant("sliced_ellpack.cl"),
        Variant("sparse_half_steps.cl"),  # last: a crash in it leaves the others verified
    )


def all_variants(dimension: int = 5) -> tuple[Variant, ...]:
    """Return every file in every variant that operations on points of a dimension use."""
    both = False, True
    softmins = [(False, False, 0), (False, True, 0), (True, False, 0), (True, True, 0)]
    softmins += [(True, False, 1), (True, True, 1)]
    masked = [(False, True, 0), (True, True, 0), (True, True, 1), (True, True, 2)]
    if dimension >= SLICED_FROM:
        masked.pop()  # all exponents of a tile are formed in one precision
    made = [Variant("log_sum_exp.cl", dimension, *kind) for kind in softmins]
    made += [Variant("log_sum_exp.cl", dimension, *kind, masked=True) for kind in masked]
    made.append(Variant("near_field.cl", dimension, listed=True))
    for file in ("plan_rows.cl", "barycentric_projection.cl", "plan_shares.cl"):
        made += [
            Variant(file, dimension, precise, listed, masked=listed and file == "plan_shares.cl")
            for precise in both
            for listed in both
        ]
    made += [Variant("grid_log_sum_exp.cl", precise=precise) for precise in both]
    rest = [Variant(file) for file in KERNELS if file not in {variant.file for variant in made}]
    return (*made, *rest)


def used_together(variant: Variant) -> tuple[Variant, ...]:
    """Return the variants that one morph, or solve, uses with this one; else this one alone."""
    if variant.is_optional:
        return (variant,)
    dimension = variant.dimension or 5
    if variant.is_sliced:
        # What a solve uses, beside what morphs use, too.
        solve = (
            Variant("log_sum_exp.cl", dimension),
            Variant("log_sum_exp.cl", dimension, precise=True, bounded=1),
        )
        return solve if variant in solve else (variant,)
    groups = usual_variants(dimension), further_variants(dimension)
    return next((group for group in groups if variant in group), (variant,))
